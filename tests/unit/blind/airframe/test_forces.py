from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from mavcal.calib.blind.airframe.draw import draw_vehicle
from mavcal.calib.blind.airframe.forces import Forces
from mavcal.calib.blind.airframe.vehicle import FRAMES, GRAVITY, SEA_LEVEL, Hull, Rotor, Vehicle

FAR = 1e3
STILL = (0.0, 0.0, 0.0)


def vehicle(seed: int = 1) -> Vehicle:
    drawn = draw_vehicle(np.random.default_rng(seed))
    hull = replace(drawn.hull, centre=STILL, torque=STILL)
    return replace(drawn, hull=hull, ground=0.0)


def hover(v: Vehicle) -> list[float]:
    return [math.sqrt(v.weight / (len(v.rotors) * v.propeller.thrust))] * len(v.rotors)


def wrench(v: Vehicle, air=STILL, turn=STILL, h=FAR, speeds=None, gaining=None):
    speeds = hover(v) if speeds is None else speeds
    return Forces(v)(speeds, gaining or [0.0] * len(speeds), air, turn, h)


def test_thrust_in_hover_is_the_weight():
    v = vehicle()
    fx, fy, fz, mx, my, mz = wrench(v)
    assert (fx, fy) == (0.0, 0.0)
    assert fz == pytest.approx(-v.hull.mass * GRAVITY)
    assert (mx, my, mz) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


def test_drag_in_the_rotor_plane_is_linear_and_that_of_the_hull_quadratic():
    v = vehicle()
    speed = hover(v)[0]
    for velocity in (0.5, 3.0, -7.0):
        linear = len(v.rotors) * v.propeller.drag * speed * velocity
        square = 0.5 * SEA_LEVEL * v.hull.area[0] * velocity * abs(velocity)
        assert wrench(v, air=(velocity, 0.0, 0.0))[0] == pytest.approx(-linear - square)


def test_a_climb_loses_lift_and_a_descent_gains_it():
    v = replace(vehicle(), hull=replace(vehicle().hull, area=(0.0, 0.0, 0.0)))
    lost = len(v.rotors) * v.propeller.inflow * hover(v)[0] * 2.0
    assert wrench(v, air=(0.0, 0.0, -2.0))[2] == pytest.approx(-v.weight + lost)
    assert wrench(v, air=(0.0, 0.0, 2.0))[2] == pytest.approx(-v.weight - lost)


def test_level_flight_gains_what_momentum_theory_says():
    v = vehicle()
    v = replace(v, propeller=replace(v.propeller, lift=1.0))
    rotor = v.weight / len(v.rotors)
    disc = math.pi * v.propeller.radius**2
    still = math.sqrt(rotor / (2.0 * SEA_LEVEL * disc))
    for velocity in (1.0, 5.0, 12.0):
        # Glauert: thrust = 2 rho A v_i sqrt(V^2 + v_i^2)
        induced = brentq(lambda x, u=velocity: 2.0 * SEA_LEVEL * disc * x * math.hypot(u, x) - rotor, 0.0, 2.0 * still)
        gained = len(v.rotors) * v.propeller.inflow * hover(v)[0] * (still - induced)
        assert wrench(v, air=(velocity, 0.0, 0.0))[2] == pytest.approx(-v.weight - gained)


def test_near_the_ground_a_rotor_alone_has_cheeseman_and_bennetts_thrust():
    v = replace(vehicle(), ground=1.0)
    radius = v.propeller.radius
    for ratio in (0.6, 1.0, 3.0):
        expected = 1.0 / (1.0 - (1.0 / (4.0 * ratio)) ** 2)
        assert wrench(v, h=ratio * radius)[2] / -v.weight == pytest.approx(expected)
    assert wrench(v, h=10.0 * radius)[2] == pytest.approx(-v.weight)


@pytest.mark.parametrize("frame", FRAMES)
def test_rotors_turn_the_vehicle_where_they_should(frame):
    drawn = vehicle()
    v = replace(drawn, frame=frame, rotors=FRAMES[frame].rotors(0.3, 0.0))
    speed = math.sqrt(v.weight / (len(v.rotors) * v.propeller.thrust))
    for k, rotor in enumerate(v.rotors):
        alone = [speed if j == k else 0.0 for j in range(len(v.rotors))]
        thrust = v.propeller.thrust * speed**2
        _, _, _, mx, my, mz = wrench(v, speeds=alone)
        assert mx == pytest.approx(-rotor.y * thrust)  # on the right: rolls to the left
        assert my == pytest.approx(rotor.x * thrust)  # in front: raises the nose
        assert mz == pytest.approx(rotor.spin * v.propeller.torque_arm * thrust)
    assert sum(r.spin for r in v.rotors) == 0
    assert sum(r.x for r in v.rotors) == pytest.approx(0.0)
    assert sum(r.y * r.spin for r in v.rotors) == pytest.approx(0.0)


def test_a_rotor_that_gains_speed_turns_the_vehicle_against_itself():
    v = vehicle()
    v = replace(v, rotors=(Rotor(0.0, 0.0, 0.0, 1),))
    base = wrench(v, speeds=[300.0])[5]
    assert wrench(v, speeds=[300.0], gaining=[50.0])[5] - base == pytest.approx(50.0 * v.propeller.inertia)


def test_gyroscopic_moments_do_no_work():
    v = vehicle()
    v = replace(v, rotors=(Rotor(0.0, 0.0, 0.0, 1),), hull=replace(v.hull, damping=STILL))
    blade = replace(v.propeller, drag=0.0, flapping=0.0, inflow=0.0, torque_arm=0.0)
    turn = (1.0, -2.0, 0.7)
    moment = wrench(replace(v, propeller=blade), turn=turn, speeds=[400.0])[3:]
    assert np.linalg.norm(moment) > 0.0
    assert np.dot(moment, turn) == pytest.approx(0.0, abs=1e-12)
    # L of a rotor that turns counter-clockwise seen from above points up: the moment is its change, -w x L
    assert moment == pytest.approx(-np.cross(turn, (0.0, 0.0, -400.0 * blade.inertia)))


def test_leaned_thrust_pushes_and_an_askew_plate_pushes_sideways():
    v = vehicle()
    leaned = replace(v, rotors=tuple(replace(r, tilt=(0.02, -0.01)) for r in v.rotors))
    assert wrench(leaned)[:2] == pytest.approx((0.02 * v.weight, -0.01 * v.weight))
    bare: Hull = replace(v.hull, area=(0.0, 0.0, 0.0), plate=(math.pi / 4.0, 0.1))
    blade = replace(v.propeller, drag=0.0)
    fx, fy, *_ = wrench(replace(v, hull=bare, propeller=blade), air=(4.0, 0.0, 0.0))
    assert fx == pytest.approx(fy)
    assert math.hypot(fx, fy) == pytest.approx(0.5 * SEA_LEVEL * 0.1 * 8.0)
    assert fx < 0.0


def test_density_scales_every_force_of_the_air():
    v = vehicle()
    thin = replace(v, density=0.8)
    air, turn = (3.0, -2.0, 1.0), (0.3, 0.2, -0.4)
    still = replace(v, hull=replace(v.hull, damping=STILL))
    a = wrench(still, air, turn)
    b = Forces(replace(thin, hull=still.hull))(hover(v), [0.0] * len(v.rotors), air, turn, FAR)
    # All but the gyroscopic moment, which cancels for a balanced frame.
    assert np.array(b) == pytest.approx(0.8 * np.array(a))
