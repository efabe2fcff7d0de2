from __future__ import annotations

import numpy as np
import pytest

from calib.errors import InvalidInputError
from calib.firmware.plan import Change, Fingerprint, ParameterKind, WritePlan
from calib.fit import FitResult, FitStatus
from calib.recording import Identity, Sensor
from calib.triad import TriadModel
from service.jobs.model import Job
from service.jobs.planning import (
    accel_temperatures,
    checked_plan_options,
    identity_from_json,
    identity_to_json,
)
from service.jobs.states import JobState


def test_plan_options_are_those_of_composing() -> None:
    assert checked_plan_options({"keep_gyro_at_boot": True}) == {"keep_gyro_at_boot": True}
    with pytest.raises(InvalidInputError, match="keep_gyro_at_boot"):
        checked_plan_options({"keep_gyros": True})
    with pytest.raises(InvalidInputError, match="true or false"):
        checked_plan_options({"keep_gyro_at_boot": 1})


def test_identity_survives() -> None:
    identity = Identity("px4", 2, (1, 16, 0), "abc", 1, 1)
    assert identity_from_json(identity_to_json(identity)) == identity
    assert identity_from_json(identity_to_json(Identity())) == Identity()


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
