"""Magnetic fields by strength and direction, as tests state them."""

from __future__ import annotations

import math

import numpy as np

from mavcal.calib.earth import EarthField


def field_of(
    norm: float, inclination: float, declination: float = 0.0, norm_sd: float = 0.0, model: str = "given"
) -> EarthField:
    """The field of strength `norm` (uT), `inclination` (rad, positive down) and `declination` (rad, east)."""
    horizontal = norm * math.cos(inclination)
    vector = (horizontal * math.cos(declination), horizontal * math.sin(declination), norm * math.sin(inclination))
    return EarthField(np.array(vector), norm_sd, model=model)
