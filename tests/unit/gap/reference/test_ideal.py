"""References that a recording carries itself, sampled where the sensor was."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavcal.calib.gap.problem import ReferenceInfo, ReferenceKind, Trace
from mavcal.calib.gap.reference.channels import (
    comparable_channels,
    filter_delay,
    filter_gain,
    filter_in_force,
    sensors_of,
)
from mavcal.calib.gap.reference.expected_noise import slopes_squared
from mavcal.calib.gap.reference.ideal import (
    Ideal,
    continuous,
    recorded_reference,
    trace_of,
    true_attitude,
    with_unit_noise,
)
from mavcal.calib.gap.reference.signals import Signal
from mavcal.calib.recording import Channel, Identity, ParameterTimeline, Recording, Sensor, Stage
from tests.examples import examples

T = np.arange(0.0, 10.0, 0.02)
SIM = ReferenceInfo(ReferenceKind.SIM)


def smooth(t):
    return np.column_stack([np.sin(t), np.cos(0.7 * t), 0.1 * t])


def channel(t=T, values=None, sensor=Sensor.GYRO, instance=0, *, stage=Stage.RAW, source="IMU", unit="rad/s"):
    made = smooth(t) if values is None else values
    return Channel(sensor, instance, np.asarray(t), np.asarray(made, dtype=float), unit, stage, source)


@settings(max_examples=examples(15), deadline=None)
@given(signs=st.lists(st.sampled_from([-1.0, 1.0]), min_size=30, max_size=30))
def test_attitudes_without_jumps_of_sign_are_the_same_attitudes(signs):
    q = Rotation.from_rotvec(np.arange(30)[:, None] * [0.1, -0.2, 0.15]).as_quat(scalar_first=True)
    made = continuous(q * np.array(signs)[:, None])
    assert ((made[1:] * made[:-1]).sum(axis=1) > 0.0).all()
    np.testing.assert_allclose(np.abs((made * q).sum(axis=1)), 1.0)
    np.testing.assert_array_equal(made[0], signs[0] * q[0])


def test_the_spin_is_the_change_of_the_rate_unless_it_is_given():
    ideal = Ideal(SIM, {Sensor.GYRO: Signal(T, smooth(T))})
    np.testing.assert_allclose(ideal.spin.values[5:-5, 0], np.cos(T[5:-5]), atol=1e-3)
    given_spin = Signal(T, np.zeros((len(T), 3)))
    assert Ideal(SIM, {Sensor.GYRO: Signal(T, smooth(T))}, spin=given_spin).spin is given_spin
    assert Ideal(SIM, {Sensor.MAG: Signal(T, smooth(T))}).spin is None


def test_a_body_has_what_is_known_and_attitudes_of_length_one():
    q = Rotation.from_rotvec(T[:, None] * [0.3, 0.0, 0.0]).as_quat(scalar_first=True)
    ideal = Ideal(SIM, {Sensor.ACCEL: Signal(T, smooth(T))}, Signal(T, 1.3 * q))
    body = ideal.body(T[:-1] + 0.01)
    np.testing.assert_allclose(np.linalg.norm(body["attitude"], axis=1), 1.0)
    np.testing.assert_allclose(body["force"], smooth(T[:-1] + 0.01), atol=1e-6)
    assert [name for name, value in body.items() if value is None] == ["rate", "spin", "field", "place"]
    later = ideal.shifted(2.0).body(T[:-1] + 2.01)
    np.testing.assert_allclose(later["force"], body["force"], atol=1e-9)
    np.testing.assert_allclose(later["attitude"], body["attitude"], atol=1e-9)


def test_the_ideal_reading_is_taken_when_the_sensor_was_read():
    """Stamps that jitter by a fifth of a step leave no residual of a sensor that reads the truth at its own stamps."""
    rng = np.random.default_rng(1)
    stamps = T + 0.004 * rng.uniform(-1.0, 1.0, len(T))
    fine = np.arange(-0.1, 10.1, 0.005)
    trace = trace_of(channel(stamps), Signal(fine, smooth(fine)), None, Recording(()))
    np.testing.assert_allclose(trace.residual, 0.0, atol=1e-8)
    assert trace.observed.all()
    assert trace.fs == pytest.approx(50.0, rel=1e-3)


def test_what_was_not_sampled_has_no_residual_and_is_not_observed():
    kept = (T < 3.0) | (T > 3.5)
    trace = trace_of(channel(T[kept], smooth(T[kept]) + 1.0), Signal(T, smooth(T)), None, Recording(()))
    hole = ~trace.observed
    assert hole.sum() == (~kept).sum()
    np.testing.assert_array_equal(trace.residual[hole], 0.0)
    np.testing.assert_allclose(trace.residual[trace.observed], 1.0, atol=1e-9)


def test_a_trace_ends_where_the_reference_does():
    part = T[(T > 2.0) & (T < 8.0)]
    trace = trace_of(channel(), Signal(part, smooth(part)), None, Recording(()))
    assert trace.t[0] == pytest.approx(part[0], abs=0.011)
    assert trace.t[-1] == pytest.approx(part[-1], abs=0.011)
    assert trace.observed[[0, -1]].all()


def test_what_the_vehicle_did_comes_along_at_the_times_of_the_sensor():
    warm = Channel(Sensor.TEMPERATURE, 0, np.array([0.0, 10.0]), np.array([20.0, 30.0]), "degC", Stage.RAW, "IMU")
    motors = Channel(Sensor.MOTOR, 0, np.array([0.0, 10.0]), np.array([[0.0, 1.0], [1.0, 0.0]]), "1", Stage.RAW, "RC")
    trace = trace_of(channel(instance=1), Signal(T, smooth(T)), None, Recording((warm, motors)))
    np.testing.assert_allclose(trace.temperature, 20.0 + trace.t, atol=1e-6)
    np.testing.assert_allclose(trace.motors.sum(axis=1), 1.0)
    assert (trace.current, trace.throttle, trace.rotor_hz, trace.force) == (None, None, None, None)


def test_a_reference_is_what_its_columns_say_and_an_estimator_s_attitude_is_none():
    assert recorded_reference(Recording((channel(),))) is None
    own = Recording((channel(),), reference=(channel(), channel(sensor=Sensor.MAG, unit="uT")))
    found = recorded_reference(own)
    assert found.info.kind is ReferenceKind.SIM
    assert found.info.text == "The recording carries what ideal sensors read (gyro, mag)."
    q = np.tile([1.0, 0.0, 0.0, 0.0], (len(T), 1))
    for source, known in (("table", True), ("ATT", False)):
        estimated = channel(values=q, sensor=Sensor.ATTITUDE, source=source, unit="1")
        assert (true_attitude(Recording((estimated,))) is not None) == known
    reference = Recording((), reference=(channel(values=-q, sensor=Sensor.ATTITUDE, unit="1"),))
    np.testing.assert_array_equal(true_attitude(reference).values, -q)


def quiet_trace(**over):
    t = np.arange(0.0, 20.0, 0.02)
    rng = np.random.default_rng(2)
    sd = np.where((t >= 8.0) & (t < 10.0), 0.01, 0.5)[:, None]
    ideal = sd * rng.normal(size=(len(t), 3))
    return Trace(Sensor.ACCEL, (0,), t, ideal, ideal, np.ones(len(t), dtype=bool), **over)


def test_the_noise_inside_a_reference_is_bounded_by_its_quietest_second():
    bounded = ReferenceInfo(ReferenceKind.ESTIMATOR, bandwidth_hz=5.0)
    trace = quiet_trace()
    assert with_unit_noise(trace, bounded).unit_sd == pytest.approx(0.01, rel=0.2)
    assert with_unit_noise(trace, SIM).unit_sd == 0.0
    assert with_unit_noise(quiet_trace(against=1), bounded).unit_sd == 0.0
    turns_alone = ReferenceInfo(ReferenceKind.ESTIMATOR, turns_hz=5.0)
    assert with_unit_noise(trace, turns_alone).unit_sd == 0.0
    hidden = dataclasses.replace(trace, observed=(trace.t < 8.0) | (trace.t >= 10.0))
    assert with_unit_noise(hidden, bounded).unit_sd > 0.3


@pytest.mark.parametrize(
    ("stage", "autopilot", "parameters", "cutoff"),
    [
        (Stage.FILTERED, "ardupilot", {"INS_GYRO_FILTER": 20.0}, 20.0),
        (Stage.FILTERED, "ardupilot", {"INS_GYRO_FILTER": 0.0}, None),
        (Stage.FILTERED, "ardupilot", {}, None),
        (Stage.CORRECTED, "ardupilot", {"INS_GYRO_FILTER": 20.0}, None),
        (Stage.FILTERED, "px4", {"INS_GYRO_FILTER": 20.0}, None),
        (Stage.FILTERED, "ardupilot", {"INS_ACCEL_FILTER": 10.0}, None),
    ],
)
def test_the_filter_of_the_firmware_is_known_of_filtered_channels_of_ardupilot(stage, autopilot, parameters, cutoff):
    made = Recording((), identity=Identity(autopilot), parameters=ParameterTimeline.constant(parameters))
    assert filter_in_force(channel(stage=stage), made) == cutoff


def test_a_filter_of_two_poles_halves_the_power_at_its_cutoff_and_is_late_by_its_slope():
    np.testing.assert_allclose(filter_gain(np.array([0.0, 20.0, 200.0]), 20.0) ** 2, [1.0, 0.5, 1e-4], rtol=1e-3)
    np.testing.assert_array_equal(filter_gain(np.array([0.0, 5.0]), None), 1.0)
    s = 2j * math.pi * 1e-3 / (2.0 * math.pi * 20.0)
    phase = np.angle(1.0 / (1.0 + math.sqrt(2.0) * s + s * s))
    assert filter_delay(20.0) == pytest.approx(-phase / (2.0 * math.pi * 1e-3), rel=1e-4)
    assert filter_delay(None) == 0.0


def test_the_source_that_most_instances_have_is_compared():
    imu = [channel(instance=i) for i in (0, 1)]
    fast = channel(np.arange(0.0, 10.0, 0.001), instance=0, source="GYR")
    found = comparable_channels(Recording((*imu, fast)), Sensor.GYRO)
    assert {i: c.source for i, c in found.items()} == {0: "IMU", 1: "IMU"}
    assert comparable_channels(Recording((imu[0], fast)), Sensor.GYRO)[0].source == "GYR"
    assert comparable_channels(Recording(()), Sensor.GYRO) == {}


def test_instances_that_were_sampled_at_other_times_are_not_compared():
    """A shift of a tenth of a step is movement in the difference; a fiftieth is the rounding of stamps."""
    for shift, together in ((0.0004, 2), (0.002, 1)):
        pair = channel(), channel(T + shift, instance=1)
        assert len(comparable_channels(Recording(pair), Sensor.GYRO)) == together
    numbered = channel(source="IMU"), channel(instance=1, source="IMU2")
    assert len(comparable_channels(Recording(numbered), Sensor.GYRO)) == 2
    debiased = channel(), channel(instance=1, stage=Stage.DEBIASED)
    assert list(comparable_channels(Recording(debiased), Sensor.GYRO)) == [0]
    assert [c.instance for c in sensors_of(Recording(debiased))] == [0]


def test_the_change_of_a_reading_is_the_mean_of_the_steps_on_either_side():
    t = np.arange(6) * 0.5
    values = np.column_stack([[0.0, 1.0, 3.0, 6.0, 6.0, 6.0], 2.0 * np.arange(6), np.zeros(6)])
    trace = Trace(Sensor.GYRO, (0,), t, values, values, np.ones(6, dtype=bool))
    np.testing.assert_allclose(slopes_squared(trace)[:, 0], [4.0, 10.0, 26.0, 18.0, 0.0, 0.0])
    np.testing.assert_allclose(slopes_squared(trace)[:, 1], 16.0)
    holed = dataclasses.replace(trace, observed=np.arange(6) != 2)
    np.testing.assert_allclose(slopes_squared(holed)[:, 0], [4.0, 4.0, 0.0, 0.0, 0.0, 0.0])
