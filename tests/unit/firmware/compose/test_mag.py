from __future__ import annotations

import dataclasses
import lzma

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.firmware import names
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.compose.plan import ComposeOptions, compose
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.firmware.px4.parameters import without_row
from mavcal.calib.firmware.rotations import rotation_matrix
from mavcal.calib.logs.tlog import read_tlog
from mavcal.calib.mag.free_rotation import angle_between
from mavcal.calib.recording import Event, ParameterEntry, Sensor

SOFT = np.array([[1.06, 0.03, -0.02], [0.03, 0.95, 0.015], [-0.02, 0.015, 1.03]])
OFFSET = np.array([9.0, -5.5, 3.5])  # uT
KNOWN = {"radius": 48.0, "field_ratio": 1.0}


def after(plan, parameters):
    return {**parameters, **{c.name: c.new for c in plan.changes}}


def mag_fit(make_fit, instance=0, quality=None, **more):
    more = {"offset": OFFSET, "matrix": SOFT, "offset_sd": 0.02, "matrix_sd": 5e-4} | more
    return make_fit(Sensor.MAG, instance, quality=KNOWN if quality is None else quality, **more)


def test_ardupilot_adds_the_offset_in_mgauss_in_the_body(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    plan = compose([mag_fit(make_fit)], ardupilot_parameters, ardupilot_fingerprint)
    values = {c.name: c.new for c in plan.changes}
    assert [values[f"COMPASS_OFS_{a}"] for a in "XYZ"] == [-90.0, 55.0, -35.0]
    assert [values[f"COMPASS_ODI_{a}"] for a in "XYZ"] == pytest.approx([0.03, -0.02, 0.015], rel=1e-6)
    assert [values[f"COMPASS_DIA_{a}"] for a in "XYZ"] == pytest.approx([1.06, 0.95, 1.03], rel=1e-6)
    assert values["COMPASS_SCALE"] == 1.0
    assert not plan.losses
    assert not plan.blockers
    assert {c.name: c.sd for c in plan.changes}["COMPASS_OFS_X"] == pytest.approx(0.2)


@pytest.mark.parametrize("orientation", [2, 8, 14, 24])
def test_what_ardupilot_does_afterwards_is_what_was_fitted(
    ardupilot_parameters, ardupilot_fingerprint, make_fit, orientation
):
    parameters = ardupilot_parameters | {"COMPASS_ORIENT2": orientation, "COMPASS_SCALE2": 1.2, "COMPASS_DIA2_X": 1.1}
    fit = mag_fit(make_fit, 1)
    plan = compose([fit], parameters, ardupilot_fingerprint)
    model = ardupilot.calibration_in_force(after(plan, parameters), Sensor.MAG, 1)
    raw = np.random.default_rng(1).normal(0, 40, (50, 3))
    turn = rotation_matrix("ardupilot", orientation)
    np.testing.assert_allclose(model.apply(raw), fit.model.apply(raw) @ turn.T, atol=1e-4)


def test_a_compass_is_found_by_its_device_id_and_not_by_its_rank(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    swapped = ardupilot_parameters | {
        "COMPASS_PRIO1_ID": ardupilot_parameters["COMPASS_DEV_ID2"],
        "COMPASS_PRIO2_ID": ardupilot_parameters["COMPASS_DEV_ID"],
    }
    plan = compose([mag_fit(make_fit, 0)], swapped, ardupilot_fingerprint)
    assert {c.name for c in plan.changes if "OFS" in c.name} == {f"COMPASS_OFS2_{a}" for a in "XYZ"}


def test_an_unknown_field_leaves_the_scale_unset(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    quality = {"radius": 48.0, "field_ratio": None}
    plan = compose(
        [mag_fit(make_fit, quality=quality)], ardupilot_parameters | {"COMPASS_SCALE": 1.1}, ardupilot_fingerprint
    )
    assert {c.name: c.new for c in plan.changes}["COMPASS_SCALE"] == 0.0


def test_a_wrong_mounting_is_put_right_with_the_offsets_in_the_new_frame(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    turn = rotation_matrix("ardupilot", 2)  # yaw 90
    found = {"verdict": "rotated", "name": "yaw_90", "matrix": turn.tolist()}
    fit = mag_fit(make_fit, quality=KNOWN | {"orientation": found})
    plan = compose([fit], ardupilot_parameters, ardupilot_fingerprint)
    values = {c.name: c.new for c in plan.changes}
    assert values["COMPASS_ORIENT"] == 2
    model = ardupilot.calibration_in_force(after(plan, ardupilot_parameters), Sensor.MAG, 0)
    raw = np.random.default_rng(1).normal(0, 40, (50, 3))
    np.testing.assert_allclose(model.apply(raw), fit.model.apply(raw) @ turn.T, atol=1e-4)

    internal = compose([fit], ardupilot_parameters | {"COMPASS_EXTERNAL": 0}, ardupilot_fingerprint)
    assert "internal" in internal.blockers[0]
    unexplained = mag_fit(make_fit, quality=KNOWN | {"orientation": {**found, "verdict": "unexplained"}})
    assert compose([unexplained], ardupilot_parameters, ardupilot_fingerprint).blockers


def test_motor_compensation_is_carried_into_the_new_matrix(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    induced = np.array([4.0, -2.0, 3.0])  # mGauss per unit of throttle at the sensor
    old = np.diag([1.2, 0.9, 1.1])
    parameters = ardupilot_parameters | {"COMPASS_MOTCT": 1}
    parameters |= {f"COMPASS_DIA_{a}": d for a, d in zip("XYZ", np.diag(old), strict=True)}
    parameters |= {f"COMPASS_MOT_{a}": m for a, m in zip("XYZ", -old @ induced, strict=True)}
    plan = compose([mag_fit(make_fit)], parameters, ardupilot_fingerprint)
    values = after(plan, parameters)
    np.testing.assert_allclose([values[f"COMPASS_MOT_{a}"] for a in "XYZ"], -SOFT @ induced, rtol=1e-6)


@pytest.mark.parametrize("stated", [0, 2, 14, 28])
@pytest.mark.parametrize("internal", [False, True])
@pytest.mark.parametrize("scale", [0.0, 1.2, 9.0])
@pytest.mark.parametrize("turn", [0, 6])
def test_the_motor_term_is_carried_into_the_frame_of_the_new_mounting(
    ardupilot_parameters, ardupilot_fingerprint, make_fit, stated, internal, scale, turn
):
    """What the motors induce is a field at the sensor: the term takes it away before the write and after it."""
    if internal and turn:
        pytest.skip("an internal compass follows the board")
    name = "AHRS_ORIENTATION" if internal else "COMPASS_ORIENT"
    parameters = ardupilot_parameters | {"COMPASS_MOTCT": 1, "COMPASS_EXTERNAL": int(not internal), name: stated}
    parameters |= {f"COMPASS_DIA_{a}": d for a, d in zip("XYZ", (1.2, 0.9, 1.1), strict=True)}
    parameters |= {f"COMPASS_ODI_{a}": c for a, c in zip("XYZ", (0.05, -0.04, 0.02), strict=True)}
    parameters["COMPASS_SCALE"] = scale
    induced = np.array([4.0, -2.0, 3.0])  # mGauss per unit of throttle, along the axes of the sensor
    old = -ardupilot.calibration_in_force(parameters, Sensor.MAG, 0).matrix @ induced
    parameters |= {f"COMPASS_MOT_{a}": m for a, m in zip("XYZ", old, strict=True)}
    fit = turned(make_fit, rotation_matrix("ardupilot", turn)) if turn else mag_fit(make_fit)
    plan = compose([fit], parameters, ardupilot_fingerprint, options=CONFIRMED)
    assert not plan.blockers
    found = after(plan, parameters)
    new = -ardupilot.calibration_in_force(found, Sensor.MAG, 0).matrix @ induced
    np.testing.assert_allclose([found[f"COMPASS_MOT_{a}"] for a in "XYZ"], new, rtol=1e-5, atol=1e-6)
    assert np.abs(new - old).max() > 0.1


def test_code_76_for_compasses_and_learning_off(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    both = [mag_fit(make_fit, i) for i in (0, 1)]
    plan = compose(both, ardupilot_parameters | {"COMPASS_LEARN": 3}, ardupilot_fingerprint)
    assert [a.params for a in plan.after] == [(0, 76, 0, 0, 0, 0, 0)]
    assert (plan.changes[0].name, plan.changes[0].new) == ("COMPASS_LEARN", 0)
    one = compose(both[:1], ardupilot_parameters, ardupilot_fingerprint)
    assert one.after == ()
    assert any("compass 2 is in use" in text for text in one.warnings)


@pytest.mark.parametrize(
    ("more", "text"),
    [
        ({"offset": [150.0, 100.0, 50.0]}, "COMPASS_OFFS_MAX"),
        ({"matrix": 1.6 * np.eye(3)}, "times the Earth's field"),
        ({"undetermined": ("offset_z",)}, "not determined"),
    ],
)
def test_implausible_compasses_block(ardupilot_parameters, ardupilot_fingerprint, make_fit, more, text):
    plan = compose([mag_fit(make_fit, **more)], ardupilot_parameters, ardupilot_fingerprint)
    assert text in plan.blockers[0]


def test_px4_subtracts_the_offset_in_gauss_in_the_sensor_frame(px4_parameters, px4_fingerprint, make_fit):
    parameters = px4_parameters | {"SENS_BOARD_ROT": 2}
    fit = mag_fit(make_fit)
    plan = compose([fit], parameters, px4_fingerprint)
    values = {c.name: c.new for c in plan.changes}
    assert [values[f"CAL_MAG0_{a}OFF"] for a in "XYZ"] == pytest.approx([0.09, -0.055, 0.035], rel=1e-6)
    assert [values[f"CAL_MAG0_{a}ODIAG"] for a in "XYZ"] == pytest.approx([0.03, -0.02, 0.015], rel=1e-6)
    model = px4.calibration_in_force(after(plan, parameters), Sensor.MAG, 0)
    raw = np.random.default_rng(1).normal(0, 40, (50, 3))
    np.testing.assert_allclose(model.apply(raw), fit.model.apply(raw) @ rotation_matrix("px4", 2).T, atol=1e-4)
    assert not plan.losses
    (session,) = [c for c in plan.changes if c.session]
    assert (session.name, session.new) == ("SENS_MAG_AUTOCAL", 0)
    assert plan.changes[0] == session


def test_px4_values_near_neutral_are_announced_as_lost(px4_parameters, px4_fingerprint, make_fit):
    soft = np.array([[1.004, 0.003, 0], [0.003, 0.998, 0.002], [0, 0.002, 1.003]])
    fit = mag_fit(make_fit, offset=[0.3, 0.2, 0.1], matrix=soft)
    plan = compose([fit], px4_parameters, px4_fingerprint)
    assert not [c for c in plan.changes if "CAL_MAG" in c.name]
    model = px4.calibration_in_force(after(plan, px4_parameters), Sensor.MAG, 0)
    directions = np.random.default_rng(1).normal(size=(100_000, 3))
    truth = 48.0 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    left = model.apply(fit.model.invert(truth)) - truth
    cost = {loss.what: loss.cost for loss in plan.losses}
    spread = np.linalg.norm(left - left.mean(axis=0), axis=1).max()
    assert spread == pytest.approx(cost["scale and cross terms"], rel=2e-2)
    assert cost["offset"] == pytest.approx(np.linalg.norm([0.3, 0.2, 0.1]), rel=1e-6)


def test_a_wrong_mounting_on_px4(px4_parameters, px4_fingerprint, make_fit):
    found = {"verdict": "rotated", "name": "yaw_90", "matrix": rotation_matrix("px4", 2).tolist()}
    fit = mag_fit(make_fit, quality=KNOWN | {"orientation": found})
    plan = compose([fit], px4_parameters | {"CAL_MAG0_ROT": 4}, px4_fingerprint)
    assert {c.name: c.new for c in plan.changes}["CAL_MAG0_ROT"] == 6
    assert "internal" in compose([fit], px4_parameters, px4_fingerprint).blockers[0]


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize("quarter", [False, True])
def test_what_no_parameter_holds_of_the_mounting_is_lost_with_its_angle(request, make_fit, autopilot, quarter):
    """A fit that knows the rotation: 2 deg askew, and perhaps a quarter turn besides, which a parameter holds."""
    parameters = {**request.getfixturevalue(f"{autopilot}_parameters")}
    parameters |= {"COMPASS_ORIENT": 0, "COMPASS_EXTERNAL": 1} if autopilot == "ardupilot" else {"CAL_MAG0_ROT": 0}
    askew = Rotation.from_euler("Y", 2.0, degrees=True).as_matrix()
    turn = Rotation.from_euler("Z", 90.0, degrees=True).as_matrix().round() if quarter else np.eye(3)
    found = {"verdict": "rotated" if quarter else "as_stated", "name": "yaw_90", "matrix": turn.tolist()}
    fit = mag_fit(make_fit, matrix=askew @ turn @ SOFT, quality=KNOWN | {"orientation": found})
    options = ComposeOptions(confirm_mounting=True)
    plan = compose([fit], parameters, request.getfixturevalue(f"{autopilot}_fingerprint"), options=options)
    assert not plan.blockers
    (loss,) = (x for x in plan.losses if x.what == "mounting")
    assert (loss.cost, loss.unit) == (pytest.approx(2.0, abs=1e-6), "deg")
    rotation = {c.name for c in plan.changes} & {"COMPASS_ORIENT", "CAL_MAG0_ROT"}
    assert bool(rotation) == quarter


@pytest.mark.parametrize(("autopilot", "name"), [("ardupilot", "COMPASS_ORIENT"), ("px4", "CAL_MAG0_ROT")])
def test_another_mounting_is_said_in_words_and_confirmed_in_a_field_of_its_own(request, make_fit, autopilot, name):
    parameters = {**request.getfixturevalue(f"{autopilot}_parameters")}
    parameters |= {"COMPASS_ORIENT": 0, "COMPASS_EXTERNAL": 1} if autopilot == "ardupilot" else {"CAL_MAG0_ROT": 0}
    fingerprint = request.getfixturevalue(f"{autopilot}_fingerprint")
    found = {"verdict": "rotated", "name": "yaw_270", "matrix": rotation_matrix(autopilot, 6).tolist()}
    fit = mag_fit(make_fit, quality=KNOWN | {"orientation": found})
    (blocker,) = compose([fit], parameters, fingerprint).blockers
    assert blocker.startswith(f"compass 1 is mounted turned by yaw 270: {name} changes from 0 (none) to 6 (yaw 270).")
    assert "confirm_mounting (--confirm-mounting)" in blocker
    plan = compose([fit], parameters, fingerprint, options=ComposeOptions(confirm_mounting=True))
    assert not plan.blockers
    assert plan.warnings[0].startswith("compass 1 is mounted turned by yaw 270, as confirmed:")
    assert {c.name: c.new for c in plan.changes}[name] == 6


def test_a_rotation_that_is_stated_already_is_named_beside_the_one_that_was_found(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    found = {"verdict": "rotated", "name": "yaw_90", "matrix": rotation_matrix("ardupilot", 2).tolist()}
    fit = mag_fit(make_fit, quality=KNOWN | {"orientation": found})
    parameters = ardupilot_parameters | {"COMPASS_ORIENT": 4, "COMPASS_EXTERNAL": 1}
    (blocker,) = compose([fit], parameters, ardupilot_fingerprint).blockers
    tokens = ("compass 1", "COMPASS_ORIENT", "yaw 90 ", "4 (yaw", "yaw 180)", "6 (yaw", "yaw 270)")
    assert all(token in blocker for token in tokens)


@pytest.mark.parametrize("separated", [False, True])
def test_the_idle_current_is_compensated_twice_only_if_the_offset_holds_it(
    ardupilot_parameters, ardupilot_fingerprint, make_fit, separated
):
    parameters = ardupilot_parameters | {"COMPASS_MOTCT": 2, "COMPASS_MOT_X": 3.0}
    fit = mag_fit(make_fit, native={"without_motors": separated})
    warnings = compose([fit], parameters, ardupilot_fingerprint).warnings
    assert any("idle current" in text for text in warnings) != separated


@pytest.mark.parametrize(
    ("autopilot", "text"), [("ardupilot", "ArduPilot's offsets are in mGauss"), ("px4", "PX4's offsets are in Gauss")]
)
def test_counts_are_no_field_and_are_refused(request, make_fit, autopilot, text):
    parameters = request.getfixturevalue(f"{autopilot}_parameters")
    fit = dataclasses.replace(mag_fit(make_fit), unit="counts")
    plan = compose([fit], parameters, request.getfixturevalue(f"{autopilot}_fingerprint"))
    assert f"the fit is in counts; {text}" in plan.blockers[0]
    assert plan.changes == ()


@pytest.mark.parametrize(
    ("more", "text"),
    [
        ({"matrix": 1.6 * np.eye(3)}, "measures 0.62 times the Earth's field"),
        ({"matrix": 0.5 * np.eye(3)}, "measures 2.00 times the Earth's field"),
        ({"undetermined": ("offset_z",)}, "offset_z are not determined"),
    ],
)
def test_implausible_compasses_block_on_px4_too(px4_parameters, px4_fingerprint, make_fit, more, text):
    plan = compose([mag_fit(make_fit, **more)], px4_parameters, px4_fingerprint)
    assert text in plan.blockers[0]
    assert plan.changes == ()
    relative = mag_fit(make_fit, **more, quality={"radius": 48.0, "field_ratio": None})
    assert ("undetermined" in more) == bool(compose([relative], px4_parameters, px4_fingerprint).blockers)


@pytest.mark.parametrize("factor", [0.7, 1.3])
def test_a_strength_just_inside_the_window_is_written(px4_parameters, px4_fingerprint, make_fit, factor):
    plan = compose([mag_fit(make_fit, matrix=factor * np.eye(3))], px4_parameters, px4_fingerprint)
    assert not plan.blockers
    assert {c.name: c.new for c in plan.changes}["CAL_MAG0_XSCALE"] == pytest.approx(factor)


def turned(make_fit, matrix, name="yaw_90"):
    orientation = {"verdict": "rotated", "name": name, "matrix": matrix.tolist()}
    return mag_fit(make_fit, quality=KNOWN | {"orientation": orientation})


def test_px4_puts_an_external_compass_right_by_number_where_it_has_one(px4_parameters, px4_fingerprint, make_fit):
    fit = turned(make_fit, rotation_matrix("px4", 2))

    def composed(rotation, **more):
        parameters = px4_parameters | {"CAL_MAG0_ROT": rotation} | more
        return compose([fit], parameters, px4_fingerprint, options=CONFIRMED)

    assert {c.name: c.new for c in composed(0).changes}["CAL_MAG0_ROT"] == 2
    assert {c.name: c.new for c in composed(2).changes}["CAL_MAG0_ROT"] == 4
    plan = composed(-1)
    assert "internal and follows SENS_BOARD_ROT" in plan.blockers[0]
    assert plan.changes == ()
    # angles that stay beside a number would make it custom again: they go first
    changes = [(c.name, c.new) for c in composed(100, CAL_MAG0_YAW=45.0).changes if c.name in PX4_MOUNTING]
    assert changes == [("CAL_MAG0_YAW", 0.0), ("CAL_MAG0_ROT", 3)]


CONFIRMED = ComposeOptions(confirm_mounting=True)
ODD = Rotation.from_euler("ZYX", [29.0, -8.0, 3.0], degrees=True).as_matrix()
AP_MOUNTING = ["CUST_ROT_ENABLE", "CUST_ROT1_ROLL", "CUST_ROT1_PITCH", "CUST_ROT1_YAW", "COMPASS_ORIENT"]
PX4_MOUNTING = ["CAL_MAG0_ROT", "CAL_MAG0_ROLL", "CAL_MAG0_PITCH", "CAL_MAG0_YAW"]


def at_angles(make_fit, matrix=ODD, askew_deg=30.0, nearest="none", instance=0):
    found = {
        "verdict": "by_angles",
        "name": "roll 3.0 ± 0.3, pitch -8.0 ± 0.3, yaw 29.0 ± 0.3 deg",
        "matrix": matrix.tolist(),
        "covariance": (np.radians(0.3) ** 2 * np.eye(3)).tolist(),
        "nearest": nearest,
        "askew_deg": askew_deg,
    }
    return mag_fit(make_fit, instance, quality=KNOWN | {"orientation": found})


def custom(parameters, **more):
    """An ArduPilot with custom rotations that are switched off, so that their angles are not listed."""
    return parameters | {"COMPASS_EXTERNAL": 1, "COMPASS_EXTERN2": 1, "CUST_ROT_ENABLE": 0} | more


def mountings(plan, names):
    return [(c.name, c.new) for c in plan.changes if c.name in names]


def test_odd_angles_become_a_custom_rotation_of_ardupilot(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    parameters = custom(ardupilot_parameters)
    (blocker,) = compose([at_angles(make_fit)], parameters, ardupilot_fingerprint).blockers
    assert "COMPASS_ORIENT changes from 0 (none) to 101 (custom rotation 1: roll 3.0 ± 0.3, pitch" in blocker
    assert "confirm_mounting" in blocker
    plan = compose([at_angles(make_fit)], parameters, ardupilot_fingerprint, options=CONFIRMED)
    assert not plan.blockers
    assert plan.needs_reboot
    expected = zip(AP_MOUNTING, [1, 3.0, -8.0, 29.0, 101], strict=True)
    assert mountings(plan, AP_MOUNTING) == [(name, pytest.approx(value, abs=0.005)) for name, value in expected]
    assert all(0.25 < c.sd < 0.4 and c.unit == "deg" for c in plan.changes if c.name in AP_MOUNTING[1:4])
    model = ardupilot.calibration_in_force(after(plan, parameters), Sensor.MAG, 0)
    raw = np.random.default_rng(1).normal(0, 40, (50, 3))
    np.testing.assert_allclose(model.apply(raw), at_angles(make_fit).model.apply(raw) @ ODD.T, atol=0.01)
    assert not [loss for loss in plan.losses if loss.what == "mounting"]


@pytest.mark.parametrize("level", [(0.0, 0.0, 0.0), (2.0, -1.0, 1.5)])
@pytest.mark.parametrize(
    "stated", [{"CAL_MAG0_ROT": 0}, {"CAL_MAG0_ROT": 6}, {"CAL_MAG0_ROT": 100, "CAL_MAG0_ROLL": 40.0}]
)
def test_odd_angles_become_the_angles_of_px4s_row(px4_parameters, px4_fingerprint, make_fit, level, stated):
    parameters = px4_parameters | dict(zip(names.PX4_LEVEL, level, strict=True)) | stated
    before = px4.mounting(parameters, Sensor.MAG, 0)
    plan = compose([at_angles(make_fit)], parameters, px4_fingerprint, options=CONFIRMED)
    assert not plan.blockers
    found = after(plan, parameters)
    assert found["CAL_MAG0_ROT"] == 100
    assert angle_between(px4.mounting(found, Sensor.MAG, 0), ODD @ before) < np.radians(0.01)
    assert not [loss for loss in plan.losses if loss.what == "mounting"]
    written = [name for name, _ in mountings(plan, PX4_MOUNTING)]
    assert written == PX4_MOUNTING[written[0] != "CAL_MAG0_ROT" :]  # the number first, or angles make it custom


def test_a_fitted_angle_near_a_number_of_the_firmware_is_that_number(
    ardupilot_parameters, ardupilot_fingerprint, px4_parameters, px4_fingerprint, make_fit
):
    about = at_angles(make_fit, Rotation.from_euler("ZYX", [46.0, 1.0, -1.0], degrees=True).as_matrix(), 44.0)
    parameters = custom(ardupilot_parameters)
    plan = compose([about], parameters, ardupilot_fingerprint, options=CONFIRMED)
    assert mountings(plan, AP_MOUNTING) == [("COMPASS_ORIENT", 1)]
    np.testing.assert_allclose(
        ardupilot.mounting(after(plan, parameters), Sensor.MAG, 0), rotation_matrix("ardupilot", 1), atol=1e-12
    )
    (loss,) = (x for x in plan.losses if x.what == "mounting")
    assert loss.cost == pytest.approx(np.sqrt(3.0), abs=0.05)
    px4_plan = compose([about], px4_parameters | {"CAL_MAG0_ROT": 0}, px4_fingerprint, options=CONFIRMED)
    assert mountings(px4_plan, PX4_MOUNTING) == [("CAL_MAG0_ROT", 1)]


@pytest.mark.parametrize(
    ("more", "number"),
    [
        ({}, 101),
        ({"AHRS_ORIENTATION": 101, "CUST_ROT1_YAW": 9.0}, 102),
        ({"COMPASS_ORIENT2": 101, "CUST_ROT1_YAW": 9.0}, 102),
        ({"COMPASS_ORIENT": 102, "CUST_ROT2_YAW": 9.0, "CUST_ROT1_YAW": 9.0}, 102),
        ({"CUST_ROT1_PITCH": 9.0}, 102),
        ({"CUST_ROT1_PITCH": 9.0, "CUST_ROT2_ROLL": 9.0}, None),
        ({"COMPASS_ORIENT2": 101, "AHRS_ORIENTATION": 102}, None),
        ({"COMPASS_ORIENT": 101, "COMPASS_ORIENT2": 101, "CUST_ROT1_YAW": 9.0}, 102),
    ],
)
def test_a_custom_rotation_that_something_else_uses_is_left_alone(
    ardupilot_parameters, ardupilot_fingerprint, make_fit, more, number
):
    angles = {f"CUST_ROT{k}_{a}": 0.0 for k in (1, 2) for a in ("ROLL", "PITCH", "YAW")}
    parameters = custom(ardupilot_parameters, **angles, CUST_ROT_ENABLE=1)
    parameters |= more
    plan = compose([at_angles(make_fit)], parameters, ardupilot_fingerprint, options=CONFIRMED)
    if number is None:
        assert "hold angles already" in plan.blockers[0]
        assert plan.changes == ()
        return
    assert not plan.blockers
    assert after(plan, parameters)["COMPASS_ORIENT"] == number
    other = {101: "CUST_ROT2", 102: "CUST_ROT1"}[number]
    assert not [c for c in plan.changes if c.name.startswith(other)]


def test_a_right_angle_is_exact_and_turns_the_angles_that_are_stated(
    ardupilot_parameters, ardupilot_fingerprint, px4_parameters, px4_fingerprint, make_fit
):
    """134 degrees is a degree from a number of the firmware; a compass that is stated at 44 is not at 135 by a turn."""
    fit = turned(make_fit, rotation_matrix("px4", 2))
    held = {"CUST_ROT_ENABLE": 1, "CUST_ROT1_ROLL": 0.0, "CUST_ROT1_PITCH": 0.0, "CUST_ROT1_YAW": 44.0}
    now = custom(ardupilot_parameters, **held, COMPASS_ORIENT=101)
    plan = compose([fit], now, ardupilot_fingerprint, options=CONFIRMED)
    assert mountings(plan, AP_MOUNTING) == [("CUST_ROT1_YAW", pytest.approx(134.0))]
    row = px4_parameters | {"CAL_MAG0_ROT": 100, "CAL_MAG0_YAW": 44.0}
    plan = compose([fit], row, px4_fingerprint, options=CONFIRMED)
    assert mountings(plan, PX4_MOUNTING) == [("CAL_MAG0_YAW", pytest.approx(134.0))]


def test_only_new_angles_wait_for_a_restart(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    """A rotation that was made at boot acts as soon as it is called by its number; its angles do not change before."""
    held = {"CUST_ROT_ENABLE": 1, "CUST_ROT2_YAW": 0.0, "CUST_ROT2_ROLL": 0.0, "CUST_ROT2_PITCH": 0.0}
    held |= {"CUST_ROT1_ROLL": 3.0, "CUST_ROT1_PITCH": -8.0, "CUST_ROT1_YAW": 29.0, "COMPASS_ORIENT": 101}
    now = custom(ardupilot_parameters, **held)
    fit = at_angles(make_fit, Rotation.from_euler("Z", 12.0, degrees=True).as_matrix(), 12.0)
    plan = compose([fit], now, ardupilot_fingerprint, options=CONFIRMED)
    late = {c.name for c in plan.changes if c.needs_reboot}
    assert late == {c.name for c in plan.changes if c.name.startswith("CUST_ROT1_")}
    assert late
    first = compose([at_angles(make_fit)], custom(ardupilot_parameters), ardupilot_fingerprint, options=CONFIRMED)
    assert {c.name for c in first.changes if c.needs_reboot} == set(AP_MOUNTING[:4])


def test_two_compasses_at_odd_angles_have_a_custom_rotation_each(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    fits = [at_angles(make_fit), at_angles(make_fit, ODD.T, instance=1)]
    parameters = custom(ardupilot_parameters)
    plan = compose(fits, parameters, ardupilot_fingerprint, options=CONFIRMED)
    assert not plan.blockers
    found = after(plan, parameters)
    for k, matrix in enumerate((ODD, ODD.T)):
        assert angle_between(ardupilot.mounting(found, Sensor.MAG, k), matrix) < np.radians(0.01)


def test_an_ardupilot_without_custom_rotations_says_so(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    known = {name: v for name, v in custom(ardupilot_parameters).items() if not name.startswith("CUST_ROT")}
    plan = compose([at_angles(make_fit)], known, ardupilot_fingerprint, options=CONFIRMED)
    assert "this vehicle has no CUST_ROT_ENABLE (ArduPilot 4.3 and later)" in plan.blockers[0]
    assert len(plan.blockers) == 1
    assert plan.changes == ()
    assert plan.losses == ()  # what is not written costs nothing


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize("internal", [True, False])
def test_a_compass_that_is_little_askew_may_stay_and_its_angles_are_offered(request, make_fit, autopilot, internal):
    parameters = {**request.getfixturevalue(f"{autopilot}_parameters")}
    stated = {"ardupilot": {"COMPASS_EXTERNAL": int(not internal)}, "px4": {"CAL_MAG0_ROT": -1 if internal else 0}}
    parameters |= {"CUST_ROT_ENABLE": 0} | stated[autopilot] if autopilot == "ardupilot" else stated[autopilot]
    matrix = Rotation.from_euler("Y", 12.0, degrees=True).as_matrix()
    fingerprint = request.getfixturevalue(f"{autopilot}_fingerprint")
    fit = at_angles(make_fit, matrix, 12.0)
    plan = compose([fit], parameters, fingerprint)
    assert not plan.blockers
    assert not mountings(plan, [*AP_MOUNTING, *PX4_MOUNTING])
    (loss,) = (x for x in plan.losses if x.what == "mounting")
    assert loss.cost == pytest.approx(12.0, abs=1e-6)
    offered = any("(--confirm-mounting) writes these angles" in text for text in plan.warnings)
    follows = any("it has no angles of its own" in text for text in plan.warnings)
    assert (offered, follows) == (not internal, internal)
    confirmed = compose([fit], parameters, fingerprint, options=CONFIRMED)
    assert not confirmed.blockers
    assert bool(mountings(confirmed, [*AP_MOUNTING, *PX4_MOUNTING])) == (not internal)
    beyond = compose([at_angles(make_fit, askew_deg=30.0)], parameters, fingerprint)
    assert ("internal" if internal else "confirm_mounting") in beyond.blockers[0]
    quarter = compose([at_angles(make_fit, matrix, 12.0, "yaw_90")], parameters, fingerprint)
    assert quarter.blockers


def test_a_mirrored_compass_is_never_planned(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    orientation = {"verdict": "mirrored", "message": "its z axis reads with the wrong sign"}
    fit = mag_fit(make_fit, quality=KNOWN | {"orientation": orientation})
    plan = compose([fit], ardupilot_parameters, ardupilot_fingerprint, options=CONFIRMED)
    assert "its z axis reads with the wrong sign" in plan.blockers[0]
    assert plan.changes == ()


def test_a_mounting_that_could_not_be_told_is_a_warning_and_changes_nothing(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    orientation = {"verdict": "ambiguous", "name": "none", "matrix": np.eye(3).tolist()}
    plan = compose(
        [mag_fit(make_fit, quality=KNOWN | {"orientation": orientation})], ardupilot_parameters, ardupilot_fingerprint
    )
    assert any("does not show whether it is mounted as stated" in text for text in plan.warnings)
    assert not [c for c in plan.changes if "ORIENT" in c.name]
    assert not plan.blockers


def test_motor_compensation_turns_with_the_compass(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    turn = rotation_matrix("ardupilot", 2)
    motors = {"COMPASS_MOTCT": 2, "COMPASS_MOT_X": 3.0, "COMPASS_MOT_Y": -2.0, "COMPASS_MOT_Z": 1.0}
    parameters = ardupilot_parameters | motors
    options = ComposeOptions(confirm_mounting=True)
    plan = compose([turned(make_fit, turn)], parameters, ardupilot_fingerprint, options=options)
    values = after(plan, parameters)
    expected = turn @ SOFT @ np.array([3.0, -2.0, 1.0])
    np.testing.assert_allclose([values[f"COMPASS_MOT_{a}"] for a in "XYZ"], expected, rtol=1e-5)


def test_compasses_are_not_marked_as_calibrated_against_the_operators_word(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    both = [mag_fit(make_fit, i) for i in (0, 1)]
    plan = compose(both, ardupilot_parameters, ardupilot_fingerprint, options=ComposeOptions(mark_calibrated=False))
    assert plan.changes
    assert plan.after == ()
    assert not any("code 76" in text for text in plan.warnings)


def test_a_compass_without_a_row_keeps_no_other_from_its_calibration(px4_parameters, px4_fingerprint, make_fit):
    fits = [mag_fit(make_fit, 3), mag_fit(make_fit, 0)]
    plan = compose(fits, px4_parameters, px4_fingerprint)
    assert plan.blockers == ()
    assert {"CAL_MAG0_XOFF", "CAL_MAG0_YOFF"} <= {c.name for c in plan.changes}
    assert not any(c.name.startswith("CAL_MAG3") for c in plan.changes)


@pytest.mark.parametrize(("limit", "blocked"), [(1800.0, False), (1799.9, True)])
def test_an_offset_as_long_as_ardupilot_allows_is_written(
    ardupilot_parameters, ardupilot_fingerprint, make_fit, limit, blocked
):
    """ArduPilot refuses to arm beyond COMPASS_OFFS_MAX, and not at it."""
    fit = mag_fit(make_fit, offset=[0.0, 180.0, 0.0], matrix=np.eye(3))
    plan = compose([fit], ardupilot_parameters | {"COMPASS_OFFS_MAX": limit}, ardupilot_fingerprint)
    assert bool(plan.blockers) is blocked


@pytest.mark.parametrize("known", [{"radius": 24.0, "field_ratio": 0.96}, {"radius": 25.0, "field_ratio": 1.0}])
def test_what_px4_drops_costs_its_share_of_the_field_and_of_50_ut_where_none_is_known(
    px4_parameters, px4_fingerprint, make_fit, known
):
    def cost(quality):
        fit = mag_fit(make_fit, quality=quality, matrix=np.diag([1.004, 0.997, 1.0]))
        (loss,) = compose([fit], px4_parameters, px4_fingerprint).losses
        return loss.cost

    assert cost(known) == pytest.approx(0.5 * cost({}))  # a field of 25 uT
    assert cost({}) == pytest.approx(0.004 * 50.0, rel=0.01)


STALE = {"CAL_MAG0_ID": 197388, "CAL_MAG1_ID": 197644}
SECOND = frozenset({(Sensor.MAG, 1)})


def test_a_row_that_px4_says_is_not_this_compass_is_not_written(px4_parameters, px4_fingerprint, make_fit):
    """A second compass on UAVCAN, and in the second row the id of one that was taken away."""
    parameters = px4_parameters | STALE
    fits = [mag_fit(make_fit, i) for i in (0, 1)]
    plan = compose(fits, parameters, px4_fingerprint, options=ComposeOptions(without_row=SECOND))
    assert not any(c.name.startswith("CAL_MAG") for c in plan.changes)
    first, second = plan.left_out
    assert (first.sensor, first.instance, second.instance) == (Sensor.MAG, 0, 1)
    assert "2 rows hold ids" in first.reason
    assert "CAL_MAG1_ID = 197644 is the id of another sensor" in second.reason
    assert "--device-ids" in second.reason

    known = ComposeOptions(without_row=SECOND, device_ids={(Sensor.MAG, 0): 197388})
    plan = compose(fits, parameters, px4_fingerprint, options=known)
    written = {c.name[:8] for c in plan.changes if c.name.startswith("CAL_MAG")}
    assert written == {"CAL_MAG0"}
    assert [out.instance for out in plan.left_out] == [1]

    wrong = ComposeOptions(without_row=SECOND, device_ids={(Sensor.MAG, 1): 197644})
    plan = compose(fits, parameters, px4_fingerprint, options=wrong)
    assert "PX4 says that mag 2 is in none of its rows, but 197644 is in CAL_MAG1_ID" in plan.blockers


def test_a_compass_whose_id_is_told_has_that_row_or_a_free_one(px4_parameters, px4_fingerprint, make_fit):
    parameters = px4_parameters | STALE | {"CAL_MAG1_ROT": 6, "CAL_MAG1_XOFF": 0.3}
    confirmed = KNOWN | {"orientation": {"verdict": "as_stated", "name": "none", "matrix": np.eye(3).tolist()}}
    fits = [mag_fit(make_fit, i, quality=confirmed, offset=OFFSET * (i + 1)) for i in (0, 1)]
    first, second = (Sensor.MAG, 0), (Sensor.MAG, 1)
    told = ComposeOptions(without_row=SECOND, device_ids={first: 197388, second: 8944899})
    plan = compose(fits, parameters, px4_fingerprint, options=told)
    assert (plan.blockers, plan.left_out) == ((), ())
    values = {c.name: c.new for c in plan.changes}
    assert {name[:8] for name in values if name.startswith("CAL_MAG")} == {"CAL_MAG0", "CAL_MAG2"}
    assert [values[f"CAL_MAG2_{a}OFF"] for a in "XYZ"] == pytest.approx(OFFSET * 2 / 100)
    assert (plan.changes[-1].name, plan.changes[-1].new, plan.changes[-1].instance) == ("CAL_MAG2_ID", 8944899, 1)
    assert values["CAL_MAG2_ROT"] == 6  # the capture turned it as the row by order says
    assert not plan.needs_reboot

    stored = after(plan, parameters)  # and again: it agrees with its own row, not with the one by order
    plan = compose(fits, stored, px4_fingerprint, options=dataclasses.replace(told, without_row=frozenset()))
    assert not plan.changes
    assert [(a.sensor, a.instance) for a in plan.agreements] == [first, second]

    gone = ComposeOptions(device_ids={first: 197644})  # the one of the first row was taken away
    plan = compose([fits[0]], px4_parameters | STALE, px4_fingerprint, options=gone)
    assert {c.name[:8] for c in plan.changes if c.name.startswith("CAL_MAG")} == {"CAL_MAG1"}


def test_what_cannot_be_of_a_told_id_is_refused(px4_parameters, px4_fingerprint, make_fit):
    both = ComposeOptions(device_ids={(Sensor.MAG, i): 5 for i in (0, 1)})
    fits = [mag_fit(make_fit, i) for i in (0, 1)]
    blockers = compose(fits, px4_parameters | STALE, px4_fingerprint, options=both).blockers
    assert any("mag 1" in text and "mag 2" in text and text.endswith("id 5") for text in blockers)
    full = px4_parameters | {f"CAL_MAG{slot}_ID": slot + 1 for slot in range(4)}
    new = ComposeOptions(device_ids={(Sensor.MAG, 1): 9})
    (text,) = compose([fits[1]], full, px4_fingerprint, options=new).blockers
    assert all(f"CAL_MAG{slot}_ID" in text for slot in range(4))
    assert " 9: set" in text
    held = px4_parameters | {"CAL_GYRO0_ID": 7}  # its values were taken out of the samples
    gyro = make_fit(Sensor.GYRO, offset=[0.0132, -0.0284, 0.0057])
    (text,) = compose([gyro], held, px4_fingerprint, options=ComposeOptions(device_ids={(Sensor.GYRO, 0): 8})).blockers
    assert "CAL_GYRO0_ID to" in text


def test_rows_by_order_are_said_to_be_a_guess_that_no_stream_shows(px4_parameters, px4_fingerprint, make_fit):
    plan = compose([mag_fit(make_fit, 1)], px4_parameters | STALE, px4_fingerprint)
    assert any("no stream shows whether that is right" in text for text in plan.warnings)
    assert not any("physical check will tell" in text for text in plan.warnings)
    assert plan.left_out == ()


def test_what_px4_said_before_it_filled_a_row_counts_no_more():
    said = [Event(1.0, "text", "Preflight Fail: Gyro 0 uncalibrated"), Event(5.0, "text", "Compass 1 uncalibrated")]
    read = [ParameterEntry(0.5, "CAL_GYRO0_ID", 0), ParameterEntry(3.0, "CAL_GYRO0_ID", 1310988)]
    assert without_row(said, read) == SECOND
    assert without_row(said, read[:1]) == SECOND | {(Sensor.GYRO, 0)}


@pytest.mark.shared
def test_px4_itself_said_that_a_recorded_compass_had_no_row(shared_data):
    path = shared_data / "firmware_runs" / "px4_mag_external_second_row.tlog.xz"
    if not path.exists():
        pytest.skip("the recording is not there")
    recording = read_tlog(lzma.decompress(path.read_bytes()), system=1)
    assert without_row(recording.events) == SECOND
