"""Sorts fits by content: sensor corrections, board level, motor compensation, and neither.

Every fit has the form of a sensor model, but a level fit holds a neutral one and a motor fit the one in force. Taken
for corrections they would claim, with perfect certainty, that the sensor has no error at all. So only
:func:`contents` makes a :data:`Correction`, and everything that reads a model for what the sensor truly does takes
nothing else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NewType

import numpy as np

from mavcal.calib.firmware.compose import mag_motor, trim
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.gyro.g_sensitivity import METHOD as G_SENSITIVITY

Correction = NewType("Correction", FitResult)
"""A fit whose model is what it found of the sensor."""

NOT_HELD: Final = frozenset({G_SENSITIVITY})
"""Methods whose offset belongs to a term that no firmware holds: the offset of a gyroscope free of gravity."""


@dataclass(frozen=True)
class Contents:
    """Fits by content."""

    corrections: tuple[Correction, ...]
    levels: tuple[FitResult, ...]
    motors: tuple[FitResult, ...]
    others: tuple[FitResult, ...]
    """Those that say nothing that a firmware could hold."""


def contents(fits: Sequence[FitResult]) -> Contents:
    """Sort fits by content; refused ones are left out."""
    usable = [fit for fit in fits if fit.status != FitStatus.REFUSED]
    levels = tuple(fit for fit in usable if trim.is_level(fit))
    motors = tuple(fit for fit in usable if mag_motor.is_motor(fit))
    rest = [fit for fit in usable if not (trim.is_level(fit) or mag_motor.is_motor(fit))]
    corrections = tuple(Correction(fit) for fit in rest if _corrects(fit))
    return Contents(corrections, levels, motors, tuple(fit for fit in rest if not _corrects(fit)))


def _corrects(fit: FitResult) -> bool:
    """Whether anything of the model was estimated. What a method holds fixed has no variance."""
    return fit.method not in NOT_HELD and bool(np.nanmax(fit.sd, initial=0.0) > 0.0)
