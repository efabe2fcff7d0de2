from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.blind.missions import GRAVITY_N, OVERSAMPLING, MissionKind, World, make_mission

KINDS = tuple(MissionKind)


@pytest.fixture(scope="module", params=KINDS, ids=str)
def world(request) -> World:
    return make_mission(request.param, np.random.default_rng(11), duration=40.0)


def test_the_path_is_the_double_integral_of_the_specific_force(world):
    acceleration = world.attitude.apply(world.force) + GRAVITY_N
    velocity = world.velocity[0] + np.cumsum(acceleration[:-1], axis=0) * world.dt
    assert np.abs(velocity - world.velocity[1:]).max() < 0.02
    place = world.place[0] + np.cumsum(world.velocity[:-1], axis=0) * world.dt
    assert np.abs(place - world.place[1:]).max() < 0.02


def test_the_rates_turn_the_attitude(world):
    at = 20_000
    turned = world.attitude[at]
    for rate in 0.5 * (world.rate[at : at + 800] + world.rate[at + 1 : at + 801]):
        turned = turned * Rotation.from_rotvec(rate * world.dt)
    assert (turned.inv() * world.attitude[at + 800]).magnitude() < 2e-4


def test_no_jumps_and_nothing_that_no_vehicle_does(world):
    assert np.abs(np.diff(world.rate, axis=0)).max() < 0.3
    assert np.abs(world.rate).max() < 20.0
    assert np.abs(world.force).max() < 40.0
    assert np.linalg.norm(world.field, axis=1) == pytest.approx(np.linalg.norm(world.field_n))


def test_rotors_turn_below_half_the_log_rate_and_their_second_harmonic_does_not_in_the_air():
    world = make_mission(MissionKind.HOVER, np.random.default_rng(3), duration=30.0)
    assert world.rotor_hz.max() < 100.0
    assert 2.0 * np.median(world.rotor_hz) > 100.0


def test_a_seed_is_a_mission():
    a, b, c = (make_mission(MissionKind.FULL, np.random.default_rng(s), duration=20.0) for s in (5, 5, 6))
    assert np.array_equal(a.force, b.force)
    assert not np.allclose(a.force, c.force)
    assert len(a.t) == 20 * 200 * OVERSAMPLING
