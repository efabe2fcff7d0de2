"""An attitude error of the reference, which accelerometer and magnetometer share: a finding about the reference."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects.affine import rotated, rotation_columns
from mavcal.calib.gap.effects.base import CatalogueEffect, MeanEffect
from mavcal.calib.gap.effects.parts import per_axis
from mavcal.calib.gap.effects.traits import Trait
from mavcal.calib.gap.problem import Trace
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]


def direction_columns(trace: Trace, theta: float) -> Array:
    """Columns ``e_j x ideal`` for an accelerometer or magnetometer; zero for a gyroscope."""
    if trace.sensor == Sensor.GYRO:
        return np.zeros((3, *trace.ideal.shape))
    return rotation_columns(trace, theta)


def direction_turned(trace: Trace, parameters: Array) -> Array:
    """Change of the ideal reading by a rotation that is not small; zero for a gyroscope."""
    return np.zeros_like(trace.ideal) if trace.sensor == Sensor.GYRO else rotated(trace, parameters)


REFERENCE = "reference_attitude"
"""Id of the effect, which distinguishes findings about the reference from those about sensors."""

EFFECTS: tuple[CatalogueEffect, ...] = (
    MeanEffect(
        REFERENCE,
        Sensor.ACCEL,
        per_axis("rotation", "rad"),
        "any attitude; two sensors that see a direction",
        "a better reference; two instances of a sensor, whose difference is free of it",
        rivals=("accel_rotation", "mag_rotation", "accel_random_walk", "mag_random_walk", "accel_bias"),
        shared=True,
        plain="an error of the reference's attitude",
        traits=frozenset({Trait.STEADY}),
        columns=direction_columns,
        exact=direction_turned,
    ),
)
"""Columns of a constant error; the diagnosis lets it wander as :class:`calib.gap.problem.ReferenceInfo` states."""
