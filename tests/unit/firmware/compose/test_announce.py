"""Losses and refusals that both autopilots have in common, with what they cost."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.firmware import losses
from mavcal.calib.firmware.compose import announce
from mavcal.calib.firmware.compose.draft import Draft, Subject
from mavcal.calib.firmware.options import ComposeOptions
from mavcal.calib.firmware.plan import ParameterKind
from mavcal.calib.firmware.rotations import euler_matrix
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import ThermalPolynomial

ACCEL, GYRO, MAG = (Subject(s, 0) for s in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG))
G = 9.80665


@pytest.fixture
def draft():
    return Draft({}, ComposeOptions(), ParameterKind.INT32)


def lost(draft):
    return [(loss.what, loss.cost, loss.unit) for loss in draft.losses]


@pytest.mark.parametrize(
    ("sensor", "thermal", "usable"),
    [(Sensor.ACCEL, False, False), (Sensor.GYRO, True, False), (Sensor.GYRO, False, True)],
)
def test_an_open_offset_stays_only_where_the_others_hold_without_it(draft, make_fit, sensor, thermal, usable):
    about = Subject(sensor, 0)
    assert announce.offsets_usable(draft, about, make_fit(sensor), thermal=thermal) is True
    assert not draft.refused
    fit = make_fit(sensor, undetermined=("offset_x", "offset_z"), message="turn it.")
    assert announce.offsets_usable(draft, about, fit, thermal=thermal) is usable
    start = f"{about}: the offset of x, z is not determined"
    plan_says = draft.plan(None).warnings if usable else draft.refused[about]
    assert [text.startswith(start) and text.endswith("turn it.") for text in plan_says] == [True]


def test_scales_that_a_fit_assumed_must_be_those_in_force(draft, make_fit):
    fit = make_fit(Sensor.ACCEL, matrix=np.diag([1.01, 1.0, 1.0]))
    assert announce.scale_usable(draft, ACCEL, fit, np.array([1.01, 1.0, 1.0 + 0.9e-6])) is False
    assert not draft.refused
    assert announce.scale_usable(draft, ACCEL, fit, np.array([1.01, 1.0, 1.0 + 1.2e-6])) is False
    assert "this fit assumes scales of [1.01, 1.0, 1.0]" in draft.refused[ACCEL][0]


def test_scales_must_be_determined_to_be_written(draft, make_fit):
    fit = make_fit(Sensor.ACCEL, matrix_sd=1e-4)
    assert announce.scale_usable(draft, ACCEL, fit, np.ones(3)) is True
    cross = dataclasses.replace(fit, undetermined=("matrix_xy",))
    assert announce.scale_usable(draft, ACCEL, cross, np.ones(3)) is True
    assert not draft.refused
    open_one = make_fit(Sensor.ACCEL, matrix_sd=1e-4, undetermined=("matrix_xx", "matrix_zz"))
    assert announce.scale_usable(draft, ACCEL, open_one, np.ones(3)) is False
    assert draft.refused[ACCEL][0].startswith("accel 1: matrix_xx, matrix_zz are not determined")


def parts_of(make_fit, matrix):
    return losses.split(make_fit(Sensor.ACCEL, matrix=matrix))


def test_cross_terms_cost_what_they_turn_gravity_by(draft, make_fit):
    matrix = np.array([[1.0, 0.003, 0.0], [0.003, 1.0, 0.0], [0.0, 0.0, 1.0]])
    announce.lose_accel(draft, ACCEL, parts_of(make_fit, matrix), np.ones(3), np.eye(3))
    # along the eigenvector of 1 - 0.003 the relative error is the largest
    assert lost(draft) == [("cross terms", pytest.approx(G * 0.003 / 0.997), "m/s2")]
    assert "cross-axis terms (xy xz yz: 0.00300, 0.00000, 0.00000) cannot be stored" in draft.losses[0].text
    scaled = parts_of(make_fit, matrix + np.diag([0.0, 0.0, 0.002]))
    announce.lose_accel(draft, ACCEL, scaled, np.ones(3), np.eye(3))
    assert draft.losses[1].what == "scale and cross terms"
    assert "scales so near to 1 never reach PX4's memory" in draft.losses[1].text


@pytest.mark.parametrize(("sd", "said"), [(1e-4, "0.0295 ± 0.0010"), (3e-3, "at most 0.0")])
def test_what_stays_of_cross_terms_is_said_with_its_uncertainty(draft, make_fit, sd, said):
    matrix = np.array([[1.0, 0.003, 0.0], [0.003, 1.0, 0.0], [0.0, 0.0, 1.0]])
    parts = losses.split(make_fit(Sensor.ACCEL, matrix=matrix, matrix_sd=sd))
    announce.lose_accel(draft, ACCEL, parts, np.ones(3), np.eye(3))
    assert said in draft.losses[0].text
    if sd > 1e-3:  # as large as the terms: nothing of them need be real
        assert "they agree with zero" in draft.losses[0].text
        assert draft.losses[0].text.endswith("perhaps nothing")


def test_what_single_precision_costs_is_not_worth_a_word(draft, make_fit):
    for scale, told in ((1.0 + 0.9e-6, 0), (1.0 + 1.1e-6, 1)):
        announce.lose_accel(draft, ACCEL, parts_of(make_fit, np.diag([scale, 1, 1])), np.ones(3), np.eye(3))
        assert len(draft.losses) == told


@pytest.mark.parametrize("board", [0, 90])
def test_a_mounting_costs_twice_the_sine_of_half_its_angle(draft, make_fit, board):
    turn = euler_matrix(0.0, 1.5, board)
    announce.lose_accel(draft, ACCEL, parts_of(make_fit, turn), np.ones(3), euler_matrix(0, 0, board))
    assert lost(draft) == [("mounting", pytest.approx(2 * G * np.sin(np.radians(0.75))), "m/s2")]
    assert "turned by 1.500 deg in its mounting" in draft.losses[0].text
    announce.lose_accel(
        draft, ACCEL, parts_of(make_fit, euler_matrix(0, 0, board)), np.ones(3), euler_matrix(0, 0, board)
    )
    announce.lose_accel(draft, ACCEL, parts_of(make_fit, np.eye(3)), np.ones(3), euler_matrix(0, 0, board))
    assert len(draft.losses) == 1


def test_a_gyro_s_matrix_costs_its_largest_share_of_a_rate(draft, make_fit):
    announce.lose_gyro_matrix(draft, GYRO, make_fit(Sensor.GYRO))
    assert draft.losses == ()
    announce.lose_gyro_matrix(draft, GYRO, make_fit(Sensor.GYRO, matrix=np.diag([1.0, 0.8, 1.1])))
    assert lost(draft) == [("scale and misalignment", pytest.approx(0.25), "rad/s at 1 rad/s")]
    assert "up to 25.000 % of the rate stay" in draft.losses[0].text


def test_a_compass_that_is_askew_loses_what_the_new_rotation_leaves(draft, make_fit):
    straight = make_fit(Sensor.MAG)
    askew = make_fit(Sensor.MAG, matrix=euler_matrix(0, 0, 93))
    announce.lose_compass_mounting(draft, MAG, straight, np.eye(3), euler_matrix(0, 0, 90))
    assert draft.losses == ()  # a fit of lengths says nothing of a mounting
    announce.lose_compass_mounting(draft, MAG, askew, np.eye(3), euler_matrix(0, 0, 90))
    announce.lose_compass_mounting(draft, MAG, askew, euler_matrix(0, 0, -90), euler_matrix(0, 0, 3))
    assert lost(draft) == [("mounting", pytest.approx(3.0), "deg")]
    assert "mounted 3.00 deg askew" in draft.losses[0].text


def test_what_is_left_of_a_mounting_is_an_angle_between_directions_of_the_body(draft, make_fit):
    """The rotation of a fit is along the sensor's axes: one about its z axis is about y of the body it is rolled in."""
    askew = make_fit(Sensor.MAG, matrix=euler_matrix(0, 0, 30))
    rolled = euler_matrix(90, 0, 0)
    announce.lose_compass_mounting(draft, MAG, askew, rolled, rolled @ euler_matrix(0, 0, 30))
    assert draft.losses == ()
    announce.lose_compass_mounting(draft, MAG, askew, rolled, euler_matrix(0, 0, 30) @ rolled)
    assert draft.losses[0].cost == pytest.approx(42.1, abs=0.1)


@pytest.mark.parametrize(("about", "unit"), [(ACCEL, "m/s2"), (GYRO, "rad/s")])
def test_a_drift_that_is_not_written_costs_its_span(draft, make_fit, about, unit):
    # x goes from -0.3 to +0.4, y is a parabola of 10^2 and 40^2 at the ends and 0 between, z is constant
    curve = ThermalPolynomial(30.0, 20.0, 70.0, [[0.01, 0.0], [0.0, 1e-4], [0.0, 0.0]])
    announce.lose_drift(draft, about, make_fit(about.sensor, polynomial=curve), "of a reason")
    assert lost(draft) == [("temperature drift", pytest.approx(np.hypot(0.5, 0.16)), unit)]
    assert draft.dropped == {about: f"{about}: its drift is not written, because of a reason"}
    assert draft.losses[0].text == draft.dropped[about]
