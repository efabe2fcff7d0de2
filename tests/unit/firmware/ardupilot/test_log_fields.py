from __future__ import annotations

from mavcal.calib.firmware.ardupilot.log_fields import (
    COMPASS,
    INERTIAL,
    MOTOR_FUNCTIONS,
    THROTTLE_FUNCTIONS,
    implied_parameters,
)

OLD, NEW = (3, 2, 9), (3, 3, 0)
OFFSETS = {"COMPASS_OFS_X": 1.0, "COMPASS_OFS2_X": 2.0}


def neutral(digit: str) -> dict[str, float]:
    diagonal = {f"COMPASS_DIA{digit}_{axis}": 1.0 for axis in "XYZ"}
    return diagonal | {f"COMPASS_ODI{digit}_{axis}": 0.0 for axis in "XYZ"}


def test_a_firmware_without_soft_iron_corrects_with_the_identity() -> None:
    second = neutral("2") | {"COMPASS_EXTERN2": 0.0, "COMPASS_ORIENT2": 0.0}
    assert implied_parameters(OFFSETS, OLD) == neutral("") | second
    assert implied_parameters({"COMPASS_OFS_X": 1.0}, OLD) == neutral("")


def test_what_a_log_says_itself_is_not_implied() -> None:
    said = OFFSETS | {"COMPASS_EXTERN2": 1.0}
    assert "COMPASS_EXTERN2" not in implied_parameters(said, OLD)
    assert implied_parameters(OFFSETS | {"COMPASS_DIA_X": 1.1}, OLD) == {}


def test_nothing_is_implied_of_a_newer_an_unknown_or_a_compassless_firmware() -> None:
    assert implied_parameters(OFFSETS, NEW) == {}
    assert implied_parameters(OFFSETS, (4, 0, 0)) == {}
    assert implied_parameters(OFFSETS, None) == {}
    assert implied_parameters({"INS_ACC_ID": 1.0}, OLD) == {}


def test_a_bin_is_as_wide_as_the_unit_of_a_truncated_field() -> None:
    assert COMPASS.quantum == 0.1  # whole mGauss
    assert {reading.quantum for reading in INERTIAL} == {0.0}


def test_motors_are_found_by_the_functions_that_ardupilot_gives_their_outputs() -> None:
    """SERVOn_FUNCTION: Motor1 to Motor8 are 33 to 40, Motor9 to Motor12 are 82 to 85."""
    assert [MOTOR_FUNCTIONS[f] for f in (*range(33, 41), *range(82, 86))] == list(range(12))
    assert len(MOTOR_FUNCTIONS) == 12


def test_throttles_are_the_outputs_that_ardupilot_names_so() -> None:
    """SRV_Channel.h: k_throttle is 70, k_throttleLeft 73, k_throttleRight 74."""
    assert set(THROTTLE_FUNCTIONS) == {70, 73, 74}
