"""Legends: the meaning of each colour, with a sample of its line or dots."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from markupsafe import Markup

from mavcal.calib.drawing.picture import dotted, text

LETTER = 5.9
"""Mean width of a letter of the legend."""
ROW = 14
"""Height of a row of the legend."""
_SIGN = 18
_APART = 12


class Key(NamedTuple):
    """A colour, what it means, and whether it is drawn as dots."""

    colour: str
    name: str
    dots: bool = False


def above(keys: Sequence[Key], left: float, rows: int = 1) -> list[Markup]:
    """The keys in `rows` rows over a pair of axes, each column as wide as its longest name."""
    across, out, x = math.ceil(len(keys) / rows), [], left
    for column in range(across):
        below = keys[column::across]
        for k, key in enumerate(below):
            y = 31 + ROW * k
            out += [_sign(x, y - 4, key), text(x + _SIGN, y, key.name, kind="legend")]
        x += _SIGN + _APART + LETTER * max(len(key.name) for key in below)
    return out


def inside(keys: Sequence[Key], right: float, top: float) -> list[Markup]:
    """The keys one below another in an upper right corner."""
    out = []
    for k, key in enumerate(keys):
        y = top + 12 + ROW * k
        out += [_sign(right - 18, y - 4, key), text(right - 22, y, key.name, anchor="end", kind="legend")]
    return out


def _sign(x: float, y: float, key: Key) -> Markup:
    if key.dots:
        return dotted(np.array([x + 7.0]), np.array([y]), key.colour, size=3.0, opacity=1.0)
    return Markup('<path d="M{:.1f} {}h14" style="stroke:{}" stroke-width="3"/>').format(x, y, key.colour)
