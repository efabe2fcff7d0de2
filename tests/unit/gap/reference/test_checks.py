from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.gap.reference import build
from mavcal.calib.logs.tables import NO_TIME
from mavcal.calib.recording import Event, Identity, Recording, Sensor

from .test_recorded import RATE, by_sensor, channel, flown


def changed(recording, sensor, change):
    """`recording` with the readings of `sensor` changed."""
    return recording.with_channels(
        dataclasses.replace(c, values=change(c.values)) if c.sensor == sensor else c for c in recording.channels
    )


@pytest.mark.parametrize("sensor", [Sensor.ACCEL, Sensor.GYRO, Sensor.MAG])
@pytest.mark.parametrize(
    ("turn", "words"),
    [
        (np.diag([1.0, -1.0, 1.0]), "the sign of y is turned"),
        (np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), "x reads y, y reads x"),
        (np.diag([1.0, -1.0, -1.0]), "the sign of y is turned, the sign of z is turned"),
    ],
)
def test_another_frame_is_named(sensor, turn, words):
    problem = build(changed(flown(), sensor, lambda v: v @ turn.T))
    assert sensor not in by_sensor(problem)
    (refused,) = problem.not_testable
    assert refused[0] == sensor.value
    assert words in refused[1]
    assert refused[1] in problem.warnings


def test_a_fragmented_recording_is_refused_and_poses_with_pauses_are_not():
    def cut(period, kept):
        made = flown()
        return made.with_channels(
            c.take((c.t - c.t[0]) % period < kept) if c.sensor is Sensor.GYRO else c for c in made.channels
        )

    (refused,) = build(cut(0.8, 0.2)).not_testable
    assert refused[0] == "gyro"
    assert "pieces of 0.2" in refused[1]
    assert "cover 26 % of its time" in refused[1]
    assert build(cut(8.0, 3.0)).not_testable == ()


@pytest.mark.parametrize(
    ("sensor", "factor", "words"),
    [
        (Sensor.ACCEL, 1000.0, "a thousand"),
        (Sensor.ACCEL, 1.0 / 9.80665, "g and m/s2"),
        (Sensor.GYRO, 180.0 / np.pi, "degrees and radians"),
        (Sensor.MAG, 0.01, "gauss"),
    ],
)
def test_another_unit_is_named(sensor, factor, words):
    (refused,) = build(changed(flown(), sensor, lambda v: factor * v)).not_testable
    assert words in refused[1]


def test_large_errors_of_a_sensor_are_neither_frame_nor_unit():
    skew = np.eye(3) + 0.15 * np.array([[1.0, 1.0, 0.0], [0.0, -1.0, 1.0], [1.0, 0.0, 1.0]])
    real = flown()
    for sensor, offset in ((Sensor.ACCEL, 2.0), (Sensor.GYRO, 0.3), (Sensor.MAG, 60.0)):
        real = changed(real, sensor, lambda v, o=offset: v @ skew.T + np.array([o, -o, o]))
    assert build(real).not_testable == ()


def test_a_sensor_that_is_stuck_is_named():
    problem = build(changed(flown(), Sensor.MAG, lambda v: np.full_like(v, 12.0)))
    [(name, reason, _)] = problem.not_testable
    assert name == "mag"
    assert "x, y, z" in reason
    assert "one value" in reason


def test_seconds_of_data_are_not_testable():
    problem = build(flown().between(0.0, 3.0))
    assert problem.traces == ()
    assert {name for name, _, _ in problem.not_testable} == {"accel", "gyro", "mag"}


def test_a_reference_of_another_movement_is_named():
    real = flown()
    other = tuple(
        channel(c.sensor, c.t, c.values[::-1] * [0.2, -1.0, 0.5]) if c.sensor == Sensor.GYRO else c
        for c in real.reference
    )
    problem = build(dataclasses.replace(real, reference=other))
    assert Sensor.GYRO not in by_sensor(problem)
    [(name, _, need)] = problem.not_testable
    assert name == "gyro"
    assert "same movement" in need


def test_recordings_that_do_not_overlap_are_refused():
    real = flown()
    late = tuple(channel(c.sensor, c.t + 500.0, c.values) for c in real.reference)
    with pytest.raises(InvalidInputError, match="do not overlap"):
        build(dataclasses.replace(real, reference=late))


def test_vehicles_of_another_kind_are_refused():
    real = dataclasses.replace(flown(), identity=Identity(vehicle_type=2))
    with pytest.raises(InvalidInputError, match="another kind of vehicle"):
        build(real, dataclasses.replace(flown(2), identity=Identity(vehicle_type=1)))


def test_samples_that_are_not_finite_are_holes():
    def spoil(values):
        spoilt = values.copy()
        spoilt[int(RATE) : int(1.2 * RATE)] = np.nan
        return spoilt

    trace = by_sensor(build(changed(flown(), Sensor.ACCEL, spoil)))[Sensor.ACCEL]
    assert (~trace.observed).sum() == int(0.2 * RATE)
    assert np.isfinite(trace.measured).all()


def test_a_recording_of_nothing_is_refused():
    with pytest.raises(InvalidInputError):
        build(Recording(()))


def hovering(values, sensor):
    """Little movement about a mean: what a hover leaves of it."""
    size = 0.25 if sensor == Sensor.MAG else 1.0
    return values.mean(axis=0) + size * (values - values.mean(axis=0))


def calm():
    """A recording with ideal readings in which the field turns little."""
    real = flown()
    reference = tuple(dataclasses.replace(c, values=hovering(c.values, c.sensor)) for c in real.reference)
    noise = np.random.default_rng(4)
    channels = [
        dataclasses.replace(c, values=hovering(c.values, c.sensor) + 0.2 * noise.standard_normal(c.values.shape))
        if c.sensor == Sensor.MAG
        else c
        for c in real.channels
    ]
    return dataclasses.replace(real, channels=tuple(channels), reference=reference)


def test_the_frame_of_a_compass_shows_in_a_hover():
    (refused,) = build(
        changed(calm(), Sensor.MAG, lambda v: v[:, [1, 0, 2]] + np.array([20.0, -5.0, 9.0]))
    ).not_testable
    assert "x reads y, y reads x" in refused[1]
    assert build(changed(calm(), Sensor.MAG, lambda v: v + np.array([40.0, -25.0, 19.0]))).not_testable == ()


def test_the_unit_of_a_compass_shows_at_rest():
    def stand(values):
        noise = np.random.default_rng(1).standard_normal(values.shape)
        return values.mean(axis=0) + 0.1 * noise

    real = changed(flown(), Sensor.MAG, stand)
    real = dataclasses.replace(
        real,
        reference=tuple(
            dataclasses.replace(c, values=np.tile(c.values.mean(axis=0), (len(c), 1))) if c.sensor == Sensor.MAG else c
            for c in real.reference
        ),
    )
    assert build(real).not_testable == ()
    for factor, words in ((1000.0, "a thousand"), (10.0, "mgauss"), (0.01, "gauss")):
        (refused,) = build(changed(real, Sensor.MAG, lambda v, f=factor: f * v)).not_testable
        assert words in refused[1]
        assert "--unit-mag" in refused[2]


def test_milligravities_are_no_gauss():
    (refused,) = build(changed(flown(), Sensor.ACCEL, lambda v: v / 9.80665e-3)).not_testable
    assert refused[0] == "accel"
    assert "mg and" in refused[1]
    assert "--unit-accel" in refused[2]


def of_reference(recording, sensor, change):
    return dataclasses.replace(
        recording,
        reference=tuple(
            dataclasses.replace(c, values=change(c.values)) if c.sensor == sensor else c for c in recording.reference
        ),
    )


@pytest.mark.parametrize("sensor", [Sensor.ACCEL, Sensor.GYRO, Sensor.MAG])
def test_a_reference_of_zeros_is_named(sensor):
    real = of_reference(flown(), sensor, lambda v: np.tile([0.0, 0.0, 40.0 * (sensor == Sensor.MAG)], (len(v), 1)))
    (refused,) = build(real).not_testable
    assert refused[0] == sensor.value
    assert "has one value throughout" in refused[1]


def test_a_reference_that_is_worse_than_the_sensor_is_named():
    noise = np.random.default_rng(3)
    (refused,) = build(
        of_reference(flown(), Sensor.ACCEL, lambda v: v + 0.3 * noise.standard_normal(v.shape))
    ).not_testable
    assert refused[0] == "accel"
    assert "noise" in refused[1]
    assert " x, y, z" in refused[1]
    assert "better than" in refused[2]


def test_a_slower_sensor_is_no_worse_reference():
    def slow(values):
        kernel = np.ones(25) / 25.0
        return np.column_stack([np.convolve(c, kernel, mode="same") for c in values.T])

    assert build(changed(flown(), Sensor.GYRO, slow)).not_testable == ()


def test_a_copy_of_the_reference_is_named():
    real = flown()
    exact = next(c.values for c in real.reference if c.sensor == Sensor.GYRO)
    (refused,) = build(changed(real, Sensor.GYRO, lambda _: exact + np.array([0.1, 0.0, -0.2]))).not_testable
    assert refused[0] == "gyro"
    assert all(token in refused[1] for token in (" 0.1, 0,", " -0.2 rad/s", " x, y, z", "without any noise"))


def test_a_sensor_without_noise_is_not_alive_even_at_rest():
    still = flown()
    for sensor in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG):
        still = of_reference(still, sensor, lambda v: np.tile(v[0], (len(v), 1)))
        still = changed(still, sensor, lambda v: np.tile(v[0], (len(v), 1)))
    problem = build(still)
    assert problem.traces == ()
    assert all("a live sensor has noise" in reason for _, reason, _ in problem.not_testable)


def test_a_damaged_number_is_named_with_its_time():
    def struck(values):
        spoilt = values.copy()
        spoilt[700, 0] = 1e30
        return spoilt

    (refused,) = build(changed(flown(), Sensor.ACCEL, struck)).not_testable
    assert refused[0] == "accel"
    assert all(token in refused[1] for token in ("1e+30 m/s2", "on x", "7.000 s"))


@pytest.mark.parametrize(("factor", "words"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")])
def test_time_in_another_unit_is_named(factor, words):
    real = flown()

    def later(channels):
        return tuple(dataclasses.replace(c, t=c.t * factor) for c in channels)

    timed = dataclasses.replace(real, channels=later(real.channels), reference=later(real.reference))
    with pytest.raises(InvalidInputError, match=f"looks like {words}"):
        build(timed)


def test_time_that_stands_still_is_named():
    real = flown()
    stopped = [dataclasses.replace(c, t=np.full(len(c), 5.0)) for c in real.channels]
    with pytest.raises(InvalidInputError, match="one time for all samples"):
        build(real.with_channels(stopped))


def test_rows_that_were_counted_are_no_time():
    real = dataclasses.replace(flown(), events=(Event(0.0, NO_TIME, "rows are counted; give --rate"),))

    def counted(channels):
        return tuple(dataclasses.replace(c, t=np.arange(len(c), dtype=float)) for c in channels)

    with pytest.raises(InvalidInputError, match="--rate"):
        build(dataclasses.replace(real, channels=counted(real.channels), reference=counted(real.reference)))
