from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mavcal.calib.blind.airframe.body import Body, rotation_of
from mavcal.calib.blind.airframe.draw import draw_vehicle
from mavcal.calib.blind.airframe.forces import Forces
from mavcal.calib.blind.airframe.vehicle import GRAVITY, SEA_LEVEL

DT = 1.0 / 1200.0
NOTHING = (0.0,) * 6


def airborne() -> Body:
    body = Body.of(draw_vehicle(np.random.default_rng(3)), 0.4)
    body.place[2] = -1000.0
    return body


def test_standing_it_feels_the_ground_and_does_not_move():
    body = Body.of(draw_vehicle(np.random.default_rng(3)), 0.4)
    for _ in range(100):
        body.step(NOTHING, DT)
    assert body.force == pytest.approx((0.0, 0.0, -GRAVITY))
    assert body.velocity == [0.0, 0.0, 0.0]
    assert body.place == [0.0, 0.0, 0.0]
    assert math.atan2(body.rotation[1][0], body.rotation[0][0]) == pytest.approx(0.4)


def test_in_free_fall_it_feels_nothing_and_falls_as_a_stone():
    body = airborne()
    for _ in range(1200):
        body.step(NOTHING, DT)
    assert body.force == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    assert body.velocity == pytest.approx([0.0, 0.0, GRAVITY])
    assert body.place[2] + 1000.0 == pytest.approx(0.5 * GRAVITY)


def test_a_free_tumble_keeps_energy_and_angular_momentum():
    body = airborne()
    body.turn = (3.0, -2.0, 4.0)

    def state():
        inertia, turn = np.array(body.inertia), np.array(body.turn)
        return 0.5 * turn @ inertia @ turn, np.array(body.rotation) @ inertia @ turn

    energy, momentum = state()
    for _ in range(2400):
        body.step(NOTHING, DT)
    later, turned = state()
    assert later == pytest.approx(energy, rel=0.02)
    assert turned == pytest.approx(momentum, abs=0.02 * np.linalg.norm(momentum))


def test_a_constant_force_in_the_body_is_what_it_feels():
    body = airborne()
    push = 2.0 * body.mass
    for _ in range(600):
        body.step((push, 0.0, -GRAVITY * body.mass, 0.0, 0.0, 0.0), DT)
    assert body.force == pytest.approx((2.0, 0.0, -GRAVITY))
    assert math.hypot(*body.velocity[:2]) == pytest.approx(1.0)
    assert body.velocity[1] / body.velocity[0] == pytest.approx(math.tan(0.4))


def test_it_falls_no_faster_than_its_drag_lets_it():
    vehicle = draw_vehicle(np.random.default_rng(3))
    vehicle = replace(vehicle, hull=replace(vehicle.hull, centre=(0.0, 0.0, 0.0)))
    forces, body = Forces(vehicle), airborne()
    stopped = [0.0] * len(vehicle.rotors)
    for _ in range(24_000):
        body.step(forces(stopped, stopped, body.through((0.0, 0.0, 0.0)), body.turn, 1e3), DT)
    terminal = math.sqrt(2.0 * body.mass * GRAVITY / (SEA_LEVEL * vehicle.hull.area[2]))
    assert body.velocity[2] == pytest.approx(terminal, rel=1e-3)


def test_wind_is_felt_from_where_it_comes():
    body = airborne()
    body.grounded = False
    ahead, right, down = body.through((1.0, 0.0, 0.0))  # the air moves north, the nose points 0.4 rad east of it
    assert (ahead, right, down) == pytest.approx((-math.cos(0.4), math.sin(0.4), 0.0))


def test_rotations_are_those_of_their_quaternions():
    q = np.array([0.7, -0.3, 0.5, 0.2])
    w, x, y, z = q / np.linalg.norm(q)
    rotation = np.array(rotation_of(w, x, y, z))
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    axis = np.array([x, y, z])
    assert rotation @ axis == pytest.approx(axis)
    assert np.trace(rotation) == pytest.approx(4.0 * w * w - 1.0)
