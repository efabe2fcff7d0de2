from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from mavcal.service.simvehicle.errors import ControlError
from mavcal.service.simvehicle.motion import FACES, CurrentMotion
from mavcal.service.simvehicle.rotation import (
    body_from_ned,
    conjugate,
    euler_from_quaternions,
    matrices_from_quaternions,
    mounting_matrix,
    multiply,
    quaternion_from_euler,
    quaternion_from_vector,
    shortest_rotation,
    vector_from_quaternion,
)

GRAVITY = np.array([0.0, 0.0, -9.80665])

Command = Callable[[CurrentMotion], object]
COMMANDS: dict[str, Command] = {
    "still": lambda m: m.still(1.0),
    "hold": lambda m: m.hold(1.0, "left", 3.0, 0.2),
    "turn": lambda m: m.turn(1.0, [0.3, -0.2, 1.0], 90.0),
    "tumble": lambda m: m.tumble(1.0, 45.0),
    "whole turns": lambda m: m.turn(1.0, [0.3, -0.2, 1.0], -120.0, turns=1.0),
}


def moving(command: Command, seed: int = 3) -> CurrentMotion:
    motion = CurrentMotion(np.random.default_rng(seed))
    motion.hold(0.0, [20.0, -10.0, 40.0], transition_s=0.0)
    command(motion)
    return motion


@pytest.mark.parametrize("name", COMMANDS)
def test_the_rate_is_the_exact_derivative_of_the_attitude(name: str) -> None:
    motion = moving(COMMANDS[name])
    t = np.linspace(1.01, 8.0, 200)
    h = 1e-5
    q_before, _ = motion.evaluate(t - h)
    q_after, _ = motion.evaluate(t + h)
    _, rate = motion.evaluate(t)
    difference = multiply(conjugate(q_before), q_after)
    numeric = np.array([vector_from_quaternion(d) for d in difference]) / (2 * h)
    assert rate == pytest.approx(numeric, abs=2e-6)


@pytest.mark.parametrize("name", COMMANDS)
def test_attitudes_are_unit_and_continuous_across_a_command(name: str) -> None:
    motion = CurrentMotion(np.random.default_rng(3))
    motion.tumble(0.0)
    before = motion.attitude(1.0)
    COMMANDS[name](motion)
    q, _ = motion.evaluate(np.linspace(1.0, 5.0, 500))
    assert np.linalg.norm(q, axis=1) == pytest.approx(np.ones(500))
    assert abs(np.dot(q[0], before)) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("face", "axis", "sign"),
    [("level", 2, -1), ("back", 2, 1), ("left", 1, 1), ("right", 1, -1), ("nose_down", 0, -1), ("nose_up", 0, 1)],
)
def test_faces_point_gravity_along_their_axis(face: str, axis: int, sign: int) -> None:
    motion = CurrentMotion(np.random.default_rng(1))
    motion.hold(0.0, face, transition_s=0.5)
    q, rate = motion.evaluate(np.array([2.0]))
    expected = np.zeros(3)
    expected[axis] = sign * 9.80665
    assert body_from_ned(q, GRAVITY)[0] == pytest.approx(expected, abs=1e-9)
    assert not rate.any()


def test_a_hand_errs_by_a_few_degrees_and_trembles() -> None:
    errors, tremors = [], []
    for seed in range(30):
        motion = CurrentMotion(np.random.default_rng(seed))
        reached = motion.hold(0.0, "level", tilt_deg=3.0, tremor_deg=0.2)
        q, _ = motion.evaluate(np.linspace(reached + 1, reached + 5, 400))
        vectors = np.degrees([vector_from_quaternion(x) for x in q])
        errors.append(vectors.mean(axis=0))
        tremors.append(vectors.std(axis=0))
    assert 2.0 < np.sqrt(np.mean(np.square(errors))) < 4.0
    assert 0.15 < np.sqrt(np.mean(np.square(tremors))) < 0.25


def test_tumbling_keeps_its_pace_and_covers_the_sphere() -> None:
    motion = CurrentMotion(np.random.default_rng(1))
    motion.tumble(0.0, 45.0)
    q, rate = motion.evaluate(np.arange(0.6, 60, 0.1))
    speed = np.degrees(np.linalg.norm(rate, axis=1))
    assert 24 < speed.min() < 30  # +-17 % of 45 that swells and fades by 35 %
    assert 60 < speed.max() < 72
    down = body_from_ned(q, np.array([0.0, 0.0, 1.0]))
    directions = np.random.default_rng(0).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    nearest = np.degrees(np.arccos(np.clip((directions @ down.T).max(axis=1), -1, 1)))
    assert nearest.max() < 35


@pytest.mark.parametrize(("rate", "turns"), [(90.0, 3.0), (-45.0, 0.5), (360.0, 0.1)])
def test_turns_on_a_thread_are_as_many_as_asked_for_and_end_at_rest(rate: float, turns: float) -> None:
    motion = CurrentMotion(np.random.default_rng(1))
    motion.turn(1.0, [0, 0, 1], rate, turns=turns)
    t = np.linspace(1.0, 20.0, 40_000)
    _, rates = motion.evaluate(t)
    angle = np.degrees(np.sum(0.5 * (rates[1:, 2] + rates[:-1, 2]) * np.diff(t)))
    assert angle == pytest.approx(np.sign(rate) * 360.0 * turns, rel=1e-6)
    assert not rates[-1].any()
    assert np.degrees(np.abs(rates).max()) <= abs(rate) * (1.0 + 1e-9)


def test_turns_that_cannot_be_made_are_refused() -> None:
    for rate, turns in ((90.0, 0.0), (0.0, 1.0), (90.0, -2.0)):
        with pytest.raises(ControlError, match="cannot be made"):
            CurrentMotion(np.random.default_rng(1)).turn(1.0, [0, 0, 1], rate, turns=turns)


def test_a_turntable_turns_about_the_body_axis_at_the_asked_rate() -> None:
    motion = CurrentMotion(np.random.default_rng(1))
    motion.hold(0.0, "left", transition_s=0.0)
    motion.turn(1.0, [0, 2, 0], -90.0)
    _, rate = motion.evaluate(np.array([5.0]))
    assert np.degrees(rate[0]) == pytest.approx([0, -90, 0])


def test_a_jolt_is_a_short_force_and_no_motion() -> None:
    motion = CurrentMotion(np.random.default_rng(1))
    motion.jolt(1.0, [5.0, 0.0, 0.0], 0.2)
    force = motion.linear_acceleration(np.array([0.9, 1.1, 1.3]))
    assert force[:, 0] == pytest.approx([0.0, 5.0, 0.0])


def test_a_reboot_sets_the_clock_back_and_leaves_the_motion() -> None:
    motion = CurrentMotion(np.random.default_rng(1))
    motion.tumble(0.0)
    before = motion.attitude(12.5)
    motion.restart(10.0)
    assert motion.attitude(2.5) == pytest.approx(before)


@pytest.mark.parametrize("pose", ["upside_down", [1.0, 2.0]])
def test_an_unknown_pose_is_refused_with_what_is_known(pose: object) -> None:
    with pytest.raises(ControlError, match="hold"):
        CurrentMotion(np.random.default_rng(1)).hold(0.0, pose)  # type: ignore[arg-type]


def test_a_zero_axis_is_refused() -> None:
    with pytest.raises(ControlError, match="axis"):
        CurrentMotion(np.random.default_rng(1)).turn(0.0, [0, 0, 0], 10.0)


def test_euler_angles_and_matrices_agree() -> None:
    for roll, pitch, yaw in ((0.3, -0.4, 1.2), (-2.0, 0.7, -1.0)):
        q = quaternion_from_euler(roll, pitch, yaw)
        assert euler_from_quaternions(q[None])[0] == pytest.approx([roll, pitch, yaw])
        assert matrices_from_quaternions(q) @ matrices_from_quaternions(conjugate(q)) == pytest.approx(np.eye(3))


def test_level_facing_east_sees_north_on_its_left() -> None:
    q = quaternion_from_euler(0.0, 0.0, np.pi / 2)
    assert body_from_ned(q[None], np.array([1.0, 0.0, 0.0]))[0] == pytest.approx([0.0, -1.0, 0.0])


def test_mounting_rotations_are_rotations_and_the_common_ones_right() -> None:
    for k in range(41):
        m = mounting_matrix(k)
        assert m @ m.T == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(m) == pytest.approx(1.0)
    assert mounting_matrix(2) @ [1, 0, 0] == pytest.approx([0, 1, 0])
    assert mounting_matrix(8) @ [0, 1, 0] == pytest.approx([0, -1, 0])
    assert mounting_matrix(24) @ [1, 0, 0] == pytest.approx([0, 0, -1])


def test_the_shortest_rotation_takes_one_direction_to_the_other() -> None:
    a, b = np.array([[1.0, 2.0, 3.0]]), np.array([[-2.0, 0.5, 1.0]])
    turned = matrices_from_quaternions(shortest_rotation(a, b))[0] @ a[0]
    assert turned / np.linalg.norm(turned) == pytest.approx(b[0] / np.linalg.norm(b[0]))


def test_rotation_vectors_go_round_the_whole_way() -> None:
    v = np.array([0.3, -1.2, 0.7])
    assert vector_from_quaternion(quaternion_from_vector(v)) == pytest.approx(v)
    assert quaternion_from_vector(np.zeros(3)) == pytest.approx([1, 0, 0, 0])


def test_faces_are_the_six_of_ardupilot() -> None:
    assert set(FACES) == {"level", "left", "right", "nose_down", "nose_up", "back"}
