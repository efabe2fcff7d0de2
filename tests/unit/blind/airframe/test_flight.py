from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.blind.airframe.flight import LOOP_S, Events, LowPass, in_wake
from mavcal.calib.blind.airframe.seen import hover_command, see
from mavcal.calib.blind.airframe.vehicle import GRAVITY
from tests.unit.blind.airframe.flights import SHORT, flown_in_calm


def turned(flown):
    return Rotation.from_quat(flown.attitude[:, [1, 2, 3, 0]])


def test_it_takes_off_flies_as_asked_and_lands(flown):
    assert flown.grounded[0]
    assert flown.grounded[-1]
    assert flown.command[-1].max() == 0.0
    assert 2.5 < -flown.place[:, 2].min() < 6.0
    heading = np.array([np.cos(SHORT.heading), np.sin(SHORT.heading)])
    assert (flown.velocity[:, :2] @ heading).max() == pytest.approx(6.0, abs=1.0)
    tilt = np.degrees(turned(flown).magnitude())
    assert turned(flown).as_matrix()[:, 2, 2].min() > np.cos(np.radians(45.0))
    assert tilt[-1] == pytest.approx(np.degrees(SHORT.heading), abs=8.0)


def test_what_it_feels_moves_it(flown):
    felt = turned(flown).apply(flown.force) + np.array([0.0, 0.0, GRAVITY])
    left = flown.velocity - np.cumsum(felt, axis=0) * LOOP_S
    assert np.abs(np.diff(left[::40], axis=0)).max() < 0.02  # in a tenth of a second, the contact with the ground too


def test_its_rates_turn_it(flown):
    attitude = turned(flown)
    steps = (attitude[:-1].inv() * attitude[1:]).as_rotvec() / LOOP_S
    assert steps == pytest.approx(flown.rate[1:], abs=0.005)


def test_in_hover_it_feels_gravity_and_commands_what_carries_it(flown, vehicle):
    hover = (flown.t > 7.0) & (flown.t < 8.5)
    assert flown.force[hover].mean(axis=0) == pytest.approx([0.0, 0.0, -GRAVITY], abs=0.15)
    ratio = float(flown.voltage[hover].mean()) / vehicle.battery.full
    assert flown.command[hover].mean() == pytest.approx(hover_command(vehicle, ratio), rel=0.02)


def test_at_rest_it_feels_gravity_alone(flown):
    rest = flown.t < 0.9
    assert np.abs(flown.force[rest] - [0.0, 0.0, -GRAVITY]).max() < 1e-9
    assert np.abs(flown.felt_rate[rest]).max() == 0.0


def test_drag_is_what_the_accelerometer_sees_sideways(flown, vehicle):
    fast = np.abs(np.linalg.norm(flown.velocity[:, :2], axis=1)) > 3.0
    through = turned(flown).inv().apply(flown.velocity)
    seen = see(vehicle)
    columns = np.column_stack([through[fast, 0], through[fast, 0] * np.abs(through[fast, 0])])
    linear, square = np.linalg.lstsq(columns, -flown.force[fast, 0], rcond=None)[0]
    assert linear * 5.0 + square * 25.0 == pytest.approx(seen.rotor_drag * 5.0 + seen.body_drag * 25.0, rel=0.25)


def test_a_lost_mass_is_carried_by_less_throttle(vehicle):
    count = round(SHORT.longest / LOOP_S) + 1
    light = flown_in_calm(vehicle, events=Events(mass=np.full(count, 0.8)))
    hover = (light.t > 6.0) & (light.t < 7.0)
    thrust = (light.speeds[hover] ** 2).sum(axis=1).mean() * vehicle.propeller.thrust
    assert thrust == pytest.approx(0.8 * vehicle.weight, rel=0.03)


def test_a_held_output_repeats(vehicle):
    held = np.zeros(round(SHORT.longest / LOOP_S) + 1, dtype=bool)
    held[2800:2900] = True
    flown = flown_in_calm(vehicle, events=Events(held=held))
    speeds = flown.speeds[2870:2900]
    assert np.ptp(speeds, axis=0).max() < 0.5  # rad/s: motors have settled on the held command
    assert np.ptp(flown.command[2870:2900], axis=0).max() > 0.0


def test_a_wake_takes_thrust_only_where_it_sinks_into_it():
    assert in_wake((0.0, 0.0, -3.0), 0.2) == 1.0
    assert in_wake((0.0, 0.0, 3.0), 0.2) == pytest.approx(0.8)
    assert in_wake((9.0, 0.0, 3.0), 0.2) > 0.97


def test_the_filter_passes_what_stands_still_and_delays_the_rest():
    low = LowPass(40.0)
    out = [low.step((1.0, 0.0, -2.0), (0.0, 0.0, 0.0)) for _ in range(400)]
    assert out[-1] == pytest.approx((1.0, 0.0, -2.0))
    ramp = LowPass(40.0)
    late = [k - ramp.step((float(k), 0.0, 0.0), (0.0, 0.0, 0.0))[0] for k in range(400)][-1] * LOOP_S
    assert late == pytest.approx(np.sqrt(2.0) / (2.0 * np.pi * 40.0), rel=0.05)
