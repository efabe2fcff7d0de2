"""Implausible results of a model: a sensor without any response to its reference, and improbable names."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from mavcal.calib.gap.effects.base import CatalogueEffect
from mavcal.calib.gap.effects.traits import Trait
from mavcal.calib.gap.model.hypotheses import Key
from mavcal.calib.gap.model.joint import Model, predicted
from mavcal.calib.gap.problem import GapProblem
from mavcal.calib.gap.reference.align import FOLLOWS
from mavcal.calib.gap.reference.checks import MOVES
from mavcal.calib.gap.unknown.misattributed_noise import Unexplained
from mavcal.calib.gap.unknown.verdict import UnnamedCause
from mavcal.calib.gap.worth.attribution import Attribution
from mavcal.calib.recording import Sensor

_LEAST_PROBABILITY = 0.01
"""Probability below which no effect is named where something without a name is the likelier. Chosen, not measured: a
name of one in a hundred helps nobody."""
_COMMON = "clock"
"""What an effect belongs to that is common to all sensors."""
_LIVE = "a live sensor, and a reference of the same movement"


def unresponsive_sensors(model: Model) -> frozenset[Sensor]:
    """Sensors that, by the model, respond to next to nothing of their reference's movement.

    A scale of minus one or a cancelled field is implausible. The modelled response is compared with the reference's
    movement axis by axis.
    """
    found = set()
    for view in model.setting.views:
        terms = [t for t in model.terms if t.hypothesis.touches(view) and Trait.SIZE in t.effect.traits]
        if not terms or view.first or not view.reference_error or min(view.weights.values()) <= 0.0:
            continue
        ideal = np.add.reduce([w * view.traces[i].ideal[view.keep] for i, w in view.weights.items()])
        moved = ideal - ideal.mean(axis=0)
        square = (moved**2).sum(axis=0)
        response = square + np.add.reduce([(moved * predicted(term, view)).sum(axis=0) for term in terms])
        moves = square > MOVES[view.sensor] ** 2 * len(moved)
        if (response[moves] < FOLLOWS * square[moves]).any():
            found.add(view.sensor)
    return frozenset(found)


def without_sensors(problem: GapProblem, sensors: Collection[Sensor]) -> GapProblem:
    """`problem` without unresponsive sensors, with a notice for each."""
    said = [
        (s.value, f"{s.value} does not follow its reference: of its movement next to nothing is in the readings", _LIVE)
        for s in Sensor
        if s in sensors
    ]
    return replace(
        problem,
        traces=tuple(t for t in problem.traces if t.sensor not in sensors),
        warnings=(*problem.warnings, *(reason for _, reason, _ in said)),
        not_testable=(*problem.not_testable, *said),
    )


def improbable_effects(
    attributions: Iterable[Attribution], effects: Mapping[Key, CatalogueEffect], withdrawn: Sequence[Unexplained]
) -> Iterable[UnnamedCause]:
    """Effects that are far less likely than an unnamed cause in their place or than a withdrawn one."""
    found: dict[str, list[Key]] = {}
    for a in attributions:
        effect = effects[a.key]
        if effect.nameless:
            continue  # it has no name to begin with
        if a.probability < _LEAST_PROBABILITY and (withdrawn or a.unknown_probability > a.probability):
            found.setdefault(_COMMON if effect.shared else effect.sensor.value, []).append(a.key)
    return [
        UnnamedCause(tuple(keys), f"a difference on {name} that no effect describes") for name, keys in found.items()
    ]
