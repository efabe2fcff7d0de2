"""Checks of added noise, lines and tones before they count as effects of a sensor.

Noise must exceed the usual difference between two flights, and be on the instances that show it. Beside a line it must
exceed that line's unsteadiness. A tone must not be in a nominal recording as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects.traits import Trait
from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.model.joint import Model, NoiseTerm, Term
from mavcal.calib.gap.model.noise_fit import densities_of
from mavcal.calib.gap.model.views import View
from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.search import prices

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class AddedNoise:
    """Noise of a hypothesis: `amplitudes` (p, 3) of its densities at the shape `theta`."""

    hypothesis: Hypothesis
    theta: float
    amplitudes: Array

    def power(self, model: Model, v: int) -> Array:
        """Power that it adds to the bins of series `v`, (3, n)."""
        return self.amplitudes.T @ densities_of(self.hypothesis, model.setting.views[v], self.theta)


def _series_of(hypothesis: Hypothesis, model: Model) -> list[int]:
    return [v for v, view in enumerate(model.setting.views) if hypothesis.touches(view)]


def exceeds_flight_differences(added: AddedNoise, model: Model) -> bool:
    """Whether added noise exceeds the usual difference in noise between two flights of one vehicle.

    A spectrum learned from another recording is a mean over its rest and its flight, in unknown proportion. Beside
    declared noise any addition counts.
    """
    touched = _series_of(added.hypothesis, model)
    if any(model.setting.views[v].density is None for v in touched):
        return True
    for v in touched:
        base = np.array([model.noise[3 * v + c].power for c in range(3)])
        if float((added.power(model, v) / base).max()) > prices.FLIGHT_NOISE_RATIO:
            return True
    return False


def is_line_unsteadiness(term: NoiseTerm, model: Model) -> bool:
    """Whether broadband noise of a model may be the unsteadiness of a line beside it."""
    if Trait.LINE in term.hypothesis.effect.traits:
        return False
    return _term_power(term, term.hypothesis, model) <= prices.LINE_UNSTEADINESS * line_power(term.hypothesis, model)


def drift_exceeds_lines(added: AddedNoise, model: Model) -> bool:
    """Whether drift noise exceeds the unsteadiness of the model's lines, whose skirts reach the lowest bins."""
    if not added.hypothesis.effect.drifts:
        return True
    power = sum(float(added.power(model, v).sum()) for v in _series_of(added.hypothesis, model))
    return power > prices.LINE_UNSTEADINESS * line_power(added.hypothesis, model)


def tone_exceeds_lines(hypothesis: Hypothesis, beta: Array, model: Model) -> bool:
    """Whether a tone with amplitudes `beta` exceeds the unsteadiness of the model's lines."""
    if not hypothesis.effect.tonal:
        return True
    samples = sum(
        model.setting.views[v].whole.n for v in _series_of(hypothesis, model) if not model.setting.views[v].first
    )
    return 0.5 * float(beta @ beta) * samples > prices.LINE_UNSTEADINESS * line_power(hypothesis, model)


def line_power(hypothesis: Hypothesis, model: Model) -> float:
    """Power of the model's lines on the sensor of `hypothesis`, summed over bins and axes."""
    return sum(
        _term_power(term, hypothesis, model)
        for term in model.noise_terms
        if term.hypothesis.effect.sensor is hypothesis.effect.sensor and Trait.LINE in term.hypothesis.effect.traits
    )


def _term_power(term: NoiseTerm, hypothesis: Hypothesis, model: Model) -> float:
    names = [term.name(j) for j in range(len(term.hypothesis.effect.parameters) // 3)]
    seen = [n for a, n in enumerate(model.noise) if hypothesis.touches(model.setting.views[a // 3])]
    return sum(n.amplitudes[k] * float(n.densities[k].sum()) for n in seen for k in names if k in n.amplitudes)


def is_on_loud_instances(added: AddedNoise, model: Model) -> bool:
    """Whether the instances of a hypothesis are those that show the noise.

    Sums and differences of instances have the same spectra whichever of them is loud; the single instances do not.
    """
    excess = _excess_by_instance(added, model)
    if not excess:
        return True
    largest = max(excess.values())
    if largest <= 0.0:
        return True
    return {i for i, e in excess.items() if e > prices.INSTANCE_SHARE * largest} == set(added.hypothesis.instances)


def _excess_by_instance(added: AddedNoise, model: Model) -> Mapping[int, float]:
    """By instance, power above the noise, weighted by the added density; empty if every series is of one instance."""
    found: dict[int, float] = {}
    for v in _series_of(added.hypothesis, model):
        view = model.setting.views[v]
        if len(view.weights) < 2:
            continue
        group = [
            u
            for u, other in enumerate(model.setting.views)
            if other.sensor is view.sensor and other.first == view.first and other.count == view.count
        ]
        weights = {i: [model.setting.views[u].weights.get(i, 0.0) for u in group] for i in view.weights}
        rows = np.array(list(weights.values()))
        if np.abs(rows @ rows.T - np.eye(len(rows))).max() > 1e-6:
            return {}  # not orthonormal: no way back to single instances
        shape = _search_band(added, model, v)
        spectra = [model.setting.views[u].spectra(model.residual[u]) for u in group]
        power = np.array([[model.noise[3 * u + c].power for c in range(3)] for u in group])
        for i, row in weights.items():
            own = np.add.reduce([w * y for w, y in zip(row, spectra, strict=True)])
            base = np.add.reduce([w * w * p for w, p in zip(row, power, strict=True)])
            found[i] = found.get(i, 0.0) + float((shape / base**2 * (own**2 - base)).sum())
    return found


def _search_band(added: AddedNoise, model: Model, v: int) -> Array:
    """Bins in which added noise is searched for, (3, n).

    A line is sought around its frequency, because each unit has its own clock.
    """
    power = added.power(model, v)
    if Trait.LINE not in added.hypothesis.effect.traits:
        return power
    view = model.setting.views[v]
    near = _near_peak(view, int(np.argmax(power.sum(axis=0))))
    return np.where(near, power.max(axis=1, keepdims=True), 0.0)


def _near_peak(view: View, peak: int) -> NDArray[np.bool_]:
    """Bins near the peak of a line."""
    return np.asarray(np.abs(view.omega - view.omega[peak]) < prices.LINE_REACH_HZ * 2.0 * np.pi / view.whole.fs)


def line_amplitudes(term: NoiseTerm, model: Model) -> tuple[Array, Array]:
    """Squared amplitudes (3,) of a line from the power near its frequency alone, and their standard errors.

    The likelihood uses all bins; the skirts of a strong and unsteady line would dominate it.
    """
    total, size, scatter = np.zeros(3), np.zeros(3), np.zeros(3)
    for v in _series_of(term.hypothesis, model):
        view = model.setting.views[v]
        density = densities_of(term.hypothesis, view, term.theta)[0]
        near = _near_peak(view, int(np.argmax(density)))
        spectra = view.spectra(model.residual[v])
        for c in range(3):
            noise = model.noise[3 * v + c]
            rest = noise.power - noise.amplitudes.get(term.name(0), 0.0) * density
            total[c] += float((spectra[c] ** 2 - rest)[near].sum())
            size[c] += float(density[near].sum())
            # A normal y has var y^2 = 2 s^4 = 2/3 E y^4.
            scatter[c] += float((spectra[c] ** 4)[near].sum()) * 2.0 / 3.0
    size = np.maximum(size, np.finfo(float).tiny)
    return np.maximum(total / size, 0.0), np.sqrt(scatter) / size


def nominal_has_tone(term: Term, nominal: Iterable[Trace]) -> bool:
    """Whether a nominal recording has a line at the frequency of a tone, such as the mains or a converter's clock.

    A learned spectrum consists of band means and does not show it.
    """
    if not term.effect.tonal:
        return False
    size = float(np.sqrt((term.beta**2).sum()))
    return any(
        trace.sensor is term.hypothesis.effect.sensor
        and term.theta < 0.5 * trace.fs
        and _amplitude(trace, term.theta) > prices.NOMINAL_TONE_SHARE * size
        and _line_to_neighbours(trace, term.theta) > prices.LINE_TO_NEIGHBOURS
        for trace in nominal
    )


def _amplitude(trace: Trace, hz: float) -> float:
    """Amplitude of the residual of `trace` at that frequency, over all axes."""
    return float(np.sqrt((_wave_amplitudes(trace, hz) ** 2).sum()))


def _line_to_neighbours(trace: Trace, hz: float) -> float:
    """Energy at `hz` over the median energy of its neighbours."""
    step = trace.fs / len(trace.t)
    near = [
        _amplitude(trace, hz + k * step)
        for k in range(-prices.LINE_NEIGHBOURS, prices.LINE_NEIGHBOURS + 1)
        if abs(k) > 2
    ]
    return float((_amplitude(trace, hz) / max(np.median(near), 1e-300)) ** 2)


def _wave_amplitudes(trace: Trace, hz: float) -> Array:
    rows = trace.observed
    left = trace.residual[rows] - trace.residual[rows].mean(axis=0)
    angle = 2.0 * np.pi * hz * trace.t[rows]
    return np.asarray(2.0 / len(left) * np.vstack([np.cos(angle) @ left, np.sin(angle) @ left]))
