"""Parts of a report about the recordings: inputs, series before and after the effects, overstated noise."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Iterable, Iterator
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.model.bands import assembled
from mavcal.calib.gap.model.hypotheses import Key
from mavcal.calib.gap.model.joint import Model, Term, predicted
from mavcal.calib.gap.model.noise_fit import declared
from mavcal.calib.gap.model.views import View
from mavcal.calib.gap.problem import GapProblem
from mavcal.calib.gap.schema import FIRST, Inputs, SeriesFit

Array = NDArray[np.float64]


def inputs_of(problem: GapProblem) -> Inputs:
    """The inputs of a problem."""
    reference = problem.reference
    noise = {
        f"{t.sensor.value}{t.instances[0] + FIRST}": tuple(map(float, t.sigma))
        for t in problem.traces
        if t.sigma is not None and t.against is None
    }
    return Inputs(
        problem.inputs.get("real"),
        problem.inputs.get("sim"),
        max((t.fs for t in problem.traces), default=0.0),
        problem.duration_s,
        reference.kind.value,
        reference.att_sigma_deg,
        reference.text,
        noise,
        diagnoser_sha256(),
    )


@cache
def diagnoser_sha256() -> str:
    """Digest of the sources of ``calib.gap``: the version of the diagnoser."""
    root = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def series_of(model: Model, tolerated: Collection[Key] = ()) -> tuple[SeriesFit, ...]:
    """Every series of a model at its own rate, with both bands as one.

    Effects of the keys `tolerated` are part of the model, but are not listed separately.
    """
    return tuple(_series_fit(model, v, tolerated) for v, band in enumerate(model.setting.views) if not band.first)


def _series_fit(model: Model, v: int, tolerated: Collection[Key]) -> SeriesFit:
    """The series whose lower band, or whole, has index `v`."""
    band = model.setting.views[v]
    view = band.whole
    drawn = {t.hypothesis.key: (t, _at_own_rate(t, band)) for t in model.terms if t.hypothesis.touches(band)}
    modelled = np.add.reduce([np.zeros_like(view.residual), *(added for _, added in drawn.values())])
    parts = _parts([found for key, found in drawn.items() if key not in tolerated])
    power = np.column_stack([assembled(model.setting.views, [n.power for n in model.noise], v, c) for c in range(3)])
    trace, keep = view.any_trace, view.keep
    about = {"temperature": trace.temperature, "current": trace.current, "throttle": trace.throttle}
    instances = tuple(i + FIRST for i in view.weights)
    sigma = np.sqrt(power.mean(axis=0))
    return SeriesFit(
        *(view.sensor, instances, view.t, view.residual, modelled, sigma, trace.unit, parts),
        ideal=trace.ideal[keep] if len(view.weights) == 1 else None,
        covariates={name: values[keep] for name, values in about.items() if values is not None},
        power=power,
    )


def _parts(drawn: Iterable[tuple[Term, Array]]) -> dict[str, Array]:
    """Contribution of each effect to a series, by id; repeated effects are summed."""
    parts: dict[str, Array] = {}
    for term, added in drawn:
        name = term.effect.id
        parts[name] = parts.get(name, 0.0) + added
    return parts


def _at_own_rate(term: Term, band: View) -> Array:
    """Prediction of a term at the series' own rate; slow ones are interpolated from the lower band."""
    if band.fine is None or term.hypothesis.fast:
        return predicted(term, band.whole)
    slow = predicted(term, band)
    return np.column_stack([np.interp(band.whole.t, band.t, column) for column in slow.T])


_MOST_POWER_RATIO = 0.75
"""Ratio of powers below which a notice is given: a drone's noise varies by less from flight to flight. Chosen, not
measured: 14 % less in amplitude (sqrt(0.75))."""
_SURE = 6.0
"""Standard errors of a significant difference. Chosen, not measured: noise in flights is not normal, so six instead of
three."""


def overstated_noise(model: Model) -> Iterator[str]:
    """A notice for every series whose residual has less noise than is declared."""
    labels = dict.fromkeys(view.label for view in model.setting.views)
    for label in labels:
        found = [(v, view) for v, view in enumerate(model.setting.views) if view.label == label]
        view = found[0][1].whole
        if any(declared(band) is None for _, band in found) or len(view.weights) != 1:
            continue
        squares, counts, variance = 0.0, 0.0, 0.0
        for v, band in found:
            power = np.asarray(declared(band))
            squares += float((band.spectra(model.residual[v]).T ** 2 / power).sum())
            variance += float(power.sum() / band.gain)
            counts += power.size
        ratio = squares / counts
        error = math.sqrt(2.0 / counts + 2.0 / (3.0 * view.dof))
        if ratio < _MOST_POWER_RATIO and 1.0 - ratio > _SURE * error:
            instance = next(iter(view.weights)) + 1
            sd = math.sqrt(variance / counts)
            yield (
                f"{view.sensor.value} of instance {instance} has less noise than is declared: "
                f"{math.sqrt(ratio) * sd:.3g} {view.any_trace.unit} a sample beside {sd:.3g}; a "
                f"simulator that has it is {1.0 / math.sqrt(ratio):.2g} times too noisy"
            )
