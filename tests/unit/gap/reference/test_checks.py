from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calib.errors import InvalidInputError
from calib.gap.reference import build
from calib.recording import Identity, Recording, Sensor

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
    assert [(name, "one value throughout" in reason) for name, reason, _ in problem.not_testable] == [("mag", True)]


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
    assert any("nothing in common" in reason for _, reason, _ in problem.not_testable)


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
