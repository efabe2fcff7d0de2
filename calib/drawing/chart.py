"""Axes with lines, dots, bands and bars. A colour is what a style sheet knows: ``#1f6fb2``, ``var(--model)``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike, NDArray

from mavcal.calib.drawing.picture import dotted, svg, text
from mavcal.calib.drawing.scale import runs_inside, shares, ticks

Array = NDArray[np.float64]

LETTER = 5.9
"""Mean width of a letter of the legend."""
_LEFT, _RIGHT, _TOP, _BOTTOM = 62, 12, 40, 38


@dataclass
class Chart:
    """One pair of axes; a logarithmic axis takes positive numbers. Lines outside of them are cut off."""

    title: str
    x_label: str
    y_label: str
    x: tuple[float, float]
    y: tuple[float, float]
    width: int = 430
    height: int = 240
    log_x: bool = False
    log_y: bool = False
    legend_inside: bool = False
    """The legend stands in the upper right corner of the axes: for names that are long; else in a row above them."""
    x_names: Sequence[str] = ()
    """Words at 0, 1, 2 ... of x instead of numbers."""
    parts: list[Markup] = field(default_factory=list)
    legend: list[tuple[str, str]] = field(default_factory=list)
    """Colours and what they mean."""

    def line(
        self, x: ArrayLike, y: ArrayLike, colour: str, name: str = "", *, thin: bool = False, dashed: bool = False
    ) -> None:
        """A line through points, and its name in the legend; gaps where a number is not finite."""
        wide, dash = "0.8" if thin else "1.8", Markup(' stroke-dasharray="5 4"') if dashed else ""
        for run in runs_inside(*self._shares(x, y)):
            points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(*self._at(*np.transpose(run)), strict=True))
            self.parts.append(
                Markup('<polyline points="{}" fill="none" style="stroke:{}" stroke-width="{}"{}/>').format(
                    points, colour, wide, dash
                )
            )
        self._named(colour, name)

    def dots(self, x: ArrayLike, y: ArrayLike, colour: str, name: str = "", *, size: float = 1.4) -> None:
        """A dot a point: one path, so that many stay small."""
        self.parts.append(dotted(*self._inside(x, y), colour, size=size))
        self._named(colour, name)

    def bars(self, x: ArrayLike, y: ArrayLike, half: ArrayLike, colour: str, name: str = "") -> None:
        """A dot with its interval at each point."""
        middle, reach = np.asarray(y, dtype=np.float64), np.asarray(half, dtype=np.float64)
        u, low = self._shares(x, middle - reach)
        _, high = self._shares(x, middle + reach)
        rows = zip(*self._at(u, np.clip(low, 0.0, 1.0)), self._at(u, np.clip(high, 0.0, 1.0))[1], strict=True)
        for a, b, c in rows:
            self.parts.append(
                Markup('<path d="M{:.1f} {:.1f}V{:.1f}" style="stroke:{}" stroke-width="1"/>').format(a, b, c, colour)
            )
        self.parts.append(dotted(*self._inside(x, y), colour, size=2.4, opacity=1.0))
        self._named(colour, name)

    def mark(self, x: float, words: str, colour: str) -> None:
        """An upright line with a word."""
        (a,), _ = self._at(*self._shares([x], [self.y[0]]))
        self.parts.append(
            Markup('<path d="M{:.1f} {}V{}" style="stroke:{}" stroke-dasharray="4 3"/>').format(
                a, _TOP, self.height - _BOTTOM, colour
            )
            + text(a + 3, _TOP + 11, words)
        )

    def drawn(self) -> Markup:
        """The picture, for a page."""
        return svg(self.width, self.height, [self.body()], self.title)

    def body(self) -> Markup:
        """Everything within the frame of the picture."""
        right, bottom = self.width - _RIGHT, self.height - _BOTTOM
        out = [text(_LEFT, 16, self.title, kind="title")]
        named = [(float(place), name) for place, name in enumerate(self.x_names)]
        for value, label in named or ticks(self.x, log=self.log_x):
            (a,), _ = self._at(*self._shares([value], [self.y[0]]))
            rule = Markup('<path class="grid" d="M{:.1f} {}V{}"/>').format(a, _TOP, bottom)
            out += [rule, text(a, bottom + 14, label, anchor="middle")]
        for value, label in ticks(self.y, log=self.log_y):
            _, (b,) = self._at(*self._shares([self.x[0]], [value]))
            rule = Markup('<path class="grid" d="M{} {:.1f}H{}"/>').format(_LEFT, b, right)
            out += [rule, text(_LEFT - 5, b + 3.5, label, anchor="end")]
        out += self.parts
        # Only a file's own style draws it.
        edge = Markup('<rect x="{}" y="{}" width="{}" height="{}" fill="none" class="edge"/>')
        out.append(edge.format(_LEFT, _TOP, right - _LEFT, bottom - _TOP))
        out.append(text((_LEFT + right) / 2, self.height - 8, self.x_label, anchor="middle", kind="axis"))
        middle = (_TOP + bottom) / 2
        turned = text(0, 0, self.y_label, anchor="middle", kind="axis")
        out.append(Markup('<g transform="translate(13 {:.0f}) rotate(-90)">{}</g>').format(middle, turned))
        out += self._legend_inside() if self.legend_inside else self._legend_above()
        return Markup().join(out)

    def _legend_above(self) -> list[Markup]:
        out, x = [], float(_LEFT)
        for colour, name in self.legend:
            out += [_key(x, 27, colour), text(x + 18, 31, name, kind="legend")]
            x += 30 + LETTER * len(name)
        return out

    def _legend_inside(self) -> list[Markup]:
        right, out = self.width - _RIGHT, []
        for k, (colour, name) in enumerate(self.legend):
            y = _TOP + 12 + 14 * k
            out += [_key(right - 18, y - 4, colour), text(right - 22, y, name, anchor="end", kind="legend")]
        return out

    def _named(self, colour: str, name: str) -> None:
        if name:
            self.legend.append((colour, name))

    def _shares(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        return shares(x, self.x, log=self.log_x), shares(y, self.y, log=self.log_y)

    def _inside(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """Places of the points that lie within the axes."""
        u, v = self._shares(x, y)
        inside = (u >= 0.0) & (u <= 1.0) & (v >= 0.0) & (v <= 1.0)
        return self._at(u[inside], v[inside])

    def _at(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Places in the picture of shares of both axes."""
        tall = self.height - _TOP - _BOTTOM
        return _LEFT + u * (self.width - _LEFT - _RIGHT), self.height - _BOTTOM - v * tall


def _key(x: float, y: float, colour: str) -> Markup:
    return Markup('<path d="M{:.1f} {}h14" style="stroke:{}" stroke-width="3"/>').format(x, y, colour)
