from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.gap.problem import ReferenceKind
from mavcal.calib.gap.reference import build
from mavcal.calib.gap.reference.posed import body_rate, earth_field_of, pose_of
from mavcal.calib.recording import Recording, Sensor

from .test_recorded import RATE, SECONDS, SIGMA, by_sensor, channel, flown, truth

EARTH = np.array([22.0, 1.0, 42.0])


def posed(seed=1, effects=None, jitter=0.0):
    """A table whose own attitude is the truth, with noise of `jitter` rad, and no ideal readings."""
    made = flown(seed, effects=effects, reference=False)
    t = np.arange(int(RATE * SECONDS)) / RATE
    _, q = truth(t)
    q = q + 0.5 * jitter * np.random.default_rng(seed + 100).standard_normal(q.shape)
    attitude = channel(Sensor.ATTITUDE, t, q / np.linalg.norm(q, axis=1, keepdims=True))
    return Recording((*made.channels, attitude))


def test_an_ideal_sensor_is_driven_by_the_attitude():
    problem = build(posed(effects={Sensor.GYRO: np.array([0.01, -0.02, 0.03])}))
    assert problem.reference.kind == ReferenceKind.POSE
    traces = by_sensor(problem)
    gyro = traces[Sensor.GYRO].residual[20:-20]
    assert gyro.mean(axis=0) == pytest.approx([0.01, -0.02, 0.03], abs=3e-4)
    assert gyro.std(axis=0) == pytest.approx(SIGMA[Sensor.GYRO], rel=0.15)
    assert traces[Sensor.MAG].residual.std(axis=0) == pytest.approx(SIGMA[Sensor.MAG], rel=0.15)
    assert "acceleration is not in it" in problem.reference.text


def test_a_velocity_gives_the_acceleration():
    real = posed()
    t = np.arange(int(RATE * SECONDS)) / RATE
    velocity = np.column_stack([0.3 * t, np.zeros((len(t), 2))])
    real = dataclasses.replace(real, reference=(channel(Sensor.VELOCITY, t, velocity),))
    residual = by_sensor(build(real))[Sensor.ACCEL].residual
    assert residual.mean(axis=0) == pytest.approx(np.zeros(3), abs=0.003)
    place = np.column_stack([0.15 * t**2, np.zeros((len(t), 2))])
    placed = dataclasses.replace(real, reference=(channel(Sensor.PLACE, t, place),))
    assert by_sensor(build(placed))[Sensor.ACCEL].residual[50:-50].mean(axis=0) == pytest.approx(np.zeros(3), abs=0.003)


def test_the_velocity_of_a_flight_table_gives_the_acceleration():
    """A windy null had a low pass of both accelerometers: every force of flight was missing in the reference."""
    t = np.arange(int(RATE * SECONDS)) / RATE
    velocity = channel(Sensor.VELOCITY, t, np.column_stack([0.3 * t, np.zeros((len(t), 2))]))
    problem = build(dataclasses.replace(posed(), dynamics=(velocity,)))
    assert by_sensor(problem)[Sensor.ACCEL].residual.mean(axis=0) == pytest.approx(np.zeros(3), abs=0.003)
    assert "acceleration is not in it" not in problem.reference.text


def test_a_measured_place_comes_before_the_velocity_of_an_estimator():
    t = np.arange(int(RATE * SECONDS)) / RATE
    nothing = np.zeros((len(t), 2))
    place = channel(Sensor.PLACE, t, np.column_stack([0.15 * t**2, nothing]))
    wrong = channel(Sensor.VELOCITY, t, np.column_stack([3.0 * t, nothing]))
    real = dataclasses.replace(posed(), reference=(place,), dynamics=(wrong,))
    assert by_sensor(build(real))[Sensor.ACCEL].residual[50:-50].mean(axis=0) == pytest.approx(np.zeros(3), abs=0.003)


def test_a_pose_goes_no_further_than_the_one_it_is_compared_with():
    noisy = pose_of(posed(jitter=2e-3))
    exact = pose_of(posed(), noisy.cutoffs)
    assert exact.cutoffs.rotation == noisy.cutoffs.rotation


def test_a_noisy_pose_is_used_below_the_frequency_where_it_is_noise():
    exact, noisy = pose_of(posed()), pose_of(posed(jitter=2e-3))
    assert noisy.cutoffs.rotation is not None
    assert noisy.cutoffs.rotation < 10.0
    assert exact.cutoffs.rotation is None or exact.cutoffs.rotation > 3.0
    ideal, _ = truth(noisy.t)
    assert np.abs(noisy.rate - ideal[Sensor.GYRO])[50:-50].std() < 0.02


def test_a_pose_of_holes_only_is_none():
    noisy = posed(jitter=2e-3)
    assert pose_of(noisy) is not None
    attitude = noisy.channels[-1]
    kept = np.arange(len(attitude)) % int(0.8 * RATE) < int(0.2 * RATE)
    fragments = Recording((*noisy.channels[:-1], attitude.take(kept)))
    assert pose_of(fragments, pose_of(noisy).cutoffs) is None


def test_rate_of_a_steady_turn():
    t = np.linspace(0.0, 1.0, 101)
    q = np.column_stack([np.cos(t), np.zeros(101), np.zeros(101), np.sin(t)])
    change = np.column_stack([-np.sin(t), np.zeros(101), np.zeros(101), np.cos(t)])
    assert body_rate(q, change) == pytest.approx(np.tile([0.0, 0.0, 2.0], (101, 1)))


def test_the_earths_field_is_told_from_an_offset():
    real = posed(effects={Sensor.MAG: np.array([5.0, -3.0, 8.0])})
    mags = [c for c in real.channels if c.sensor == Sensor.MAG]
    assert earth_field_of(mags, pose_of(real)) == pytest.approx(EARTH, abs=0.3)


def test_a_nominal_recording_gives_field_and_noise():
    t = np.arange(int(RATE * SECONDS))[::4] / RATE
    magnet = np.where((t > 6.0) & (t < 14.0), 30.0, 0.0)[:, None] * np.array([0.0, 0.0, 1.0])
    real = posed()
    changed = [dataclasses.replace(c, values=c.values + magnet) if c.sensor == Sensor.MAG else c for c in real.channels]
    trace = by_sensor(build(real.with_channels(changed), nominal=(posed(seed=7),)))[Sensor.MAG]
    off = (trace.t < 5.5) | (trace.t > 14.5)
    assert trace.residual[off].mean(axis=0) == pytest.approx(np.zeros(3), abs=0.3)
    assert trace.residual[~off].mean(axis=0)[2] == pytest.approx(30.0, rel=0.15)
    assert trace.sigma == pytest.approx(SIGMA[Sensor.MAG], rel=0.2)


def turned(recording, sensor, turn):
    """`recording` with the readings of `sensor` in another frame."""
    return recording.with_channels(
        dataclasses.replace(c, values=c.values @ turn.T) if c.sensor == sensor else c for c in recording.channels
    )


@pytest.mark.parametrize(
    ("turn", "words"),
    [
        (np.diag([1.0, -1.0, -1.0]), "the sign of y is turned, the sign of z is turned"),
        (np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]), "x reads y, y reads x"),
    ],
)
@pytest.mark.parametrize("sensor", [Sensor.ACCEL, Sensor.GYRO, Sensor.MAG])
def test_a_frame_is_named_and_costs_the_other_sensors_nothing(sensor, turn, words):
    usual, problem = by_sensor(build(posed())), build(turned(posed(), sensor, turn))
    (refused,) = problem.not_testable
    assert refused[0] == sensor.value
    assert words in refused[1]
    for other, trace in by_sensor(problem).items():
        assert trace.residual[50:-50].std() == pytest.approx(usual[other].residual[50:-50].std(), rel=0.1)


@pytest.mark.parametrize("factor", [1000.0, 10.0, 0.01])
def test_a_field_that_is_not_the_earths_is_named(factor):
    (refused,) = build(turned(posed(), Sensor.MAG, factor * np.eye(3))).not_testable
    assert refused[0] == "mag"
    assert "Earth's" in refused[1]
    assert "--unit-mag" in refused[2]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda q: q * [1.0, -1.0, -1.0, -1.0], "inverted"),
        (lambda q: q[:, [1, 2, 3, 0]], "x y z w"),
        (lambda q: np.tile(q[0], (len(q), 1)), "nothing in common"),
    ],
)
def test_an_attitude_of_another_convention_is_named(change, words):
    real = posed()
    other = [
        dataclasses.replace(c, values=change(c.values)) if c.sensor == Sensor.ATTITUDE else c for c in real.channels
    ]
    with pytest.raises(InvalidInputError, match=words):
        build(real.with_channels(other))


def test_a_hole_of_the_pose_is_no_reference():
    real = posed()
    kept = [c.take((c.t < 8.0) | (c.t > 10.0)) if c.sensor == Sensor.ATTITUDE else c for c in real.channels]
    for trace in build(real.with_channels(kept)).traces:
        assert not trace.observed[(trace.t > 8.1) & (trace.t < 9.9)].any()
        assert trace.observed[trace.t < 6.5].all()
