"""Sensors that do not respond to the movement of their reference."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from mavcal.calib.gap.effects.traits import Trait
from mavcal.calib.gap.model.joint import Model, predicted
from mavcal.calib.gap.problem import GapProblem
from mavcal.calib.gap.reference.align import FOLLOWS
from mavcal.calib.gap.reference.checks import MOVES
from mavcal.calib.recording import Sensor

_LIVE = "a live sensor, and a reference of the same movement"


def unresponsive_sensors(model: Model) -> frozenset[Sensor]:
    """Sensors that, by the model, hardly respond to the movement of their reference.

    A scale of minus one or a cancelled field is implausible. The modelled response is compared with the reference's
    movement axis by axis.
    """
    found = set()
    for view in model.setting.views:
        terms = [t for t in model.terms if t.hypothesis.touches(view) and Trait.SIZE in t.effect.traits]
        if not terms or view.first or not view.reference_error or min(view.weights.values()) <= 0.0:
            continue
        ideal = view.ideal
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
