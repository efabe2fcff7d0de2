"""A level trim is proved where it shows: PX4's in every sensor, ArduPilot's in the attitude alone."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.firmware.compose.plan import compose
from mavcal.calib.firmware.compose.trim import force_when_level
from mavcal.calib.firmware.plan import ProofVerdict, SensorVerdict
from mavcal.calib.firmware.proof.verify import verify
from mavcal.calib.geometry import quaternion_from_euler
from mavcal.calib.recording import Channel, Recording, Sensor, Stage

OLD = {"AHRS_TRIM_X": 0.019, "AHRS_TRIM_Y": -0.014}
ROLL, PITCH = np.radians((1.7, -2.3))


def standing(rng, roll, pitch, trim, *, start=0.0, error=(0.0, 0.0)):
    """Four seconds of an ArduPilot whose board stands at `roll`, `pitch` in a vehicle that is trimmed by `trim`.

    To first order the vehicle's attitude is the board's less the trim; `error` is the estimator's own.
    """
    t = start + np.arange(200) / 50.0
    accel = force_when_level(roll, pitch) + rng.normal(0.0, 0.003, (200, 3))
    slow = t[::5]
    angles = [a - b + e + rng.normal(0.0, 2e-4, len(slow)) for a, b, e in zip((roll, pitch), trim, error, strict=True)]
    q = quaternion_from_euler(angles[0], angles[1], np.full(len(slow), 0.7))
    return Recording(
        (
            Channel(Sensor.ACCEL, 0, t, accel, "m/s2", Stage.FILTERED, "TEST"),
            Channel(Sensor.GYRO, 0, t, rng.normal(0.0, 2e-4, (200, 3)), "rad/s", Stage.FILTERED, "TEST"),
            Channel(Sensor.ATTITUDE, 0, slow, q, "1", Stage.RAW, "ATTITUDE"),
        )
    )


@pytest.fixture
def levelled(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    native = {"roll": ROLL, "pitch": PITCH, "roll_sd": 2e-4, "pitch_sd": 2e-4}
    fit = make_fit(Sensor.ACCEL, method="level", offset_sd=0.0, native=native)
    parameters = ardupilot_parameters | OLD | {"INS_ACCOFFS_X": 0.3, "INS_ACCSCAL_Z": 0.98}
    plan = compose([fit], parameters, ardupilot_fingerprint)
    assert {c.name for c in plan.changes} == set(OLD)
    return plan, [fit], parameters | {c.name: c.new for c in plan.changes}


def judged(levelled, trim, *, pose=(ROLL, PITCH), seed=0, error=(0.0, 0.0)):
    plan, fits, stored = levelled
    rng = np.random.default_rng(seed)
    before = standing(rng, ROLL, PITCH, tuple(OLD.values()), error=error)
    after = standing(rng, *pose, trim, start=9.0, error=error)
    return verify(plan, fits, before, after, parameters=stored)


@pytest.mark.parametrize("seed", range(20))
def test_ardupilots_trim_is_proved_by_the_attitude(levelled, seed):
    result = judged(levelled, (ROLL, PITCH), seed=seed, error=(0.002, -0.003))
    assert {p.verdict for p in result.parameters} == {ProofVerdict.PROVED}
    assert result.proved
    level, attitude = result.sensors
    assert (level.id, level.verdict) == ("level", SensorVerdict.RIGHT)
    assert level.value < np.radians(0.05) < np.radians(0.2) <= level.limit
    assert (attitude.id, attitude.verdict) == ("attitude", SensorVerdict.RIGHT)


@pytest.mark.parametrize(("applied", "refused"), [("", "XY"), ("X", "Y"), ("Y", "X")])
def test_a_trim_that_did_not_take_effect_is_named(levelled, applied, refused):
    trim = [ROLL if "X" in applied else OLD["AHRS_TRIM_X"], PITCH if "Y" in applied else OLD["AHRS_TRIM_Y"]]
    assert set(judged(levelled, trim).contradicted) == {f"AHRS_TRIM_{axis}" for axis in refused}


@pytest.mark.parametrize("seed", range(5))
def test_an_estimator_that_remembers_an_earlier_calibration_refutes_no_level(levelled, seed):
    """`level` after `accel` without a restart, as ArduCopter 4.7-dev does it: the attitude stays 2.2 deg off."""
    result = judged(levelled, (ROLL, PITCH), seed=seed, error=np.radians((-0.75, -2.07)))
    level, attitude = result.sensors
    assert (level.id, level.verdict, result.must_go) == ("level", SensorVerdict.RIGHT, "")
    assert (attitude.id, attitude.verdict) == ("attitude", SensorVerdict.NOT_OBSERVABLE)
    assert "2.2" in attitude.text
    assert " deg off accel 1: " in attitude.text
    assert attitude.text.endswith("restart the vehicle")
    assert {p.verdict for p in result.parameters} == {ProofVerdict.PROVED}  # it turned by the change of the trim


def test_a_trim_that_does_not_level_the_accelerometer_is_refuted(levelled):
    plan, fits, stored = levelled
    rng = np.random.default_rng(6)
    native = fits[0].native | {"roll": ROLL + 0.02}
    wrong = dataclasses.replace(fits[0], native=native)
    before = standing(rng, ROLL + 0.02, PITCH, tuple(OLD.values()))
    after = standing(rng, ROLL + 0.02, PITCH, (ROLL, PITCH), start=9.0)
    result = verify(plan, [wrong], before, after, parameters=stored)
    assert [c.verdict for c in result.sensors if c.id == "level"] == [SensorVerdict.WRONG]


def test_a_vehicle_that_was_moved_proves_no_level_and_refutes_none(levelled):
    result = judged(levelled, (ROLL, PITCH), pose=(0.2, 0.1))
    assert {p.verdict for p in result.parameters} == {ProofVerdict.NOT_OBSERVABLE}
    (check,) = result.sensors
    assert check.verdict == SensorVerdict.NOT_OBSERVABLE
    assert result.must_go == ""


def test_px4_reads_level_after_its_level_job(px4_parameters, px4_fingerprint, make_fit):
    native = {"roll": ROLL, "pitch": PITCH, "roll_sd": 2e-4, "pitch_sd": 2e-4}
    fit = make_fit(Sensor.ACCEL, method="level", offset_sd=0.0, native=native)
    plan = compose([fit], px4_parameters, px4_fingerprint)
    rng = np.random.default_rng(2)
    stored = px4_parameters | {c.name: c.new for c in plan.changes}
    before = standing(rng, ROLL, PITCH, (0.0, 0.0))
    level = standing(rng, 0.0, 0.0, (0.0, 0.0), start=9.0)
    result = verify(plan, [fit], before, level, parameters=stored)
    (check,) = result.sensors
    assert (check.id, check.verdict) == ("level", SensorVerdict.RIGHT)
    assert abs(np.linalg.norm(force_when_level(ROLL, PITCH)) - STANDARD_GRAVITY) < 1e-9
    assert result.proved


def test_without_a_rest_before_the_write_no_trim_is_judged(levelled):
    """Only the level itself is: the vehicle stands as it did when the fit was made."""
    plan, fits, stored = levelled
    rng = np.random.default_rng(4)
    shaken = standing(rng, ROLL, PITCH, tuple(OLD.values()))
    channels = tuple(
        c if c.sensor is Sensor.ATTITUDE else dataclasses.replace(c, values=c.values + rng.normal(0.0, 2.0, (200, 3)))
        for c in shaken.channels
    )
    after = standing(rng, ROLL, PITCH, (ROLL, PITCH), start=9.0)
    result = verify(plan, fits, Recording(channels), after, parameters=stored)
    assert {p.verdict for p in result.parameters} == {ProofVerdict.NOT_OBSERVABLE}
    assert result.must_go == ""


def test_an_attitude_that_turned_by_itself_tells_nothing_of_a_trim(levelled):
    plan, fits, stored = levelled
    rng = np.random.default_rng(5)
    before = standing(rng, ROLL, PITCH, tuple(OLD.values()))
    after = standing(rng, ROLL, PITCH, (ROLL, PITCH), start=9.0, error=(0.2, -0.3))
    result = verify(plan, fits, before, after, parameters=stored)
    assert {p.verdict for p in result.parameters} == {ProofVerdict.NOT_OBSERVABLE}
    assert result.must_go == ""
    assert {p.text for p in result.parameters} == {
        "the attitude also changed for another reason: the trim cannot be checked"
    }
