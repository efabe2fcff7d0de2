"""Samples about the touch-down are left out, and no others."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.gap.companion.touch_down import touch_down, without_touch_down
from mavcal.calib.recording import Channel, ParameterTimeline, Recording, Sensor, Stage
from tests.unit.gap.synthetic import problem_of

TIMES = np.arange(0.0, 20.0, 0.1)


def recording(output: np.ndarray) -> Recording:
    motors = Channel(Sensor.MOTOR, 0, TIMES, np.column_stack([output, output]), "1", Stage.RAW, "RCOU")
    return Recording((motors,), ParameterTimeline())


def flight(start: float = 4.0, end: float = 15.0) -> np.ndarray:
    """Motors that idle from 2 to 18 s and carry the vehicle in between."""
    t = TIMES
    return np.where((t > start) & (t < end), 0.6, np.where((t > 2.0) & (t < 18.0), 0.1, 0.0))


def test_a_flight_ends_where_the_motors_let_go_of_the_vehicle() -> None:
    assert touch_down(recording(flight())) == pytest.approx(15.0, abs=0.11)


def test_a_short_loss_of_thrust_is_no_touch_down() -> None:
    output = flight()
    output[(TIMES > 8.0) & (TIMES < 9.0)] = 0.1
    assert touch_down(recording(output)) == pytest.approx(15.0, abs=0.11)


@pytest.mark.parametrize("output", [np.full(len(TIMES), 0.6), np.zeros(len(TIMES))])
def test_a_log_that_ends_in_the_air_or_never_flies_has_none(output: np.ndarray) -> None:
    assert touch_down(recording(output)) is None
    problem = problem_of(np.random.default_rng(1), (Sensor.ACCEL,))
    assert without_touch_down(problem, recording(output)) is problem


def test_a_recording_without_motors_has_none() -> None:
    assert touch_down(Recording((), ParameterTimeline())) is None


def test_only_the_samples_about_it_are_left_out() -> None:
    problem = problem_of(np.random.default_rng(1), (Sensor.ACCEL, Sensor.MAG))
    for trace in without_touch_down(problem, recording(flight())).traces:
        apart = np.abs(trace.t - 14.9)
        assert not trace.observed[apart < 1.3].any()
        assert trace.observed[apart > 1.7].all()
