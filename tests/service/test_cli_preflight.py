"""``mavcal preflight`` on the command line: table, JSON, exit codes, and --fix."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from mavcal.service.commands.output import EXIT_PART
from mavcal.service.commands.preflight import FIXABLE
from mavcal.service.fixing import Fixable
from mavcal.service.simvehicle import SimulatedVehicle
from tests.patience import scaled


def preflight(url: str, folder: Path, *more: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "mavcal", "preflight", "--connect", url, "--data-dir", str(folder), *more]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


FIX_GYRO = ("--fix", "gyro", "--apply", "--json")


def json_fixes(done: subprocess.CompletedProcess[str]) -> list[dict[str, Any]]:
    told = json.loads(done.stdout)
    assert "fixed" in told, (told, done.stderr)
    fixes: list[dict[str, Any]] = told["fixed"]
    return fixes


def test_the_kinds_that_need_no_hands_are_the_same_everywhere() -> None:
    assert tuple(Fixable) == FIXABLE


def test_fix_and_apply_go_together(tmp_path: Path) -> None:
    for options in (["--fix", "gyro"], ["--apply"], ["--fix", "accel", "--apply"]):
        assert preflight("udpin:127.0.0.1:1", tmp_path, *options).returncode == 2


@pytest.mark.long
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_gyroscope_that_is_off_fails_and_is_mended(autopilot: str, tmp_path: Path) -> None:
    config: dict[str, Any] = {"calibration": "fresh", "imu_count": 2}
    if autopilot == "px4":
        config["parameters"] = {"IMU_GYRO_CAL_EN": 0.0}  # else it mends its gyroscope by itself
    with SimulatedVehicle(autopilot, seed=8, speed=4.0, config=config) as sim:
        sim.wait(5.0)  # a PX4 is not ready in its first seconds
        sim.call("add", sensor="gyro", instance=1, by=[0.02, 0.0, 0.0])
        first = preflight(sim.url, tmp_path, "--json")
        told = json.loads(first.stdout)
        assert first.returncode == 1, first.stderr
        assert [c["id"] for c in told["checks"] if c["verdict"] == "fail"] == ["gyro_rest"]
        assert told["seconds"] < scaled(10.0)
        second = preflight(sim.url, tmp_path, *FIX_GYRO)
        told = json.loads(second.stdout)
        assert [fix["state"] for fix in told.get("fixed", [])] == ["succeeded"], (told, second.stderr)
        verdicts = {c["id"]: c["verdict"] for c in told["checks"]}
        assert verdicts["gyro_rest"] == "pass"
        assert verdicts["calibration_age"] == verdicts["sensor_ids"] == "pass"  # the job that mended it is known now
        assert second.returncode in (0, EXIT_PART), second.stdout


LEFT_OUT = "Nothing was written. gyro0 stays as it is: its change would act only after a restart."
LEFT_OUT_BOTH = "Nothing was written. gyro0, gyro1 stay as they are: their change would act only after a restart."


@pytest.mark.long
def test_a_change_that_needs_a_restart_is_left_out(tmp_path: Path) -> None:
    """PX4's memory takes no gyroscope offset that differs by less than 0.01 rad/s before it restarts."""
    config = {"calibration": "fresh", "imu_count": 2, "parameters": {"IMU_GYRO_CAL_EN": 0.0}}
    with SimulatedVehicle("px4", seed=8, speed=4.0, config=config) as sim:
        sim.call("add", sensor="gyro", instance=0, by=[0.0, 0.004, 0.0])
        sim.call("add", sensor="gyro", instance=1, by=[0.02, 0.0, 0.0])
        before, [found] = sim.parameters()[0], json_fixes(preflight(sim.url, tmp_path, *FIX_GYRO))
        after = sim.parameters()[0]
        assert found["state"] == "succeeded", found
        assert found["text"].endswith("gyro0 stays as it is: its change would act only after a restart.")
        assert {name for name in after if after[name] != before[name]} >= {"CAL_GYRO1_XOFF"}
        assert all(after[f"CAL_GYRO0_{axis}OFF"] == before[f"CAL_GYRO0_{axis}OFF"] for axis in "XYZ")
        [found] = json_fixes(preflight(sim.url, tmp_path, *FIX_GYRO))  # nothing acts at once any more
        assert found["state"] == "review", found
        assert found["text"] in {LEFT_OUT, LEFT_OUT_BOTH}  # a second rest may read gyro 1 a little differently


@pytest.mark.long
def test_the_table_names_what_helps(tmp_path: Path) -> None:
    with SimulatedVehicle("ardupilot", seed=8, speed=4.0, config={"calibration": "fresh", "imu_count": 1}) as sim:
        done = preflight(sim.url, tmp_path)
    assert done.returncode == EXIT_PART, done.stderr
    assert "UNKNOWN calibration_age" in done.stdout
    assert "-> " in done.stdout
    assert "checks pass" in done.stdout.splitlines()[-1]


RECIPE = Path(__file__).resolve().parents[2] / "docs" / "preflight.md"


@pytest.mark.long
def test_the_recipe_for_ten_vehicles(tmp_path: Path) -> None:
    """As the page has it: nine healthy vehicles, and one whose accelerometer is off."""
    blocks = re.findall(r"^```sh\n(.*?)^```", RECIPE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    (script,) = [block for block in blocks if "vehicles.txt" in block]
    config = {"calibration": "fresh", "imu_count": 2}
    with ExitStack() as stack:
        kinds = [("ardupilot", "px4")[number % 2] for number in range(10)]
        sims = [
            stack.enter_context(SimulatedVehicle(kind, seed=20 + number, system_id=1 + number, config=config))
            for number, kind in enumerate(kinds)
        ]
        sims[-1].wait(5.0)  # a PX4 is not ready in its first seconds
        sims[3].call("add", sensor="accel", instance=1, by=[0.4, 0.0, 0.0])
        (tmp_path / "vehicles.txt").write_text("".join(f"{sim.url}\n" for sim in sims), encoding="utf-8")
        path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
        done = subprocess.run(
            ["sh", "-c", script], cwd=tmp_path, env={**os.environ, "PATH": path}, capture_output=True, text=True,
            timeout=600, check=False,
        )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert "stays on the ground" in done.stdout
    told = json.loads((tmp_path / "preflight.json").read_text(encoding="utf-8"))["vehicles"]
    assert [one["connect"] for one in told] == [sim.url for sim in sims]
    failed = {one["connect"]: [c["id"] for c in one["checks"] if c["verdict"] == "fail"] for one in told}
    assert failed == {sim.url: ["accel_force"] if sim is sims[3] else [] for sim in sims}


@pytest.mark.long
def test_who_waits_for_a_vehicle_that_has_just_started_is_told(tmp_path: Path) -> None:
    config = {"calibration": "fresh", "agreement_s": 10.0}
    with SimulatedVehicle("ardupilot", seed=8, config=config) as sim:
        done = preflight(sim.url, tmp_path)
    assert done.returncode == EXIT_PART, (done.stdout, done.stderr)  # no calibration of it is known here
    assert "still looking" in done.stderr
