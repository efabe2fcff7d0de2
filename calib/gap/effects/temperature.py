"""Thermal effects: a bias that follows the temperature, directly or late, and a scale that follows it.

The temperature at which an effect vanishes is the same on all axes and depends on the simulator or the calibration. It
is 25 degC in MATLAB, and the middle of the range in ArduPilot's SITL. It is therefore a parameter; a wrong fixed value
would add a bias to every thermal effect.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects.affine import scale_columns
from mavcal.calib.gap.effects.base import CatalogueEffect, EffectParameter, EffectShape, MeanEffect, Missing
from mavcal.calib.gap.effects.parts import TRIADS, axiswise, first_missing, lagged, missing_movement, per_axis
from mavcal.calib.gap.effects.traits import SensorTerm, Trait
from mavcal.calib.gap.problem import UNIT, Trace, known
from mavcal.calib.gap.remembered import remembered
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_LEAST_SPAN = {"temp_linear": 2.0, "temp_poly": 5.0, "temp_scale": 3.0, "thermal_lag": 5.0}
"""Least temperature span, degC, for an effect to be testable. Chosen, not measured: a scale needs more than an offset,
and a curve or a lag more than a slope."""
_TRAITS = frozenset({Trait.THERMAL, Trait.LEVEL})
_GOOD_SPAN = 15.0
"""Temperature span, degC, that separates the rivals. Source: GAP 8."""
_OUTSIDE_SEEN = 20.0
"""Largest distance, K, of the reference temperature from the recorded range. Chosen, not measured: few flights are
further from the temperature of their calibration."""
_REFERENCES = 13
"""Temperatures of the grid. Chosen, not measured: 5 kelvin apart for a span of 20."""
_TRIED = 241
"""Temperatures whose cost is computed. Chosen, not measured: twenty to each step of the grid."""
_MINIMA = 2
"""Minima of that cost that are tried. Chosen, not measured: it bounds the time."""
_LAGS = np.geomspace(2.0, 180.0, 5)
"""Time constants that are tried, s: of a die in its package to a board in its box. Chosen, not measured: neighbours
differ by a factor of three, and refinement goes between."""

_POWERS = {"per_degc": "", "per_degc2": "2", "per_degc3": "3"}

_HEAT_AND_COOL = "heat and cool through the calibration temperature"


def temperature_of(trace: Trace) -> Array:
    """Temperature (N,), degC."""
    return known(trace.temperature, "temperature")


def temperature_difference(trace: Trace, t_ref: float) -> Array:
    """``T - t_ref`` (1, N)."""
    return (temperature_of(trace) - t_ref)[None, :]


def temperature_powers(trace: Trace, t_ref: float) -> Array:
    """``T - t_ref``, its square and its cube (3, N)."""
    d = temperature_of(trace) - t_ref
    return np.stack([d, d * d, d * d * d])


def lagged_temperature(trace: Trace, time_constant: float) -> Array:
    """``T_lag - t_ref`` (1, N), with `T_lag` the temperature through a first-order lag.

    `t_ref` is the one that fits the residual best under white noise (rank one in slope and intercept).
    """
    delayed = lagged(temperature_of(trace), 1.0 / trace.fs, time_constant)
    return (delayed - best_reference_temperature(delayed, trace.residual, trace.observed))[None, :]


def best_reference_temperature(temperature: Array, residual: Array, observed: NDArray[np.bool_]) -> float:
    """Temperature at which linear fits of `residual` (N, 3) over `temperature` (N,) cross zero, of least misfit.

    With ``T = m + s u``, u of mean zero and size one, each axis has the slope ``k s`` and the mean ``k (m - t_ref)``:
    the nearest rank one to the three pairs. It lies in the range of :func:`reference_temperatures`.
    """
    T, y = temperature[observed], residual[observed]
    m, s = float(T.mean()), float(T.std())
    if s == 0.0:
        return m
    pairs = np.stack([(T - m) @ y / (len(T) * s), y.mean(axis=0)])
    left = np.linalg.svd(pairs)[0][:, 0]  # proportional to (s, m - t_ref)
    low, high = float(T.min()) - _OUTSIDE_SEEN, float(T.max()) + _OUTSIDE_SEEN
    ratio = left[1] / left[0] if left[0] != 0.0 else np.inf
    return float(np.clip(m - s * ratio, low, high))


def temperature_scale_columns(trace: Trace, t_ref: float) -> Array:
    """Each axis' ideal reading times ``T - t_ref`` on that axis."""
    return np.asarray(
        scale_columns(trace, np.nan) * temperature_difference(trace, t_ref)[0][None, :, None], dtype=np.float64
    )


def reference_temperatures(trace: Trace) -> Array:
    """Reference temperatures to try, degC."""
    seen = temperature_of(trace)[trace.observed]
    return np.linspace(float(seen.min()) - _OUTSIDE_SEEN, float(seen.max()) + _OUTSIDE_SEEN, _REFERENCES)


def best_references(factor: Callable[[Trace], Array], degree: int) -> Callable[[Trace, Array], Array]:
    """Screen of :func:`reference_temperatures` for an effect of `degree` in temperature on the signals `factor` (N, 3).

    Each axis is fitted with a free polynomial c (white noise). The constraint that it vanishes at T, ``a'c = 0`` with
    ``a = (1, T, T^2 ...)``, costs ``(a'c)^2 / (a' G^-1 a)``, with G the Gram matrix. The temperatures of least cost are
    returned.
    """

    @remembered(8)
    def prepared(trace: Trace) -> tuple[Array, Array, Array]:
        grid = reference_temperatures(trace)
        u = (temperature_of(trace)[trace.observed] - 0.5 * (grid[0] + grid[-1])) / (0.5 * (grid[-1] - grid[0]))
        signals, powers_of_u = factor(trace)[trace.observed], u ** np.arange(degree + 1)[:, None]
        grams = np.array([(powers_of_u * column**2) @ powers_of_u.T for column in signals.T])
        return signals, powers_of_u, np.linalg.pinv(grams, hermitian=True)

    def screen(trace: Trace, residual: Array) -> Array:
        grid = reference_temperatures(trace)
        middle, half = 0.5 * (grid[0] + grid[-1]), 0.5 * (grid[-1] - grid[0])
        tried = np.linspace(-1.0, 1.0, _TRIED)
        a = tried[:, None] ** np.arange(degree + 1)
        signals, powers_of_u, inverses = prepared(trace)
        right = powers_of_u @ (signals * residual[trace.observed])
        cost = np.zeros(_TRIED)
        for axis, inverse in enumerate(inverses):
            cost += (a @ inverse @ right[:, axis]) ** 2 / np.maximum(
                ((a @ inverse) * a).sum(axis=1), np.finfo(float).tiny
            )
        edged = np.concatenate([[np.inf], cost, [np.inf]])
        lowest = np.flatnonzero((cost <= edged[:-2]) & (cost <= edged[2:]))
        best = lowest[np.argsort(cost[lowest])[:_MINIMA]]
        found = np.clip(middle + half * np.sort(tried[best]), grid[0], grid[-1])
        return np.asarray(found, dtype=np.float64)

    return screen


def _ones(trace: Trace) -> Array:
    return np.ones_like(trace.ideal)


def _ideal(trace: Trace) -> Array:
    return trace.ideal


def lags(trace: Trace) -> Array:
    """Time constants to try, s, up to a third of the recording."""
    longest = max(float(trace.t[-1] - trace.t[0]) / 3.0, 2.0 * float(_LAGS[0]))
    return np.asarray(_LAGS[_LAGS <= longest], dtype=np.float64)  # noqa: SIM300


def _missing_span(kind: str) -> Missing:
    def missing(trace: Trace) -> tuple[str, str] | None:
        need = f"span >= {_GOOD_SPAN:.0f} C" + (" with tumble" if kind == "temp_scale" else "")
        if trace.temperature is None:
            return "no temperature recorded", f"temperature of the sensor, {need}"
        seen = trace.temperature[trace.observed]
        span = float(np.ptp(seen)) if len(seen) else 0.0
        return (f"temperature span {span:.1f} C", need) if span < _LEAST_SPAN[kind] else None

    return missing


def _effects_of(sensor: Sensor) -> tuple[CatalogueEffect, ...]:
    unit = UNIT[sensor]
    vanishes = EffectParameter("t_ref", "degC")
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
            _missing_span("temp_linear"),
            EffectShape(vanishes, reference_temperatures, best_references(_ones, 1), chosen=True),
            columns=axiswise(temperature_difference),
            signals=temperature_difference,
            plain="an offset that follows the temperature",
            rivals=ids("temp_poly", "thermal_lag", "random_walk", offset),
            traits=_TRAITS,
            term=SensorTerm.TEMPERATURE_CURVE,
        ),
        MeanEffect(
            f"{sensor}_temp_poly",
            sensor,
            tuple(p for n, to in _POWERS.items() for p in per_axis(n, f"{unit}/degC{to}")),
            "temperature that varies widely",
            _HEAT_AND_COOL,
            _missing_span("temp_poly"),
            EffectShape(vanishes, reference_temperatures, best_references(_ones, 3), chosen=True),
            columns=axiswise(temperature_powers),
            signals=temperature_powers,
            plain="an offset that follows the temperature along a curve",
            rivals=ids("temp_linear", "thermal_lag", "random_walk"),
            traits=_TRAITS,
            term=SensorTerm.TEMPERATURE_CURVE,
        ),
        MeanEffect(
            f"{sensor}_temp_scale",
            sensor,
            per_axis("scale_per_degc", "1/degC"),
            "temperature that varies while the vehicle turns",
            "tumble cold and warm",
            first_missing((_missing_span("temp_scale"), missing_movement(sensor))),
            EffectShape(vanishes, reference_temperatures, best_references(_ideal, 1), chosen=True),
            columns=temperature_scale_columns,
            plain="a scale that follows the temperature",
            rivals=ids(iron, "temp_linear"),
            traits=_TRAITS,
            term=SensorTerm.TEMPERATURE_SCALE,
        ),
        MeanEffect(
            f"{sensor}_thermal_lag",
            sensor,
            per_axis("per_degc", f"{unit}/degC"),
            "temperature that turns round",
            _HEAT_AND_COOL,
            _missing_span("thermal_lag"),
            EffectShape(EffectParameter("lag_s", "s"), lags),
            columns=axiswise(lagged_temperature),
            signals=lagged_temperature,
            plain="an offset that follows the temperature late",
            rivals=ids("temp_linear", "temp_poly", "random_walk"),
            traits=_TRAITS,
            term=SensorTerm.THERMAL_LAG,
            hidden=1,
        ),
    )


EFFECTS: tuple[CatalogueEffect, ...] = tuple(effect for sensor in TRIADS for effect in _effects_of(sensor))
