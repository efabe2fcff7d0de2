from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.simulate import MOTIONS, MotionOptions, Warming, along, motion_of, trajectory
from mavcal.calib.simulate.motion import hold, spin, turn

FIELD = np.array([20.0, 1.0, 43.0])
G = 9.80665
DOWN = {  # MAVLink's names: what is down
    "level": (0, 0, 1),
    "back": (0, 0, -1),
    "left": (0, -1, 0),
    "right": (0, 1, 0),
    "nose_down": (1, 0, 0),
    "nose_up": (-1, 0, 0),
}


def made(name: str, rate: float = 50.0, seed: int = 1, **options):
    motion = motion_of(name, MotionOptions(**options), np.random.default_rng(seed))
    return trajectory(motion.legs, rate, field=FIELD, start=motion.start)


@pytest.mark.parametrize("name", MOTIONS)
def test_attitude_rate_force_and_field_agree(name):
    path = made(name, rate=200.0, duration=20.0)
    turned = (path.attitude[:-1].inv() * path.attitude[1:]).as_rotvec() * 200.0
    np.testing.assert_allclose(turned, 0.5 * (path.rate[1:] + path.rate[:-1]), atol=2e-3)
    np.testing.assert_allclose(path.attitude.apply(path.force), np.tile([0, 0, -G], (len(path.t), 1)), atol=1e-12)
    np.testing.assert_allclose(path.attitude.apply(path.field), np.tile(FIELD, (len(path.t), 1)), atol=1e-12)


def test_labelled_faces_are_the_faces_that_they_say():
    for name in ("six-faces", "rings"):
        path = made(name, duration=4.0)
        assert len(path.facts) == 6
        for facts in path.facts:
            span = (path.t >= facts.segment.start) & (path.t < facts.segment.end)
            np.testing.assert_allclose(-path.force[span] / G, np.tile(DOWN[facts.segment.label], (200, 1)), atol=1e-9)


def test_a_ring_is_one_whole_turn_and_the_table_turns_both_ways():
    for facts in made("rings", duration=4.0).facts:
        assert facts.turns == pytest.approx(1.0)
    path = made("turntable", duration=4.0)
    assert [f.segment.label for f in path.facts] == ["x+", "x-", "y+", "y-", "z+", "z-"]
    for k, facts in enumerate(path.facts):
        expected = np.radians(90.0) * (-1.0) ** k * np.eye(3)[k // 2]
        np.testing.assert_allclose(facts.rate, expected, atol=1e-12)
        span = (path.t >= facts.segment.start) & (path.t < facts.segment.end)
        np.testing.assert_allclose(path.rate[span], np.tile(expected, (span.sum(), 1)), atol=1e-12)


def test_ten_turns_of_the_thread_come_back():
    path = made("thread", duration=10.0)
    for facts in path.facts:
        assert facts.turns == pytest.approx(10.0)
    assert (path.attitude[-1].inv() * Rotation.identity()).magnitude() == pytest.approx(0.0, abs=0.05)


def test_a_fixture_tilts_every_face_by_its_own():
    path = made("six-faces", duration=2.0, fixture_sd=1.0)
    tilts = []
    for facts in path.facts:
        row = int(np.searchsorted(path.t, facts.segment.start))
        tilts.append(np.degrees(np.arccos(np.clip(-path.force[row] / G @ DOWN[facts.segment.label], -1, 1))))
    assert 0.2 < np.mean(tilts) < 3.0
    assert len(set(np.round(tilts, 9))) == 6


def test_there_and_back_visits_every_face_twice():
    labels = [f.segment.label for f in made("six-faces", duration=1.0, back=True).facts]
    assert labels == ["level", "left", "right", "nose_down", "nose_up", "back", *labels[4::-1]]
    assert len(labels) == 11


def test_legs_begin_where_the_last_one_ended():
    legs = [hold(1.0), turn(np.array([0.0, 0.0, 1.0]), 1.0), spin(np.array([0.5, 0.0, 0.0]), 2.0), hold(0.5, "end")]
    path = trajectory(legs, 10.0, field=FIELD)
    expected = Rotation.from_rotvec([0, 0, 1.0]) * Rotation.from_rotvec([1.0, 0, 0])
    assert (path.attitude[-1].inv() * expected).magnitude() < 1e-12
    assert path.facts[0].segment.start == pytest.approx(4.0)
    assert len(path.t) == 45


def test_a_path_through_attitudes_has_their_rates():
    t = np.linspace(0.0, 4.0, 81)
    attitude = Rotation.from_euler("x", 0.4) * Rotation.from_rotvec(np.outer(t, [0.0, 0.3, 0.0]))
    np.testing.assert_allclose(along(t, attitude, field=FIELD).rate, np.tile([0.0, 0.3, 0.0], (81, 1)), atol=1e-9)
    with pytest.raises(InvalidInputError, match="rising times"):
        along(t[::-1], attitude, field=FIELD)


def test_warming_goes_from_start_to_end():
    warming = Warming(20.0, 60.0, 100.0)
    np.testing.assert_allclose(warming(np.array([0.0, 100.0, 1e6])), [20.0, 60.0 - 40.0 / np.e, 60.0])
    with pytest.raises(InvalidInputError, match="time constant"):
        Warming(20.0, 60.0, 0.0)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: motion_of("waltz", MotionOptions(), np.random.default_rng(0)), "waltz"),
        (lambda: MotionOptions(duration=-1.0), "duration"),
        (lambda: trajectory([hold(1.0)], 0.0, field=FIELD), "rate"),
        (lambda: trajectory([hold(0.0)], 10.0, field=FIELD), "positive"),
        (lambda: trajectory([], 10.0, field=FIELD), "positive"),
        (lambda: trajectory([hold(0.1)], 10.0, field=FIELD), "fewer than two"),
        (lambda: trajectory([hold(60.0)], 1e9, field=FIELD), "more than"),
        (lambda: trajectory([hold(1.0)], 10.0, field=np.zeros(2)), "field"),
        (lambda: trajectory([hold(1.0)], 10.0, field=FIELD, gravity=-1.0), "gravity"),
    ],
)
def test_impossible_motions_are_refused(call, said):
    with pytest.raises(InvalidInputError, match=said):
        call()
