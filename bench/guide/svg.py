"""Plots as SVG, written by hand: small files that a browser shows and a diff can read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np

INK, GREY, GRID = "#1d2b36", "#6b7a86", "#dfe5ea"
BLUE, ORANGE, GREEN, RED = "#1f6fb2", "#d9731a", "#2f8f5b", "#c0392b"
_LEFT, _RIGHT, _TOP, _BOTTOM = 58, 14, 30, 42


@dataclass
class Plot:
    """Axes with lines, dots, bands and words on them; a logarithmic axis takes positive numbers."""

    title: str
    x_label: str
    y_label: str
    x: tuple[float, float]
    y: tuple[float, float]
    width: int = 360
    height: int = 250
    log_x: bool = False
    log_y: bool = False
    parts: list[str] = field(default_factory=list)
    legend: list[tuple[str, str]] = field(default_factory=list)

    def line(
        self, x: Sequence[float], y: Sequence[float], colour: str, name: str = "", *, dashed: bool = False
    ) -> None:
        """A line through points, and its name in the legend."""
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in self._inside(x, y))
        dash = ' stroke-dasharray="5 4"' if dashed else ""
        self.parts.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.6"{dash}/>')
        self._named(colour, name)

    def dots(self, x: Sequence[float], y: Sequence[float], colour: str, name: str = "", *, size: float = 1.4) -> None:
        """A dot a point: one path, so that many stay small."""
        path = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in self._inside(x, y))
        self.parts.append(
            f'<path d="{path}" stroke="{colour}" stroke-width="{2 * size:g}" stroke-linecap="round" opacity="0.75"/>'
        )
        self._named(colour, name)

    def band(
        self, x: Sequence[float], low: Sequence[float], high: Sequence[float], colour: str, name: str = ""
    ) -> None:
        """A filled band between two lines."""
        there, back = self._inside(x, low), self._inside(x, high)[::-1]
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in [*there, *back])
        self.parts.append(f'<polygon points="{points}" fill="{colour}" opacity="0.22"/>')
        self._named(colour, name)

    def _named(self, colour: str, name: str) -> None:
        if name:
            self.legend.append((colour, name))

    def _inside(self, x: Sequence[float], y: Sequence[float]) -> list[tuple[float, float]]:
        a = _LEFT + _share(np.asarray(x, dtype=float), self.x, log=self.log_x) * (self.width - _LEFT - _RIGHT)
        b = self.height - _BOTTOM - _share(np.asarray(y, dtype=float), self.y, log=self.log_y) * self._tall
        return list(zip(a.tolist(), b.tolist(), strict=True))

    @property
    def _tall(self) -> int:
        return self.height - _TOP - _BOTTOM

    def body(self) -> str:
        """Everything within the picture's frame."""
        right, bottom = self.width - _RIGHT, self.height - _BOTTOM
        out = [_text(self.width / 2, 17, self.title, size=12.5, weight="600", anchor="middle")]
        for value, label in _ticks(self.x, log=self.log_x):
            (a, _) = self._inside([value], [self.y[0]])[0]
            out += [_rule(a, _TOP, a, bottom), _text(a, bottom + 15, label, anchor="middle")]
        for value, label in _ticks(self.y, log=self.log_y):
            (_, b) = self._inside([self.x[0]], [value])[0]
            out += [_rule(_LEFT, b, right, b), _text(_LEFT - 6, b + 3.5, label, anchor="end")]
        out.append(f'<g clip-path="url(#{self._clip})">{"".join(self.parts)}</g>')
        out.append(
            f'<rect x="{_LEFT}" y="{_TOP}" width="{right - _LEFT}" height="{self._tall}" fill="none" stroke="{GREY}"/>'
        )
        out.append(_text((_LEFT + right) / 2, self.height - 8, self.x_label, anchor="middle"))
        out.append(_text(0, 0, self.y_label, anchor="middle", turned=(14, (_TOP + bottom) / 2)))
        for k, (colour, name) in enumerate(self.legend):
            y = _TOP + 14 + 14 * k
            out.append(f'<rect x="{right - 12}" y="{y - 8}" width="8" height="8" fill="{colour}"/>')
            out.append(_text(right - 17, y, name, anchor="end"))
        return "".join(out)

    @property
    def _clip(self) -> str:
        return f"c{self.width}x{self.height}"

    def frame(self) -> str:
        """The clip that keeps lines inside the axes."""
        return (
            f'<clipPath id="{self._clip}"><rect x="{_LEFT}" y="{_TOP}" width="{self.width - _LEFT - _RIGHT}" '
            f'height="{self._tall}"/></clipPath>'
        )


@dataclass
class Map:
    """Directions on an equal-area map of the whole sphere (Mollweide), x to the centre, z at the top."""

    title: str
    below: str
    width: int = 360
    height: int = 250
    parts: list[str] = field(default_factory=list)

    def dots(self, directions: np.ndarray, colour: str, *, size: float = 1.3) -> None:
        """A dot for each of `directions` (N, 3)."""
        unit = directions / np.linalg.norm(directions, axis=1)[:, None]
        x, y = _mollweide(np.arctan2(unit[:, 1], unit[:, 0]), np.arcsin(np.clip(unit[:, 2], -1.0, 1.0)))
        path = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(*self._placed(x, y), strict=True))
        self.parts.append(
            f'<path d="{path}" stroke="{colour}" stroke-width="{2 * size:g}" stroke-linecap="round" opacity="0.75"/>'
        )

    def _placed(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        scale = (self.width - 20) / (4.0 * np.sqrt(2.0))
        return self.width / 2 + scale * x, 34 + (self.height - 68) / 2 - scale * y

    def body(self) -> str:
        """Everything within the picture's frame."""
        out = [_text(self.width / 2, 17, self.title, size=12.5, weight="600", anchor="middle")]
        for latitude in np.radians([-60, -30, 0, 30, 60]):
            out.append(self._curve(np.linspace(-np.pi, np.pi, 41), np.full(41, latitude), GRID))
        for longitude in np.radians([-180, -120, -60, 0, 60, 120, 180]):
            edge = GREY if abs(longitude) > 3.1 else GRID
            out.append(self._curve(np.full(41, longitude), np.linspace(-np.pi / 2, np.pi / 2, 41), edge))
        out += [*self.parts, _text(self.width / 2, self.height - 12, self.below, anchor="middle")]
        return "".join(out)

    def _curve(self, longitude: np.ndarray, latitude: np.ndarray, colour: str) -> str:
        a, b = self._placed(*_mollweide(longitude, latitude))
        points = " ".join(f"{p:.1f},{q:.1f}" for p, q in zip(a, b, strict=True))
        return f'<polyline points="{points}" fill="none" stroke="{colour}"/>'

    def frame(self) -> str:
        """Nothing: a map has no clip."""
        return ""


def side_by_side(plots: Sequence[Plot | Map], told: str) -> str:
    """One SVG of plots in a row; `told` is what a reader without eyes is told."""
    width, height = sum(p.width for p in plots), max(p.height for p in plots)
    at, groups = 0, []
    for plot in plots:
        groups.append(f'<g transform="translate({at} 0)">{plot.body()}</g>')
        at += plot.width
    frames = "".join(dict.fromkeys(plot.frame() for plot in plots))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        f'font-family="Helvetica, Arial, sans-serif" role="img" aria-label="{escape(told, quote=True)}">'
        f'<rect width="{width}" height="{height}" fill="#ffffff"/><defs>{frames}</defs>{"".join(groups)}</svg>\n'
    )


def _share(values: np.ndarray, limits: tuple[float, float], *, log: bool) -> np.ndarray:
    low, high = (np.log10(v) for v in limits) if log else limits
    scaled = np.log10(np.maximum(values, 1e-300)) if log else values
    return np.asarray(np.clip((scaled - low) / (high - low), -1.0, 2.0))


def _ticks(limits: tuple[float, float], *, log: bool) -> list[tuple[float, str]]:
    low, high = limits
    if log:
        decades = range(int(np.ceil(np.log10(low) - 1e-9)), int(np.floor(np.log10(high) + 1e-9)) + 1)
        return [(10.0**k, f"{10.0**k:g}") for k in decades]
    raw = (high - low) / 5.0
    step = next(s for s in (m * 10.0 ** np.floor(np.log10(raw)) for m in (1, 2, 2.5, 5, 10)) if s >= raw * 0.999)
    ticks = np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1) * step
    return [(float(v), f"{v + 0.0:.6g}") for v in ticks]


def _rule(a: float, b: float, c: float, d: float) -> str:
    return f'<line x1="{a:.1f}" y1="{b:.1f}" x2="{c:.1f}" y2="{d:.1f}" stroke="{GRID}"/>'


def _text(
    x: float,
    y: float,
    words: str,
    *,
    size: float = 10.5,
    weight: str = "400",
    anchor: str = "start",
    turned: tuple[float, float] | None = None,
) -> str:
    place = (
        f'x="{x:.1f}" y="{y:.1f}"'
        if turned is None
        else f'transform="translate({turned[0]} {turned[1]:.1f}) rotate(-90)"'
    )
    style = f'font-size="{size}" font-weight="{weight}" fill="{INK}" text-anchor="{anchor}"'
    return f"<text {place} {style}>{escape(words)}</text>"


def _mollweide(longitude: np.ndarray, latitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Plane coordinates; Newton's method for ``2 u + sin 2u = pi sin latitude``."""
    u = 0.9 * latitude
    for _ in range(30):
        slope = np.maximum(2.0 + 2.0 * np.cos(2.0 * u), 1e-9)
        u = np.clip(u - (2.0 * u + np.sin(2.0 * u) - np.pi * np.sin(latitude)) / slope, -np.pi / 2, np.pi / 2)
    return np.sqrt(8.0) / np.pi * longitude * np.cos(u), np.sqrt(2.0) * np.sin(u)
