"""Directions on a map of the whole sphere."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from markupsafe import Markup

from mavcal.calib.drawing.picture import Array, dotted, text


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
