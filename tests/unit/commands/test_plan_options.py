from __future__ import annotations

import click
import pytest
from click.testing import CliRunner

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.options import compose_options
from mavcal.calib.recording import Sensor
from mavcal.service.commands.calibrate import HANDS_FREE, parsed
from mavcal.service.commands.calibrate import command as calibrate
from mavcal.service.commands.plan_options import all_plan_options, given, plan_options


def said(*arguments, options=all_plan_options):
    """What a command with these options makes of its arguments."""
    found = {}

    @click.command()
    @options
    def command(**more):
        found.update(given(more))
        assert more == {}

    CliRunner().invoke(command, arguments, standalone_mode=False, catch_exceptions=False)
    return found


def test_what_was_not_given_is_not_decided():
    assert said() == {}


def test_a_switch_is_only_ever_switched_on_unless_it_goes_both_ways():
    assert said("--keep-gyro-at-boot", "--confirm-mounting", "--confirm-other-unit") == {
        "keep_gyro_at_boot": True,
        "confirm_mounting": True,
        "confirm_other_unit": True,
    }
    assert said("--no-mark-calibrated", "--adjust-level") == {"mark_calibrated": False, "adjust_level": True}


def test_sensors_and_numbers_by_sensor_are_read():
    found = said(
        "--only", "gyro0,,accel1", "--device-ids", "gyro0=1310988, mag1=7", "--accel-temperature", "accel0=31.5",
        "--mountings", "mag0=6",
    )  # fmt: skip
    assert found == {
        "only": ["gyro0", "accel1"],
        "device_ids": {"gyro0": 1310988.0, "mag1": 7.0},
        "accel_temperature": {"accel0": 31.5},
        "mountings": {"mag0": 6.0},
    }
    options = compose_options(found)  # as a job takes them
    assert options.only == ((Sensor.GYRO, 0), (Sensor.ACCEL, 1))
    assert options.device_ids == {(Sensor.GYRO, 0): 1310988, (Sensor.MAG, 1): 7}


@pytest.mark.parametrize("text", ["gyro0", "gyro0=", "gyro0=x", "gyro0=1,mag1"])
def test_what_is_no_number_by_sensor_is_named(text):
    with pytest.raises(click.UsageError, match=r"--device-ids: .* is not SENSOR=NUMBER"):
        said("--device-ids", text)


def test_only_a_job_of_a_recording_confirms_another_unit():
    with pytest.raises(click.NoSuchOption):
        said("--confirm-other-unit", options=plan_options)


def test_options_of_others_are_left():
    more = {"only": None, "kind": "gyro"}
    assert given(more) == {}
    assert more == {"kind": "gyro"}


@pytest.mark.parametrize(
    ("text", "value"),
    [("1.5", 1.5), ("3", 3), ("true", True), ("false", False), (" -2e-3", -0.002), ('"a b"', "a b"), ("null", None)],
)
def test_a_value_of_a_procedure_is_json(text, value):
    found = parsed((f" rate = {text}",))
    assert found == {"rate": value}
    assert type(found["rate"]) is type(value)


def test_a_word_is_a_value_of_a_method_alone():
    assert parsed(("model= ring ",), words=True) == {"model": "ring"}
    assert parsed(("model=",), words=True) == {"model": ""}
    with pytest.raises(click.UsageError, match="'model=ring' is not NAME=VALUE"):
        parsed(("model=ring",))


@pytest.mark.parametrize("words", [True, False])
def test_a_pair_needs_an_equals_sign(words):
    with pytest.raises(click.UsageError, match="'rate' is not NAME=VALUE"):
        parsed(("rate",), words=words)


@pytest.mark.parametrize(
    "arguments",
    [
        ("accel", "--all", "--apply"),
        ("gyro", "--all"),
        ("gyro", "--all", "--apply", "--require-proof"),
        ("gyro", "--all", "--apply", "--reboot"),
        ("gyro", "--all", "--apply", "--option", "uncertainty=1"),
        ("gyro", "--all", "--apply", "--keep-gyro-at-boot"),
    ],
)
def test_several_vehicles_are_calibrated_by_kinds_without_hands_and_without_options(arguments):
    result = CliRunner().invoke(calibrate, arguments, standalone_mode=False)
    assert isinstance(result.exception, click.UsageError)
    assert f"--all is for {' and '.join(HANDS_FREE)} with --apply" in str(result.exception)


def test_a_proof_is_of_what_was_written():
    result = CliRunner().invoke(calibrate, ("gyro", "--connect", "tcp:v:1", "--require-proof"), standalone_mode=False)
    assert isinstance(result.exception, click.UsageError)
    assert "--apply" in str(result.exception)


def test_one_vehicle_needs_one_endpoint():
    for urls in ((), ("--connect", "tcp:v:1", "--connect", "tcp:v:2")):
        result = CliRunner().invoke(calibrate, ("gyro", *urls), standalone_mode=False)
        assert isinstance(result.exception, click.UsageError)
        assert ("one --connect" if urls else "give --connect") in str(result.exception)


def test_a_sensor_that_there_is_not_is_refused_by_the_plan():
    with pytest.raises(InvalidInputError, match="names no sensor"):
        compose_options(said("--only", "baro0"))
