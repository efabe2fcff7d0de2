"""The series of a report: what was left of each, and what a model makes of it, effect by effect."""

from __future__ import annotations

from collections.abc import Collection, Iterable

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.model.bands import assembled
from mavcal.calib.gap.model.hypotheses import Key
from mavcal.calib.gap.model.joint import Model, Term, predicted
from mavcal.calib.gap.model.views import View
from mavcal.calib.gap.schema import FIRST, SeriesFit

Array = NDArray[np.float64]


def series_of(model: Model, tolerated: Collection[Key] = ()) -> tuple[SeriesFit, ...]:
    """Every series of a model at its own rate; what its bands have in common is one.

    Effects of the keys `tolerated` are in what is modelled and are not shown by themselves.
    """
    return tuple(_fit(model, v, tolerated) for v, band in enumerate(model.setting.views) if not band.first)


def _fit(model: Model, v: int, tolerated: Collection[Key]) -> SeriesFit:
    """The series whose lower band, or whole, has index `v`."""
    band = model.setting.views[v]
    view = band.whole
    drawn = {t.hypothesis.key: (t, _drawn(t, band)) for t in model.terms if t.hypothesis.touches(band)}
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
    """What each effect adds to a series, by id; what happens more than once is shown as one."""
    parts: dict[str, Array] = {}
    for term, added in drawn:
        name = term.effect.id
        parts[name] = parts.get(name, 0.0) + added
    return parts


def _drawn(term: Term, band: View) -> Array:
    """The prediction of a term at the own rate of a series; what is slow is drawn between the samples of its band."""
    if band.fine is None or term.hypothesis.fast:
        return predicted(term, band.whole)
    slow = predicted(term, band)
    return np.column_stack([np.interp(band.whole.t, band.t, column) for column in slow.T])
