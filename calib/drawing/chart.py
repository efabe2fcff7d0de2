"""Axes with lines, dots, bands and bars. Colours are CSS colours: ``#1f6fb2``, ``var(--model)``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike

from mavcal.calib.drawing.legend import ROW, Key, above, inside
from mavcal.calib.drawing.picture import Array, dotted, svg, text
from mavcal.calib.drawing.scale import runs_inside, shares, ticks

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
    """Draw the legend in the upper right corner of the axes, for long names; else above them."""
    legend_rows: int = 1
    """Rows of the legend above the axes, which are moved down to make room."""
    x_names: Sequence[str] = ()
    """Words at 0, 1, 2 ... of x instead of numbers."""
    parts: list[Markup] = field(default_factory=list)
    legend: list[Key] = field(default_factory=list)
    """Colours and what they mean."""

    @property
    def _top(self) -> int:
        return _TOP + ROW * (self.legend_rows - 1)

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

    def band(self, x: ArrayLike, low: ArrayLike, high: ArrayLike, colour: str) -> None:
        """The area between two lines, in the colour of its line."""
        u, bottom = self._shares(x, low)
        _, top = self._shares(x, high)
        kept = (u >= 0.0) & (u <= 1.0) & np.isfinite(bottom) & np.isfinite(top)
        round_about = np.concatenate([u[kept], u[kept][::-1]])
        edges = np.clip(np.concatenate([bottom[kept], top[kept][::-1]]), 0.0, 1.0)
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(*self._at(round_about, edges), strict=True))
        self.parts.append(Markup('<polygon points="{}" style="fill:{}" opacity="0.25"/>').format(points, colour))

    def columns(self, x: ArrayLike, y: ArrayLike, colour: str, name: str = "", *, wide: float = 0.5) -> None:
        """A column from zero to each point, `wide` on the scale of x."""
        thick = wide / (self.x[1] - self.x[0]) * (self.width - _LEFT - _RIGHT)
        places, heads = self._at(*self._shares(x, np.clip(y, *self.y)))
        _, (foot,) = self._at(*self._shares([self.x[0]], np.clip([0.0], *self.y)))
        path = "".join(f"M{a:.1f} {foot:.1f}V{b:.1f}" for a, b in zip(places, heads, strict=True))
        self.parts.append(Markup('<path d="{}" style="stroke:{}" stroke-width="{:.1f}"/>').format(path, colour, thick))
        self._named(colour, name)

    def dots(self, x: ArrayLike, y: ArrayLike, colour: str, name: str = "", *, size: float = 1.4) -> None:
        """One dot for each point, all in one path to keep the file small."""
        self.parts.append(dotted(*self._inside(x, y), colour, size=size))
        self._named(colour, name, dots=True)

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
        self._named(colour, name, dots=True)

    def mark(self, x: float, words: str, colour: str) -> None:
        """A vertical line with a label."""
        (a,), _ = self._at(*self._shares([x], [self.y[0]]))
        self.parts.append(
            Markup('<path d="M{:.1f} {}V{}" style="stroke:{}" stroke-dasharray="4 3"/>').format(
                a, self._top, self.height - _BOTTOM, colour
            )
            + text(a + 3, self._top + 11, words)
        )

    def drawn(self) -> Markup:
        """The picture, for a page."""
        return svg(self.width, self.height, [self.body()], self.title)

    def body(self) -> Markup:
        """Everything within the frame of the picture."""
        right, bottom, top = self.width - _RIGHT, self.height - _BOTTOM, self._top
        out = [text(_LEFT, 16, self.title, kind="title")]
        named = [(float(place), name) for place, name in enumerate(self.x_names)]
        for value, label in named or ticks(self.x, log=self.log_x):
            (a,), _ = self._at(*self._shares([value], [self.y[0]]))
            rule = Markup('<path class="grid" d="M{:.1f} {}V{}"/>').format(a, top, bottom)
            out += [rule, text(a, bottom + 14, label, anchor="middle")]
        for value, label in ticks(self.y, log=self.log_y):
            _, (b,) = self._at(*self._shares([self.x[0]], [value]))
            rule = Markup('<path class="grid" d="M{} {:.1f}H{}"/>').format(_LEFT, b, right)
            out += [rule, text(_LEFT - 5, b + 3.5, label, anchor="end")]
        out += self.parts
        # Only a file's own style draws it.
        edge = Markup('<rect x="{}" y="{}" width="{}" height="{}" fill="none" class="edge"/>')
        out.append(edge.format(_LEFT, top, right - _LEFT, bottom - top))
        out.append(text((_LEFT + right) / 2, self.height - 8, self.x_label, anchor="middle", kind="axis"))
        middle = (top + bottom) / 2
        turned = text(0, 0, self.y_label, anchor="middle", kind="axis")
        out.append(Markup('<g transform="translate(13 {:.0f}) rotate(-90)">{}</g>').format(middle, turned))
        out += inside(self.legend, right, top) if self.legend_inside else above(self.legend, _LEFT, self.legend_rows)
        return Markup().join(out)

    def _named(self, colour: str, name: str, *, dots: bool = False) -> None:
        if name:
            self.legend.append(Key(colour, name, dots))

    def _shares(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        return shares(x, self.x, log=self.log_x), shares(y, self.y, log=self.log_y)

    def _inside(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """Picture coordinates of the points that lie within the axes."""
        u, v = self._shares(x, y)
        within = (u >= 0.0) & (u <= 1.0) & (v >= 0.0) & (v <= 1.0)
        return self._at(u[within], v[within])

    def _at(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Picture coordinates of points given as fractions of both axes."""
        tall = self.height - self._top - _BOTTOM
        return _LEFT + u * (self.width - _LEFT - _RIGHT), self.height - _BOTTOM - v * tall
