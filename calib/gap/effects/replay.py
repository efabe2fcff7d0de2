"""Effects of a report added to the ideal readings of a problem: the readings of a remedied simulator."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects import by_id, forward_models
from mavcal.calib.gap.effects.base import CatalogueEffect, MeanEffect, NoiseEffect
from mavcal.calib.gap.problem import GapProblem, Trace, UnknownQuantityError
from mavcal.calib.gap.schema import EffectEstimate

Array = NDArray[np.float64]

_BINS = 1024
"""Bins of a computed noise spectrum. Chosen, not measured: finer than the edge of any filter."""


def with_effects(
    problem: GapProblem, effects: Sequence[EffectEstimate], *, shared: bool = False
) -> tuple[GapProblem, tuple[str, ...]]:
    """`problem` compared with a simulator that has `effects`, and the ids that could not be added.

    Mean effects change the ideal reading, noise effects the expected noise; the residual is what that simulator still
    lacks. Effects that all sensors share belong to the reference and are omitted unless `shared`.
    """
    traces, lost = with_effects_in(problem.traces, effects, shared=shared)
    return dataclasses.replace(problem, traces=traces), lost


def with_effects_in(
    traces: Sequence[Trace], effects: Sequence[EffectEstimate], *, shared: bool = True
) -> tuple[tuple[Trace, ...], tuple[str, ...]]:
    """The same for single traces."""
    lost: dict[str, None] = {}
    made = []
    for trace in traces:
        changed = trace
        for effect, sign in _effects_on(trace, effects):
            described = next((e for e in forward_models().get(effect.id, ()) if _is_complete(e, effect)), None)
            try:
                if isinstance(described, MeanEffect) and (shared or not described.shared):
                    added = sign * added_by(described, effect, trace)
                    # rows without a sample keep a zero residual
                    measured = np.where(trace.observed[:, None], changed.measured, changed.measured + added)
                    changed = dataclasses.replace(changed, ideal=changed.ideal + added, measured=measured)
                elif isinstance(described, NoiseEffect):
                    changed = _with_noise(changed, described, effect)
                else:
                    lost[effect.id] = None
            except UnknownQuantityError:
                lost[effect.id] = None
        made.append(changed)
    return tuple(made), tuple(lost)


def added_by(described: MeanEffect, found: EffectEstimate, trace: Trace) -> Array:
    """What an effect with its parameters adds to the ideal reading of `trace` (N, 3).

    Raises
    ------
    UnknownQuantityError
        If the effect depends on a quantity that is unknown for the trace, such as the angular rate.
    """
    theta, amplitudes = shape_and_amplitudes(described, found)
    if described.exact is not None:
        return described.exact(trace, amplitudes)
    columns = described.columns(trace, theta)
    weights = np.ones(1) if described.fixed else amplitudes
    return np.asarray(np.tensordot(weights, columns, axes=1), dtype=np.float64)


def shape_and_amplitudes(described: CatalogueEffect, found: EffectEstimate) -> tuple[float, Array]:
    """The shape (NaN without one) and the amplitudes, in the catalogue's order."""
    values: Mapping[str, float] = {p.name: p.value for p in found.params}
    amplitudes = np.array([values.get(p.name, 0.0) for p in described.parameters], dtype=np.float64)
    return (math.nan if described.shape is None else values[described.shape.parameter.name]), amplitudes


def _is_complete(described: CatalogueEffect, found: EffectEstimate) -> bool:
    """Whether every parameter was estimated."""
    known = {p.name for p in found.params}
    shape = {described.shape.parameter.name} if described.shape is not None else set()
    return {p.name for p in described.parameters} | shape <= known


def _effects_on(trace: Trace, effects: Iterable[EffectEstimate]) -> Iterable[tuple[EffectEstimate, float]]:
    """Effects on the trace's sensor with sign one, and those on the instance that it is compared with, negated."""
    for effect in effects:
        if effect.sensor is None:  # of airframe or air: it moves no sensor's reading
            continue
        if effect.sensor is not trace.sensor and not by_id()[effect.id].shared:
            continue
        if trace.instances[0] + 1 in effect.instances:
            yield effect, 1.0
        if trace.against is not None and trace.against + 1 in effect.instances:
            yield effect, -1.0


def _with_noise(trace: Trace, described: NoiseEffect, found: EffectEstimate) -> Trace:
    """`trace` with the effect's power in its declared noise; undeclared noise is learned anyway."""
    theta, values = shape_and_amplitudes(described, found)
    squared = np.array([v**2 if p.squared else v for v, p in zip(values, described.parameters, strict=True)])
    hz = np.linspace(0.0, 0.5 * trace.fs, _BINS) if trace.psd_hz is None else trace.psd_hz
    omega = 2.0 * np.pi * np.asarray(hz) / trace.fs
    density = described.density(trace, omega, theta)
    power = np.einsum("pk,pc->kc", density, squared.reshape(len(density), 3))
    if trace.psd is None:
        if trace.sigma is None:
            return trace
        base = np.broadcast_to(trace.sigma**2, (len(hz), 3))
    else:
        base = trace.psd
    own = None if trace.own_psd is None else trace.own_psd + power
    return dataclasses.replace(trace, psd=base + power, psd_hz=np.asarray(hz), own_psd=own)
