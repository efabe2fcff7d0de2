"""Temperature: a bias that follows it, at once or late, and a scale that follows it.

The temperature at which an effect vanishes is the simulator's or the calibration's choice (25 degC in MATLAB, the
middle of the range in ArduPilot's SITL), one for all axes. It is therefore a parameter: were it fixed elsewhere than
the truth, every thermal effect would be accompanied by a bias that is not there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.gap.effects.affine import scale_columns
from calib.gap.effects.base import Effect, MeanEffect, Missing, Parameter, Shape
from calib.gap.effects.parts import TRIADS, UNIT, axiswise, first_missing, lagged, moves, per_axis
from calib.gap.problem import Trace
from calib.recording import Sensor

Array = NDArray[np.float64]

_LEAST_SPAN = {"temp_linear": 2.0, "temp_poly": 5.0, "temp_scale": 3.0, "thermal_lag": 5.0}  # degC, for any statement
_GOOD_SPAN = 15.0  # degC, for one that tells the rivals apart
_BEYOND = 20.0  # degC by which the reference temperature may lie outside what was seen
_REFERENCES = 5  # tried first: the gain of a slope is a smooth function of it
_ROOTS = 11  # that of a parabola has two tops, one a root
_LAGS = np.geomspace(2.0, 180.0, 5)  # s, of a die in its package to a board in its box

_HEAT_AND_COOL = "heat and cool through the calibration temperature"


def temperature_of(trace: Trace) -> Array:
    """Temperature (N,), degC."""
    assert trace.temperature is not None
    return trace.temperature


def above(trace: Trace, t_ref: float) -> Array:
    """One signal: ``T - t_ref``."""
    return (temperature_of(trace) - t_ref)[None, :]


def powers(trace: Trace, t_ref: float) -> Array:
    """Two signals: ``T - t_ref`` and its square."""
    d = temperature_of(trace) - t_ref
    return np.stack([d, d * d])


def late(trace: Trace, time_constant: float) -> Array:
    """One signal: ``T_late - t_ref``, `T_late` the temperature through one pole.

    Its reference temperature is the one that fits the residual best on white noise (rank one in slope and intercept).
    """
    delayed = lagged(temperature_of(trace), 1.0 / trace.fs, time_constant)
    return (delayed - vanishing_at(delayed, trace.residual, trace.observed))[None, :]


def vanishing_at(temperature: Array, residual: Array, observed: NDArray[np.bool_]) -> float:
    """The one temperature at which slopes of `residual` (N, 3) over `temperature` (N,) leave least unexplained.

    With ``T = m + s u``, u of mean zero and size one, each axis has its slope ``k s`` and mean ``k (m - t_ref)``: the
    nearest rank one to the three pairs of both. It lies in the range of :func:`references`.
    """
    T, y = temperature[observed], residual[observed]
    m, s = float(T.mean()), float(T.std())
    if s == 0.0:
        return m
    pairs = np.stack([(T - m) @ y / (len(T) * s), y.mean(axis=0)])
    left = np.linalg.svd(pairs)[0][:, 0]  # proportional to (s, m - t_ref)
    low, high = float(T.min()) - _BEYOND, float(T.max()) + _BEYOND
    ratio = left[1] / left[0] if left[0] != 0.0 else np.inf
    return float(np.clip(m - s * ratio, low, high))


def warm_scale_columns(trace: Trace, t_ref: float) -> Array:
    """Each axis' ideal reading times ``T - t_ref`` on that axis."""
    return np.asarray(scale_columns(trace, np.nan) * above(trace, t_ref)[0][None, :, None], dtype=np.float64)


def references(trace: Trace) -> Array:
    """Reference temperatures to try, degC."""
    seen = temperature_of(trace)[trace.observed]
    return np.linspace(float(seen.min()) - _BEYOND, float(seen.max()) + _BEYOND, _REFERENCES)


def roots(trace: Trace) -> Array:
    """The same for a parabola."""
    seen = references(trace)
    return np.linspace(float(seen[0]), float(seen[-1]), _ROOTS)


def lags(trace: Trace) -> Array:
    """Time constants to try, s: none that a third of the recording would not show."""
    longest = max(float(trace.t[-1] - trace.t[0]) / 3.0, 2.0 * float(_LAGS[0]))
    return np.asarray(_LAGS[_LAGS <= longest], dtype=np.float64)  # noqa: SIM300


def _span(kind: str) -> Missing:
    def missing(trace: Trace) -> tuple[str, str] | None:
        need = f"span >= {_GOOD_SPAN:.0f} C" + (" with tumble" if kind == "temp_scale" else "")
        if trace.temperature is None:
            return "no temperature recorded", f"temperature of the sensor, {need}"
        seen = trace.temperature[trace.observed]
        span = float(np.ptp(seen)) if len(seen) else 0.0
        return (f"temperature span {span:.1f} C", need) if span < _LEAST_SPAN[kind] else None

    return missing


def _of(sensor: Sensor) -> tuple[Effect, ...]:
    unit = UNIT[sensor]
    at_zero = Shape(Parameter("t_ref", "degC"), references)
    iron = {Sensor.MAG: "soft_iron"}.get(sensor, "scale")
    offset = {Sensor.MAG: "hard_iron"}.get(sensor, "bias")

    def ids(*kinds: str) -> tuple[str, ...]:
        return tuple(f"{sensor}_{kind}" for kind in kinds)

    return (
        MeanEffect(
            f"{sensor}_temp_linear",
            sensor,
            per_axis("per_degc", f"{unit}/degC"),
            "temperature that varies",
            _HEAT_AND_COOL,
            _span("temp_linear"),
            at_zero,
            columns=axiswise(above),
            signals=above,
            rivals=ids("temp_poly", "thermal_lag", "random_walk", offset),
        ),
        MeanEffect(
            f"{sensor}_temp_poly",
            sensor,
            per_axis("per_degc", f"{unit}/degC") + per_axis("per_degc2", f"{unit}/degC2"),
            "temperature that varies widely",
            _HEAT_AND_COOL,
            _span("temp_poly"),
            Shape(at_zero.parameter, roots),
            columns=axiswise(powers),
            signals=powers,
            rivals=ids("temp_linear", "thermal_lag", "random_walk"),
        ),
        MeanEffect(
            f"{sensor}_temp_scale",
            sensor,
            per_axis("scale_per_degc", "1/degC"),
            "temperature that varies while the vehicle turns",
            "tumble cold and warm",
            first_missing((_span("temp_scale"), moves(sensor))),
            at_zero,
            columns=warm_scale_columns,
            rivals=ids(iron, "temp_linear"),
        ),
        MeanEffect(
            f"{sensor}_thermal_lag",
            sensor,
            per_axis("per_degc", f"{unit}/degC"),
            "temperature that turns round",
            _HEAT_AND_COOL,
            _span("thermal_lag"),
            Shape(Parameter("lag_s", "s"), lags),
            columns=axiswise(late),
            signals=late,
            rivals=ids("temp_linear", "temp_poly", "random_walk"),
        ),
    )


EFFECTS: tuple[Effect, ...] = tuple(effect for sensor in TRIADS for effect in _of(sensor))
