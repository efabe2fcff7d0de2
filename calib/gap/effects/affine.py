"""Bias, scale, misalignment and rotation: ``measured = R K (ideal) + b`` (METHODS 0)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mavcal.calib.gap.effects.base import CatalogueEffect, EffectParameter, MeanEffect
from mavcal.calib.gap.effects.parts import (
    AXES,
    INERTIAL,
    TRIADS,
    TUMBLE,
    axiswise,
    crossed,
    missing_movement,
    per_axis,
)
from mavcal.calib.gap.effects.traits import SensorTerm, Trait
from mavcal.calib.gap.problem import UNIT, Trace
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

OFF_DIAGONAL = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))
"""Row and column of each off-diagonal element: sensitivity of the `row` axis to the ideal `column` axis."""


def constant(trace: Trace, _theta: float) -> Array:
    """The constant signal one, (1, N)."""
    return np.ones((1, len(trace.t)))


def scale_columns(trace: Trace, _theta: float) -> Array:
    """Columns (3, N, 3) of ``K - 1``: each axis' ideal reading on that axis."""
    columns = np.zeros((3, *trace.ideal.shape))
    for axis in range(3):
        columns[axis, :, axis] = trace.ideal[:, axis]
    return columns


def misalignment_columns(trace: Trace, _theta: float) -> Array:
    """Columns (6, N, 3) of the off-diagonal elements of the matrix."""
    columns = np.zeros((6, *trace.ideal.shape))
    for j, (row, column) in enumerate(OFF_DIAGONAL):
        columns[j, :, row] = trace.ideal[:, column]
    return columns


def rotation_columns(trace: Trace, _theta: float) -> Array:
    """Columns (3, N, 3) of a small rotation: ``e_j x ideal``."""
    return crossed(trace.ideal)


def rotated(trace: Trace, parameters: Array) -> Array:
    """Change of the ideal reading (N, 3) by a rotation vector in rad, without linearisation."""
    matrix = Rotation.from_rotvec(np.array(parameters)).as_matrix()
    return np.asarray(trace.ideal @ (matrix - np.eye(3)).T, dtype=np.float64)


def _bias(sensor: Sensor) -> CatalogueEffect:
    rivals = {
        Sensor.ACCEL: ("accel_vibration_rectification", "accel_scale", "reference_attitude"),
        Sensor.GYRO: ("gyro_g_sensitivity", "gyro_temp_linear", "gyro_vibration_rectification"),
    }
    return MeanEffect(
        f"{sensor}_bias",
        sensor,
        per_axis("bias", UNIT[sensor]),
        "any movement, rest included",
        f"{TUMBLE}; throttle 0-hover-0 twice at one attitude",
        columns=axiswise(constant),
        signals=constant,
        plain="a constant offset",
        rivals=rivals[sensor],
        traits=frozenset({Trait.STEADY, Trait.LEVEL}),
        term=SensorTerm.BIAS,
    )


_PLAIN = {
    "scale": "a wrong scale",
    "misalignment": "axes that are not at right angles",
    "rotation": "a sensor mounted at an angle",
}


def _matrix_part(
    kind: str,
    term: SensorTerm,
    sensor: Sensor,
    parameters: tuple[EffectParameter, ...],
    columns: Callable[[Trace, float], Array],
    rivals: tuple[str, ...],
    *,
    exact: Callable[[Trace, Array], Array] | None = None,
) -> CatalogueEffect:
    about = {Sensor.ACCEL: "attitudes", Sensor.GYRO: "turns", Sensor.MAG: "attitudes"}[sensor]
    return MeanEffect(
        f"{sensor}_{kind}",
        sensor,
        parameters,
        f"{about} about all three axes",
        "turn about each axis both ways" if sensor == Sensor.GYRO else TUMBLE,
        missing_movement(sensor),
        columns=columns,
        rivals=tuple(f"{sensor}_{rival}" for rival in rivals),
        exact=exact,
        plain=_PLAIN[kind],
        traits=frozenset({Trait.STEADY, Trait.SIZE} if term is SensorTerm.SCALE else {Trait.STEADY}),
        term=term,
    )


def _effects() -> tuple[CatalogueEffect, ...]:
    cross = tuple(EffectParameter(f"misalignment.{AXES[i]}{AXES[j]}", "1") for i, j in OFF_DIAGONAL)
    biases = [_bias(s) for s in INERTIAL]
    scales = [
        _matrix_part("scale", SensorTerm.SCALE, s, per_axis("scale", "1"), scale_columns, ("bias", "temp_scale"))
        for s in INERTIAL
    ]
    crossings = [
        _matrix_part("misalignment", SensorTerm.MISALIGNMENT, s, cross, misalignment_columns, ("rotation", "bias"))
        for s in INERTIAL
    ]
    # A magnetometer's symmetric matrix is its soft iron; what is left of the matrix is the rotation.
    rivals = {
        Sensor.ACCEL: ("misalignment", "bias"),
        Sensor.GYRO: ("misalignment", "bias"),
        Sensor.MAG: ("earth_field", "hard_iron"),
    }
    rotations = [
        _matrix_part(
            "rotation", SensorTerm.ROTATION, s, per_axis("rotation", "rad"), rotation_columns, rivals[s], exact=rotated
        )
        for s in TRIADS
    ]
    return (*biases, *scales, *crossings, *rotations)


EFFECTS = _effects()
