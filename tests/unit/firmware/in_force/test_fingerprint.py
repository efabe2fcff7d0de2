"""What a plan rests on: all but the gyro offsets that a vehicle rewrites by itself, unless it is about gyros."""

from __future__ import annotations

import pytest

from mavcal.calib.firmware.compose.plan import compose
from mavcal.calib.firmware.in_force.fingerprint import calibration_snapshot, fingerprint, matters, rests_on
from mavcal.calib.firmware.names import OFFSET, Role, ardupilot_imu_names, px4_names
from mavcal.calib.firmware.options import compose_options
from mavcal.calib.firmware.plan import Value, WritePlan
from mavcal.calib.procedures.registry import PROCEDURES
from mavcal.calib.recording import Identity, Sensor

from .test_needed import IDS, held
from .test_needed_plan import FITS

OWN = {
    "ardupilot": {ardupilot_imu_names(Sensor.GYRO, s)[r] for s in range(3) for r in (*OFFSET, Role.TEMPERATURE)},
    "px4": {px4_names(Sensor.GYRO, s)[r] for s in range(4) for r in OFFSET},
}
SWITCH = {"ardupilot": "INS_GYR_CAL", "px4": "IMU_GYRO_CAL_EN"}
AUTOPILOTS = pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])


def plan_of(autopilot: str, values: dict[str, Value], kind: str, make_fit) -> WritePlan:
    sensor, about = FITS[kind]
    identity = Identity(autopilot, 2, (4, 7, 0), "00112233", 1, 1)
    fits = [make_fit(s, instance, **about) for s, instance in IDS[autopilot](values) if s == sensor]
    options = compose_options({}, accel_temperature=dict.fromkeys(range(3), 32.0))
    return compose(fits, values, fingerprint(identity, values), options=options)


@AUTOPILOTS
def test_gyro_offsets_void_the_plans_for_gyros_alone(autopilot: str, make_fit) -> None:
    values = held(autopilot)
    assert OWN[autopilot] <= set(values)
    later = {**values, **{name: float(values[name]) + 0.02 for name in OWN[autopilot]}}
    for kind in ("accel", "mag", "level"):
        before, after = (plan_of(autopilot, v, kind, make_fit) for v in (values, later))
        assert before.changes
        assert before == after
    before, after = (plan_of(autopilot, v, "gyro", make_fit) for v in (values, later))
    assert before.sensors == {Sensor.GYRO}
    assert before.snapshot_sha256 != after.snapshot_sha256


@AUTOPILOTS
def test_nothing_else_is_left_out(autopilot: str) -> None:
    values = held(autopilot)
    whole = calibration_snapshot(values)
    assert SWITCH[autopilot] in whole
    assert rests_on(values, {Sensor.GYRO, Sensor.ACCEL}) == whole
    assert set(whole) - set(rests_on(values, {Sensor.MAG})) == OWN[autopilot]


def test_the_gyro_only_tells_rest_from_motion_where_the_job_says_so() -> None:
    still_only = {spec.kind for spec in PROCEDURES.values() if not matters("CAL_GYRO0_XOFF", spec.measured)}
    assert still_only == {"accel", "accel-one-axis", "accel-six-face", "level"}
    assert all(
        matters("CAL_ACC0_XOFF", spec.measured) and matters("CAL_GYRO0_ID", spec.measured)
        for spec in PROCEDURES.values()
    )
