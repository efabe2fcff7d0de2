"""The generator's vehicle of PX4's simulator against that simulator's formulas (AIRFRAME 4.2)."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.blind.airframe.cases import AirTier, drafted, make_air_label
from mavcal.calib.blind.airframe.forces import Forces
from mavcal.calib.blind.airframe.seen import see
from mavcal.calib.blind.airframe.sih import SIH_KINDS, draw_sih

OUTPUTS = (0.5, 0.4, 0.45, 0.55)


def test_force_and_moment_are_linear_in_output_velocity_and_rate():
    sih = draw_sih(np.random.default_rng(3))
    thrust, torque = sih.top_thrust, sih.top_thrust * sih.propeller.torque_arm
    speeds = [sih.drive.top * sih.drive.share_of_top(u) for u in OUTPUTS]
    v, w = np.array([3.0, -2.0, 1.0]), np.array([0.5, -0.4, 0.3])
    found = Forces(sih)(speeds, [0.0] * 4, tuple(v), tuple(w), 100.0)
    right, left, front_left, back_right = OUTPUTS  # front right, back left, front left, back right
    arm = sih.rotors[0].x
    roll = arm * thrust * (-right + left + front_left - back_right)
    pitch = arm * thrust * (right - left + front_left - back_right)
    yaw = torque * (right + left - front_left - back_right)
    damping = sih.hull.damping[0]
    np.testing.assert_allclose(found[:3], -sih.hull.pull * v - np.array([0.0, 0.0, thrust * sum(OUTPUTS)]))
    np.testing.assert_allclose(found[3:], np.array([roll, pitch, yaw]) - damping * w)


def test_a_lag_is_that_of_the_output_and_the_battery_does_not_matter():
    sih = draw_sih(np.random.default_rng(3))
    assert sih.battery.constant
    assert see(sih, 0.5).thrust == pytest.approx(see(sih, 1.0).thrust)
    assert see(sih).expo == pytest.approx(0.0, abs=1e-9)
    assert see(sih).rotor_drag == pytest.approx(sih.hull.pull / sih.hull.mass)
    assert see(sih).body_drag == pytest.approx(0.0, abs=1e-9)


def test_every_setting_is_drawn_and_knows_no_weather():
    labels = [make_air_label(AirTier.SIH, seed) for seed in range(80)]
    assert {label["effects"][0]["id"] for label in labels} == {kind.id for kind in SIH_KINDS}
    assert not any(label["differs"] for label in labels)
    assert {name for label in labels for name in label["effects"][0]["params"]} >= {"xy", "xz", "yz", "x", "y", "s"}


def test_a_product_of_inertia_is_the_share_that_the_label_says():
    for seed in range(200):
        pair = drafted(AirTier.SIH, seed)[1].pair
        hull = pair.real.vehicle.hull
        if hull.products[0]:
            assert pair.entries[0].params == {"xy": pytest.approx(hull.products[0] / hull.inertia[1])}
            return
    raise AssertionError("no case has a product of inertia xy")
