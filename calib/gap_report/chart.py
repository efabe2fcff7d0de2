"""Axes with lines, bands and bars as inline SVG; colours are variables of the page's style sheet."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

BEFORE, AFTER, MODEL, FLOOR = "--before", "--after", "--model", "--floor"
COLOURS = (BEFORE, AFTER, MODEL, FLOOR)
_LEFT, _RIGHT, _TOP, _BOTTOM = 62, 12, 40, 38
_LETTER = 5.9  # mean width of a letter of the legend
_STEEP = 0.87  # height of a letter's width in the turned names of columns
_MOST_POINTS = 600


def text(x: float, y: float, words: str, *, anchor: str = "start", kind: str = "") -> str:
    """Words at a place; `kind` is a class of the style sheet."""
    style = f' class="{kind}"' if kind else ""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{style}>{escape(words)}</text>'


def svg(width: float, height: float, parts: Iterable[str], title: str) -> str:
    """A picture with its words for those who cannot see it."""
    inner = "".join(parts)
    return (
        f'<svg viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" role="img" aria-label="{escape(title)}">'
        f"{inner}</svg>"
    )


@dataclass
class Chart:
    """One pair of axes; a logarithmic axis takes positive numbers. Points outside are cut off."""

    title: str
    x_label: str
    y_label: str
    x: tuple[float, float]
    y: tuple[float, float]
    width: int = 430
    height: int = 240
    log_x: bool = False
    log_y: bool = False
    parts: list[str] = field(default_factory=list)
    legend: list[tuple[str, str]] = field(default_factory=list)

    def line(self, x: ArrayLike, y: ArrayLike, colour: str, name: str = "", *, thin: bool = False) -> None:
        """A line through points, and its name in the legend; gaps where a number is not finite."""
        a, b = self._placed(x, y)
        wide = "0.8" if thin else "1.8"
        for run in _runs(a, b):
            points = " ".join(f"{u:.1f},{v:.1f}" for u, v in run)
            self.parts.append(
                f'<polyline points="{points}" fill="none" style="stroke:var({colour})" stroke-width="{wide}"/>'
            )
        self._named(colour, name)

    def band(self, x: ArrayLike, low: ArrayLike, high: ArrayLike, colour: str) -> None:
        """The area between two lines."""
        a, b = self._placed(x, low)
        c, d = self._placed(x, high)
        points = " ".join(f"{u:.1f},{v:.1f}" for u, v in [*zip(a, b, strict=True), *zip(c[::-1], d[::-1], strict=True)])
        self.parts.append(f'<polygon points="{points}" style="fill:var({colour})" opacity="0.2"/>')

    def bars(self, x: ArrayLike, y: ArrayLike, half: ArrayLike, colour: str, name: str = "") -> None:
        """A dot with its interval at each point."""
        for u, v, h in np.column_stack([np.asarray(x, float), np.asarray(y, float), np.asarray(half, float)]):
            (a,), (b,) = self._placed([u], [v])
            (_,), (low,) = self._placed([u], [v - h])
            (_,), (high,) = self._placed([u], [v + h])
            self.parts.append(
                f'<path d="M{a:.1f} {low:.1f}V{high:.1f}" style="stroke:var({colour})" stroke-width="1"/>'
                f'<circle cx="{a:.1f}" cy="{b:.1f}" r="2.4" style="fill:var({colour})"/>'
            )
        self._named(colour, name)

    def mark(self, x: float, words: str, colour: str = MODEL) -> None:
        """An upright line with a word."""
        (a,), _ = self._placed([x], [self.y[0]])
        self.parts.append(
            f'<path d="M{a:.1f} {_TOP}V{self.height - _BOTTOM}" style="stroke:var({colour})" stroke-dasharray="4 3"/>'
            + text(a + 3, _TOP + 11, words)
        )

    def drawn(self) -> str:
        """The picture."""
        right, bottom = self.width - _RIGHT, self.height - _BOTTOM
        out = [text(_LEFT, 16, self.title, kind="title")]
        for value, label in ticks(self.x, log=self.log_x):
            (a,), _ = self._placed([value], [self.y[0]])
            out += [f'<path class="grid" d="M{a:.1f} {_TOP}V{bottom}"/>', text(a, bottom + 14, label, anchor="middle")]
        for value, label in ticks(self.y, log=self.log_y):
            _, (b,) = self._placed([self.x[0]], [value])
            out += [f'<path class="grid" d="M{_LEFT} {b:.1f}H{right}"/>', text(_LEFT - 5, b + 3.5, label, anchor="end")]
        out += self.parts
        out.append(text((_LEFT + right) / 2, self.height - 8, self.x_label, anchor="middle", kind="axis"))
        middle = (_TOP + bottom) / 2
        turned = text(0, 0, self.y_label, anchor="middle", kind="axis")
        out.append(f'<g transform="translate(13 {middle:.0f}) rotate(-90)">{turned}</g>')
        out += self._legend()
        return svg(self.width, self.height, out, self.title)

    def _legend(self) -> list[str]:
        out, x = [], float(_LEFT)
        for colour, name in self.legend:
            out.append(f'<path d="M{x:.1f} 27h14" style="stroke:var({colour})" stroke-width="3"/>')
            out.append(text(x + 18, 31, name, kind="legend"))
            x += 30 + _LETTER * len(name)
        return out

    def _named(self, colour: str, name: str) -> None:
        if name:
            self.legend.append((colour, name))

    def _placed(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        tall = self.height - _TOP - _BOTTOM
        a = _LEFT + _share(x, self.x, log=self.log_x) * (self.width - _LEFT - _RIGHT)
        b = self.height - _BOTTOM - _share(y, self.y, log=self.log_y) * tall
        return a, b


def _share(values: ArrayLike, limits: tuple[float, float], *, log: bool) -> Array:
    """Where values lie between `limits`, 0..1; what is beyond is put on the edge."""
    found = np.asarray(values, dtype=np.float64)
    low, high = limits
    if log:
        found = np.where(found > 0.0, np.log10(np.maximum(found, 1e-300)), math.log10(low))
        low, high = math.log10(low), math.log10(high)
    return np.asarray(np.clip((found - low) / (high - low), -0.02, 1.02), dtype=np.float64)


def _runs(a: Array, b: Array) -> list[list[tuple[float, float]]]:
    runs: list[list[tuple[float, float]]] = [[]]
    for u, v in zip(a.tolist(), b.tolist(), strict=True):
        if math.isfinite(u) and math.isfinite(v):
            runs[-1].append((u, v))
        elif runs[-1]:
            runs.append([])
    return [run for run in runs if len(run) > 1]


def ticks(limits: tuple[float, float], *, log: bool) -> list[tuple[float, str]]:
    """Round numbers within `limits`."""
    low, high = limits
    if log:
        first, last = math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9)
        if last - first < 1:  # less than two powers of ten: halves and fifths of them too
            fine = [m * 10.0**k for k in range(first - 1, last + 1) for m in (1.0, 2.0, 5.0)]
            return [(v, f"{v:g}") for v in fine if low <= v <= high]
        every = max(1, math.ceil((last - first) / 6))
        return [(10.0**k, f"{10.0**k:g}") for k in range(first, last + 1, every)]
    step = 10.0 ** math.floor(math.log10((high - low) / 4.0))
    step *= next(m for m in (1.0, 2.0, 5.0, 10.0) if (high - low) / (m * step) <= 5.0)
    count = range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
    return [(k * step, f"{k * step:.6g}") for k in count]


def limits_of(*values: ArrayLike, log: bool = False, zero: bool = False) -> tuple[float, float]:
    """Limits that hold the finite ones of `values`, with some room; never empty."""
    found = np.concatenate([np.asarray(v, dtype=np.float64).ravel() for v in values])
    found = found[np.isfinite(found) & ((found > 0.0) | (not log))]
    if not len(found):
        return (0.1, 1.0) if log else (0.0, 1.0)
    low, high = float(found.min()), float(found.max())
    if log:
        return (low / 1.3, high * 1.3) if high / low > 1.5 else (low / 3.0, high * 3.0)
    low, high = (min(low, 0.0), max(high, 0.0)) if zero else (low, high)
    room = 0.06 * (high - low) or 0.5 * abs(high) or 1.0
    return low - (0.0 if zero and low == 0.0 else room), high + room


def thinned(t: Array, values: Array) -> tuple[Array, Array]:
    """At most some hundreds of points of a series, its peaks kept."""
    count = len(t)
    if count <= _MOST_POINTS:
        return t, values
    size = math.ceil(count / (_MOST_POINTS // 2))
    starts = range(0, count, size)
    picked: list[int] = []
    for s in starts:
        part = values[s : s + size]
        picked += sorted({s + int(np.argmin(part)), s + int(np.argmax(part))})
    return t[picked], values[picked]


def heat(rows: Sequence[str], columns: Sequence[str], cells: Sequence[tuple[int, int, float, str]], title: str) -> str:
    """A table of coloured cells: (row, column, 0..1, words for the pointer); empty ones are blank."""
    left, wide, tall = 128.0, 17.0, 17.0
    longest = _LETTER * max(map(len, columns), default=0)
    top = 14.0 + _STEEP * longest
    out = []
    for j, name in enumerate(columns):
        x = left + (j + 0.65) * wide
        out.append(f'<g transform="translate({x:.1f} {top - 6:.1f}) rotate(-60)">{text(0, 0, name)}</g>')
    for i, name in enumerate(rows):
        out.append(text(left - 6, top + (i + 0.7) * tall, name, anchor="end"))
        out.append(f'<path class="grid" d="M{left} {top + i * tall:.1f}h{wide * len(columns):.1f}"/>')
    for i, j, level, words in cells:
        out.append(
            f'<rect x="{left + j * wide:.1f}" y="{top + i * tall:.1f}" width="{wide - 1:.0f}" height="{tall - 1:.0f}" '
            f'style="fill:var(--before)" fill-opacity="{0.12 + 0.88 * min(max(level, 0.0), 1.0):.2f}">'
            f"<title>{escape(words)}</title></rect>"
        )
    return svg(left + wide * len(columns) + 0.5 * longest, top + tall * len(rows) + 8, out, title)
