"""Common parts of the families: names, columns made of signals, and requirements of a trace."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from mavcal.calib.gap.effects.base import EffectParameter, Missing
from mavcal.calib.gap.problem import Trace
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

AXES = "xyz"
INERTIAL = (Sensor.ACCEL, Sensor.GYRO)
TRIADS = (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG)

TUMBLE = "tumble through six attitudes or more"

_SPREAD = {Sensor.ACCEL: 0.3, Sensor.GYRO: 0.02, Sensor.MAG: 2.0}
"""Least standard deviation of the ideal reading for effects proportional to it: 3 % of its usual size. Chosen, not
measured: an error of 1 % then shows 3 mm/s2, 0.2 mrad/s or 0.02 uT."""
_MOVEMENT = {
    Sensor.ACCEL: "specific force varies by {:.2g} m/s2",
    Sensor.GYRO: "angular rate varies by {:.2g} rad/s",
    Sensor.MAG: "field varies by {:.2g} uT",
}
_TURN = {
    Sensor.ACCEL: f"a variation >= 0.3 m/s2: {TUMBLE}",
    Sensor.GYRO: "a variation >= 0.02 rad/s: turn about all three axes",
    Sensor.MAG: f"a variation >= 2 uT: {TUMBLE}",
}


def per_axis(name: str, unit: str, *, squared: bool = False) -> tuple[EffectParameter, ...]:
    """``name.x name.y name.z``."""
    return tuple(EffectParameter(f"{name}.{axis}", unit, squared) for axis in AXES)


def on_each_axis(signals: Array) -> Array:
    """Columns (3 q, N, 3) of `signals` (q, N): column ``3 q + axis`` is signal q on that axis alone."""
    q, n = signals.shape
    columns = np.zeros((q, 3, n, 3))
    for axis in range(3):
        columns[:, axis, :, axis] = signals
    return columns.reshape(3 * q, n, 3)


def axiswise(signals: Callable[[Trace, float], Array]) -> Callable[[Trace, float], Array]:
    """Columns of an effect that acts on each axis with `signals`."""

    def columns(trace: Trace, theta: float) -> Array:
        return on_each_axis(signals(trace, theta))

    return columns


def crossed(vectors: Array) -> Array:
    """Columns (3, N, 3): ``e_j x v`` of `vectors` (N, 3), what a small rotation about axis j adds."""
    x, y, z = vectors.T
    o = np.zeros(len(vectors))
    return np.stack([np.stack(c, axis=1) for c in ((o, -z, y), (z, o, -x), (-y, x, o))])


def body_from_ned(attitude: Array) -> Array:
    """Matrices (N, 3, 3) that take north-east-down to the body, from quaternions (N, 4) body to north-east-down."""
    w, x, y, z = (attitude / np.linalg.norm(attitude, axis=1, keepdims=True)).T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


def lagged(values: Array, dt: float, time_constant: float) -> Array:
    """`values` (N, ...) through a first-order lag that was settled at the first sample, exact for linear input.

    ``y' = (x - y) / tau``: with ``e = exp(-dt/tau)`` and ``g = (1 - e) tau/dt``, ``y_n = e y_(n-1) + (g - e) x_(n-1) +
    (1 - g) x_n``.
    """
    e = np.exp(-dt / time_constant)
    g = -np.expm1(-dt / time_constant) * time_constant / dt
    b, a = np.array([1.0 - g, g - e]), np.array([1.0, -e])
    start = (1.0 - b[0]) * values[:1]  # settled: y = x
    return np.asarray(lfilter(b, a, values, axis=0, zi=start)[0], dtype=np.float64)


def spread(values: Array, observed: NDArray[np.bool_]) -> float:
    """Largest standard deviation over time of the columns of `values` (N, k) where observed."""
    seen = values[observed]
    return float(seen.std(axis=0).max()) if len(seen) else 0.0


def missing_movement(sensor: Sensor) -> Missing:
    """What is missing if the ideal reading is constant: the effect would be indistinguishable from a bias."""

    def missing(trace: Trace) -> tuple[str, str] | None:
        if sensor is Sensor.GYRO and not trace.rate_known:
            return "the re-estimated reference does not follow fast turns", "a log at a higher rate, or a pose"
        size = spread(trace.ideal, trace.observed)
        if size >= _SPREAD[sensor]:
            return None
        return _MOVEMENT[sensor].format(size), _TURN[sensor]

    return missing


def first_missing(conditions: Iterable[Missing]) -> Missing:
    """The first of `conditions` that is not met."""
    known = tuple(conditions)

    def missing(trace: Trace) -> tuple[str, str] | None:
        return next((lack for condition in known if (lack := condition(trace)) is not None), None)

    return missing
