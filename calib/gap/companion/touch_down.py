"""The touch-down of a flying vehicle.

It then turns within a few milliseconds. The age of a sample, which differs between sensors, looks like a sensor error.
A touch-down at 25 degrees of tilt was reported as an unknown error of gyroscope and compass.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mavcal.calib.gap.effects.vibration import RUNNING_THROTTLE
from mavcal.calib.gap.problem import GapProblem
from mavcal.calib.recording import Recording, Sensor

_HALF = 0.5
"""Fraction of the usual motor output below which a vehicle does not fly. Chosen, not measured: with half of its hover
thrust it falls."""
_AROUND_S = 1.5
"""Time, s, before and after that belongs to the touch-down. Chosen, not measured: land detectors wait for a second."""


def without_touch_down(problem: GapProblem, recording: Recording) -> GapProblem:
    """`problem` without the samples about the touch-down of its `recording`."""
    moment = touch_down(recording)
    if moment is None:
        return problem
    kept = (replace(t, observed=t.observed & (np.abs(t.t - moment) > _AROUND_S)) for t in problem.traces)
    return replace(problem, traces=tuple(kept))


def touch_down(recording: Recording) -> float | None:
    """Time, s, when the motors last fall below half of their usual output; None: they never run, or run to the end."""
    motors = next((c for c in recording.find(Sensor.MOTOR) if len(c)), None)
    if motors is None:
        return None
    output = motors.values.mean(axis=1)
    running = output > RUNNING_THROTTLE
    if not running.any():
        return None
    last = int(np.flatnonzero(output > _HALF * np.median(output[running]))[-1])
    return float(motors.t[last]) if last < len(output) - 1 else None
