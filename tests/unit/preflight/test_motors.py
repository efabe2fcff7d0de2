"""Motor compensation that cannot be right."""

from __future__ import annotations

import dataclasses

import pytest

from mavcal.calib.firmware.plan import Value
from mavcal.calib.preflight.check import Snapshot, Verdict
from mavcal.calib.preflight.compass import motor_compensation
from mavcal.calib.recording import Sensor
from tests.unit.preflight.vehicle import healthy

ARDUPILOT, PX4 = 2, 3


def snapshot(seed: int, **parameters: Value) -> Snapshot:
    vehicle = healthy(seed)
    vehicle.parameters.update(parameters)
    return vehicle.snapshot()


def field(seed: int) -> float:
    """Strength of the field where that vehicle is, uT."""
    return healthy(seed).field.norm


def test_none_is_fine() -> None:
    assert motor_compensation(snapshot(ARDUPILOT)).verdict == Verdict.PASS


def test_switched_on_without_a_vector() -> None:
    assert motor_compensation(snapshot(ARDUPILOT, COMPASS_MOTCT=2)).verdict == Verdict.WARN


@pytest.mark.parametrize(("per_ampere", "verdict"), [(2.0, Verdict.PASS), (20.0, Verdict.FAIL)])
def test_beside_the_field(per_ampere: float, verdict: Verdict) -> None:
    check = motor_compensation(snapshot(ARDUPILOT, COMPASS_MOTCT=2, COMPASS_MOT_X=per_ampere))
    assert check.verdict == verdict
    assert check.value == pytest.approx(per_ampere * 0.1 * 30.0 / field(ARDUPILOT), rel=1e-3)


def test_px4_counts_in_gauss_per_kiloampere() -> None:
    check = motor_compensation(snapshot(PX4, CAL_MAG_COMP_TYP=2, CAL_MAG0_XCOMP=2.0))
    assert check.value == pytest.approx(2.0 * 100.0 * 0.03 / field(PX4), rel=1e-3)


def test_by_current_without_a_sensor_of_current() -> None:
    found = dataclasses.replace(snapshot(ARDUPILOT, COMPASS_MOTCT=2, COMPASS_MOT_X=1.0), current_known=False)
    assert motor_compensation(found).verdict == Verdict.FAIL


def test_where_the_place_is_not_known_the_field_is_a_typical_one() -> None:
    found = snapshot(ARDUPILOT, COMPASS_MOTCT=2, COMPASS_MOT_X=2.0)
    channels = tuple(c for c in found.recording.channels if c.sensor != Sensor.POSITION)
    nowhere = dataclasses.replace(found, recording=dataclasses.replace(found.recording, channels=channels))
    assert motor_compensation(nowhere).value == pytest.approx(2.0 * 0.1 * 30.0 / 50.0)
