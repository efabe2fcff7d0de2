from __future__ import annotations

import dataclasses

import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.options import PLAN_OPTIONS, ComposeOptions, compose_options, how, parse_key, unknown_keys
from mavcal.calib.recording import Sensor


def test_every_decision_of_composing_is_an_option_and_nothing_else_is() -> None:
    fields = {field.name for field in dataclasses.fields(ComposeOptions)}
    assert fields - {"unproved_origin", "without_row"} == set(PLAN_OPTIONS)


def test_plain_data_become_options() -> None:
    data = {
        "keep_gyro_at_boot": True,
        "only": ["gyro0", "accel1", "gyro0"],
        "device_ids": {"gyro1": 1310988},
        "accel_temperature": {"accel0": 31.5},
    }
    options = compose_options(data, accel_temperature={1: 20.0})
    assert options.keep_gyro_at_boot
    assert options.only == ((Sensor.GYRO, 0), (Sensor.ACCEL, 1))
    assert options.device_ids == {(Sensor.GYRO, 1): 1310988}
    assert options.accel_temperature == {0: 31.5}
    assert compose_options({}, accel_temperature={1: 20.0}).accel_temperature == {1: 20.0}


@pytest.mark.parametrize(
    ("data", "text"),
    [
        ({"keep_gyros": True}, "keep_gyro_at_boot"),
        ({"keep_gyro_at_boot": 1}, "true or false"),
        ({"only": "gyro0"}, "list of sensors"),
        ({"only": ["gyr0"]}, "names no sensor"),
        ({"only": ["gyro1\n"], "device_ids": {"gyro0": 0}}, "whole number"),
        ({"device_ids": {"gyro0": "7"}}, "by sensor"),
        ({"accel_temperature": {"gyro0": 20.0}}, "of accelerometers"),
        ({"accel_temperature": {"accel0": 900.0}}, "150"),
        ({"unproved_origin": "x"}, "no option"),
    ],
)
def test_what_is_no_option_is_refused_by_name(data: dict[str, object], text: str) -> None:
    with pytest.raises(InvalidInputError, match=text):
        compose_options(data)


@pytest.mark.parametrize(("degc", "fine"), [(-70.0, True), (150.0, True), (-70.1, False), (150.1, False)])
def test_a_temperature_is_within_the_range_of_the_sensors(degc: float, fine: bool) -> None:
    data = {"accel_temperature": {"accel0": degc}}
    if fine:
        assert compose_options(data).accel_temperature == {0: degc}
    else:
        with pytest.raises(InvalidInputError, match="-70 to 150"):
            compose_options(data)


def test_an_unknown_sensor_is_answered_with_the_list_of_what_there_is() -> None:
    there = [(Sensor.GYRO, 0), (Sensor.ACCEL, 0)]
    assert unknown_keys([parse_key("gyro0")], there) == ""
    assert unknown_keys([parse_key("gyro3")], there) == ("there is no gyro3 to plan for; there are: accel0, gyro0")


def test_advice_names_the_option_as_both_faces_take_it() -> None:
    assert how("keep_gyro_at_boot") == "the plan option keep_gyro_at_boot (--keep-gyro-at-boot)"
    with pytest.raises(KeyError):
        how("keep_gyros")
