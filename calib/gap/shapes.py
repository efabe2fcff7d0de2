"""Shapes that no effect of the catalogue has: broken lines over covariates, products, and low orders of the readings.

They stand in the same contest as the catalogue and pay for their freedom. Low orders are there beside the broken lines
since one amplitude an axis shows what six would hide: a curve, a dead travel, a slow approach.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from calib.gap.effects.base import MeanEffect, Parameter
from calib.gap.hypotheses import Hypothesis
from calib.gap.model import Setting
from calib.gap.problem import Trace
from calib.recording import Sensor

Array = NDArray[np.float64]

PREFIX = "unknown"
_KNOTS = 6
_KNOTS_TIME = 20
_TIES = 1e-3
_APPROACHES_S = (3.0, 10.0, 30.0)
_STILL = 0.1  # of the rms slope: slower changes have no direction


def shapes_of(setting: Setting) -> tuple[Hypothesis, ...]:
    """Every shape that can be drawn, of every sensor and instance."""
    found = []
    for view in setting.views:
        for instance, trace in view.traces.items() if not view.first else ():
            if instance in view.weights:
                found += [Hypothesis(effect, (instance,)) for effect in _effects(trace)]
    unique = {h.key: h for h in found}
    return tuple(unique.values())


def _effects(trace: Trace) -> Iterator[MeanEffect]:
    for name, values, knots in _covariates(trace):
        basis = _hats(values, trace.observed, knots)
        if basis is not None:
            yield from _on_axes(trace.sensor, f"function of {name}", basis)
    for name, products in _products(trace):
        yield _effect(trace.sensor, f"{name} on {trace.sensor.value}", products, None)
    for name, signal in _orders(trace):
        yield _effect(trace.sensor, f"{name} on {trace.sensor.value}", _fixed_basis(signal), None)
    for name, columns in _own(trace):
        yield _by_axis(trace.sensor, f"{name} on {trace.sensor.value}", columns)


def _on_axes(sensor: Sensor, name: str, basis: Callable[[Trace], Array]) -> Iterator[MeanEffect]:
    yield _effect(sensor, f"{name} on {sensor.value}", basis, None)
    for c in range(3):
        yield _effect(sensor, f"{name} on {sensor.value}.{'xyz'[c]}", basis, c)


def _effect(sensor: Sensor, text: str, basis: Callable[[Trace], Array], axis: int | None) -> MeanEffect:
    def signals(trace: Trace, _theta: float) -> Array:
        return basis(trace)

    def columns(trace: Trace, _theta: float) -> Array:
        made = basis(trace)
        placed = np.zeros((*made.shape, 3))
        placed[:, :, axis or 0] = made
        return placed

    return MeanEffect(
        f"{PREFIX}:{text}",
        sensor,
        (Parameter("amplitude", ""),),
        text,
        "a recording in which the covariate varies by itself",
        columns=columns,
        signals=signals if axis is None else None,
    )


def _by_axis(sensor: Sensor, text: str, values: Array) -> MeanEffect:
    """One amplitude an axis, on `values` (N, 3)."""

    def columns(_trace: Trace, _theta: float) -> Array:
        placed = np.zeros((3, *values.shape))
        for axis in range(3):
            placed[axis, :, axis] = values[:, axis]
        return placed

    parameters = (Parameter("amplitude", ""),)
    wish = "a recording in which the covariate varies by itself"
    return MeanEffect(f"{PREFIX}:{text}", sensor, parameters, text, wish, columns=columns)


def _own(trace: Trace) -> Iterator[tuple[str, Array]]:
    """Of each axis' own ideal reading: low orders, and the direction of its change."""
    x = trace.ideal
    size = np.sqrt((x**2).mean(axis=0)) + 1e-300
    yield "square of the reading", (x / size) ** 2
    yield "cube of the reading", (x / size) ** 3
    yield "size of the reading", np.abs(x) / size
    slope = np.gradient(x, axis=0)
    steady = _STILL * np.sqrt((slope**2).mean(axis=0)) + 1e-300
    yield "direction of the reading's change", np.tanh(slope / steady)


def _orders(trace: Trace) -> Iterator[tuple[str, Array]]:
    """Signals (q, N) of low order."""
    for name, scalar in (("current", trace.current), ("throttle", trace.throttle)):
        if scalar is not None:
            yield f"square of {name}", (scalar**2)[None]
    elapsed = trace.t - trace.t[0]
    for time in _APPROACHES_S:
        yield f"approach with {time:.0f} s", np.exp(-elapsed / time)[None]
    if trace.sensor is Sensor.MAG:
        yield "change of the field", np.ascontiguousarray(np.gradient(trace.ideal, trace.t, axis=0).T)


def _fixed_basis(signals: Array) -> Callable[[Trace], Array]:
    def basis(_trace: Trace) -> Array:
        return signals

    return basis


def _covariates(trace: Trace) -> Iterator[tuple[str, Array, int]]:
    for letter, vector in (("a", trace.force), ("w", trace.rate), ("dw", trace.spin), ("m", trace.field)):
        if vector is not None:
            yield from ((f"{letter}_{'xyz'[c]}", vector[:, c], _KNOTS) for c in range(3))
    for name, vector in (("|a|", trace.force), ("|w|", trace.rate)):
        if vector is not None:
            yield name, np.linalg.norm(vector, axis=1), _KNOTS
    yield "time", trace.t, _KNOTS_TIME
    for name, scalar in (("temperature", trace.temperature), ("current", trace.current), ("throttle", trace.throttle)):
        if scalar is not None:
            yield name, scalar, _KNOTS
    if trace.rotor_hz is not None:
        yield "rotor speed", trace.rotor_hz.mean(axis=1), _KNOTS
    if trace.temperature is not None:
        yield "the slope of temperature", np.gradient(trace.temperature, trace.t), _KNOTS


def _hats(values: Array, observed: NDArray[np.bool_], knots: int) -> Callable[[Trace], Array] | None:
    """Hat functions over quantiles of a covariate; None where it hardly varies."""
    seen = values[observed]
    if len(seen) < 4 * knots or float(np.ptp(seen)) <= 1e-9 * (abs(float(seen.mean())) + 1e-12):
        return None
    at = np.unique(np.quantile(seen, np.linspace(0.0, 1.0, knots)))
    keep = np.concatenate([[True], np.diff(at) > _TIES * np.ptp(at)])
    at = at[keep]
    if len(at) < 3:
        return None
    clipped = np.clip(values, at[0], at[-1])

    def basis(_trace: Trace) -> Array:
        return np.array([np.interp(clipped, at, unit) for unit in np.eye(len(at))])

    return basis


def _products(trace: Trace) -> Iterator[tuple[str, Callable[[Trace], Array]]]:
    pairs = (
        ("products of a and a", trace.force, trace.force),
        ("products of w and w", trace.rate, trace.rate),
        ("products of a and w", trace.force, trace.rate),
        ("current times field", _column(trace.current), trace.field),
        ("current times a", _column(trace.current), trace.force),
        ("temperature times a", _column(trace.temperature), trace.force),
        ("temperature times w", _column(trace.temperature), trace.rate),
    )
    for name, one, other in pairs:
        if one is not None and other is not None:
            yield name, _product(one, other)


def _column(scalar: Array | None) -> Array | None:
    return None if scalar is None else (scalar - scalar.mean())[:, None]


def _product(one: Array, other: Array) -> Callable[[Trace], Array]:
    same = one is other

    def basis(_trace: Trace) -> Array:
        rows = [one[:, i] * other[:, j] for i in range(one.shape[1]) for j in range(i if same else 0, other.shape[1])]
        return np.array(rows)

    return basis
