"""A mounting that the operator chose: taken where the movement does not show it, refused where it speaks against it."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware import body_from_sensor
from mavcal.calib.firmware.compose.plan import ComposeOptions, compose
from mavcal.calib.firmware.options import compose_options
from mavcal.calib.firmware.rotations import rotation_matrix
from mavcal.calib.recording import Sensor

BOTH = pytest.mark.parametrize(("autopilot", "name"), [("ardupilot", "COMPASS_ORIENT"), ("px4", "CAL_MAG0_ROT")])
YAW_270 = 6
AMBIGUOUS = {"verdict": "ambiguous", "name": "none", "matrix": np.eye(3).tolist()}


def found(autopilot, number, verdict="rotated"):
    return {"verdict": verdict, "name": "", "matrix": rotation_matrix(autopilot, number).tolist()}


@pytest.fixture
def planned(request, make_fit):
    def plan(autopilot, number, orientation, stated=0, **options):
        parameters = {**request.getfixturevalue(f"{autopilot}_parameters")}
        if autopilot == "px4":
            parameters["CAL_MAG0_ROT"] = stated
        else:
            parameters |= {"COMPASS_ORIENT": max(stated, 0), "COMPASS_EXTERNAL": int(stated >= 0)}
        quality = {"radius": 48.0, "field_ratio": 1.0}
        quality |= {} if orientation is None else {"orientation": orientation[0]}
        fit = make_fit(Sensor.MAG, 0, offset=[9.0, -5.5, 3.5], offset_sd=0.02, matrix_sd=5e-4, quality=quality)
        chosen = ComposeOptions(mountings={(Sensor.MAG, 0): number}, **options)
        fingerprint = request.getfixturevalue(f"{autopilot}_fingerprint")
        return compose([fit], parameters, fingerprint, options=chosen), parameters

    return plan


@BOTH
@pytest.mark.parametrize("orientation", [AMBIGUOUS, None], ids=["ambiguous", "not told"])
def test_what_the_movement_does_not_show_is_taken_as_chosen_and_confirmed(planned, autopilot, name, orientation):
    asked, _ = planned(autopilot, YAW_270, [orientation])
    (blocker,) = asked.blockers
    assert blocker.startswith("compass 1 is mounted as chosen (yaw 270): ")
    assert "confirm_mounting" in blocker
    plan, parameters = planned(autopilot, YAW_270, [orientation], confirm_mounting=True)
    assert not plan.blockers
    after = parameters | {c.name: c.new for c in plan.changes}
    assert after[name] == YAW_270
    np.testing.assert_allclose(
        body_from_sensor(autopilot, after, Sensor.MAG, 0), rotation_matrix(autopilot, YAW_270), atol=1e-9
    )
    assert any("nothing proves the chosen yaw 270" in text for text in plan.warnings)


@BOTH
def test_a_choice_is_of_the_mounting_and_not_of_what_is_missing(planned, autopilot, name):
    """Stated yaw 180, and the movement shows a turn of 90 deg against that: yaw 270 agrees."""
    plan, _ = planned(autopilot, YAW_270, [found(autopilot, 2)], stated=4, confirm_mounting=True)
    assert not plan.blockers
    assert {c.name: c.new for c in plan.changes}[name] == YAW_270
    assert not any("nothing proves" in text for text in plan.warnings)


@BOTH
def test_what_the_movement_speaks_against_is_not_written(planned, autopilot, name):
    plan, _ = planned(autopilot, 4, [found(autopilot, YAW_270)], confirm_mounting=True)
    (blocker,) = plan.blockers
    assert all(token in blocker for token in ("compass 1", "yaw 180", "90 deg"))
    (blocker,) = planned(autopilot, 4, [found(autopilot, 0, "as_stated")], confirm_mounting=True)[0].blockers
    assert all(token in blocker for token in ("compass 1", "yaw 180", "180 deg"))


@BOTH
def test_the_stated_mounting_can_be_chosen_and_changes_nothing(planned, autopilot, name):
    plan, _ = planned(autopilot, 4, [AMBIGUOUS], stated=4)
    assert not plan.blockers
    assert name not in {c.name for c in plan.changes}


@BOTH
def test_where_there_is_nothing_to_choose_the_plan_says_why(planned, autopilot, name):
    assert "follows" in planned(autopilot, YAW_270, [AMBIGUOUS], stated=-1)[0].blockers[0]
    assert "for granted" in planned(autopilot, YAW_270, None)[0].blockers[0]
    assert "no mounting rotation 99" in planned(autopilot, 99, [AMBIGUOUS])[0].blockers[0]


def test_a_choice_is_a_number_of_a_compass():
    assert compose_options({"mountings": {"mag1": 6}}).mountings == {(Sensor.MAG, 1): 6}
    for wrong in ({"gyro0": 6}, {"mag0": 1.5}, {"mag0": -1}, {"mag0": True}, [6]):
        with pytest.raises(InvalidInputError, match="option mountings of a plan"):
            compose_options({"mountings": wrong})
