from __future__ import annotations

import pytest

from calib.errors import InvalidInputError
from calib.recording import Identity
from service.jobs.planning import PLAN_OPTIONS, checked_plan_options, identity_from_json, identity_to_json


def test_plan_options_are_those_of_composing_and_switches() -> None:
    assert set(PLAN_OPTIONS) >= {"keep_gyro_at_boot", "mark_calibrated", "adjust_level"}
    assert checked_plan_options({"keep_gyro_at_boot": True}) == {"keep_gyro_at_boot": True}
    with pytest.raises(InvalidInputError, match="keep_gyro_at_boot"):
        checked_plan_options({"keep_gyros": True})
    with pytest.raises(InvalidInputError, match="true or false"):
        checked_plan_options({"keep_gyro_at_boot": 1})


def test_identity_survives() -> None:
    identity = Identity("px4", 2, (1, 16, 0), "abc", 1, 1)
    assert identity_from_json(identity_to_json(identity)) == identity
    assert identity_from_json(identity_to_json(Identity())) == Identity()
