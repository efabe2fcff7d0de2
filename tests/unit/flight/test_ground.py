"""When the motors were off, by arming, by outputs or by nothing, at the edges of each."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.flight.rest import Known, TimeSpan, ground, grounded, rests
from mavcal.calib.recording import Channel, Event, Identity, Recording, Sensor, Stage
from mavcal.calib.stats.stillness import Still

T = np.arange(0.0, 100.01, 0.1)


def recording(*channels, events=()):
    imu = Channel(Sensor.ACCEL, 0, T, np.tile([0.0, 0.0, -9.8], (len(T), 1)), "m/s2", Stage.RAW, "IMU")
    return Recording((imu, *channels), events=tuple(Event(t, kind, "") for t, kind in events))


def output(values, sensor=Sensor.MOTOR, t=T):
    return Channel(sensor, 0, t, np.asarray(values, dtype=float), "1", Stage.RAW, "RCOU")


def spans(found):
    return [(span.start, span.end) for span in found]


ARM, DISARM = "armed", "disarmed"


@pytest.mark.parametrize(
    ("said", "off", "running"),
    [
        ([(20.0, ARM), (60.0, DISARM)], [(0.0, 20.0), (60.5, 100.0)], [(20.0, 60.0)]),
        ([(60.0, DISARM)], [(60.5, 100.0)], [(0.0, 60.0)]),
        ([(20.0, ARM)], [(0.0, 20.0)], [(20.0, 100.0)]),
        ([(0.0, DISARM)], [(0.5, 100.0)], []),
        ([(0.0, ARM)], [], [(0.0, 100.0)]),
        (
            [(60.0, DISARM), (20.0, ARM), (80.0, ARM), (90.0, DISARM)],
            [(0.0, 20.0), (60.5, 80.0), (90.5, 100.0)],
            [(20.0, 60.0), (80.0, 90.0)],
        ),
        ([(20.0, ARM), (30.0, ARM), (60.0, DISARM), (70.0, DISARM)], [(0.0, 20.0), (60.5, 100.0)], [(20.0, 60.0)]),
        ([(20.0, ARM), (60.0, DISARM), (60.2, ARM), (80.0, DISARM)], None, [(20.0, 60.0), (60.2, 80.0)]),
    ],
)
def test_arming_tells_when_the_motors_ran(said, off, running):
    found = ground(recording(events=said))
    assert found.known == Known.ARMING
    assert spans(found.running) == running
    if off is not None:
        expected = [(a, b) for a, b in off if b > a]
        if said == [(0.0, DISARM)]:
            expected = [(0.0, 100.0)]
        np.testing.assert_allclose(spans(found.off), expected)


@pytest.mark.parametrize(
    ("autopilot", "first", "running"),
    [
        ("px4", DISARM, []),  # its logs begin with a state
        ("px4", ARM, [(0.0, 100.0)]),
        ("ardupilot", DISARM, [(0.0, 0.8)]),  # an event on board is a change
        ("ardupilot", ARM, [(0.8, 100.0)]),
    ],
)
def test_a_first_state_holds_from_the_beginning(autopilot, first, running):
    made = dataclasses.replace(recording(events=[(0.8, first)]), identity=Identity(autopilot))
    assert spans(ground(made).running) == running


def test_a_pause_shorter_than_the_run_down_of_the_rotors_is_no_rest():
    found = ground(recording(events=[(20.0, ARM), (60.0, DISARM), (60.4, ARM), (80.0, DISARM)]))
    np.testing.assert_allclose(spans(found.off), [(0.0, 20.0), (80.5, 100.0)])


def test_an_output_above_idle_tells_from_the_sample_before_to_the_sample_after():
    values = np.where((T > 29.95) & (T < 40.05), 0.5, 0.0)
    found = ground(recording(output(np.column_stack([np.zeros_like(values), values]))))
    assert found.known == Known.MOTORS
    np.testing.assert_allclose(spans(found.running), [(29.9, 40.1)])
    np.testing.assert_allclose(spans(found.off), [(0.0, 29.9), (40.6, 100.0)])


@pytest.mark.parametrize(("level", "runs"), [(0.03, False), (0.031, True), (-0.03, False), (-0.5, True)])
def test_idle_is_three_hundredths_of_the_range(level, runs):
    found = ground(recording(output(np.full(len(T), level))))
    assert bool(found.running) == runs
    assert spans(found.off) == ([] if runs else [(0.0, 100.0)])


def test_a_throttle_tells_where_no_output_was_logged_and_arming_goes_before_both():
    up = np.where(T > 49.95, 0.6, 0.0)
    throttle, motor = output(up, Sensor.THROTTLE), output(0.0 * up)
    assert spans(ground(recording(throttle)).running) == [(pytest.approx(49.9), pytest.approx(100.0))]
    assert ground(recording(throttle, motor)).running == ()
    assert ground(recording(throttle, events=[(10.0, ARM), (20.0, DISARM)])).known == Known.ARMING


def test_outputs_that_are_no_numbers_tell_nothing():
    assert ground(recording(output(np.full(len(T), np.nan)))).known == Known.STILLNESS
    partly = np.where(T < 50.0, np.nan, 0.5)
    assert spans(ground(recording(output(partly))).running) == [(pytest.approx(49.9), pytest.approx(100.0))]
    alone = ground(recording())
    assert (spans(alone.off), alone.running, alone.known) == ([(0.0, 100.0)], (), Known.STILLNESS)


def test_a_pause_of_the_recording_is_neither_flown_nor_rested():
    kept = recording(events=[(20.0, ARM), (90.0, DISARM)])
    kept = kept.with_channels(c.take((c.t < 40.0) | (c.t > 70.0)) for c in kept.channels)
    running = spans(ground(kept).running)
    assert running[0][1] == pytest.approx(39.9, abs=0.2)
    assert running[1] == (pytest.approx(70.1, abs=0.2), 90.0)


times = st.lists(st.integers(1, 199), min_size=1, max_size=8, unique=True).map(lambda found: [0.5 * t for t in found])


@given(moments=times, armed_first=st.booleans())
def test_spans_with_motors_on_and_off_never_overlap_and_lie_in_the_recording(moments, armed_first):
    said = [(t, ARM if (k % 2 == 0) == armed_first else DISARM) for k, t in enumerate(sorted(moments))]
    found = ground(recording(events=said))
    every = sorted([*found.off, *found.running], key=lambda span: span.start)
    assert all(a.end <= b.start for a, b in pairwise(every))
    assert all(0.0 <= span.start < span.end <= 100.0 + 1e-9 for span in every)
    lost = 100.0 - sum(span.duration for span in every)
    assert -1e-9 <= lost <= 0.5 * len(found.running) + 1e-9


def still(start, end):
    return Still(start, end, None, None)


def test_of_what_was_still_only_what_the_motors_left_alone_counts():
    made = recording(events=[(20.0, ARM), (60.0, DISARM)])
    kept = grounded(made, (still(10.0, 30.0), still(40.0, 50.0), still(55.0, 80.0)), 1.0)
    np.testing.assert_allclose(spans(kept), [(10.0, 20.0), (60.5, 80.0)])
    assert spans(grounded(made, (still(10.0, 30.0),), 10.0)) == [(10.0, 20.0)]
    assert grounded(made, (still(10.0, 30.0),), 10.01) == ()
    assert grounded(made, (still(20.0, 60.5),), 0.0) == ()


def test_each_inertial_unit_rests_by_its_own_samples():
    made = recording(events=[(20.0, ARM), (60.0, DISARM)])
    shaken = dataclasses.replace(
        made.channels[0], instance=1, values=made.channels[0].values + 3.0 * np.sin(9.0 * T)[:, None]
    )
    both = made.with_channels([*made.channels, shaken])
    assert len(rests(both, 0)) == 2
    assert rests(both, 1) == ()
    assert TimeSpan(3.0, 5.0).duration == 2.0
