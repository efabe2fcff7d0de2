"""Events that take time: while a magnet is put on, a sensor reads neither what it did before nor what it does after.

A step has no duration. Several of them in a row that stand for one event say that there is one; the samples between
are then left out, and one step is the difference of the levels.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

from calib.gap.effects.events import SLOW_S
from calib.gap.model import Model, Term
from calib.gap.problem import Problem
from calib.recording import Sensor

ONE_EVENT_S = 2.0
"""Jumps that follow each other within this time are one event."""
_MARGIN_S = 0.3
"""Before the first and after the last of them."""


@dataclass(frozen=True)
class Transition:
    """From `start` to `end`, s, the readings of a sensor say nothing."""

    sensor: Sensor
    start: float
    end: float


def events_of(model: Model, sensor: Sensor) -> list[list[Term]]:
    """The jumps of a sensor in a model in the order of time, those of one event together."""
    jumps = [t for t in model.terms if t.effect.id.endswith("_step") and t.effect.sensor is sensor]
    events: list[list[Term]] = []
    for term in sorted(jumps, key=lambda t: t.theta):
        if events and term.theta - events[-1][-1].theta < ONE_EVENT_S:
            events[-1].append(term)
        else:
            events.append([term])
    return events


def transitions(model: Model) -> tuple[Transition, ...]:
    """Events of a model that take several jumps, or one that is gradual."""
    sensors = dict.fromkeys(view.sensor for view in model.setting.views)
    events = itertools.chain.from_iterable(events_of(model, sensor) for sensor in sensors)
    return tuple(
        Transition(event[0].effect.sensor, event[0].theta - _beside(event[0]), event[-1].theta + _beside(event[-1]))
        for event in events
        if len(event) > 1 or event[0].effect.form
    )


def _beside(term: Term) -> float:
    """Seconds on either side of its moment."""
    return _MARGIN_S + (0.5 * SLOW_S if term.effect.form else 0.0)


def without_transitions(problem: Problem, found: Sequence[Transition]) -> Problem:
    """`problem` with the samples of transitions left out."""
    traces = list(problem.traces)
    for one in found:
        for i, trace in enumerate(traces):
            if trace.sensor is one.sensor:
                during = (trace.t > one.start) & (trace.t < one.end)
                traces[i] = replace(trace, observed=trace.observed & ~during)
    return replace(problem, traces=tuple(traces))
