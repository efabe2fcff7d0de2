"""The stated mounting of each compass of a plan, and the rotations that an operator may choose instead."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.firmware import calibration_names
from mavcal.calib.firmware.names import Role
from mavcal.calib.firmware.options import compose_options
from mavcal.calib.firmware.plan import Value, WritePlan
from mavcal.calib.firmware.rotations import ROTATIONS, rotation_matrix, rotation_words
from mavcal.calib.fit import FitResult
from mavcal.calib.recording import Sensor


@dataclass(frozen=True, eq=False)
class MountingChoice:
    """One of the firmware's rotations: its number, its words, and sensor to body (3, 3)."""

    number: int
    text: str
    matrix: NDArray[np.float64]


@dataclass(frozen=True)
class StatedMounting:
    """The mounting of a compass; numbers are the firmware's."""

    instance: int
    """Which compass, from 0."""
    stated: int
    """What the vehicle is told now."""
    stated_text: str
    chosen: int | None
    """What the plan takes instead; None: as it was found."""


def mountings_of(
    fits: Sequence[FitResult], plan: WritePlan, parameters: Mapping[str, Value], options: Mapping[str, Any]
) -> tuple[StatedMounting, ...]:
    """Compasses whose mounting can be chosen: those with their own rotation parameter that the calibration examined."""
    chosen, autopilot = compose_options(options).mountings, plan.fingerprint.autopilot
    found = []
    for fit in fits:
        if fit.sensor != Sensor.MAG or "orientation" not in fit.quality:
            continue
        names = calibration_names(autopilot, parameters, fit.sensor, fit.instance)
        number = int(parameters.get(names[Role.ROTATION], -1))
        external = number >= 0 and (Role.EXTERNAL not in names or int(parameters.get(names[Role.EXTERNAL], 0)) != 0)
        if external:
            words = rotation_words(autopilot, number)
            found.append(StatedMounting(fit.instance, number, words, chosen.get((fit.sensor, fit.instance))))
    return tuple(found)


def choices_of(autopilot: str) -> tuple[MountingChoice, ...]:
    """Every numbered rotation of the firmware; of two equal ones, the first."""
    found: dict[bytes, MountingChoice] = {}
    for number in range(len(ROTATIONS[autopilot])):
        matrix = rotation_matrix(autopilot, number)
        found.setdefault(
            (np.round(matrix, 6) + 0.0).tobytes(), MountingChoice(number, rotation_words(autopilot, number), matrix)
        )
    return tuple(found.values())
