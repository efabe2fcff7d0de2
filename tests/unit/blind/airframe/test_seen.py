from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mavcal.calib.blind.airframe.draw import draw_vehicle
from mavcal.calib.blind.airframe.forces import Forces
from mavcal.calib.blind.airframe.seen import hover_command, hover_ratio, see, speed_of
from mavcal.calib.blind.airframe.vehicle import GRAVITY, SEA_LEVEL, Vehicle


def plain(seed: int = 2) -> Vehicle:
    """Without cross terms, so that textbook formulas hold."""
    drawn = draw_vehicle(np.random.default_rng(seed))
    hull = replace(drawn.hull, products=(0.0, 0.0, 0.0), centre=(0.0, 0.0, 0.0))
    rotors = tuple(replace(r, z=0.0) for r in drawn.rotors)
    return replace(drawn, hull=hull, rotors=rotors, propeller=replace(drawn.propeller, flapping=0.0))


def hover_speed(v: Vehicle) -> float:
    return math.sqrt(v.weight / (len(v.rotors) * v.propeller.thrust))


def test_hover_is_where_the_weight_is_carried():
    v = plain()
    ratio = hover_ratio(v)
    assert 0.8 < ratio < 1.0
    assert speed_of(v, hover_command(v, ratio), ratio) == pytest.approx(hover_speed(v))


def test_the_curve_is_that_of_the_drive_at_the_hover_voltage():
    v = plain()
    found = see(v)
    full = len(v.rotors) * v.top_thrust / v.hull.mass
    assert found.thrust == pytest.approx(full * hover_ratio(v) ** v.drive.exponent)
    assert found.expo == pytest.approx(v.drive.expo)


def test_drag_and_inflow_are_the_derivatives_of_textbooks():
    v, found = plain(), see(plain())
    count, mass, blade = len(v.rotors), v.hull.mass, v.propeller
    assert found.rotor_drag == pytest.approx(count * blade.drag * hover_speed(v) / mass, rel=0.01)
    square = 0.5 * SEA_LEVEL * (v.hull.area[0] + v.hull.area[1]) / 2.0 / mass
    assert found.body_drag == pytest.approx(square, rel=0.03)
    assert found.inflow == pytest.approx(count * blade.inflow * hover_speed(v) / mass, rel=1e-3)
    assert found.lift > 0.0


def test_damping_is_what_rotors_do_that_move_with_their_arms():
    v, found = plain(), see(plain())
    speed, blade, inertia = hover_speed(v), v.propeller, v.hull.inertia
    x = v.hull.damping[0] + sum(blade.inflow * speed * r.y**2 for r in v.rotors)
    z = v.hull.damping[2] + sum(blade.drag * speed * (r.x**2 + r.y**2) for r in v.rotors)
    assert found.damping[0] == pytest.approx(x / inertia[0])
    assert found.damping[2] == pytest.approx(z / inertia[2])


def test_levers_are_inertia_over_mass_and_arm():
    v, found = plain(), see(plain())
    factors = [-r.y for r in v.rotors]
    pattern = [0.5 * f / max(map(abs, factors)) for f in factors]
    roll = sum(-r.y * f for r, f in zip(v.rotors, pattern, strict=True))
    assert found.lever[0] == pytest.approx(v.hull.inertia[0] * len(v.rotors) / (v.hull.mass * roll), rel=1e-3)
    yaw = 0.5 * v.propeller.torque_arm * v.hull.mass / v.hull.inertia[2]
    assert found.yaw == pytest.approx(yaw, rel=1e-3)


def test_trim_is_the_moment_of_a_shifted_centre():
    v = plain()
    shifted = replace(v, hull=replace(v.hull, centre=(0.01, -0.02, 0.0)))
    trim = see(shifted).trim
    assert trim[0] == pytest.approx(-0.02 * v.weight / v.hull.inertia[0])  # motors right of it: rolls left
    assert trim[1] == pytest.approx(-0.01 * v.weight / v.hull.inertia[1])
    assert Forces(v)([0.0] * 4, [0.0] * 4, (0.0,) * 3, (0.0,) * 3, 1e3) == pytest.approx((0.0,) * 6)
    assert see(v).trim == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert v.weight == pytest.approx(v.hull.mass * GRAVITY)
