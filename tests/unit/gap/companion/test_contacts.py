"""Samples about take-off and touch-down are left out, and no others."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.gap.companion.contacts import contacts, without_contacts
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


def test_a_flight_meets_the_ground_twice() -> None:
    assert tuple(contacts(recording(flight()))) == pytest.approx((4.0, 15.0), abs=0.11)


def test_a_short_loss_of_thrust_is_no_contact() -> None:
    output = flight()
    output[(TIMES > 8.0) & (TIMES < 9.0)] = 0.1
    assert tuple(contacts(recording(output))) == pytest.approx((4.0, 15.0), abs=0.11)


def test_a_log_that_begins_and_ends_in_the_air_has_no_contact() -> None:
    assert tuple(contacts(recording(np.full(len(TIMES), 0.6)))) == ()
    assert tuple(contacts(recording(np.zeros(len(TIMES))))) == ()
    assert tuple(contacts(Recording((), ParameterTimeline()))) == ()


def test_only_the_samples_about_a_contact_are_left_out() -> None:
    problem = problem_of(np.random.default_rng(1), (Sensor.ACCEL, Sensor.MAG))
    for trace in without_contacts(problem, recording(flight())).traces:
        near = (np.abs(trace.t - 4.0) < 1.3) | (np.abs(trace.t - 14.9) < 1.3)
        far = (np.abs(trace.t - 4.0) > 1.7) & (np.abs(trace.t - 14.9) > 1.7)
        assert near.any()
        assert not trace.observed[near].any()
        assert trace.observed[far].all()
