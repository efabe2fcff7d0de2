from __future__ import annotations

import dataclasses

import pytest

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.in_force.origin import differences, origin_of, unproved
from mavcal.calib.fit import FitBuilder, FitStatus
from mavcal.calib.recording import Identity, ParameterTimeline, Recording, Sensor
from tests.unit.logs.ulog_file import PARAMETERS

BOARD = Identity(autopilot="px4", uid="0002aa00")


def fits(*sensors):
    return [dataclasses.replace(FIT, sensor=sensor) for sensor in sensors]


FIT = dataclasses.replace(FitBuilder("x", Sensor.GYRO, 0, "rad/s", 0).refused(""), status=FitStatus.OK)


def origin(*sensors, parameters=PARAMETERS, identity=BOARD):
    return origin_of(Recording((), ParameterTimeline.constant(parameters), identity=identity), fits(*sensors))


def test_the_same_vehicle_may_have_it():
    assert differences(origin(Sensor.GYRO, Sensor.MAG), BOARD, PARAMETERS) == ()
    padded = dataclasses.replace(BOARD, uid="0002AA" + "00" * 6)
    assert differences(origin(Sensor.GYRO), padded, PARAMETERS) == ()


@pytest.mark.parametrize(
    ("identity", "change", "says"),
    [
        (dataclasses.replace(BOARD, autopilot="ardupilot"), {}, "is of px4, the vehicle runs ardupilot"),
        (dataclasses.replace(BOARD, uid="0003"), {}, "of the board 0002aa00"),
        (BOARD, {"CAL_GYRO0_ID": 5}, "gyro 1 had the device id"),
        (BOARD, {"CAL_GYRO0_ID": 0}, "it has none"),
        (BOARD, {"SENS_BOARD_ROT": 4}, "SENS_BOARD_ROT was 0 in the recording and is 4 here"),
    ],
)
def test_any_difference_is_named(identity, change, says):
    (reason,) = differences(origin(Sensor.GYRO), identity, PARAMETERS | change)
    assert says in reason


def test_a_sensor_that_was_not_fitted_does_not_matter():
    assert differences(origin(Sensor.GYRO), BOARD, PARAMETERS | {"CAL_MAG0_ID": 9}) == ()


def test_fits_of_nothing_and_of_unnamed_sensors_are_for_no_vehicle():
    assert len(differences(origin(), BOARD, PARAMETERS)) == 1
    unnamed = origin(Sensor.GYRO, parameters=PARAMETERS | {"CAL_GYRO0_ID": 0})
    (reason,) = differences(unnamed, BOARD, PARAMETERS)
    assert "device id" in reason
    assert "gyro 1" in reason


@pytest.mark.parametrize(
    ("identity", "parameters"), [(Identity(), PARAMETERS), (BOARD, {}), (Identity(autopilot="other"), PARAMETERS)]
)
def test_a_recording_of_no_vehicle_has_no_origin(identity, parameters):
    with pytest.raises(FirmwareError, match="recording"):
        origin(Sensor.GYRO, parameters=parameters, identity=identity)


@pytest.mark.parametrize(
    ("recorded", "here", "says"),
    [
        ("0002aa00", "0002aa00", ""),
        (None, "0002aa00", "the recording does not say which board it is of"),
        ("0002aa00", None, "this vehicle does not say which board it is"),
        (None, None, "the recording does not say which board it is of"),
    ],
)
def test_without_both_boards_ids_nothing_shows_that_it_is_this_vehicle(recorded, here, says):
    told = unproved(
        origin(Sensor.GYRO, identity=dataclasses.replace(BOARD, uid=recorded)), dataclasses.replace(BOARD, uid=here)
    )
    assert told.startswith(says)
    assert bool(told) == bool(says)
    assert not told or told.endswith("equal builds share the device ids of their sensors")
