"""What is read of still and moving spans, from channels whose every sample is given."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.firmware.compose.draft import Subject
from mavcal.calib.firmware.proof.evidence import gather
from mavcal.calib.recording import Channel, Recording, Rounding, Sensor, Stage

G = 9.80665
ACCEL, GYRO, MAG = (Subject(s, 0) for s in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG))
UNITS = {Sensor.ACCEL: "m/s2", Sensor.GYRO: "rad/s", Sensor.MAG: "uT", Sensor.TEMPERATURE: "degC"}
UNITS |= {Sensor.CURRENT: "A", Sensor.THROTTLE: "1"}


def channel(sensor, t, values, *, instance=0, stage=Stage.FILTERED, **more):
    values = np.asarray(values, dtype=np.float64)
    return Channel(sensor, instance, np.asarray(t, dtype=np.float64), values, UNITS[sensor], stage, "TEST", **more)


def still(seconds=4.0, rate=50.0, *, moved=(), seed=0):
    """Level and at rest, but for spans in which it shakes."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * rate)) / rate
    accel = np.array([0.0, 0.0, -G]) + rng.normal(0, 0.003, (len(t), 3))
    gyro = rng.normal(0, 2e-4, (len(t), 3))
    for start, end in moved:
        rows = (t >= start) & (t < end)
        gyro[rows] += rng.normal(0, 1.0, (rows.sum(), 3))
        accel[rows] += rng.normal(0, 5.0, (rows.sum(), 3))
    return channel(Sensor.ACCEL, t, accel), channel(Sensor.GYRO, t, gyro)


def compass(t, **more):
    return channel(Sensor.MAG, t, np.column_stack([np.arange(len(t)), np.zeros(len(t)), np.full(len(t), 40.0)]), **more)


def scalar(sensor, t, values, **more):
    return channel(sensor, t, np.reshape(values, (-1, 1)), stage=Stage.RAW, **more)


def test_a_reading_is_the_mean_in_the_middle_of_its_rest():
    accel, gyro = still()
    found = gather(Recording((accel, gyro)))
    (reading,) = found.readings[GYRO]
    assert reading.t == pytest.approx(1.99, abs=0.15)
    np.testing.assert_allclose(reading.mean, gyro.values.mean(axis=0), atol=2e-5)
    np.testing.assert_allclose(found.readings[ACCEL][0].mean, accel.values.mean(axis=0), atol=1e-3)
    assert (reading.rest, reading.temperature, reading.current, reading.throttle) == (0, None, None, None)
    assert reading.temperature_sd == 0.0
    assert found.moving == {}
    assert found.raw == frozenset()


@pytest.mark.parametrize(("seconds", "pieces"), [(8.5, 1), (9.6, 2), (18.0, 3)])
def test_a_long_rest_is_read_in_pieces_of_six_seconds(seconds, pieces):
    readings = gather(Recording(still(seconds))).readings[GYRO]
    assert len(readings) == pieces
    assert {r.rest for r in readings} == {0}
    times = [r.t for r in readings]
    assert times == pytest.approx([seconds * (k + 0.5) / pieces for k in range(pieces)], abs=0.2)


def test_every_rest_has_its_number():
    readings = gather(Recording(still(12.0, moved=[(4.0, 7.0)]))).readings
    assert [r.rest for r in readings[GYRO]] == [0, 1]
    assert [r.rest for r in readings[ACCEL]] == [0, 1]


def test_raw_streams_are_named_and_not_read():
    accel, gyro = still()
    raw = channel(Sensor.MAG, accel.t, np.tile([1.0, 2.0, 3.0], (len(accel), 1)), stage=Stage.RAW)
    found = gather(Recording((accel, gyro, raw)))
    assert found.raw == {MAG}
    assert set(found.readings) == {ACCEL, GYRO}


def test_a_debiased_field_is_passed_over_and_what_follows_is_read():
    accel, gyro = still()
    debiased = channel(Sensor.MAG, accel.t, np.tile([1.0, 2, 3], (len(accel), 1)), stage=Stage.DEBIASED)
    second = compass(accel.t, instance=1)
    found = gather(Recording((accel, gyro, debiased, second)))
    assert set(found.readings) == {ACCEL, GYRO, Subject(Sensor.MAG, 1)}


@pytest.mark.parametrize(("count", "read"), [(7, 0), (8, 1)])
def test_a_mean_needs_eight_samples(count, read):
    found = gather(Recording((*still(), compass(np.linspace(1.0, 3.0, count)))))
    assert len(found.readings[MAG]) == read
    assert found.moving[MAG] == ()


def test_samples_of_a_turning_compass_are_readings_of_their_own():
    accel, gyro = still(10.0, moved=[(4.0, 10.0)])
    turning = compass(
        np.r_[np.linspace(1.0, 3.0, 20), np.linspace(6.0, 9.0, 40)], quantum=0.3, rounding=Rounding.NEAREST
    )
    found = gather(Recording((accel, gyro, turning)))
    assert len(found.readings[MAG]) == 1
    moving = found.moving[MAG]
    np.testing.assert_array_equal([r.t for r in moving], np.linspace(6.0, 9.0, 40))
    np.testing.assert_array_equal([r.mean[0] for r in moving], np.arange(20, 60))
    for r in moving:  # rounding, and by how much a mean over a turn is shorter than what it is the mean of
        rate = np.interp(r.t, gyro.t, np.linalg.norm(gyro.values, axis=1))
        short = (0.1 * rate) ** 2 / 24.0 * r.mean
        np.testing.assert_allclose(r.covariance, 0.3**2 / 12.0 * np.eye(3) + np.outer(short, short))
    assert {r.rest for r in moving} == {-1}


@pytest.mark.parametrize(("count", "taken"), [(7, 0), (8, 8), (200, 200), (201, 200), (900, 200)])
def test_of_a_long_turn_two_hundred_samples_count_from_end_to_end(count, taken):
    moved = still(10.0, moved=[(4.0, 10.0)])
    moving = gather(Recording((*moved, compass(np.linspace(6.0, 9.0, count))))).moving[MAG]
    assert len(moving) == taken
    if taken:
        assert (moving[0].t, moving[-1].t) == (6.0, 9.0)
        places = np.array([r.mean[0] for r in moving])
        assert np.ptp(np.diff(places)) <= 1.0  # evenly


def test_a_sample_that_is_no_number_is_none():
    values = np.tile([1.0, 2.0, 40.0], (20, 1))
    values[3, 1] = np.nan
    field = channel(Sensor.MAG, np.linspace(1.0, 3.0, 20), values)
    assert gather(Recording((*still(), field))).readings[MAG][0].mean.tolist() == [1.0, 2.0, 40.0]


class TestConditions:
    """Over a rest from 0 to about 4 s."""

    def read(self, *channels):
        (reading,) = gather(Recording((*still(), *channels))).readings[GYRO]
        return reading

    def test_they_are_means_over_the_rest(self):
        reading = self.read(
            scalar(Sensor.TEMPERATURE, [-9.0, 1.0, 3.0, 30.0], [10.0, 30.0, 32.0, 90.0]),
            scalar(Sensor.CURRENT, [-9.0, 1.0, 3.0, 30.0], [9.0, 2.0, np.nan, 50.0]),
            scalar(Sensor.THROTTLE, [-9.0, 1.0, 3.0, 30.0], [0.9, 0.25, 0.75, 0.0]),
        )
        assert (reading.temperature, reading.current, reading.throttle) == (31.0, 2.0, 0.5)
        span = 2 * reading.t  # it starts at zero
        assert reading.temperature_sd == pytest.approx(2.0 / span * 0.5, rel=0.1)

    def test_the_last_value_before_holds_and_the_first_where_there_is_none(self):
        before = scalar(Sensor.TEMPERATURE, [-9.0, -5.0, 30.0], [10.0, 20.0, 90.0])
        assert self.read(before).temperature == 20.0
        assert self.read(before).temperature_sd == 0.0
        assert self.read(scalar(Sensor.TEMPERATURE, [30.0, 40.0], [90.0, 95.0])).temperature == 90.0
        assert self.read(scalar(Sensor.TEMPERATURE, [-5.0], [np.nan])).temperature is None

    def test_one_value_tells_no_change_and_two_do(self):
        assert self.read(scalar(Sensor.TEMPERATURE, [1.0], [10.0])).temperature_sd == 0.0
        reading = self.read(scalar(Sensor.TEMPERATURE, [1.0, 2.0], [40.0, 10.0]))
        assert reading.temperature_sd == pytest.approx(30.0 / (2 * reading.t) * 0.5, rel=0.1)

    def test_temperatures_are_those_of_the_own_instance_and_currents_of_the_vehicle(self):
        reading = self.read(
            scalar(Sensor.TEMPERATURE, [1.0], [10.0], instance=1), scalar(Sensor.CURRENT, [1.0], [5.0], instance=1)
        )
        assert (reading.temperature, reading.current) == (None, None)
