"""The last verified calibration as a plan: mapped by device id, of this very unit alone."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.in_force.fingerprint import fingerprint
from mavcal.calib.firmware.names import OFFSET, ardupilot_imu_names
from mavcal.calib.firmware.options import ComposeOptions
from mavcal.calib.firmware.plan import ParameterKind, WritePlan
from mavcal.calib.preflight.check import CheckId, Verdict, readiness, unchecked
from mavcal.calib.preflight.history import parameters_changed
from mavcal.calib.preflight.restore import compose_restore
from mavcal.calib.preflight.run import preflight
from mavcal.calib.recording import Sensor
from tests.unit.preflight.vehicle import BenchVehicle, healthy

ARDUPILOT, PX4 = 2, 3


def whole(seed: int) -> BenchVehicle:
    """A vehicle with every row of PX4 complete, as the firmware has it."""
    vehicle = healthy(seed, redundant=True)
    for name in list(vehicle.parameters):
        if name.startswith("CAL_") and name.endswith("OFF"):
            row = name[:-3]
            vehicle.parameters |= {} if "GYRO" in name else {f"{row}SCALE": 1.0}
            vehicle.parameters |= {f"{row}ODIAG": 0.0} if "MAG" in name else {}
    vehicle.verified = dataclasses.replace(vehicle.verified, parameters=dict(vehicle.parameters))
    return vehicle


def restored(vehicle: BenchVehicle, **options: Any) -> WritePlan:
    snapshot = vehicle.snapshot()
    kinds = {
        n: ParameterKind.INT32 if isinstance(v, int) else ParameterKind.REAL32 for n, v in vehicle.parameters.items()
    }
    of = fingerprint(snapshot.identity, snapshot.parameters)
    return compose_restore(
        snapshot.history, vehicle.parameters, kinds, of, options=ComposeOptions(mark_calibrated=False, **options)
    )


@pytest.mark.parametrize("seed", [ARDUPILOT, PX4])
def test_what_is_as_verified_is_not_written(seed: int) -> None:
    assert restored(whole(seed)).nothing_to_write


@pytest.mark.parametrize("seed", [ARDUPILOT, PX4])
def test_what_was_reset_is_put_back(seed: int) -> None:
    vehicle = whole(seed)
    verified = dict(vehicle.parameters)
    for name in vehicle.parameters:
        if name.startswith(("INS_ACC", "COMPASS_OFS", "CAL_ACC", "CAL_MAG")) and "OF" in name:
            vehicle.parameters[name] = 0.0
    plan = restored(vehicle)
    assert plan.changes
    assert not plan.blockers
    assert vehicle.parameters | {c.name: c.new for c in plan.changes} == pytest.approx(verified)


@pytest.mark.parametrize(
    ("then", "now"),
    [
        ({"ROT": 6, "YAW": 0.0, "ROLL": 0.0}, {"ROT": 100, "YAW": 29.0, "ROLL": 3.0}),
        ({"ROT": 100, "YAW": 29.0, "ROLL": 3.0}, {"ROT": 6, "YAW": 0.0, "ROLL": 0.0}),
    ],
)
def test_a_number_of_a_mounting_comes_behind_angles_that_go_and_before_those_that_come(
    then: dict[str, float], now: dict[str, float]
) -> None:
    """PX4 makes any number "custom" as long as the row holds angles (Magnetometer.cpp, ParametersLoad)."""
    vehicle = whole(PX4)
    vehicle.parameters |= {f"CAL_MAG0_{k}": v for k, v in {"PITCH": 0.0, **then}.items()}
    vehicle.verified = dataclasses.replace(vehicle.verified, parameters=dict(vehicle.parameters))
    vehicle.parameters |= {f"CAL_MAG0_{k}": v for k, v in now.items()}
    names = [c.name for c in restored(vehicle).changes]
    assert sorted(names) == ["CAL_MAG0_ROLL", "CAL_MAG0_ROT", "CAL_MAG0_YAW"]
    assert names.index("CAL_MAG0_ROT") == (0 if then["ROT"] == 100 else 2)


def test_a_sensor_that_sits_at_another_place_takes_its_values_with_it() -> None:
    vehicle = healthy(ARDUPILOT, redundant=True)
    first, second = (ardupilot_imu_names(Sensor.ACCEL, i) for i in (0, 1))
    verified = dict(vehicle.parameters)
    for role in first.keys() & second.keys():  # the units changed places, and so did what was measured of them
        if first[role] in verified and role.value == "id":
            vehicle.parameters[first[role]], vehicle.parameters[second[role]] = (
                verified[second[role]],
                verified[first[role]],
            )
    assert parameters_changed(vehicle.snapshot()).verdict == Verdict.FAIL
    plan = restored(vehicle)
    new = {c.name: c.new for c in plan.changes}
    for role in OFFSET:
        assert new[first[role]] == pytest.approx(verified[second[role]])
        assert new[second[role]] == pytest.approx(verified[first[role]])
    assert any("is accel 2 now" in text for text in plan.warnings)
    vehicle.parameters |= new
    assert parameters_changed(vehicle.snapshot()).verdict == Verdict.PASS


def test_a_sensor_that_is_gone_is_said_and_left() -> None:
    vehicle = healthy(ARDUPILOT, redundant=True)
    vehicle.parameters["INS_ACC2_ID"] = 4711
    vehicle.parameters["INS_ACCOFFS_X"] = 0.0
    plan = restored(vehicle)
    assert [c.name for c in plan.changes] == ["INS_ACCOFFS_X"]
    assert any("is not on this vehicle now" in text for text in plan.warnings)
    (out,) = plan.left_out
    assert (out.sensor, out.instance) == (Sensor.ACCEL, 1)
    assert "is not on this vehicle now" in out.reason
    assert restored(vehicle, only=((Sensor.ACCEL, 0),)).left_out == ()  # it was not asked for


def test_a_sensor_whose_parameters_are_gone_is_left_out_whole_and_a_lost_switch_alone() -> None:
    vehicle = whole(PX4)
    vehicle.parameters["CAL_ACC0_XOFF"] = 7.0
    del vehicle.parameters["CAL_ACC1_YSCALE"]
    del vehicle.parameters["CAL_MAG0_PRIO"]
    plan = restored(vehicle)
    assert [c.name for c in plan.changes] == ["CAL_ACC0_XOFF"]
    accel, mag = plan.left_out
    assert (accel.sensor, accel.instance, accel.reason) == (
        Sensor.ACCEL,
        1,
        "the vehicle does not have CAL_ACC1_YSCALE any more",
    )
    assert (mag.sensor, mag.instance) == (Sensor.MAG, 0)
    assert mag.reason.startswith("CAL_MAG0_PRIO cannot be put back")


def test_it_is_never_for_another_unit() -> None:
    vehicle = healthy(ARDUPILOT, redundant=True)
    vehicle.uid = "deadbeef"
    with pytest.raises(FirmwareError, match="never restored to another unit"):
        restored(vehicle)
    vehicle = healthy(ARDUPILOT, redundant=True)
    vehicle.uid = ""
    with pytest.raises(FirmwareError, match="does not say which unit"):
        restored(vehicle)
    vehicle = healthy(ARDUPILOT, redundant=True)
    vehicle.verified = dataclasses.replace(vehicle.verified, sensors=frozenset())
    with pytest.raises(FirmwareError, match="no verified calibration"):
        restored(vehicle)


def test_only_some_sensors() -> None:
    vehicle = healthy(ARDUPILOT, redundant=True)
    for name in ("INS_ACCOFFS_X", "INS_ACC2OFFS_X"):
        vehicle.parameters[name] = 0.0
    assert [c.name for c in restored(vehicle, only=((Sensor.ACCEL, 1),)).changes] == ["INS_ACC2OFFS_X"]


def test_every_check_says_what_it_looked_at() -> None:
    for seed in range(20):
        for check in preflight(healthy(seed).snapshot()).checks:
            assert check.evidence, check.id


def test_readiness_is_the_report_in_a_sentence() -> None:
    vehicle = healthy(ARDUPILOT, redundant=True)
    assert "would arm now" in readiness(preflight(vehicle.snapshot())).text
    other = healthy(ARDUPILOT, redundant=True)
    other.texts = ("PreArm: Throttle below Failsafe",)
    found = readiness(preflight(other.snapshot()))
    assert found.verdict == Verdict.FAIL
    assert "'PreArm: Throttle below Failsafe'" in found.text
    assert found.against[0].startswith(CheckId.VEHICLE_PREARM)
    assert unchecked("it is armed.").verdict == Verdict.UNKNOWN


def test_what_was_not_read_is_unknown_and_not_gone() -> None:
    vehicle = healthy(ARDUPILOT, redundant=True)
    del vehicle.parameters["INS_ACC2_ID"]
    snapshot = dataclasses.replace(vehicle.snapshot(), complete=False)
    found = preflight(snapshot)
    assert found.check(CheckId.SENSOR_IDS).verdict == Verdict.UNKNOWN
    assert not [c for c in found.checks if c.verdict == Verdict.FAIL]
