from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.gap.problem import ReferenceKind
from mavcal.calib.gap.reference import build
from mavcal.calib.recording import Channel, Recording, Sensor, Stage

RATE, SECONDS, SIGMA = 100.0, 20.0, {Sensor.ACCEL: 0.02, Sensor.GYRO: 0.002, Sensor.MAG: 0.4}
UNITS = {Sensor.ACCEL: "m/s2", Sensor.GYRO: "rad/s", Sensor.MAG: "uT"}


def channel(sensor, t, values, instance=0, source="table", unit=None):
    return Channel(sensor, instance, t, values, unit or UNITS.get(sensor, "1"), Stage.RAW, source)


def truth(t):
    """Ideal readings and attitude of a vehicle that weaves."""
    angles = np.column_stack([0.5 * np.sin(1.1 * t), 0.4 * np.sin(0.7 * t + 1.0), 0.6 * t])
    turn = Rotation.from_euler("ZYX", angles[:, ::-1])
    step = 1e-4
    ahead = Rotation.from_euler(
        "ZYX",
        np.column_stack([0.5 * np.sin(1.1 * (t + step)), 0.4 * np.sin(0.7 * (t + step) + 1.0), 0.6 * (t + step)])[
            :, ::-1
        ],
    )
    ideal = {
        Sensor.ACCEL: turn.inv().apply([0.3, 0.0, -9.80665]),
        Sensor.GYRO: (turn.inv() * ahead).as_rotvec() / step,
        Sensor.MAG: turn.inv().apply([22.0, 1.0, 42.0]),
    }
    return ideal, turn.as_quat()[:, [3, 0, 1, 2]]


def flown(seed=1, offset=0.0, effects=None, reference=True, noise=SIGMA, start=0.0):
    """A recording along :func:`truth`: noise, `effects` added, clock `offset` s ahead."""
    rng = np.random.default_rng(seed)
    t = start + np.arange(int(RATE * SECONDS)) / RATE
    ideal, q = truth(t)
    channels, references = [], [channel(Sensor.ATTITUDE, t + offset, q)]
    for sensor, values in ideal.items():
        rows = slice(None, None, 4) if sensor == Sensor.MAG else slice(None)
        added = (effects or {}).get(sensor, 0.0) + noise[sensor] * rng.standard_normal(values.shape)
        channels.append(channel(sensor, t[rows] + offset, (values + added)[rows]))
        references.append(channel(sensor, t[rows] + offset, values[rows]))
    channels.append(channel(Sensor.TEMPERATURE, t[::20] + offset, 20.0 + t[::20]))
    return Recording(tuple(channels), reference=tuple(references) if reference else ())


def by_sensor(problem):
    return {trace.sensor: trace for trace in problem.traces}


def test_columns_of_a_reference_are_what_an_ideal_sensor_read():
    problem = build(flown(effects={Sensor.ACCEL: np.array([0.3, -0.2, 0.1])}))
    assert problem.reference.kind == ReferenceKind.SIM
    traces = by_sensor(problem)
    assert traces[Sensor.ACCEL].residual.mean(axis=0) == pytest.approx([0.3, -0.2, 0.1], abs=0.002)
    assert traces[Sensor.MAG].fs == pytest.approx(RATE / 4)
    assert traces[Sensor.GYRO].observed.all()
    assert problem.duration_s == pytest.approx(SECONDS, abs=0.1)


def test_every_trace_knows_the_body_at_its_own_times():
    trace = by_sensor(build(flown()))[Sensor.MAG]
    ideal, q = truth(trace.t)
    assert trace.force == pytest.approx(ideal[Sensor.ACCEL], abs=1e-9)
    assert trace.rate == pytest.approx(ideal[Sensor.GYRO], abs=1e-9)
    assert np.abs((trace.attitude * q).sum(axis=1)) == pytest.approx(1.0)
    assert trace.temperature == pytest.approx(20.0 + trace.t, abs=0.2)
    assert trace.current is None
    spin = np.gradient(ideal[Sensor.GYRO], trace.t, axis=0)
    assert trace.spin[5:-5] == pytest.approx(spin[5:-5], abs=0.01)


def test_a_simulators_difference_from_its_own_reference_is_its_noise():
    trace = by_sensor(build(flown(1), flown(2)))[Sensor.ACCEL]
    assert trace.sigma == pytest.approx(SIGMA[Sensor.ACCEL], rel=0.06)
    assert trace.psd is None
    assert np.isfinite(trace.sigma_dof)


def test_without_a_simulator_no_noise_is_declared():
    assert by_sensor(build(flown()))[Sensor.ACCEL].sigma is None


def test_a_simulator_of_the_same_trajectory_is_a_reference():
    effects = {Sensor.GYRO: np.array([0.01, 0.0, -0.02])}
    problem = build(flown(1, effects=effects, reference=False), flown(2, reference=False))
    assert by_sensor(problem)[Sensor.GYRO].residual.mean(axis=0) == pytest.approx([0.01, 0.0, -0.02], abs=3e-4)


def test_a_hole_is_not_observed():
    real = flown()
    rows = np.ones(int(RATE * SECONDS), dtype=bool)
    rows[500:650] = False
    accel = real.channels[0].take(rows)
    trace = by_sensor(build(real.with_channels([accel, *real.channels[1:]])))[Sensor.ACCEL]
    assert len(trace.t) == int(RATE * SECONDS)
    assert (~trace.observed).sum() == 150
    assert not trace.observed[500:650].any()
    assert np.isfinite(trace.measured).all()


def test_nothing_to_compare_is_said():
    with pytest.raises(InvalidInputError, match="no accelerometer"):
        build(Recording((channel(Sensor.TEMPERATURE, np.arange(9.0), np.arange(9.0)),)))


def test_a_simulator_on_another_clock_is_set_right():
    problem = build(flown(1, reference=False), flown(2, reference=False, offset=3.217))
    trace = by_sensor(problem)[Sensor.GYRO]
    assert any("clock" in text for text in problem.warnings)
    assert trace.residual[50:-50].std() == pytest.approx(SIGMA[Sensor.GYRO], rel=0.15)  # the simulator's own is out
    assert trace.observed.mean() > 0.98


@pytest.mark.parametrize("shift", [0.0, 0.0033])
def test_a_simulator_on_another_trajectory_is_no_reference(shift):
    t = shift + np.arange(int(RATE * SECONDS)) / RATE
    other, _ = truth(-1.7 * t)
    moved = Recording(tuple(channel(sensor, t, values) for sensor, values in other.items()))
    with pytest.raises(InvalidInputError, match="ideal sensor"):
        build(flown(1, reference=False), moved)


def test_a_sensor_in_another_frame_is_still_on_the_same_trajectory():
    real = flown(1, reference=False)
    turned = [
        dataclasses.replace(c, values=c.values * [1.0, 1.0, -1.0]) if c.sensor == Sensor.GYRO else c
        for c in real.channels
    ]
    problem = build(real.with_channels(turned), flown(2, reference=False))
    assert problem.not_testable[0][0] == "gyro"
    assert {t.sensor for t in problem.traces} == {Sensor.ACCEL, Sensor.MAG}


@pytest.mark.parametrize("offset", [0.0, 3.217])
@pytest.mark.parametrize(
    "turn", [np.diag([1.0, -1.0, -1.0]), np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]), -np.eye(3)]
)
def test_all_sensors_in_another_frame_are_still_on_the_same_trajectory(offset, turn):
    real = flown(1, reference=False)
    turned = [dataclasses.replace(c, values=c.values @ turn.T) if c.sensor in SIGMA else c for c in real.channels]
    problem = build(real.with_channels(turned), flown(2, reference=False, offset=offset))
    assert {name for name, _, _ in problem.not_testable} == {"accel", "gyro", "mag"}
    assert all("another frame" in reason for _, reason, _ in problem.not_testable)
