from __future__ import annotations

import re

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.rotations import ROTATIONS, euler_matrix, nearest_rotation, rotation_matrix, rotation_words


@pytest.mark.parametrize(
    ("number", "turned"),
    [
        (0, [1, 2, 3]),
        (2, [-2, 1, 3]),  # yaw 90
        (8, [1, -2, -3]),  # roll 180
        (12, [-1, 2, -3]),  # pitch 180
        (16, [1, -3, 2]),  # roll 90
        (24, [3, 2, -1]),  # pitch 90
        (28, [2, -3, -1]),  # roll 90, then pitch 90
        (36, [3, -1, -2]),  # roll 90, pitch 180, yaw 90
    ],
)
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_literal_numbers(autopilot: str, number: int, turned: list[float]) -> None:
    assert (rotation_matrix(autopilot, number) @ [1, 2, 3]).tolist() == turned  # right angles are exact


def test_the_odd_one_is_ardupilots_matrix() -> None:
    first_row, last_row = [0.14303897, 0.36877649, -0.91844638], [-0.93232380, 0.36162457, 0.0]
    matrix = rotation_matrix("ardupilot", 38)
    assert matrix[0] == pytest.approx(first_row, abs=1e-8)
    assert matrix[2] == pytest.approx(last_row, abs=1e-8)
    assert not np.allclose(matrix, rotation_matrix("px4", 38), atol=1e-3)


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_the_table_is_mavlinks(autopilot: str) -> None:
    for number, entry in dialect.enums["MAV_SENSOR_ORIENTATION"].items():
        if number > 40 or number == 38:
            continue
        angles = dict(re.findall(r"(ROLL|PITCH|YAW)_(\d+)", entry.name))
        expected = tuple(float(angles.get(name, 0)) for name in ("ROLL", "PITCH", "YAW"))
        assert ROTATIONS[autopilot][number] == expected, entry.name


BEYOND_FORTY = {
    "ardupilot": {41: (0.0, 7.0, 0.0), 42: (45.0, 0.0, 0.0), 43: (315.0, 0.0, 0.0)},
    "px4": {
        41: (270.0, 0.0, 180.0),
        42: (270.0, 0.0, 270.0),
        43: (0.0, 90.0, 180.0),
        44: (0.0, 9.0, 180.0),
        45: (0.0, 45.0, 0.0),
        46: (270.0, 0.0, 225.0),
        47: (270.0, 0.0, 315.0),
    },
}


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_the_firmwares_part_beyond_forty(autopilot: str) -> None:
    table = ROTATIONS[autopilot]
    assert {number: table[number] for number in range(41, len(table))} == BEYOND_FORTY[autopilot]
    assert ROTATIONS["px4"][38] == (90.0, 68.0, 293.0)


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_number_outside_the_table_is_refused_and_named(autopilot: str) -> None:
    last = max(BEYOND_FORTY[autopilot])
    for number in (last + 1, -1):
        with pytest.raises(FirmwareError, match=f"mounting rotation {number} is none of {autopilot}'s 0 to {last}"):
            rotation_matrix(autopilot, number)
        assert rotation_words(autopilot, number) == "not in the table"
    assert rotation_words(autopilot, last) != "not in the table"
    assert rotation_words(autopilot, 0) == "none"
    assert rotation_words(autopilot, 36) == "roll 90, pitch 180, yaw 90"


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_the_nearest_is_found_again(autopilot: str) -> None:
    for number in range(len(ROTATIONS[autopilot])):
        found, angle = nearest_rotation(autopilot, rotation_matrix(autopilot, number))
        assert angle == pytest.approx(0.0, abs=1e-7)
        assert np.allclose(rotation_matrix(autopilot, found), rotation_matrix(autopilot, number))


def test_how_far_the_nearest_is() -> None:
    assert nearest_rotation("ardupilot", euler_matrix(1.0, 0.0, 90.0)) == (2, pytest.approx(np.radians(1.0)))
    assert nearest_rotation("ardupilot", euler_matrix(0.0, 180.0, 180.0))[0] == 8  # roll 180 by another name
