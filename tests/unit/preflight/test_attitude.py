"""The vehicle's attitude beside its accelerometers: an estimator that remembers old offsets does not pass."""

from __future__ import annotations

import dataclasses
import lzma
from pathlib import Path

import numpy as np
import pytest

from mavcal.calib.firmware.rotations import euler_matrix
from mavcal.calib.logs.tlog import read_tlog
from mavcal.calib.preflight.check import Check, CheckId, Verdict
from mavcal.calib.preflight.inertial import attitude
from mavcal.calib.preflight.rest import Mean, mean_at_rest
from mavcal.calib.preflight.run import preflight
from mavcal.calib.recording import Recording, Sensor
from tests.unit.preflight.vehicle import healthy, unheard

CAPTURE = "ardupilot_accel_then_level_1_accel.tlog.xz"


@pytest.mark.parametrize(("off", "verdict"), [(0.0, Verdict.PASS), (0.8, Verdict.PASS), (2.1, Verdict.FAIL)])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_vertical_that_is_off_fails(seed: int, off: float, verdict: Verdict) -> None:
    vehicle = healthy(seed, redundant=True)
    vehicle.accel_errors = [np.zeros(3) for _ in vehicle.accel_errors]
    vehicle.tilt_error = np.radians(off)
    report = preflight(vehicle.snapshot())
    check = report.check(CheckId.ATTITUDE)
    assert check.verdict == verdict
    assert check.value == pytest.approx(off, abs=0.1)
    if verdict == Verdict.FAIL:
        assert "Restart" in check.remedy
        assert [c.id for c in report.checks if c.verdict == Verdict.FAIL] == [CheckId.ATTITUDE]


def test_the_level_trim_turns_the_attitude() -> None:
    vehicle = healthy(2, redundant=True)
    roll, pitch = 0.05, -0.08
    vehicle.parameters |= {"AHRS_TRIM_X": roll, "AHRS_TRIM_Y": pitch}
    snapshot = vehicle.snapshot()
    assert preflight(snapshot).check(CheckId.ATTITUDE).value > 4.0  # the attitude is the board's: without the trim
    forces = {i: mean_at_rest(snapshot.recording, Sensor.ACCEL, i) for i in range(vehicle.imus)}
    board = {i: turned(mean, euler_matrix(*np.degrees([roll, pitch]), 0.0).T) for i, mean in forces.items()}
    found = attitude(snapshot, board, None)
    assert (found.verdict, found.value < 0.5) == (Verdict.PASS, True)


def turned(mean: object, turn: np.ndarray) -> Mean:
    assert isinstance(mean, Mean)
    return dataclasses.replace(mean, value=turn @ mean.value)


def test_without_an_attitude_nothing_is_said() -> None:
    snapshot = healthy(2, redundant=True).snapshot()
    rest = [c for c in snapshot.recording.channels if c.sensor != Sensor.ATTITUDE]
    report = preflight(dataclasses.replace(snapshot, recording=snapshot.recording.with_channels(rest)))
    assert report.check(CheckId.ATTITUDE).verdict == Verdict.UNKNOWN


def test_an_accelerometer_that_is_off_is_told_once() -> None:
    vehicle = healthy(2, redundant=True)
    vehicle.tilt_error = np.radians(4.0)
    vehicle.accel_errors[0] = np.array([0.0, 0.0, 0.6])
    report = preflight(vehicle.snapshot())
    assert [c.id for c in report.checks if c.verdict == Verdict.FAIL] == [CheckId.ACCEL_FORCE]


@pytest.mark.long
@pytest.mark.shared
def test_a_real_estimator_that_remembers_does_not_pass(shared_data: Path) -> None:
    """ArduCopter after new accelerometer offsets and no restart: ATTITUDE stays more than 2 deg off."""
    found = measured(shared_data, last_s=8.0)
    assert found.verdict == Verdict.FAIL
    assert found.value is not None
    assert 2.0 < found.value < 3.0


def measured(shared_data: Path, *, last_s: float) -> Check:
    """The check on the last seconds of the capture."""
    recording = read_tlog(lzma.decompress((shared_data / "firmware_runs" / CAPTURE).read_bytes()))
    attitudes = recording.find(Sensor.ATTITUDE)[0]
    end = float(attitudes.t[-1]) + 1e-6
    ends = Recording(tuple(c.between(end - last_s, end) for c in recording.channels))
    accels = {i: mean_at_rest(ends, Sensor.ACCEL, i) for i in (0, 1)}
    there = {i: mean for i, mean in accels.items() if isinstance(mean, Mean)}
    parameters = dict(recording.parameters.at(end))
    return attitude(unheard("ardupilot", parameters, recording=ends), there, None)
