from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.in_force.origin import Origin
from mavcal.calib.firmware.plan import Agreement, Change, Fingerprint, ParameterKind, WritePlan
from mavcal.calib.firmware.slots import CALIBRATED
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.procedures.registry import PROCEDURES, specification
from mavcal.calib.recording import Identity, Sensor
from mavcal.calib.report import from_json, to_json
from mavcal.calib.triad import TriadModel
from mavcal.service.errors import CaptureEnded, OtherVehicle
from mavcal.service.jobs.calibrate.planning import (
    accel_temperatures,
    checked_plan_options,
    confirmed,
    foresee,
    nothing_to_write,
    require_origin,
    require_sensors_of,
)
from mavcal.service.jobs.core.model import FROM_RECORDING, Job
from mavcal.service.jobs.core.proof import ProofLevel
from mavcal.service.jobs.core.states import JobState


def test_plan_options_are_those_of_composing() -> None:
    assert checked_plan_options({"keep_gyro_at_boot": True}) == {"keep_gyro_at_boot": True}
    with pytest.raises(InvalidInputError, match="keep_gyro_at_boot"):
        checked_plan_options({"keep_gyros": True})
    with pytest.raises(InvalidInputError, match="true or false"):
        checked_plan_options({"keep_gyro_at_boot": 1})


def test_identity_survives() -> None:
    identity = Identity("px4", 2, (1, 16, 0), "abc", 1, 1)
    assert from_json(to_json(identity), Identity) == identity
    assert from_json(to_json(Identity()), Identity) == Identity()


def accel_job(state: JobState, *, at: float = 1.0, temperature: float = 31.0) -> Job:
    cov = np.zeros((12, 12))
    fit = FitResult(
        "m", Sensor.ACCEL, 1, FitStatus.OK, "", TriadModel(), cov, "m/s2", 9, 9, 0.0, 1.0, temperature=temperature
    )
    changes = (
        Change("CAL_ACC1_XOFF", 0.0, 0.5, ParameterKind.REAL32, "", sensor=Sensor.ACCEL, instance=1),
        Change("SENS_BOARD_X_OFF", 0.0, 1.0, ParameterKind.REAL32, ""),
    )
    plan = WritePlan(Fingerprint("px4", "u", "1", ()), "0" * 64, changes)
    return Job(f"j{at}", "v", "accel", {}, state, at, at, results=(fit,), plan=plan)


def test_the_temperature_of_the_accelerometer_calibration_in_force_is_known_from_its_job() -> None:
    job = accel_job(JobState.SUCCEEDED)
    in_force = {"CAL_ACC1_XOFF": 0.5, "SENS_BOARD_X_OFF": 2.0}  # levelled since, which does not matter
    assert accel_temperatures([job], "v", in_force) == {1: 31.0}
    newer = accel_job(JobState.SUCCEEDED, at=2.0, temperature=40.0)
    assert accel_temperatures([newer, job], "v", in_force) == {1: 40.0}


def test_without_proof_that_it_is_still_in_force_nothing_is_known() -> None:
    job = accel_job(JobState.SUCCEEDED)
    assert accel_temperatures([job], "v", {"CAL_ACC1_XOFF": 0.25}) == {}
    assert accel_temperatures([job], "v", {}) == {}
    assert accel_temperatures([job], "other", {"CAL_ACC1_XOFF": 0.5}) == {}
    assert accel_temperatures([accel_job(JobState.REVERTED)], "v", {"CAL_ACC1_XOFF": 0.5}) == {}


def test_sensors_that_were_not_fitted_cannot_be_planned_for() -> None:
    job = accel_job(JobState.REVIEW)
    assert checked_plan_options({"only": ["accel1"]}, job.results) == {"only": ["accel1"]}
    assert checked_plan_options({"only": ["accel0"]}) == {"only": ["accel0"]}  # none was fitted yet
    with pytest.raises(InvalidInputError, match="accel0"):
        checked_plan_options({"only": ["accel0"]}, job.results)


def test_a_kind_of_job_plans_only_for_what_it_calibrates() -> None:
    require_sensors_of(specification("gyro"), {"only": ["gyro0", "gyro2"]})
    require_sensors_of(specification("gyro"), {})
    with pytest.raises(InvalidInputError, match=r"does not calibrate mag0, mag1"):
        require_sensors_of(specification("gyro"), {"only": ["gyro0", "mag0", "mag1"]})
    with pytest.raises(InvalidInputError, match=r"^mag-rings does not calibrate accel0, but mag0, mag1 \.\.\.$"):
        require_sensors_of(specification("mag-rings"), {"only": ["accel0"]})


@pytest.mark.parametrize("kind", PROCEDURES)
def test_what_a_job_calibrates_is_what_its_fits_are_of(kind: str) -> None:
    mag = {"mag", "mag-rings", "mag-fixed-yaw"}
    gyro = {"gyro", "gyro-thread", "gyro-turntable", "thermal", "imu-multi"}
    accel = {"accel", "accel-one-axis", "accel-six-face", "level", "thermal", "imu-multi"}
    expected = {Sensor.MAG: mag, Sensor.GYRO: gyro, Sensor.ACCEL: accel}
    calibrated = specification(kind).calibrated & set(CALIBRATED)
    assert calibrated == {sensor for sensor, kinds in expected.items() if kind in kinds}


def test_what_was_confirmed_is_listed_by_name() -> None:
    assert confirmed({}) == []
    assert confirmed({"confirm_mounting": False, "only": ["mag0"]}) == []
    assert confirmed({"confirm_mounting": True, "adjust_level": True}) == ["confirm_mounting"]


PX4 = Identity("px4", 2, (1, 17, 0), "0002aa", 1, 1)


def test_a_sensor_that_the_vehicle_does_not_have_ends_the_job_before_it_begins() -> None:
    parameters = {"CAL_GYRO0_ID": 7}
    assert foresee("gyro", PX4, parameters, {"only": ["gyro0"]}, {}) == ()
    with pytest.raises(CaptureEnded, match="gyro") as ended:
        foresee("gyro", PX4, parameters, {"only": ["gyro3"]}, {})
    assert ended.value.remedy == "Start the job again with sensors of this vehicle."


def test_an_agreement_is_told_as_the_outcome() -> None:
    agrees = (Agreement(Sensor.GYRO, 0, 0.4, "gyro 1"), Agreement(Sensor.GYRO, 1, 0.2, "gyro 2"))
    outcome = nothing_to_write(WritePlan(Fingerprint("px4", "u", "1", ()), "0" * 64, (), agreements=agrees))
    assert outcome.proof is ProofLevel.NONE
    assert outcome.proof_reason
    assert all(agreement.text in outcome.text for agreement in agrees)


def test_a_temperature_that_was_not_measured_or_not_written_is_not_known() -> None:
    in_force = {"CAL_ACC1_XOFF": 0.5}
    job = accel_job(JobState.SUCCEEDED)
    unmeasured = replace(job, results=(replace(job.results[0], temperature=None),))
    assert accel_temperatures([unmeasured], "v", in_force) == {}
    another = replace(job, results=(*job.results, replace(job.results[0], instance=2, temperature=50.0)))
    assert accel_temperatures([another], "v", in_force) == {1: 31.0}
    assert another.plan is not None
    agreed = replace(another.plan, agreements=(Agreement(Sensor.ACCEL, 2, 0.1, ""),))
    assert accel_temperatures([replace(another, plan=agreed)], "v", in_force) == {1: 31.0, 2: 50.0}


def test_a_job_of_another_sensor_says_nothing_of_accelerometers_and_a_log_may() -> None:
    in_force = {"CAL_ACC1_XOFF": 0.5}
    job = accel_job(JobState.SUCCEEDED)
    assert accel_temperatures([replace(job, kind="gyro")], "v", in_force) == {}
    assert accel_temperatures([replace(job, kind=FROM_RECORDING)], "v", in_force) == {1: 31.0}
    of_gyro = replace(job.results[0], sensor=Sensor.GYRO)
    assert accel_temperatures([replace(job, kind=FROM_RECORDING, results=(of_gyro,))], "v", in_force) == {}


def test_where_a_recording_comes_from_survives_and_is_held_to() -> None:
    origin = Origin("px4", "0002aa", (("gyro", 0, 7),), {"SENS_BOARD_ROT": 0})
    again = from_json(json.loads(json.dumps(to_json(origin))), Origin)
    assert again == origin
    require_origin(origin, PX4, {"CAL_GYRO0_ID": 7, "SENS_BOARD_ROT": 0})
    with pytest.raises(OtherVehicle, match="not for this vehicle: gyro 1 had the device id 7"):
        require_origin(origin, PX4, {"CAL_GYRO0_ID": 8, "SENS_BOARD_ROT": 0})
