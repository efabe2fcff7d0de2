"""Sensors at angles that no number stands for, in the simulated vehicle (AP_CustomRotations.cpp, Magnetometer.cpp)."""

from __future__ import annotations

import json

import numpy as np
import pytest

from mavcal.service.simvehicle.ardupilot_parameters import ardupilot_table
from mavcal.service.simvehicle.config import load_config
from mavcal.service.simvehicle.errors import ConfigurationError
from mavcal.service.simvehicle.mounting import CustomRotations, true_mounting
from mavcal.service.simvehicle.parameters import ParameterTable
from mavcal.service.simvehicle.px4_memory import SensorMemory
from mavcal.service.simvehicle.px4_parameters import MAG_IDS, px4_table
from mavcal.service.simvehicle.rotation import matrix_from_degrees
from mavcal.service.simvehicle.world import SimWorld

ODD = (3.0, -8.0, 29.0)


def table(make, **config):
    return ParameterTable(make(load_config(config)))


def test_a_custom_rotation_is_made_when_it_is_first_used_and_again_at_boot():
    parameters = table(ardupilot_table)
    custom = CustomRotations(parameters)
    custom.boot()
    for name, angle in zip(("ROLL", "PITCH", "YAW"), ODD, strict=True):
        parameters.store(f"CUST_ROT2_{name}", angle)
    np.testing.assert_allclose(custom.mounting(102), matrix_from_degrees(*ODD), atol=1e-6)
    assert parameters.get("CUST_ROT_ENABLE") == 1
    assert parameters.saved["CUST_ROT_ENABLE"] == 1
    parameters.store("CUST_ROT2_YAW", 90.0)
    np.testing.assert_allclose(custom.mounting(102), matrix_from_degrees(*ODD), atol=1e-6)  # not before the next boot
    custom.boot()
    np.testing.assert_allclose(custom.mounting(102), matrix_from_degrees(3.0, -8.0, 90.0), atol=1e-6)


def test_where_they_are_switched_on_all_are_made_at_boot():
    parameters = table(ardupilot_table, parameters={})
    parameters.store("CUST_ROT_ENABLE", 1)
    custom = CustomRotations(parameters)
    custom.boot()
    parameters.store("CUST_ROT1_YAW", 29.0)
    np.testing.assert_array_equal(custom.mounting(101), np.eye(3))
    np.testing.assert_array_equal(custom.mounting(77), np.eye(3))


def test_angles_are_stated_to_either_autopilot_and_are_how_it_is_mounted():
    config = load_config(json.dumps({"mag_angles_deg": [None, ODD], "mag_external": [False, True, False]}))
    np.testing.assert_allclose(true_mounting(config, 1), matrix_from_degrees(*ODD))
    np.testing.assert_array_equal(true_mounting(config, 0), np.eye(3))
    np.testing.assert_allclose(SimWorld(config).mag_from_body[1], matrix_from_degrees(*ODD).T)
    ardupilot = ParameterTable(ardupilot_table(config))
    assert [ardupilot.get(n) for n in ("COMPASS_ORIENT", "COMPASS_ORIENT2", "CUST_ROT_ENABLE")] == [0, 101, 1]
    assert [ardupilot.get(f"CUST_ROT1_{a}") for a in ("ROLL", "PITCH", "YAW")] == [*ODD]
    px4 = ParameterTable(px4_table(config))
    assert [px4.get(f"CAL_MAG1_{a}") for a in ("ROT", "ROLL", "PITCH", "YAW")] == [100, *ODD]
    assert px4.get("CAL_MAG0_ROT") == -1


def test_what_the_parameters_say_may_be_otherwise():
    config = load_config({"mag_angles_deg": [None, ODD], "mag_orientation_parameters": [0, 4, 0]})
    ardupilot = ParameterTable(ardupilot_table(config))
    assert (ardupilot.get("COMPASS_ORIENT2"), ardupilot.get("CUST_ROT_ENABLE")) == (4, 0)
    assert ParameterTable(px4_table(config)).get("CAL_MAG1_ROT") == 4


def test_angles_beside_a_number_make_it_custom_on_px4():
    parameters = table(px4_table, mag_external=[True, True, False], mag_orientations=[0, 6, 0])
    memory = SensorMemory("MAG", MAG_IDS[1])
    memory.load(parameters)
    assert memory.rotation == 6
    parameters.store("CAL_MAG1_PITCH", -8.0)
    memory.load(parameters)
    assert (memory.rotation, parameters.get("CAL_MAG1_ROT")) == (100, 100)
    inner = SensorMemory("MAG", MAG_IDS[0])
    parameters.store("CAL_MAG0_ROT", -1)
    parameters.store("CAL_MAG0_YAW", 5.0)
    inner.load(parameters)
    assert inner.rotation == -1  # an internal one follows the board


@pytest.mark.parametrize("angles", [[None, [1, 2]], [None, [1, 2, "x"]], [None, [1, 2, float("nan")]], 7])
def test_angles_that_are_none_are_refused(angles):
    with pytest.raises(ConfigurationError, match="mag_angles_deg"):
        load_config({"mag_angles_deg": angles})


def test_more_angles_than_custom_rotations_are_refused():
    config = load_config({"mag_count": 3, "mag_external": [True] * 3, "mag_angles_deg": [ODD] * 3})
    with pytest.raises(ConfigurationError, match="2 custom rotations"):
        ardupilot_table(config)
