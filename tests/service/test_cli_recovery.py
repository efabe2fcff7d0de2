"""The command line is killed or stopped in the middle of a job, and the next run puts things right."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mavcal.calib.firmware.values import shown
from mavcal.service.jobs.core.crashpoints import At
from mavcal.service.simvehicle import SimulatedVehicle
from tests.patience import scaled

from .cli_bench import mavcal

pytestmark = pytest.mark.timeout(300)

ROOT = Path(__file__).resolve().parents[2]
LIMIT_S = 120.0
"""Limit of one run on an idle machine; it takes a few seconds."""


def vehicle(autopilot: str, parameters: dict[str, float], seed: int = 5) -> SimulatedVehicle:
    sim = SimulatedVehicle(autopilot, seed=seed, speed=20, config={"thermal": False, "parameters": parameters})
    sim.call("still")
    return sim


@pytest.fixture
def ardupilot() -> Iterator[SimulatedVehicle]:
    with vehicle("ardupilot", {"INS_GYR_CAL": 0}) as sim:
        yield sim


@pytest.fixture
def px4() -> Iterator[SimulatedVehicle]:
    with vehicle("px4", {"IMU_GYRO_CAL_EN": 0}) as sim:
        yield sim


@pytest.fixture
def restarting() -> Iterator[SimulatedVehicle]:
    """A PX4 that has calibrated its gyros by itself: what is left acts after a restart only."""
    with vehicle("px4", {}) as sim:
        sim.wait(30.0)
        yield sim


class Command:
    """``mavcal`` on one data directory and one vehicle."""

    def __init__(self, data_dir: Path, sim: SimulatedVehicle) -> None:
        self._place = ["--connect", sim.url, "--data-dir", str(data_dir)]

    def killed(self, point: At, occurrence: int, *arguments: str) -> str:
        command = ["-m", "bench.campaign.cli_process", point.value, str(occurrence), *arguments, *self._place]
        done = subprocess.run(
            [sys.executable, *command], cwd=ROOT, timeout=scaled(LIMIT_S), capture_output=True, text=True, check=False
        )
        assert done.returncode == -signal.SIGKILL, f"it was not killed at {point}: {done.stderr[-2000:]}"
        return done.stderr

    def ran(self, *arguments: str) -> tuple[int, dict[str, Any], str]:
        return mavcal(*arguments, *self._place)

    def begun(self, *arguments: str, stdin: int | None = None) -> Running:
        command = [sys.executable, "-u", "-m", "mavcal", *arguments, *self._place]
        return Running(command, stdin)


class Running:
    """A command that is still running."""

    def __init__(self, command: list[str], stdin: int | None) -> None:
        self._process = subprocess.Popen(command, cwd=ROOT, stdin=stdin, stderr=subprocess.PIPE, text=True)
        self._limit = threading.Timer(scaled(LIMIT_S), self._process.kill)
        self._limit.start()
        self.said = ""

    def until(self, text: str) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            self.said += line
            if text in line:
                return
        raise AssertionError(f"it never said {text!r}: {self.said}")

    def stopped(self, number: signal.Signals) -> int:
        self._process.send_signal(number)
        return self.ended()

    def ended(self) -> int:
        assert self._process.stderr is not None
        self.said += self._process.stderr.read()
        code = self._process.wait()
        self._process.stderr.close()
        self._limit.cancel()
        assert "Traceback" not in self.said, self.said
        return code


@pytest.fixture(name="mavcal")
def command(tmp_path: Path, request: pytest.FixtureRequest) -> Command:
    name = next(n for n in ("ardupilot", "px4", "restarting") if n in request.fixturenames)
    return Command(tmp_path, request.getfixturevalue(name))


def stored(sim: SimulatedVehicle) -> dict[str, float]:
    return {name: value for name, value in sim.parameters()[1].items() if not name.startswith("STAT_")}


def test_recover_takes_back_what_was_killed_in_mid_write(ardupilot: SimulatedVehicle, mavcal: Command) -> None:
    before = stored(ardupilot)
    mavcal.killed(At.AFTER_ECHO, 5, "calibrate", "gyro", "--apply")
    assert stored(ardupilot) != before
    code, told, said = mavcal.ran("recover")
    assert code == 0, said
    (job,) = told["recovered"]
    assert job["state"] == "reverted"
    assert stored(ardupilot) == before
    assert f"job {job['id']} (gyro) was interrupted while it wrote INS_GYR1_CALTEMP, " in said
    assert "Waiting to finish this write or to take it back" in said
    code, told, said = mavcal.ran("recover")
    assert (code, told["recovered"]) == (0, [])
    assert "nothing is in doubt" in said


def test_the_next_calibration_recovers_first_and_then_goes_on(px4: SimulatedVehicle, mavcal: Command) -> None:
    mavcal.killed(At.ECHO_KEPT, 4, "calibrate", "gyro", "--apply")
    assert stored(px4)["SENS_IMU_AUTOCAL"] == 0
    code, job, said = mavcal.ran("calibrate", "gyro", "--apply", "--reboot")
    assert (code, job["state"]) == (0, "succeeded"), said
    (first,) = job["recovered"]
    assert (first["state"], first["id"] == job["id"]) == ("reverted", False)
    told = said.index("was interrupted while it wrote SENS_IMU_AUTOCAL, ")
    back = said.index("SENS_IMU_AUTOCAL is back at 1")
    assert told < back < said.index("do not touch it")
    assert stored(px4)["SENS_IMU_AUTOCAL"] == 1


@pytest.mark.long
def test_a_capture_that_was_killed_does_not_stand_in_the_way(ardupilot: SimulatedVehicle, mavcal: Command) -> None:
    mavcal.killed(At.CAPTURE_RUNNING, 1, "calibrate", "gyro")
    code, job, said = mavcal.ran("calibrate", "gyro")
    assert (code, job["state"]) == (0, "review"), said
    assert job["recovered"][0]["state"] == "cancelled"
    assert "was interrupted before it wrote anything" in said


@pytest.mark.long
def test_what_cannot_be_resolved_is_1_and_listed(ardupilot: SimulatedVehicle, mavcal: Command) -> None:
    mavcal.killed(At.AFTER_ECHO, 4, "calibrate", "gyro", "--apply")
    ardupilot.call("fault", kind="arm")
    code, told, said = mavcal.ran("recover", "--wait", "15")
    assert code == 1
    (job,) = told["in_doubt"]
    last = job["parameters"][-1]
    assert last["name"] == "INS_GYROFFS_X"
    assert "Waiting to finish this write or to take it back: the vehicle is armed." in said
    assert f"INS_GYROFFS_X: {shown(last['old'])} before, {shown(last['new'])} intended, not heard since" in said
    ardupilot.call("disarm")
    assert mavcal.ran("recover")[0] == 0


@pytest.mark.long
def test_stopped_at_the_restart_prompt(restarting: SimulatedVehicle, mavcal: Command) -> None:
    first = mavcal.begun("calibrate", "gyro", "--apply")
    first.until("Restart the vehicle")
    assert first.stopped(signal.SIGTERM) == 128 + signal.SIGTERM
    assert "is waiting_for_reboot: SENS_IMU_AUTOCAL, " in first.said
    assert "mavcal recover --connect" in first.said
    assert stored(restarting)["SENS_IMU_AUTOCAL"] == 0
    second = mavcal.begun("recover")
    second.until("Restart the vehicle")
    restarting.call("reboot")
    assert second.ended() == 0, second.said
    assert "SENS_IMU_AUTOCAL is back at 1" in second.said
    assert stored(restarting)["SENS_IMU_AUTOCAL"] == 1


@pytest.mark.long
def test_a_restart_that_nobody_saw_is_not_asked_for_again(restarting: SimulatedVehicle, mavcal: Command) -> None:
    """Stopped at the prompt, restarted meanwhile: only the verification is left to do."""
    first = mavcal.begun("calibrate", "gyro", "--apply")
    first.until("Restart the vehicle")
    assert first.stopped(signal.SIGINT) == 128 + signal.SIGINT
    restarting.call("speed", value=1.0)  # its clock must not have run for long when it is looked at
    restarting.call("reboot")
    second = mavcal.begun("recover")
    second.until("waiting until the vehicle has started")
    restarting.call("speed", value=20.0)
    assert second.ended() == 0, second.said
    assert "Restart the vehicle" not in second.said
    assert "is succeeded" in second.said
    assert stored(restarting)["SENS_IMU_AUTOCAL"] == 1


@pytest.mark.long
def test_stopped_in_the_capture_leaves_nothing(ardupilot: SimulatedVehicle, mavcal: Command) -> None:
    before = stored(ardupilot)
    ardupilot.call("speed", value=1.0)
    run = mavcal.begun("calibrate", "gyro", "--apply")
    run.until("do not touch it")
    assert run.stopped(signal.SIGINT) == 128 + signal.SIGINT
    assert "was cancelled, nothing was written" in run.said
    assert stored(ardupilot) == before
    code, told, _ = mavcal.ran("recover")
    assert (code, told["recovered"]) == (0, [])
