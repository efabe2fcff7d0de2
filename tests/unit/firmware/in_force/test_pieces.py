"""When two spans of constant parameters correct a sensor alike."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.in_force.pieces import Piece
from mavcal.calib.firmware.names import ardupilot_imu_names
from mavcal.calib.recording import Sensor

KEY = (Sensor.GYRO, 0)


def piece(parameters, autopilot="ardupilot"):
    return Piece(-np.inf, {}, {}).completed(autopilot, dict(parameters))


def thermal(parameters, *, enable=1, **coefficients):
    row = {name: 0.0 for name in ardupilot_imu_names(Sensor.GYRO, 0).values() if "TCAL" in name}
    row |= {"INS_TCAL1_ENABLE": enable, "INS_TCAL1_TMIN": 10.0, "INS_TCAL1_TMAX": 60.0, "INS_GYR1_CALTEMP": 35.0}
    return parameters | row | coefficients


def test_only_what_corrects_the_sensor_makes_a_difference(ardupilot_parameters):
    plain = piece(ardupilot_parameters)
    assert plain.same("ardupilot", piece(ardupilot_parameters), KEY)
    assert plain.same("ardupilot", piece(ardupilot_parameters | {"INS_ACCOFFS_X": 1.0}), KEY)
    assert not plain.same("ardupilot", piece(ardupilot_parameters | {"INS_GYROFFS_X": 1.0}), KEY)
    assert not plain.same("ardupilot", piece(ardupilot_parameters | {"AHRS_ORIENTATION": 2}), KEY)
    accel = (Sensor.ACCEL, 0)
    assert not plain.same("ardupilot", piece(ardupilot_parameters | {"INS_ACCSCAL_Y": 1.01}), accel)


def test_curves_are_compared_by_their_range_and_every_coefficient(ardupilot_parameters):
    slope = {"INS_TCAL1_GYR1_X": 500.0}
    base = thermal(ardupilot_parameters, **slope)
    one = piece(base)
    assert one.model("ardupilot", KEY).polynomial is not None
    assert one.same("ardupilot", piece(base), KEY)
    assert not one.same("ardupilot", piece(ardupilot_parameters), KEY)
    assert not piece(ardupilot_parameters).same("ardupilot", one, KEY)
    for change in (
        {"INS_TCAL1_TMIN": 11.0},
        {"INS_TCAL1_TMAX": 61.0},
        {"INS_TCAL1_GYR1_X": 501.0},
        {"INS_TCAL1_GYR3_Z": 1.0},
    ):
        assert not one.same("ardupilot", piece(base | change), KEY)
    flat = piece(thermal(ardupilot_parameters))
    assert flat.model("ardupilot", KEY).polynomial is None  # coefficients of zero: no temperature is needed
    assert flat.same("ardupilot", piece(ardupilot_parameters), KEY)


def test_a_correction_that_is_not_known_is_like_no_other(ardupilot_parameters):
    nothing = piece({})
    with pytest.raises(FirmwareError):
        nothing.model("ardupilot", KEY)
    assert not nothing.same("ardupilot", nothing, KEY)
    assert not piece(ardupilot_parameters).same("ardupilot", nothing, KEY)


def test_px4_s_memory_ignores_a_small_change_and_what_was_first_seen_later_held_all_along(px4_parameters):
    accel = (Sensor.ACCEL, 0)
    first = piece(px4_parameters | {"CAL_ACC0_XOFF": 0.5}, "px4")
    assert set(first.memory) >= {(s, k) for s in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG) for k in range(4)}
    small = first.changed(3.0, {"CAL_ACC0_XOFF": 0.505})
    assert (small.start, small.throughout().start) == (3.0, -np.inf)
    assert first.same("px4", small, accel)
    large = small.changed(4.0, {"CAL_ACC0_XOFF": 0.52})
    assert large.model("px4", accel).offset.tolist() == [0.52, 0.0, 0.0]
    assert not first.same("px4", large, accel)
    later = large.completed("px4", {"SENS_BOARD_ROT": 2, "CAL_ACC0_XOFF": 0.9})
    assert later.memory[accel] is large.memory[accel]  # loaded once
    assert later.start == 4.0
    assert piece(px4_parameters).memory == {}


def test_a_row_that_was_never_seen_leaves_the_memory(px4_parameters):
    known = {n: v for n, v in px4_parameters.items() if not n.startswith("CAL_ACC1")}
    known["CAL_ACC1_ID"] = 0
    first = piece(known, "px4")
    assert (Sensor.ACCEL, 0) in first.memory
    moved = first.changed(1.0, {"CAL_ACC0_ID": 0, "CAL_ACC1_ID": 1310988})
    assert moved.parameters["CAL_ACC1_ID"] == 1310988
    assert (Sensor.GYRO, 0) in moved.memory
