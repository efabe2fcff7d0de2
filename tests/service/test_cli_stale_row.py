"""A PX4 with a second compass whose device id is in no row. The second row has the id of one that was taken away."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from mavcal.service.simvehicle import SimulatedVehicle

from .cli_bench import mavcal
from .jobs_bench import stored

pytestmark = pytest.mark.timeout(300)

OWN, SECOND, GONE = 197388, 197644, 8944899
"""Device ids: what the first compass has, the second, and what nothing has any more."""


@pytest.fixture
def sim() -> Iterator[SimulatedVehicle]:
    rows = {"CAL_MAG1_ID": GONE, "CAL_MAG1_XOFF": 0.21, "SENS_MAG_AUTOCAL": 0}
    config = {"thermal": False, "imu_count": 1, "mag_count": 2, "parameters": rows}
    with SimulatedVehicle("px4", seed=7, speed=20, config=config) as vehicle:
        vehicle.call("tumble", rate_dps=45.0)
        yield vehicle


@pytest.mark.long
def test_a_compass_without_a_row_is_left_out_by_name(sim: SimulatedVehicle, tmp_path: Path) -> None:
    where = ("--connect", sim.url, "--data-dir", str(tmp_path))
    before = stored(sim)
    code, job, said = mavcal("calibrate", "mag", *where, "--apply", "--reboot", "--device-ids", f"mag0={OWN}")
    assert (code, job["state"]) == (3, "succeeded"), said
    (out,) = job["left_out"]
    assert (out["sensor"], out["instance"]) == ("mag", 1)
    assert f"CAL_MAG1_ID = {GONE} is the id of another sensor" in out["reason"]
    assert "`listener sensor_mag` on PX4's console says it" in out["reason"]
    assert "--device-ids" in out["reason"]
    changed = {name for name, value in stored(sim).items() if value != before[name]}
    assert {name[:8] for name in changed} == {"CAL_MAG0"}

    sim.call("hold", pose=[0.0, 0.0, 0.0], tilt_deg=0.0, tremor_deg=0.0)
    code, report, said = mavcal("preflight", *where)
    assert code != 0, said
    assert "Every sensor is the one" not in str(report)
    assert "Compass 1 uncalibrated" in str(report)


@pytest.mark.long
def test_a_compass_whose_id_is_told_gets_a_free_row_and_keeps_it(sim: SimulatedVehicle, tmp_path: Path) -> None:
    """What the reason of the test above advises, done."""
    where = ("--connect", sim.url, "--data-dir", str(tmp_path))
    before = stored(sim)
    told = ("--device-ids", f"mag0={OWN},mag1={SECOND}")
    code, job, said = mavcal("calibrate", "mag", *where, "--apply", "--reboot", *told)
    assert (code, job["state"], job["left_out"]) == (0, "succeeded", []), said
    held = stored(sim)
    assert (held["CAL_MAG1_ID"], held["CAL_MAG2_ID"]) == (GONE, SECOND)
    assert held["CAL_MAG1_XOFF"] == before["CAL_MAG1_XOFF"]
    truth = sim.truth()["mags"][1]["offset"]
    assert [held[f"CAL_MAG2_{axis}OFF"] for axis in "XYZ"] == pytest.approx([0.01 * part for part in truth], abs=0.004)

    sim.call("hold", pose=[0.0, 0.0, 0.0], tilt_deg=0.0, tremor_deg=0.0)
    code, report, said = mavcal("preflight", *where)
    checks = {check["id"]: check for check in report["checks"]}
    assert checks["compass_field"]["verdict"] == "pass", checks["compass_field"]
    assert "Compass 1 uncalibrated" not in str(report)
    assert "compass 2 (CAL_MAG2_ID" not in checks["sensors_heard"]["reason"]

    sim.call("tumble", rate_dps=45.0)  # what was told once is known from now on
    code, job, said = mavcal("calibrate", "mag", *where, "--apply", "--reboot")
    assert "left_out" in job, (code, job, said)
    assert [(out["instance"], out["reason"]) for out in job["left_out"]] == [(2, "the vehicle sends no samples of it")]
    assert code == 3  # the row of what is gone still announces a third one
    # Two calibrations of one sensor differ beyond their 95 % region now and then; which row is meant does not.
    assert {change["name"][:8] for change in job["plan"]["changes"]} <= {"CAL_MAG0", "CAL_MAG2"}
    again = stored(sim)
    assert (again["CAL_MAG1_ID"], again["CAL_MAG2_ID"]) == (GONE, SECOND)
    assert {
        name for name, value in stored(sim).items() if name.startswith("CAL_MAG1") and value != before[name]
    } == set()
