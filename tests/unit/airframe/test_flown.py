"""A recording on one grid: the span in the air, what is left out of it, rest, and which unit is believed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mavcal.calib.airframe.commands import commands_of
from mavcal.calib.airframe.flown import LOG_BITS, PROFILE_BITS, FlownFlight, Unflown, dropped, flown, needed_log
from mavcal.calib.recording import Channel, Event, Identity, Recording, Sensor, Stage
from tests.unit.airframe.made import G, frame, recording


def ready(one: Recording) -> FlownFlight | Unflown:
    commands = commands_of(one, frame())
    assert commands is not None
    return flown(one, frame(), commands)


def judged(one: Recording) -> FlownFlight:
    found = ready(one)
    assert isinstance(found, FlownFlight), found
    return found


def refused(one: Recording) -> str:
    found = ready(one)
    assert isinstance(found, Unflown)
    assert found.need
    return found.reason


def without(one: Recording, sensor: Sensor) -> Recording:
    return replace(
        one,
        channels=tuple(c for c in one.channels if c.sensor != sensor),
        dynamics=tuple(c for c in one.dynamics if c.sensor != sensor),
    )


def changed(one: Recording, sensor: Sensor, change: object) -> Recording:
    """Every stream of a sensor through `change`."""
    edit = lambda c: change(c) if c.sensor == sensor else c  # type: ignore[operator]  # noqa: E731
    return replace(one, channels=tuple(map(edit, one.channels)), dynamics=tuple(map(edit, one.dynamics)))


def cut(start: float, end: float):
    return lambda c: c.take((c.t < start) | (c.t >= end))


def test_a_flight_is_the_span_in_the_air_without_its_ends() -> None:
    found = judged(recording())
    assert found.fs == pytest.approx(100.0)
    assert found.t[0] == pytest.approx(11.0, abs=0.15)
    assert found.t[-1] == pytest.approx(49.0, abs=1.1)
    assert found.usable.all()
    np.testing.assert_allclose(found.c, 0.5, atol=1e-9)
    np.testing.assert_allclose(found.force, np.tile([0.0, 0.0, -G], (len(found.t), 1)), atol=1e-9)
    np.testing.assert_allclose(found.height, 10.0)
    np.testing.assert_allclose(found.voltage, 12.6)
    np.testing.assert_allclose(np.linalg.norm(found.q, axis=1), 1.0)
    assert (found.command_hz, found.inertial_hz) == (pytest.approx(50.0), pytest.approx(400.0))
    assert found.ardupilot


def test_a_vehicle_on_the_ground_does_not_fly() -> None:
    low = changed(recording(), Sensor.PLACE, lambda c: replace(c, values=0.05 * c.values))
    assert "does not fly" in refused(low)
    idle = changed(recording(), Sensor.MOTOR, lambda c: replace(c, values=0.0 * c.values))
    assert "does not fly" in refused(idle)


def test_a_hop_is_too_short_and_says_how_long_it_was() -> None:
    assert refused(recording(airborne=(10.0, 24.0))).startswith("only 12 s in the air")


@pytest.mark.parametrize(
    ("sensor", "said"),
    [
        (Sensor.ACCEL, "no accelerometer and gyroscope"), (Sensor.GYRO, "no accelerometer and gyroscope"),
        (Sensor.VELOCITY, "no velocity and attitude"), (Sensor.ATTITUDE, "no velocity and attitude"),
    ],
)  # fmt: skip
def test_what_is_missing_is_named(sensor: Sensor, said: str) -> None:
    assert refused(without(recording(), sensor)).startswith(said)


def test_streams_that_are_too_slow_are_missing() -> None:
    """20 Hz of an inertial unit, 4 Hz of the estimator."""
    slow = changed(recording(), Sensor.GYRO, lambda c: c.take(slice(None, None, 40)))
    assert "20 Hz" in refused(slow)
    slow = changed(recording(), Sensor.VELOCITY, lambda c: c.take(slice(None, None, 4)))
    assert "4 Hz" in refused(slow)


def test_each_autopilot_is_told_its_own_way_to_log() -> None:
    assert needed_log(recording()) == LOG_BITS
    assert needed_log(replace(recording(), identity=Identity(autopilot="px4"))) == PROFILE_BITS


@pytest.mark.parametrize("sensor", [Sensor.ACCEL, Sensor.GYRO, Sensor.MOTOR, Sensor.VELOCITY, Sensor.ATTITUDE])
def test_a_gap_is_left_out_with_a_tenth_of_a_second_around_it(sensor: Sensor) -> None:
    found = judged(changed(recording(), sensor, cut(20.0, 21.0)))
    out = found.t[~found.usable]
    assert out.min() == pytest.approx(19.9, abs=0.03 if sensor not in (Sensor.VELOCITY, Sensor.ATTITUDE) else 0.13)
    assert out.max() == pytest.approx(21.1, abs=0.03)
    assert len(out) == pytest.approx(120, abs=15)


def test_a_step_of_a_slow_log_is_no_gap() -> None:
    """RCOU at 10 Hz: every step is 0.1 s."""
    slow = changed(recording(), Sensor.MOTOR, lambda c: c.take(slice(None, None, 5)))
    assert judged(slow).usable.all()


def test_a_motor_at_its_limit_is_left_out_with_its_surroundings() -> None:
    def full(c: Channel) -> Channel:
        values = c.values.copy()
        values[(c.t >= 30.0) & (c.t < 30.5), 1] = 0.95
        return replace(c, values=values)

    found = judged(changed(recording(), Sensor.MOTOR, full))
    np.testing.assert_array_equal(found.limited, ~found.usable)
    out = found.t[found.limited]
    assert (out.min(), out.max()) == (pytest.approx(29.9, abs=0.03), pytest.approx(31.1, abs=0.03))


def test_a_motor_that_stops_for_a_moment_does_not_end_a_flight() -> None:
    def stopped(c: Channel) -> Channel:
        return replace(c, values=np.where(((c.t >= 30.0) & (c.t < 30.5))[:, None], 0.0, c.values))

    found = judged(changed(recording(), Sensor.MOTOR, stopped))
    assert found.t[-1] - found.t[0] > 37.0
    assert not found.usable[(found.t > 30.05) & (found.t < 30.4)].any()


def test_of_two_flights_in_a_log_the_longer_one_is_judged() -> None:
    def landed(c: Channel) -> Channel:
        down = (c.t >= 20.0) & (c.t < 24.0)
        return replace(c, values=np.where(down[:, None], 0.0, c.values))

    one = changed(changed(recording(), Sensor.PLACE, landed), Sensor.MOTOR, landed)
    found = judged(one)
    assert found.t[0] == pytest.approx(25.0, abs=0.2)


def test_motors_that_run_on_after_the_vehicle_disarmed_do_not_fly() -> None:
    one = recording()
    one = replace(one, events=(*one.events[:1], Event(40.0, "disarmed", "")))
    assert judged(one).t[-1] == pytest.approx(39.0, abs=1.1)


def test_rest_is_what_each_unit_reads_while_disarmed() -> None:
    found = judged(recording(scales=(1.0, 1.02)))
    assert found.rest is not None
    assert set(found.rest.means) == {0, 1}
    np.testing.assert_allclose(found.rest.means[1], [0.0, 0.0, -1.02 * G], atol=1e-9)
    turned = changed(recording(), Sensor.GYRO, lambda c: replace(c, values=c.values + 0.2))
    assert judged(turned).rest is None
    assert judged(replace(recording(), events=())).rest is not None  # motors that stand say it as well


def test_rest_takes_no_part_of_the_flight() -> None:
    """Armed from 9 s to 51 s: what is read in flight differs, and does not enter."""

    def flying(c: Channel) -> Channel:
        return replace(c, values=np.where(((c.t >= 9.5) & (c.t < 50.5))[:, None], 3.0, c.values))

    found = judged(changed(recording(), Sensor.ACCEL, flying))
    assert found.rest is not None
    np.testing.assert_allclose(found.rest.means[0], [0.0, 0.0, -G], atol=1e-9)


@pytest.mark.parametrize(
    ("scales", "unit"), [((1.0, 1.0), 0), ((1.03, 1.0), 1), ((1.0, 1.03), 0), ((1.03, 1.05), 0), ((1.002, 1.0), 0)]
)
def test_a_unit_that_reads_gravity_at_rest_is_believed_before_a_faster_one(
    scales: tuple[float, float], unit: int
) -> None:
    found = judged(recording(scales=scales))
    assert found.unit == unit
    np.testing.assert_allclose(found.force[:, 2], -G * scales[unit])
    assert set(found.others) == {1 - unit}
    np.testing.assert_allclose(found.others[1 - unit][:, 2], -G * scales[1 - unit])
    assert found.inertial_hz == pytest.approx(400.0)  # gyroscopes do not take part: the fastest one stays


def test_streams_of_a_driver_are_not_taken_for_calibrated_ones() -> None:
    raw = changed(recording(), Sensor.ACCEL, lambda c: replace(c, stage=Stage.RAW))
    assert "no accelerometer" in refused(raw)


def test_filters_are_those_of_the_parameters_where_streams_are_filtered() -> None:
    one = recording()
    assert judged(one).cutoff_hz == {Sensor.ACCEL: 20.0, Sensor.GYRO: 20.0}
    bare = changed(one, Sensor.GYRO, lambda c: replace(c, stage=Stage.CORRECTED))
    assert judged(bare).cutoff_hz == {Sensor.ACCEL: 20.0, Sensor.GYRO: 0.0}


def test_what_was_not_logged_is_not_a_number() -> None:
    found = judged(without(recording(), Sensor.VOLTAGE))
    assert np.isnan(found.voltage).all()


def test_a_quaternion_that_changes_its_sign_turns_nothing() -> None:
    flipped = changed(
        recording(), Sensor.ATTITUDE, lambda c: replace(c, values=c.values * np.sign(np.sin(c.t) + 0.5)[:, None])
    )  # fmt: skip
    found = judged(flipped)
    np.testing.assert_allclose(np.abs(found.q), np.tile([1.0, 0.0, 0.0, 0.0], (len(found.t), 1)), atol=1e-12)


def test_samples_that_a_log_lost_are_counted() -> None:
    one = recording()
    assert dropped(one) == pytest.approx(0.0, abs=1e-3)
    accel = next(c for c in (*one.channels, *one.dynamics) if c.sensor == Sensor.ACCEL)
    kept = np.arange(len(accel.t)) // 100 % 4 > 0
    lossy = replace(accel, t=accel.t[kept], values=accel.values[kept])
    found = dropped(replace(one, channels=(lossy,), dynamics=()))
    assert found == pytest.approx(0.25, abs=0.02)
    assert dropped(replace(one, channels=(), dynamics=())) == 0.0
