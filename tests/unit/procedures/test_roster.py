"""Which channel speaks for an instance, and which instances fall out: silent, frozen, never come."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.procedures.intake import TICK, Tick
from mavcal.calib.procedures.roster import LOST_TICKS, STUCK_TICKS, Attendance, Roster, choose, label
from mavcal.calib.recording import Channel, Rounding, Sensor, Stage

ACCEL, GYRO, MAG, WARMTH = (Sensor.ACCEL, 0), (Sensor.GYRO, 0), (Sensor.MAG, 0), (Sensor.TEMPERATURE, 0)
NOISE = {Sensor.ACCEL: 0.01, Sensor.GYRO: 0.001, Sensor.MAG: 0.2, Sensor.TEMPERATURE: 0.01}


def channel(instance, values, *, quantum=0.0, source="S"):
    values = np.atleast_2d(np.asarray(values, dtype=float))
    rounding = Rounding.NEAREST if quantum else Rounding.NONE
    t = np.linspace(0.0, TICK, len(values), endpoint=False)
    return Channel(*instance, t, values, "1", Stage.RAW, source, quantum, rounding)


class Streams:
    """Frames of a tick of noise about a value; some instances frozen."""

    def __init__(self, *instances, quantum=0.0):
        self.instances = instances
        self.quantum = quantum
        self.rng = np.random.default_rng(1)

    def frame(self, *, without=(), frozen=(), moved=()):
        found = {}
        for instance in self.instances:
            if instance in without:
                continue
            columns = 1 if instance[0] == Sensor.TEMPERATURE else 3
            values = NOISE[instance[0]] * self.rng.normal(size=(5, columns))
            if instance in moved:
                values = values + self.rng.choice([-5.0, 5.0])
            if instance in frozen:
                values = np.full((5, columns), 0.25)
            found[instance] = channel(instance, values, quantum=self.quantum)
        return found


def until_out(attendance, frames, most=400):
    """How many ticks pass until something falls out, and what is said of it."""
    for count in range(1, most + 1):
        out = attendance.update(frames())
        if out:
            return count, out
    return most, ()


def tick(*channels):
    return Tick(0.0, TICK, {c.key: c for c in channels})


def test_the_finest_channel_speaks_for_its_instance():
    coarse = channel(ACCEL, np.ones((50, 3)), quantum=0.01, source="A")
    fine = channel(ACCEL, np.ones((5, 3)), quantum=0.001, source="B")
    assert choose([tick(coarse, fine)]).keys == {ACCEL: fine.key}


def test_of_equally_fine_channels_the_one_with_more_samples_speaks():
    few, many = (channel(ACCEL, np.ones((n, 3)), source=s) for n, s in ((5, "A"), (9, "B")))
    assert choose([tick(few, many)]).keys == {ACCEL: many.key}
    assert choose([tick(few, many), tick(few), tick(few)]).keys == {ACCEL: few.key}  # over all ticks
    alike = [channel(ACCEL, np.ones((5, 3)), source=s) for s in ("B", "A")]
    assert choose([tick(*alike)]).keys == {ACCEL: alike[1].key}


def test_a_frame_has_the_channels_that_speak_and_have_samples():
    own, other = channel(ACCEL, np.ones((5, 3)), source="A"), channel(GYRO, np.ones((5, 3)), source="A")
    roster = Roster({ACCEL: own.key, GYRO: other.key})
    assert roster.frame(tick(own)) == {ACCEL: own}
    assert roster.frame(tick(own, other, channel(MAG, np.ones((5, 3))))) == {ACCEL: own, GYRO: other}


@pytest.mark.parametrize(
    ("instance", "name"), [((Sensor.ACCEL, 1), "accelerometer 2"), (GYRO, "gyro 1"), (WARMTH, "thermometer 1")]
)
def test_operators_count_instances_from_one(instance, name):
    assert label(*instance) == name


def test_an_instance_that_is_silent_for_five_seconds_is_lost():
    streams = Streams(ACCEL, GYRO)
    attendance = Attendance({ACCEL, GYRO})
    ticks, out = until_out(attendance, lambda: streams.frame(without={GYRO}))
    assert ticks * TICK == 5.0
    assert out == ((GYRO, "gyro 1 stopped giving new values"),)
    assert attendance.present == {ACCEL}


def test_a_silence_that_ends_is_forgotten():
    streams, attendance = Streams(ACCEL, GYRO), Attendance({ACCEL, GYRO})
    for _ in range(3):
        for _ in range(LOST_TICKS - 1):
            assert attendance.update(streams.frame(without={GYRO})) == ()
        assert attendance.update(streams.frame()) == ()


def test_what_fell_out_is_not_told_twice():
    streams, attendance = Streams(ACCEL, GYRO), Attendance({ACCEL, GYRO})
    until_out(attendance, lambda: streams.frame(without={GYRO}))
    assert all(attendance.update(streams.frame(without={GYRO})) == () for _ in range(2 * LOST_TICKS))


@pytest.mark.parametrize("instance", [ACCEL, GYRO])
def test_an_inertial_sensor_of_floating_point_that_repeats_for_two_seconds_is_frozen(instance):
    streams = Streams(ACCEL, GYRO)
    ticks, out = until_out(Attendance({ACCEL, GYRO}), lambda: streams.frame(frozen={instance}))
    assert (ticks - 1) * TICK == 2.0  # the first tick has none before it to repeat
    assert out == ((instance, f"{label(*instance)} is frozen: it repeats one value"),)


def test_a_quantised_sensor_may_repeat_as_long_as_nothing_moves():
    streams, attendance = Streams(ACCEL, GYRO, MAG, quantum=0.01), Attendance({ACCEL, GYRO, MAG})
    assert until_out(attendance, lambda: streams.frame(frozen={ACCEL, GYRO, MAG}), 5 * STUCK_TICKS)[1] == ()


@pytest.mark.parametrize(
    ("frozen", "moved", "falls"),
    [
        (MAG, ACCEL, True),
        (MAG, GYRO, True),
        (GYRO, ACCEL, True),
        (GYRO, MAG, False),  # a current moves compasses alone
        (ACCEL, GYRO, False),  # a turn about the vertical moves no accelerometer
        (ACCEL, MAG, False),
    ],
)
def test_a_movement_that_a_sensor_must_share_tells_that_it_is_frozen(frozen, moved, falls):
    streams, attendance = Streams(ACCEL, GYRO, MAG, quantum=1e-4), Attendance({ACCEL, GYRO, MAG})
    _, out = until_out(attendance, lambda: streams.frame(frozen={frozen}, moved={moved}), 60)
    assert [sensor for sensor, _ in out] == ([frozen] if falls else [])
    assert all(label(*frozen) in why and "frozen" in why for _, why in out)


def test_another_unit_of_the_same_kind_tells_as_well():
    second = (Sensor.ACCEL, 1)
    streams, attendance = Streams(ACCEL, second, quantum=1e-4), Attendance({ACCEL, second})
    _, out = until_out(attendance, lambda: streams.frame(frozen={ACCEL}, moved={second}), 60)
    assert [instance for instance, _ in out] == [ACCEL]


def test_a_thermometer_may_repeat():
    streams, attendance = Streams(ACCEL, WARMTH), Attendance({ACCEL, WARMTH})
    assert until_out(attendance, lambda: streams.frame(frozen={WARMTH}, moved={ACCEL}), 60)[1] == ()


def test_one_new_value_ends_a_freeze():
    streams, attendance = Streams(ACCEL, GYRO), Attendance({ACCEL, GYRO})
    for _ in range(3):
        for _ in range(STUCK_TICKS):
            assert attendance.update(streams.frame(frozen={GYRO})) == ()
        attendance.update(streams.frame())
