"""A compass that is mounted at angles which no number stands for, and one whose axes are mirrored."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mavcal.calib.firmware import calibration_in_force
from mavcal.calib.firmware.rotations import euler_matrix
from mavcal.calib.mag.free_rotation import angle_between
from mavcal.calib.recording import Sensor
from mavcal.service.simvehicle import SimulatedVehicle

from .test_cli_recovery import Command, stored

pytestmark = pytest.mark.timeout(300)

ODD = (3.0, -8.0, 29.0)
ANGLES = {
    "ardupilot": ("CUST_ROT1_ROLL", "CUST_ROT1_PITCH", "CUST_ROT1_YAW"),
    "px4": ("CAL_MAG1_ROLL", "CAL_MAG1_PITCH", "CAL_MAG1_YAW"),
}
NUMBER = {"ardupilot": ("COMPASS_ORIENT2", 101), "px4": ("CAL_MAG1_ROT", 100)}


def turned(autopilot: str, **config: object) -> SimulatedVehicle:
    plain = {"thermal": False, "imu_count": 1, "mag_orientations": [0, 0, 0], "mag_orientation_parameters": [0, 0, 0]}
    plain |= {"parameters": {"INS_GYR_CAL": 0} if autopilot == "ardupilot" else {"IMU_GYRO_CAL_EN": 0}}
    sim = SimulatedVehicle(autopilot, seed=5, speed=20, config={**plain, **config})
    sim.call("tumble", rate_dps=45.0)
    return sim


@pytest.mark.long
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_compass_at_odd_angles_is_shown_written_proved_and_taken_back(autopilot: str, tmp_path: Path) -> None:
    name, number = NUMBER[autopilot]
    with turned(autopilot, mag_angles_deg=[None, ODD]) as sim:
        mavcal, before = Command(tmp_path, sim), stored(sim)
        code, job, said = mavcal.ran("calibrate", "mag")
        assert (code, job["state"]) == (1, "review"), said
        assert "compass 2 is mounted turned by roll" in said
        assert f"{name} changes from 0 (none) to {number} (custom" in said
        assert stored(sim) == before
        planned = {c["name"]: c for c in job["plan"]["changes"]}
        assert all(0.2 < planned[each]["sd"] < 1.0 for each in ANGLES[autopilot])

        sim.call("hold", pose=[0.0, 0.0, 0.0], tilt_deg=0.0, tremor_deg=0.0)
        code, job, said = mavcal.ran("accept", job["id"], "--confirm-mounting", "--reboot")
        assert (code in (0, 3), job.get("state")) == (True, "succeeded"), (job, said)
        values = stored(sim)
        assert values[name] == number
        found = euler_matrix(*(values[each] for each in ANGLES[autopilot]))
        assert np.degrees(angle_between(found, euler_matrix(*ODD))) < 1.5
        verdicts = {p["name"]: p["verdict"] for p in job["verification"]["parameters"]}
        assert "contradicted" not in verdicts.values()
        if autopilot == "ardupilot":  # PX4 streams its magnetometers raw
            assert "proved" in {verdicts[each] for each in (*ANGLES[autopilot], name)}
        assert largest_turn(autopilot, sim) < 2.5

        code, job, said = mavcal.ran("revert", job["id"])
        assert (code, job["state"]) == (0, "reverted"), said
        after = stored(sim)
        assert {n: after[n] for n in before} == before


@pytest.mark.long
def test_a_compass_that_is_askew_may_stay_and_is_offered_its_angles(tmp_path: Path) -> None:
    with turned("ardupilot", mag_angles_deg=[None, (0.0, 12.0, 0.0)]) as sim:
        code, job, said = Command(tmp_path, sim).ran("calibrate", "mag")
        assert (code, job["state"]) == (0, "review"), said
        assert "askew, turned by roll" in said
        assert "--confirm-mounting) writes these angles" in said
        assert not {c["name"] for c in job["plan"]["changes"]} & {"COMPASS_ORIENT2", "CUST_ROT_ENABLE"}
        (lost,) = (loss for loss in job["plan"]["losses"] if loss["what"] == "mounting")
        assert lost["cost"] == pytest.approx(12.0, abs=1.0)


@pytest.mark.long
def test_a_mirrored_compass_is_left_out_by_name_and_the_exit_code_says_so(tmp_path: Path) -> None:
    mirror = {"matrix": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}
    with turned(
        "ardupilot", mag_orientation_parameters=None, mag_orientations=[0, 6, 0], truth={"mags": [None, mirror]}
    ) as sim:
        code, job, said = Command(tmp_path, sim).ran("calibrate", "mag")
        assert (code, job["state"]) == (3, "review"), said
        assert "its z axis reads with the wrong sign, which no mounting does" in said
        assert "Power-cycle the vehicle" in said
        assert not [c["name"] for c in job["plan"]["changes"] if c["name"].startswith(("COMPASS_OFS2", "COMPASS_ORI"))]


def largest_turn(autopilot: str, sim: SimulatedVehicle) -> float:
    """By how much the correction in force of the second compass turns a field in the body at most, degrees."""
    truth, rng = sim.truth()["mags"][1], np.random.default_rng(1)
    body = rng.normal(size=(200, 3))
    body *= 55.0 / np.linalg.norm(body, axis=1, keepdims=True)
    raw = body @ euler_matrix(*ODD) @ np.array(truth["matrix"]).T + truth["offset"]
    level = np.eye(3)
    if autopilot == "px4":  # which the accelerometer's vertical is turned by too
        level = euler_matrix(*(stored(sim)[f"SENS_BOARD_{axis}_OFF"] for axis in "XYZ"))
    corrected = calibration_in_force(autopilot, stored(sim), Sensor.MAG, 1).apply(raw) @ level
    cosines = np.einsum("ni,ni->n", corrected, body) / np.linalg.norm(corrected, axis=1) / 55.0
    return float(np.degrees(np.arccos(cosines.clip(-1.0, 1.0)).max()))
