from __future__ import annotations

import math

import numpy as np
import pytest

from mavcal.calib.procedures.intake import Intake
from mavcal.calib.procedures.motion import HELD, RESTING, StillWatch
from mavcal.calib.procedures.roster import choose
from mavcal.calib.recording import Sensor

INERTIAL = ((Sensor.ACCEL, 0), (Sensor.GYRO, 0))


def verdicts(recording, limits):
    intake = Intake()
    intake.add(recording)
    ticks = list(intake.ticks(to_the_end=True))
    roster, watch = choose(ticks), StillWatch(limits, INERTIAL)
    return [watch.update(roster.frame(t)) for t in ticks]


def test_a_vehicle_on_a_table_rests(bench):
    assert all(v.still for v in verdicts(bench().hold(10.0).record(), RESTING))


def test_the_first_ticks_of_a_rest_do_not_count(bench):
    assert [v.counted for v in verdicts(bench().hold(2.0).record(), RESTING)][:5] == [False] * 3 + [True] * 2


def test_a_hand_holds_a_pose_but_does_not_rest(bench):
    recording = bench().hold(8.0, tremor=0.6).record()
    assert all(v.still for v in verdicts(recording, HELD))
    assert np.mean([v.still for v in verdicts(recording, RESTING)]) < 0.5


@pytest.mark.parametrize(("rate", "what"), [((0, 0, 45), "turn"), ((3, 0, 0), "tilted"), ((0, 60, 0), "turn")])
def test_a_steady_turn_is_not_rest_and_is_named(bench, rate, what):
    judged = verdicts(bench().turn(4.0, rate).record(), RESTING)[4:]
    assert not any(v.counted for v in judged)
    assert any(what in v.why for v in judged)


def test_shaking_is_named_with_its_axis(bench):
    recording = bench().hold(4.0).record()
    c = recording.channel(Sensor.ACCEL)
    c.values[:, 1] += 3.0 * np.sin(2 * math.pi * 9.0 * c.t)
    judged = verdicts(recording, RESTING)
    assert not any(v.still for v in judged)
    assert "accelerometer 1 sees shaking" in judged[0].why
    assert judged[0].why.endswith("along y")


def test_a_slow_thermal_drift_is_no_movement(bench):
    recording = bench().hold(60.0).record()
    c = recording.channel(Sensor.ACCEL)
    c.values[:, 0] += 0.01 * (c.t - c.t[0])
    assert all(v.still for v in verdicts(recording, RESTING))
