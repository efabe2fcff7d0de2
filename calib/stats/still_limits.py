"""Limits of stillness, hand-held or on a table, and how long a pose is held."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavcal.calib.errors import InvalidInputError


@dataclass(frozen=True)
class StillnessLimits:
    """Limits of stillness. Scatter is the norm of the three axes' standard deviations about a straight line.

    The limits of the accelerometer are fractions of gravity, so they hold for counts too.
    """

    window: float  # s
    accel_scatter: float  # g
    gyro_scatter: float  # rad/s
    rate: float  # rad/s, mean of a window with the bias in it
    tilt: float  # rad, turn of gravity across a window
    accel_drift: float  # g, of a window's mean from that of its span
    gyro_drift: float  # rad/s
    shortest: float  # s, of a span


HELD = StillnessLimits(
    window=0.5,
    accel_scatter=0.06,
    gyro_scatter=0.3,
    rate=0.5,
    tilt=0.05,
    accel_drift=0.06,
    gyro_drift=0.3,
    shortest=1.0,
)
"""Limits for a hand-held pose, with sway and tremor of a degree or two."""

RESTING = StillnessLimits(
    window=0.5,
    accel_scatter=0.04,
    gyro_scatter=0.04,
    rate=0.5,
    tilt=0.007,
    accel_drift=0.006,
    gyro_drift=0.01,
    shortest=1.0,
)
"""Limits for rest on a table, untouched."""
HOLD_S = 2.0
"""Hold time of a pose, s, for :data:`HELD`: its shortest span, half a window at each end, and a margin."""

SHORTER = (0.5, 0.25)
"""Fractions of the requested hold time that are tried to find poses held too briefly."""
MANY_MORE = 2
"""Least factor by which a shorter hold time must increase the number of poses."""


def held_for(limits: StillnessLimits, seconds: float) -> StillnessLimits:
    """`limits` for poses that are held for `seconds`.

    Raises
    ------
    InvalidInputError
        If `seconds` is not a positive number.
    """
    if not (np.isfinite(seconds) and seconds > 0.0):
        raise InvalidInputError(f"a pose is held for a positive number of seconds, not {seconds}")
    part = seconds / HOLD_S
    return dataclasses.replace(limits, window=part * limits.window, shortest=part * limits.shortest)


def too_short(held: Sequence[float], needed: float, asked: float) -> str:
    """End of a refusal: hold times `held` of the poses, s, and the remedy; a limit of `asked` would accept them."""
    return (
        f"; {len(held)} poses were held for {np.median(held):.2g} s each, and {needed:g} s are needed: hold them for "
        f"longer, or take the short ones with --min-still {asked:g}"
    )
