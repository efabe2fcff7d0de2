"""Moments at which a flying vehicle leaves or meets the ground.

It turns there within a few milliseconds. The age of a sample, which no two sensors share, then reads like an error.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from mavcal.calib.gap.effects.vibration import RUNNING_THROTTLE
from mavcal.calib.gap.problem import GapProblem
from mavcal.calib.recording import Recording, Sensor

_HALF = 0.5
"""Part of the usual motor output below which a vehicle does not fly. Chosen, not measured: half of the thrust that
carries it lets it fall."""
_AROUND_S = 1.5
"""Seconds before and after that belong to the contact. Chosen, not measured: land detectors wait for a second."""


def without_contacts(problem: GapProblem, recording: Recording) -> GapProblem:
    """`problem` without the samples about take-off and touch-down of its `recording`."""
    moments = tuple(contacts(recording))
    traces = list(problem.traces)
    for i, trace in enumerate(traces):
        near = np.zeros(len(trace.t), dtype=np.bool_)
        for moment in moments:
            near |= np.abs(trace.t - moment) < _AROUND_S
        traces[i] = replace(trace, observed=trace.observed & ~near)
    return replace(problem, traces=tuple(traces))


def contacts(recording: Recording) -> Iterator[float]:
    """When the motors first reach half of their usual output, and when they last fall below it, s."""
    motors = next((c for c in recording.find(Sensor.MOTOR) if len(c)), None)
    if motors is None:
        return
    output = motors.values.mean(axis=1)
    running = output > RUNNING_THROTTLE
    if not running.any():
        return
    flying = np.flatnonzero(output > _HALF * np.median(output[running]))
    if flying[0] > 0:
        yield float(motors.t[flying[0]])
    if flying[-1] < len(output) - 1:
        yield float(motors.t[flying[-1]])
