"""Effects of the vehicle's motion: g-sensitivity of a gyroscope, lever arm of an accelerometer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects.base import CatalogueEffect, EffectParameter, MeanEffect
from mavcal.calib.gap.effects.parts import AXES, TUMBLE, on_each_axis, per_axis, spread
from mavcal.calib.gap.effects.traits import SensorTerm, Trait
from mavcal.calib.gap.problem import Trace, known
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_LEAST_FORCE = 0.3
"""Least standard deviation of the specific force, m/s2, for the effect to be testable. Chosen, not measured: 3 % of
gravity."""
_LEAST_LEVER = 0.05
"""Least standard deviation, m/s2 per metre of lever, for the effect to be testable. Chosen, not measured: a lever of 2
cm then shows 1 mm/s2, a tenth of a milligravity."""


def g_sensitivity_signals(trace: Trace, _theta: float) -> Array:
    """The components of the specific force (3, N), m/s2."""
    return np.ascontiguousarray(known(trace.force, "specific force").T)


def lever_columns(trace: Trace, _theta: float) -> Array:
    """Columns of the lever arm: ``dw/dt x e_j + w x (w x e_j)``, the acceleration one metre along axis j."""
    w, a = known(trace.rate, "angular rate"), known(trace.spin, "angular acceleration")
    columns = np.empty((3, *w.shape))
    for j, e in enumerate(np.eye(3)):
        columns[j] = np.cross(a, e) + w * w[:, j : j + 1] - e * (w * w).sum(axis=1, keepdims=True)
    return columns


def _missing_force(trace: Trace) -> tuple[str, str] | None:
    need = f"a variation >= 0.3 m/s2: {TUMBLE}"
    if trace.force is None:
        return "specific force unknown", f"an accelerometer or a reference; {need}"
    size = spread(trace.force, trace.observed)
    return None if size >= _LEAST_FORCE else (f"specific force varies by {size:.2g} m/s2", need)


def _missing_rotation(trace: Trace) -> tuple[str, str] | None:
    need = ">= 0.05 m/s2 per metre of lever: fast turns about two axes"
    if trace.rate is None or trace.spin is None:
        return "angular rate unknown", f"a gyroscope or a reference; {need}"
    size = max(spread(column, trace.observed) for column in lever_columns(trace, np.nan))
    return None if size >= _LEAST_LEVER else (f"a lever of one metre would show {size:.2g} m/s2", need)


def _g_columns(trace: Trace, theta: float) -> Array:
    return on_each_axis(g_sensitivity_signals(trace, theta))


EFFECTS: tuple[CatalogueEffect, ...] = (
    MeanEffect(
        "gyro_g_sensitivity",
        Sensor.GYRO,
        tuple(EffectParameter(f"g_sensitivity.{row}{column}", "rad/s/(m/s2)") for column in AXES for row in AXES),
        "attitudes, accelerations",
        TUMBLE,
        _missing_force,
        columns=_g_columns,
        signals=g_sensitivity_signals,
        plain="a rate that follows the specific force",
        rivals=("gyro_bias", "gyro_vibration_rectification"),
        term=SensorTerm.G_SENSITIVITY,
    ),
    MeanEffect(
        "accel_lever_arm",
        Sensor.ACCEL,
        per_axis("lever_arm", "m"),
        "fast turns",
        "fast turns about two axes at different rates; a yaw jerk",
        _missing_rotation,
        columns=lever_columns,
        plain="a sensor away from the reference point",
        rivals=("accel_delay", "accel_low_pass"),
        traits=frozenset({Trait.STEADY}),
    ),
)
