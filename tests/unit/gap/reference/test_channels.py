"""Two recordings are compared at the stage that both have."""

from __future__ import annotations

import numpy as np

from mavcal.calib.gap.reference.channels import with_common_channels
from mavcal.calib.recording import Channel, Recording, Sensor, Stage

T = np.arange(100) / 100.0


def channel(sensor, instance, source, stage):
    return Channel(sensor, instance, T, np.zeros((100, 3)), "rad/s", stage, source)


FILTERED = [channel(Sensor.GYRO, i, "IMU", Stage.FILTERED) for i in (0, 1)]
FAST = [channel(Sensor.GYRO, i, "GYR", Stage.CORRECTED) for i in (0, 1)]


def sources(recording):
    return {c.source for c in recording.channels}


def test_channels_without_a_counterpart_are_left_out():
    real, sim = with_common_channels(Recording((*FILTERED, *FAST)), Recording(tuple(FILTERED)))
    assert sources(real) == sources(sim) == {"IMU"}
    real, sim = with_common_channels(Recording(tuple(FAST)), Recording((*FILTERED, *FAST)))
    assert sources(real) == sources(sim) == {"GYR"}


def test_an_instance_keeps_what_nothing_else_shows_of_it():
    real, _ = with_common_channels(Recording((*FILTERED[:1], *FAST)), Recording(tuple(FILTERED)))
    assert sources(real) == {"IMU", "GYR"}
    real, sim = with_common_channels(Recording(tuple(FAST)), Recording(tuple(FILTERED)))
    assert (sources(real), sources(sim)) == ({"GYR"}, {"IMU"})
