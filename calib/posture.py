"""How a person holds a vehicle so that a given direction of its body points down, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

SLIGHT = 0.2
"""Components of the unit vector below this (12 deg) are not mentioned: no hand is that exact."""
UPRIGHT = math.radians(70.0)
"""Angle, rad, above which a side simply points down, and no fraction is named."""
SHARES = ((0.25, "a quarter"), (0.42, "a third"), (0.59, "half"), (1.0, "two thirds"))
"""Largest fraction of a right angle for each word."""


def tilted(down: Sequence[float]) -> str:
    """How to hold it so that the body direction `down` (front, right, down; a unit vector) points down.

    >>> tilted((0.577, -0.577, 0.577))
    'nose a third down, left side low'
    >>> tilted((0.707, 0.707, 0.0))
    'on its right side, nose half down'
    >>> tilted((-0.707, 0.0, -0.707))
    'upside down, tail half down'
    """
    front, right, below = down
    side = "right" if right > 0.0 else "left"
    nose = _share("nose" if front > 0.0 else "tail", front) if abs(front) > SLIGHT else ""
    leans = abs(right) > SLIGHT
    if below < -SLIGHT:
        parts = ["upside down", nose]
    elif leans and below < SLIGHT:
        return ", ".join(filter(None, (f"on its {side} side", nose)))
    else:
        parts = [nose]
    if leans:
        parts.append(f"{side} side low" if nose else _share(f"{side} side", right))
    return ", ".join(filter(None, parts)) or "level"


def _share(part: str, sine: float) -> str:
    """How far this part is down, as a fraction of a right angle, in words."""
    angle = math.asin(min(1.0, abs(sine)))
    if angle > UPRIGHT:
        return f"{part} down"
    share = angle / (math.pi / 2)
    return f"{part} {next(word for most, word in SHARES if share <= most)} down"
