"""Pictures of three dimensions: points and lines in a cube, and directions on a map of the whole sphere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from markupsafe import Markup

from mavcal.calib.drawing.legend import Key, above
from mavcal.calib.drawing.picture import Array, dotted, text
from mavcal.calib.drawing.scale import ticks

_AZIMUTH, _ELEVATION = np.radians(-60.0), np.radians(30.0)
_RIGHT: Final = np.array([-np.sin(_AZIMUTH), np.cos(_AZIMUTH), 0.0])
_UP: Final = np.array(
    [-np.sin(_ELEVATION) * np.cos(_AZIMUTH), -np.sin(_ELEVATION) * np.sin(_AZIMUTH), np.cos(_ELEVATION)]
)
_REACH: Final = float(np.abs(_RIGHT).sum()), float(np.abs(_UP).sum())
"""Half width and half height of the projection of a cube of half edge one."""
_CORNERS: Final = (np.array([-1, -1, -1]), np.array([1, -1, -1]), np.array([-1, -1, -1]))
"""Start of the edge that carries each axis's numbers: two lower edges in front, and the vertical one on the left."""
_BACK: Final = (-1, 1, -1)
"""The three walls behind the data."""
_TOP, _BOTTOM, _SIDE = 40, 40, 70


@dataclass
class SpaceView:
    """A cube about `middle` (3,) with half edges `half`, in parallel projection."""

    title: str
    labels: tuple[str, str, str]
    middle: Array
    half: float
    width: int = 430
    height: int = 340
    parts: list[Markup] = field(default_factory=list)
    legend: list[Key] = field(default_factory=list)

    def dots(self, points: Array, colour: str, name: str = "", *, size: float = 1.2) -> None:
        """A dot at each of `points` (N, 3)."""
        self.parts.append(dotted(*self._at(points), colour, size=size))
        if name:
            self.legend.append(Key(colour, name, dots=True))

    def lines(self, paths: Sequence[Array], colour: str) -> None:
        """Thin lines, each through the points (N, 3) of one path."""
        drawn = "".join(self._path(path) for path in paths)
        thin = Markup('<path d="{}" fill="none" style="stroke:{}" stroke-width="0.5" opacity="0.4"/>')
        self.parts.append(thin.format(drawn, colour))

    def cross(self, point: Array, colour: str) -> None:
        """A small cross at one point (3,)."""
        (x,), (y,) = self._at(point[None, :])
        self.parts.append(
            Markup('<path d="M{:.1f} {:.1f}h10m-5 -5v10" fill="none" style="stroke:{}" stroke-width="1.2"/>').format(
                x - 5.0, y, colour
            )
        )

    def body(self) -> Markup:
        """Everything within the frame of the picture."""
        out = [text(self.width / 2, 16, self.title, anchor="middle", kind="title")]
        for axis in range(3):
            out += self._axis(axis)
        wide = sum(30 + 6 * len(key.name) for key in self.legend)
        return Markup().join([*out, *self.parts, *above(self.legend, (self.width - wide) / 2)])

    def _axis(self, axis: int) -> list[Markup]:
        """Grid lines on the walls behind, at round numbers and both ends, with the numbers and the axis's name."""
        limits = float(self.middle[axis] - self.half), float(self.middle[axis] + self.half)
        out: list[Markup] = []
        anchor = ("end", "start", "end")[axis]
        dx, dy = ((-4, 12), (4, 12), (-6, 4))[axis]
        named = [((value - self.middle[axis]) / self.half, label) for value, label in ticks(limits, log=False)]
        shares = [-1.0, *(share for share, _ in named), 1.0]
        rules = [self._path(self._rule(axis, share, wall)) for share in shares for wall in {0, 1, 2} - {axis}]
        out.append(Markup('<path class="grid" d="{}"/>').format("".join(rules)))
        for share, label in named:
            x, y = self._edge(axis, share)
            out.append(text(x + dx, y + dy, label, anchor=anchor))
        x, y = self._edge(axis, 0.0)
        if axis == 2:
            turned = text(0, 0, self.labels[axis], anchor="middle", kind="axis")
            out.append(Markup('<g transform="translate({:.0f} {:.0f}) rotate(-90)">{}</g>').format(x - 40, y, turned))
        else:
            out.append(text(x + 8 * dx, y + 30, self.labels[axis], anchor="middle", kind="axis"))
        return out

    def _rule(self, axis: int, share: float, wall: int) -> Array:
        """Both ends of a grid line at `share` of an axis, on one of the walls behind."""
        ends = np.empty((2, 3))
        ends[:, axis], ends[:, wall] = share, _BACK[wall]
        ends[:, 3 - axis - wall] = -1.0, 1.0
        return self.middle + self.half * ends

    def _edge(self, axis: int, share: float) -> tuple[float, float]:
        """Picture coordinates of the number at `share` of an axis."""
        place = _CORNERS[axis].astype(np.float64)
        place[axis] = share
        (x,), (y,) = self._at((self.middle + self.half * place)[None, :])
        return float(x), float(y)

    def _path(self, points: Array) -> str:
        return "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(*self._at(points), strict=True))

    def _at(self, points: Array) -> tuple[Array, Array]:
        """Picture coordinates of points (N, 3)."""
        wide, tall = self.width - 2 * _SIDE, self.height - _TOP - _BOTTOM
        scale = min(wide / (2.0 * _REACH[0]), tall / (2.0 * _REACH[1])) / self.half
        away = points - self.middle
        return self.width / 2 + scale * away @ _RIGHT, _TOP + tall / 2 - scale * away @ _UP


@dataclass
class SphereMap:
    """Directions on an equal-area map (Mollweide), x to the centre, z at the top; words below it."""

    title: str
    below: str
    width: int = 360
    height: int = 250
    parts: list[Markup] = field(default_factory=list)

    def dots(self, directions: Array, colour: str, *, size: float = 1.3) -> None:
        """A dot for each of `directions` (N, 3)."""
        unit = directions / np.linalg.norm(directions, axis=1)[:, None]
        longitude, latitude = np.arctan2(unit[:, 1], unit[:, 0]), np.arcsin(np.clip(unit[:, 2], -1.0, 1.0))
        self.parts.append(dotted(*self._at(longitude, latitude), colour, size=size))

    def mark(self, longitude: float, latitude: float, words: str) -> None:
        """Words at a direction, degrees."""
        (x,), (y,) = self._at(np.radians([longitude]), np.radians([latitude]))
        self.parts.append(text(x, y + 4, words, anchor="middle", kind="title"))

    def body(self) -> Markup:
        """Everything within the frame of the picture."""
        out = [text(self.width / 2, 17, self.title, anchor="middle", kind="title")]
        for latitude in np.radians([-60, -30, 0, 30, 60]):
            out.append(self._curve(np.linspace(-np.pi, np.pi, 41), np.full(41, latitude), "grid"))
        for longitude in np.radians([-180, -120, -60, 0, 60, 120, 180]):
            kind = "edge" if abs(longitude) > 3.1 else "grid"
            out.append(self._curve(np.full(41, longitude), np.linspace(-np.pi / 2, np.pi / 2, 41), kind))
        out += [*self.parts, text(self.width / 2, self.height - 12, self.below, anchor="middle")]
        return Markup().join(out)

    def _at(self, longitude: Array, latitude: Array) -> tuple[Array, Array]:
        x, y = _mollweide(longitude, latitude)
        scale = (self.width - 20) / (4.0 * np.sqrt(2.0))
        return self.width / 2 + scale * x, 34 + (self.height - 68) / 2 - scale * y

    def _curve(self, longitude: Array, latitude: Array, kind: str) -> Markup:
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(*self._at(longitude, latitude), strict=True))
        return Markup('<polyline points="{}" class="{}"/>').format(points, kind)


def _mollweide(longitude: Array, latitude: Array) -> tuple[Array, Array]:
    """Plane coordinates; Newton's method for ``2 u + sin 2u = pi sin latitude``."""
    u = 0.9 * latitude
    for _ in range(30):
        slope = np.maximum(2.0 + 2.0 * np.cos(2.0 * u), 1e-9)
        u = np.clip(u - (2.0 * u + np.sin(2.0 * u) - np.pi * np.sin(latitude)) / slope, -np.pi / 2, np.pi / 2)
    return np.sqrt(8.0) / np.pi * longitude * np.cos(u), np.sqrt(2.0) * np.sin(u)
