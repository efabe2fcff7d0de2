from __future__ import annotations

import pytest

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.in_force.needed import needed
from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.recording import Sensor
from mavcal.service.simvehicle.config import SimAutopilot, VehicleConfig
from mavcal.service.simvehicle.server import make_vehicle

IN_FORCE = {"ardupilot": ardupilot.calibration_in_force, "px4": px4.calibration_in_force}
IDS = {"ardupilot": ardupilot.sensor_ids, "px4": px4.sensor_ids}


def held(autopilot: str, **changes: float) -> dict[str, Value]:
    """Every parameter of a vehicle, hidden ones too."""
    vehicle = make_vehicle(VehicleConfig(autopilot=SimAutopilot(autopilot)))
    values: dict[str, Value] = {p.name: p.value for p in vehicle.table}
    assert changes.keys() <= values.keys()
    return {**values, **changes}


def read(autopilot: str, values: dict[str, Value], *sensors: Sensor, drift: bool = False) -> dict[str, Value]:
    """What a job reads of a vehicle that holds `values`."""
    asked: set[str] = set()
    known: dict[str, Value] = {}
    while missing := needed(autopilot, sensors, known, drift=drift) - asked:
        asked |= missing
        known.update({name: values[name] for name in missing if name in values})
    return known


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize("sensor", [Sensor.ACCEL, Sensor.GYRO, Sensor.MAG])
def test_the_correction_in_force_is_that_of_the_whole_list(autopilot: str, sensor: Sensor) -> None:
    values = held(autopilot)
    known = read(autopilot, values, sensor)
    assert len(known) < 70
    found = [instance for (s, instance) in IDS[autopilot](values) if s == sensor]
    assert found == [instance for (s, instance) in IDS[autopilot](known) if s == sensor]
    for instance in found:
        whole, part = (IN_FORCE[autopilot](p, sensor, instance) for p in (values, known))
        assert (whole.offset == part.offset).all()
        assert (whole.matrix == part.matrix).all()


@pytest.mark.parametrize(
    ("autopilot", "sensor", "changes"),
    [
        ("ardupilot", Sensor.GYRO, {"INS_TCAL2_ENABLE": 1, "INS_TCAL2_GYR1_X": 7.0}),
        ("ardupilot", Sensor.ACCEL, {"AHRS_ORIENTATION": 101, "CUST_ROT_ENABLE": 1, "CUST_ROT1_YAW": 30.0}),
        ("ardupilot", Sensor.MAG, {"COMPASS_PRIO1_ID": 131874, "COMPASS_PRIO2_ID": 97539, "COMPASS_OFS2_X": 40.0}),
        ("ardupilot", Sensor.MAG, {"COMPASS_ORIENT2": 102, "CUST_ROT_ENABLE": 1, "CUST_ROT2_ROLL": 10.0}),
        ("px4", Sensor.GYRO, {"SENS_BOARD_ROT": 4, "SENS_BOARD_X_OFF": 2.0}),
    ],
)
def test_what_decides_about_others_brings_them_along(autopilot: str, sensor: Sensor, changes: dict[str, float]) -> None:
    values = held(autopilot, **changes)
    known = read(autopilot, values, sensor)
    assert changes.items() <= known.items()
    for s, instance in IDS[autopilot](values):
        if s == sensor:
            whole, part = (IN_FORCE[autopilot](p, s, instance) for p in (values, known))
            assert (whole.offset == part.offset).all()
            assert (whole.matrix == part.matrix).all()
            assert (whole.polynomial is None) == (part.polynomial is None)


def test_coefficients_are_read_where_they_may_be_written() -> None:
    values = held("ardupilot")
    assert not any("TCAL1_GYR" in name for name in read("ardupilot", values, Sensor.GYRO))
    assert "INS_TCAL1_GYR3_Z" in read("ardupilot", values, Sensor.GYRO, drift=True)
    assert "TC_G0_X3_2" in read("px4", held("px4"), Sensor.GYRO, drift=True)


def test_a_fourth_unit_is_asked_for_only_behind_a_third() -> None:
    values = held("ardupilot")
    assert "INS4_GYR_ID" in needed("ardupilot", [Sensor.GYRO], values, drift=False)
    values["INS_GYR3_ID"] = 0
    assert "INS4_GYR_ID" not in needed("ardupilot", [Sensor.GYRO], values, drift=False)


def test_another_autopilot_is_refused() -> None:
    with pytest.raises(FirmwareError, match="betaflight"):
        needed("betaflight", [Sensor.GYRO], {}, drift=False)


def test_compasses_are_asked_for_by_the_slots_that_hold_one() -> None:
    held = {"COMPASS_DEV_ID": 11, "COMPASS_DEV_ID2": 0, "COMPASS_DEV_ID3": 13, "COMPASS_PRIO1_ID": 11}
    found = needed("ardupilot", {Sensor.MAG}, held, drift=False)
    assert {"COMPASS_OFS_X", "COMPASS_OFS3_X"} <= found
    assert "COMPASS_OFS2_X" not in found
    assert "COMPASS_OFS_X" in needed("ardupilot", {Sensor.MAG}, {}, drift=False)
    assert not {"COMPASS_PMOT_EN", "COMPASS_DEV_ID4"} & found
    assert "COMPASS_PMOT1_X" in needed("ardupilot", {Sensor.MAG}, held | {"COMPASS_MOTCT": 3}, drift=False)
    assert "COMPASS_DEV_ID4" in needed("ardupilot", {Sensor.MAG}, held | {"COMPASS_PRIO2_ID": 99}, drift=False)
