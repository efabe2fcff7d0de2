"""What a review offers about the mounting of a compass."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.firmware.compose.plan import compose
from mavcal.calib.firmware.rotations import ROTATIONS, rotation_matrix
from mavcal.calib.recording import Sensor
from mavcal.calib.review.mountings import choices_of, mountings_of


@pytest.mark.parametrize("autopilot", sorted(ROTATIONS))
def test_every_rotation_is_offered_once_with_its_words(autopilot):
    choices = choices_of(autopilot)
    assert (choices[0].number, choices[0].text) == (0, "none")
    numbers = [choice.number for choice in choices]
    assert numbers == sorted(set(numbers))
    for number in range(len(ROTATIONS[autopilot])):
        same = [c for c in choices if np.allclose(c.matrix, rotation_matrix(autopilot, number), atol=1e-5)]
        assert len(same) == 1


def test_a_compass_with_a_rotation_of_its_own_can_be_chosen_for(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    looked = make_fit(Sensor.MAG, 0, offset=[1.0, 2.0, 3.0], quality={"orientation": None})
    taken = make_fit(Sensor.MAG, 0, offset=[1.0, 2.0, 3.0])
    plan = compose([taken], ardupilot_parameters, ardupilot_fingerprint)
    outside = ardupilot_parameters | {"COMPASS_EXTERNAL": 1, "COMPASS_ORIENT": 6}
    (one,) = mountings_of([looked], plan, outside, {"mountings": {"mag0": 4}})
    assert (one.instance, one.stated, one.stated_text, one.chosen) == (0, 6, "yaw 270", 4)
    assert mountings_of([looked], plan, outside, {})[0].chosen is None
    assert mountings_of([taken], plan, outside, {}) == ()  # the method took it for granted
    assert mountings_of([looked], plan, outside | {"COMPASS_EXTERNAL": 0}, {}) == ()  # it follows the board
