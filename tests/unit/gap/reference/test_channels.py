"""Two recordings are compared at the stage that both have."""

from __future__ import annotations

import numpy as np

from mavcal.calib.gap.reference.channels import as_slow_as, as_uneven_as, with_common_channels
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


def timed(instance, rate, seconds=10.0):
    t = np.arange(0.0, seconds, 1.0 / rate)
    return Channel(
        Sensor.GYRO, instance, t, np.sin(40.0 * t)[:, None].repeat(3, axis=1), "rad/s", Stage.FILTERED, "IMU"
    )


def test_a_companions_unit_is_picked_at_the_rate_of_the_real_one():
    real, sim = Recording((timed(0, 400.0), timed(1, 40.0))), Recording((timed(0, 400.0), timed(1, 400.0)))
    fast, slow = as_slow_as(sim, real).channels
    assert len(fast) == len(sim.channels[0])
    assert 390 < len(slow) < 410
    assert np.isin(slow.t, sim.channels[1].t).all()  # samples, as a logger writes them, and no means
    assert [len(c) for c in as_slow_as(real, sim).channels] == [len(c) for c in real.channels]


def test_real_units_are_picked_where_the_simulator_thins_some_of_a_sensor_only():
    """Its aliased unit beside a full one made a vibration of the real difference, which has none."""
    even, thinned = Recording((timed(0, 400.0), timed(1, 400.0))), Recording((timed(0, 400.0), timed(1, 40.0)))
    first, second = as_uneven_as(even, thinned).channels
    assert len(first) == len(even.channels[0])
    assert np.isin(second.t, even.channels[1].t).all()
    assert 390 < len(second) < 410
    slow = Recording((timed(0, 40.0), timed(1, 40.0)))
    assert [len(c) for c in as_uneven_as(even, slow).channels] == [len(c) for c in even.channels]
