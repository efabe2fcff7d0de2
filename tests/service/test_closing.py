"""The loop closed against a simulated vehicle that really flies; and simulators that do not."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from mavcal.calib import logs
from mavcal.calib.logs.missions.course import Place
from mavcal.calib.logs.missions.reading import read_mission
from mavcal.calib.recording import Recording, Sensor
from mavcal.service.closing.errors import (
    LogUnusable,
    MissionLeft,
    OtherClosing,
    SimulatorEnded,
    SimulatorError,
    SimulatorMissing,
    SimulatorSilent,
    SimulatorUnarmed,
    WrongCommand,
)
from mavcal.service.closing.loop import Closing
from mavcal.service.closing.mission import log_mission, standard_mission
from mavcal.service.closing.rounds import Outcome, RoundResult
from mavcal.service.closing.settings import SimSettings
from tests.patience import scaled
from tests.processes import left_over
from tests.service.closing_bench import FLYING, ROOT, SHORT, compare, fly, hover, plan, waypoints

PYTHON = sys.executable
REAL = 0.45
"""hoverThrOut of the vehicle that counts as the real one; the simulator's is 0.39."""

pytestmark = pytest.mark.timeout(120)


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return logs.read(fly(tmp_path_factory.mktemp("real"), SimSettings({"SIM_OPOS_HDG": 130.0}, {"hoverThrOut": REAL})))


def nobody_left() -> bool:
    """Whether all that this test started has ended; services of other tests live in the same process."""
    test = os.environ["PYTEST_CURRENT_TEST"].partition(" (")[0]
    end = time.monotonic() + scaled(5.0)
    while (left := [one for one in left_over() if one.test == test]) and time.monotonic() < end:
        time.sleep(0.05)
    return not left


def test_the_loop_finds_the_thrust_of_the_real_vehicle(real: Recording, tmp_path: Path) -> None:
    told: list[tuple[int, str]] = []
    done: list[RoundResult] = []
    closing = Closing(plan(real, tmp_path / "work"), compare, lambda n, what, *_: told.append((n, what)), done.append)
    result = closing.run()
    assert result.outcome is Outcome.CLOSED
    assert result.rounds == tuple(done)
    first, last = result.rounds[0], result.rounds[-1]
    assert first.left == ("thrust_scale",)
    assert last.left == ()
    assert last.settings.frame["hoverThrOut"] == pytest.approx(REAL, rel=0.02)
    assert first.velocity_error is not None
    assert last.velocity_error is not None
    assert last.velocity_error < 0.1 * first.velocity_error
    assert {number for number, _ in told} == {0, 1}
    assert any("flying" in what for _, what in told)
    assert nobody_left()

    folder = tmp_path / "work"
    assert json.loads((folder / "progress.json").read_text())["standing"]["doing"] == "closed"
    assert json.loads((folder / "round-1" / "frame.json").read_text())["hoverThrOut"] == pytest.approx(REAL, rel=0.02)
    assert json.loads((folder / "round-0" / "diagnosis.json").read_text())["effects"][0]["id"] == "thrust_scale"

    # What is done is neither flown nor diagnosed again; without the diagnosis, only that is made.
    again = Closing(plan(real, folder), _never)
    assert again.run().rounds == result.rounds
    (folder / "round-1" / "round.json").unlink()
    stamp = (folder / "round-1" / "log.bin").stat().st_mtime_ns
    assert Closing(plan(real, folder), compare).run().outcome is Outcome.CLOSED
    assert (folder / "round-1" / "log.bin").stat().st_mtime_ns == stamp
    with pytest.raises(OtherClosing, match="command differ"):
        Closing(plan(real, folder, FLYING + " --seed 4"), compare)


def _never(*_: object, **__: object) -> None:
    raise AssertionError("diagnosed again")


def test_parameters_go_over_mavlink_where_the_command_takes_no_file(real: Recording, tmp_path: Path) -> None:
    command = FLYING.replace("--params {params}", "")
    start = SimSettings({"SIM_WIND_SPD": 2.0, "MOT_THST_HOVER": 0.42})
    result = Closing(plan(real, tmp_path, command, start=start, rounds=0), compare).run()
    assert result.outcome is Outcome.ROUNDS_USED
    sim = logs.read(tmp_path / "round-0" / "log.bin")
    assert sim.parameters.final()["SIM_WIND_SPD"] == 2.0
    assert "MOT_THST_HOVER" in sim.parameters.final()


def test_a_vehicle_that_does_not_notice_its_landing_is_disarmed(tmp_path: Path) -> None:
    """ArduCopter's simulator stays armed on the ground where the wind shakes it."""
    log = fly(tmp_path, SimSettings({"SIM_WIND_SPD": 3.0, "SIM_WIND_TURB": 1.0}))
    recording = logs.read(log)
    assert hover(recording) > 0.3
    assert recording.channel(Sensor.THROTTLE).values[-20:].max() < 0.05, "disarmed"


def test_what_a_command_cannot_take_is_said(real: Recording, tmp_path: Path) -> None:
    result = Closing(plan(real, tmp_path, FLYING.replace("--frame {frame}", "")), compare).run()
    assert result.outcome is Outcome.NOTHING_TO_SET
    assert result.rounds[0].not_set == ("hoverThrOut",)
    assert len(result.rounds) == 1


@pytest.mark.parametrize(
    ("command", "error", "said"),
    [
        ("no-such-simulator --port {port}", SimulatorMissing, "no-such-simulator cannot be started: No such file"),
        (f"{PYTHON} -c \"print('bad frame'); raise SystemExit(3)\" {{port}}", SimulatorEnded, "exit code 3.*bad frame"),
        (f"{PYTHON} -c \"import time; print('up'); time.sleep(60)\" {{port}}", SimulatorSilent, "no heartbeat at tcp"),
    ],
)
def test_a_simulator_that_does_not_fly_is_named_with_its_last_lines(
    real: Recording, tmp_path: Path, command: str, error: type[SimulatorError], said: str
) -> None:
    with pytest.raises(error, match=f"(?s){said}"):
        Closing(plan(real, tmp_path, command, heartbeat_s=2.0), compare).run()
    assert nobody_left()


def test_a_vehicle_that_refuses_to_arm_says_why(
    real: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mavcal.service.closing.pilot.ARM_S", 5.0)
    unable = plan(real, tmp_path, start=SimSettings({"SIM_GPS1_ENABLE": 0.0}))
    with pytest.raises(SimulatorUnarmed, match=r"did not arm within 5 s.*Arm: GPS 1: Bad fix"):
        Closing(unable, compare).run()
    assert nobody_left()


def test_a_vehicle_that_cannot_lift_itself_leaves_the_mission(real: Recording, tmp_path: Path) -> None:
    heavy = plan(real, tmp_path, start=SimSettings({}, {"hoverThrOut": 1.3}))
    with pytest.raises(MissionLeft, match=r"of take-off to 3 m.*Can it carry its weight"):
        Closing(heavy, compare).run()
    assert nobody_left()


def test_a_flight_without_a_log_is_no_round(real: Recording, tmp_path: Path) -> None:
    lost = FLYING.replace("--log {log}", f"--log {tmp_path}/elsewhere.bin")
    with pytest.raises(LogUnusable, match=r"(?s)no flight log in .*round-0.*ready"):
        Closing(plan(real, tmp_path / "work", lost), compare).run()
    assert not (tmp_path / "work" / "round-0" / "flown.json").exists()


def test_a_damaged_log_is_said_to_be_unreadable(real: Recording, tmp_path: Path) -> None:
    """A log whose beginning only is there: the round stays flown, and its diagnosis says what is wrong."""
    work = tmp_path / "work"
    closing = Closing(plan(real, work, rounds=0), compare)
    closing.run()
    log = work / "round-0" / "log.bin"
    log.write_bytes(log.read_bytes()[:200])
    (work / "round-0" / "round.json").unlink()
    with pytest.raises(LogUnusable, match="log cannot be read"):
        Closing(plan(real, work, rounds=0), compare).run()


@pytest.mark.parametrize("command", ["sim {frame} {bort}", "", "sim 'x", "sim --frame {frame}"])
def test_a_wrong_command_is_refused_before_anything_is_started(real: Recording, tmp_path: Path, command: str) -> None:
    with pytest.raises(WrongCommand):
        Closing(plan(real, tmp_path / "work", command), compare)
    assert not (tmp_path / "work").exists()


HURRIED = """
import signal, subprocess, sys
from pymavlink.DFReader import DFReader_binary
signal.signal(signal.SIGTERM, lambda *_: None)
log, speedup, *command = sys.argv[1:]
subprocess.run(command)
if float(speedup) > 2.0:
    reader, kept, seen = DFReader_binary(log), [], 0
    while (message := reader.recv_msg()) is not None:
        seen += message.get_type() == "IMU"
        if message.get_type() != "IMU" or seen // 400 % 2:
            kept.append(message.get_msgbuf())
    open(log, "wb").write(b"".join(kept))
"""
"""A simulator that logs every other second only where it is to run at more than twice real time."""


def half(text: str) -> str:
    return re.sub(r"\b(4[5-9]|5[0-5]) %", "half", text)


def test_a_simulator_that_drops_its_log_flies_again_at_half_the_speed(real: Recording, tmp_path: Path) -> None:
    script = tmp_path / "hurried.py"
    script.write_text(HURRIED)
    command = f"{PYTHON} {script} {{log}} {{speedup}} {FLYING.replace('{speedup}', '0')}"
    told: list[str] = []
    closing = Closing(
        plan(real, tmp_path / "work", command, speedup=8.0, rounds=0), compare, lambda _n, doing, *_: told.append(doing)
    )
    result = closing.run()
    assert hover(logs.read(tmp_path / "work" / "round-0" / "log.bin")) > 0.0
    assert [half(doing) for doing in told if doing.startswith("starting")] == [
        "starting the simulator",
        "starting the simulator at 4 times real time, since at 8 times real time its log lacked half of its samples",
        "starting the simulator at 2 times real time, since at 4 times real time its log lacked half of its samples",
    ]
    (flown,) = result.rounds
    assert tuple(map(half, flown.notes)) == (
        "at 8 times real time its log lacked half of its samples: flown again at 4 times real time",
        "at 4 times real time its log lacked half of its samples: flown again at 2 times real time",
    )
    (tmp_path / "work" / "round-0" / "round.json").unlink()  # told again where only the diagnosis is made anew
    again = Closing(plan(real, tmp_path / "work", command, speedup=8.0, rounds=0), compare).run()
    assert again.rounds == result.rounds
    assert nobody_left()


@pytest.mark.parametrize(
    ("speed", "speedup", "said"),
    [
        ("3", 8.0, r"^at 8 times real time its log lacked half .*write \{speedup\} into the command"),
        ("3", 0.0, r"^as fast as it goes its log lacked half .*--speedup 1"),
    ],
)
def test_a_log_that_stays_with_holes_is_told(
    real: Recording, tmp_path: Path, speed: str, speedup: float, said: str
) -> None:
    """Where it cannot be flown more slowly, nobody is to believe that nothing was wrong."""
    script = tmp_path / "hurried.py"
    script.write_text(HURRIED)
    asked = FLYING.replace("{speedup}", "0")
    command = f"{PYTHON} {script} {{log}} {speed} {asked}" + (" --seed {speedup}" if speedup == 0.0 else "")
    result = Closing(plan(real, tmp_path / "work", command, speedup=speedup, rounds=0), compare).run()
    (note,) = result.rounds[0].notes
    assert re.search(said, half(note))
    assert nobody_left()


@pytest.mark.long
def test_the_loop_flies_the_mission_of_the_log(tmp_path: Path) -> None:
    """A log's own mission, moved to the simulator's home in every round, and only resumed as what it was."""
    start = SimSettings({"SIM_OPOS_LAT": 12.0, "SIM_OPOS_LNG": 34.0, "SIM_OPOS_ALT": 584.0}, {"hoverThrOut": REAL})
    flown = fly(tmp_path / "real", start, waypoints())
    mission = dataclasses.replace(log_mission(flown), rest_s=1.0, rest_after_s=1.0)
    assert [item.command for item in mission.flown.items] == [22, 19, 16, 21]
    told: list[str] = []
    work = tmp_path / "work"
    closing = Closing(plan(logs.read(flown), work, mission=mission), compare, lambda _n, what, *_: told.append(what))
    result = closing.run()
    assert result.outcome is Outcome.CLOSED
    assert result.rounds[-1].settings.frame["hoverThrOut"] == pytest.approx(REAL, rel=0.02)
    again = read_mission(work / "round-1" / "log.bin")
    assert again.home.latitude == pytest.approx(-35.363261, abs=2e-6)  # the parameter is a float32
    offset = Place(again.home.latitude, again.home.longitude, 584.0).offset
    assert offset(again.items[1].latitude, again.items[1].longitude) == pytest.approx((12.0, 0.0), abs=0.05)
    assert any("uploading the mission" in what or "flying item" in what for what in told)
    assert Closing(plan(logs.read(flown), work, mission=mission), _never).run().rounds == result.rounds
    with pytest.raises(OtherClosing, match=r"\(mission differ\)"):
        Closing(plan(logs.read(flown), work), compare)
    assert nobody_left()


STUBBORN = (
    "import os, signal, subprocess, sys, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); "
    "child = 'import signal, time; signal.signal(15, signal.SIG_IGN); time.sleep(99)'; "
    "subprocess.Popen([sys.executable, '-c', child]); "
    "print('up', flush=True); time.sleep(99)"
)


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.long)])
def test_ctrl_c_leaves_no_simulator_behind(real: Recording, tmp_path: Path, number: signal.Signals) -> None:
    """Not even one that ignores SIGTERM, with a child that does."""
    table = tmp_path / "real.csv"
    table.write_text("t,accel_x,accel_y,accel_z\n" + "".join(f"{0.02 * k},0.1,0,-9.8\n" for k in range(400)))
    running = subprocess.Popen(
        [PYTHON, "-m", "mavcal", "gap", "close", "--real", str(table), "--work", str(tmp_path / "work"),
         "--simulator", f'{PYTHON} -c "{STUBBORN}" {{port}}'],
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    output = tmp_path / "work" / "round-0" / "simulator.txt"
    end = time.monotonic() + scaled(30.0)
    while not (output.exists() and output.read_text()) and time.monotonic() < end:
        time.sleep(0.05)
    running.send_signal(number)
    said, _ = running.communicate(timeout=scaled(30.0))
    assert running.returncode == 130, said.decode()
    assert b"stopped" in said
    assert nobody_left()


@pytest.mark.long
def test_a_vehicle_that_falls_silent_in_flight_is_given_up(
    real: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mavcal.service.closing.conversation.SILENT_S", 2.0)
    slow = plan(real, tmp_path, speedup=2.0)

    def stop() -> None:
        end = time.monotonic() + scaled(20.0)
        while time.monotonic() < end:
            found = [one for one in left_over() if "simulate flight" in one.command]
            if found:
                time.sleep(2.0)
                os.kill(found[0].pid, signal.SIGSTOP)
                return
            time.sleep(0.05)

    stopper = threading.Thread(target=stop)
    stopper.start()
    with pytest.raises(SimulatorSilent, match="has sent no newer state for 2 s"):
        Closing(slow, compare).run()
    stopper.join()
    assert nobody_left()


def test_the_flight_is_that_of_the_mission(real: Recording) -> None:
    assert hover(real) == pytest.approx(REAL * 0.945, rel=0.04)  # by the air's density at 584 m
    speed = real.channel(Sensor.VELOCITY).values
    assert abs(speed[:, :2]).max() == pytest.approx(2.0, abs=1.2)
    assert SHORT.seconds < 30.0


@pytest.mark.long
@pytest.mark.timeout(600)
def test_the_command_flies_diagnoses_and_tells(tmp_path: Path) -> None:
    """The whole command with its own mission and diagnosis: thrust and inertia are found and set in one round."""
    frame = {"hoverThrOut": REAL, "moment_inertia": [0.02755, 0.02755, 0.0459]}
    flown = fly(tmp_path / "real", SimSettings({}, frame), standard_mission())
    done = subprocess.run(
        [PYTHON, "-m", "mavcal", "gap", "close", "--real", str(flown), "--simulator", FLYING, "--speedup", "0",
         "--rounds", "2", "--work", str(tmp_path / "work"), "--report", str(tmp_path / "page.html"), "--json",
         "--limit-s", "600"],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert [one["round"] for one in answer["rounds"]] == [0, 1]
    patched = json.loads((tmp_path / "work" / "round-1" / "frame.json").read_text())
    assert patched["hoverThrOut"] == pytest.approx(REAL, rel=0.01)
    assert patched["moment_inertia"][:2] == [pytest.approx(0.02755, rel=0.03)] * 2
    assert "round 0, starting the simulator" in done.stderr
    assert answer["said"] in (tmp_path / "page.html").read_text()
    left = {file.name for file in (tmp_path / "work" / "round-1").iterdir()}
    assert left >= {
        "sim.parm",
        "frame.json",
        "log.bin",
        "simulator.txt",
        "diagnosis.json",
        "diagnosis.html",
        "round.json",
    }
    assert nobody_left()
