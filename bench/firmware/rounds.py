"""The rounds: what is done one after the other with one vehicle, and what should come of each step."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from bench.firmware.arducopter import ArduCopter, drifting
from bench.firmware.jobs import Done, calibrated, command
from bench.firmware.px4 import Px4
from bench.firmware.scoring import Row, scored
from bench.firmware.truth import drawn, own_temperatures, thermal_truth
from bench.running import service
from mavcal.client.enums import JobState
from mavcal.client.jobs import JobModel
from mavcal.service.jobs.core.crashpoints import At
from mavcal.service.lifetime import ending_with_us
from mavcal.service.simvehicle import Operator

KINDS: Final = ("gyro", "accel", "level", "mag", "thermal", "kills", "preflight")
SETTLED_S: Final = 4.0
COLD_C, WARM_C, TAU_S, SPAN_C = 12.0, 62.0, 55.0, 40.0
TUMBLE_DPS = 55.0
KILL_S: Final = 300.0
HABITS: Final[Mapping[str, tuple[str, int]]] = {"ardupilot": ("INS_GYR_CAL", 0), "px4": ("IMU_GYRO_CAL_EN", 0)}
"""What the firmware does with its gyroscopes by itself, switched off."""


Rig = ArduCopter | Px4
"""A firmware whose sensors, attitude and temperature are ours."""


@dataclass(frozen=True)
class Broken:
    """A sensor of PX4's bench source that says nothing any more, or always the same."""

    sensor: str
    instance: int
    how: Literal["dead", "frozen"]

    def change(self, *, broken: bool) -> dict[str, Any]:
        """The request to the source that breaks the sensor, or mends it."""
        return {"sensor": self.sensor, "instance": self.instance, "change": {self.how: broken}}


@dataclass(frozen=True)
class Fault:
    """One thing that is made wrong before a preflight, and what should be said of it."""

    name: str
    change: Mapping[str, float] = field(default_factory=dict)
    fails: str = ""
    """Part of the id of a check that has to fail; empty: any."""
    blames: str = ""
    """What the reasons have to name."""
    sensor: Broken | None = None


@dataclass
class Round:
    """A vehicle and mavcal's data directory, from a fresh firmware on."""

    name: str
    rig: Rig
    folder: Path
    report: Callable[[Row], None]

    def calibrations(self, kinds: Sequence[str]) -> list[Done]:
        """Each kind through a service of its own, as on different days."""
        ended = []
        for kind in kinds:
            operator = Operator(
                self.rig, warm_from=COLD_C, warm_to=WARM_C, warm_tau_s=TAU_S, tumble_dps=TUMBLE_DPS, ramp_tau_s=8.0
            )
            options = {"span": SPAN_C} if kind == "thermal" else {}
            if kind == "thermal":
                self.rig.call("temperature", value=COLD_C)  # no unit cools in an instant
                time.sleep(SETTLED_S)
            names = own_temperatures(self.rig.autopilot, self.rig.truth)
            taken = {name: held for name in names if (held := self.rig.read(name)) is not None}
            with service(self.rig.url, self.folder) as running:
                done = calibrated(running.client, operator, kind, options)
            self.report(scored(self.rig.autopilot, self.name, done, self._truth(done.job, taken), self.rig.read))
            ended.append(done)
        return ended

    def aged(self) -> None:
        """An older calibration in force, and no habit of the firmware that would mend its gyroscopes."""
        rng = np.random.default_rng([41, self.rig.truth.seed])
        self.rig.set(*HABITS[self.rig.autopilot])
        time.sleep(SETTLED_S)  # until it is saved
        self.rig.restart()
        for name, true in self.rig.truth.parameters(self.rig.autopilot).items():
            if self.rig.read(name) is not None:
                self.rig.set(
                    name, float(np.float32(true + _aging(name) * rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.0)))
                )
        time.sleep(SETTLED_S)
        self.rig.restart()

    def stays(self, ended: Sequence[Done]) -> None:
        """Restart the vehicle: what these jobs wrote must still be there, but for what it calibrates at its start."""
        written = {
            change.name: float(change.new)
            for done in ended
            if done.job.state == JobState.SUCCEEDED and done.job.plan is not None
            for change in done.job.plan.changes
            if "GYR" not in change.name and not change.session
        }
        began = time.monotonic()
        self.rig.restart()
        after = {name: self.rig.read(name) for name in written}
        lost = tuple(f"{n} was {written[n]}, is {after[n]}" for n in written if after[n] != written[n])
        self.report(self._row("restart", "kept" if not lost else "lost", began, lost, right=not lost))

    def taken_back(self, kind: str) -> None:
        """A calibration and its `revert`: every value is the one of before."""
        before = {name: self.rig.read(name) for name in self.rig.truth.parameters(self.rig.autopilot)}
        done = self.calibrations([kind])[0]
        began = time.monotonic()
        code, _, said = command("revert", done.job.id, "--connect", self.rig.url, "--data-dir", str(self.folder))
        after = {name: self.rig.read(name) for name in before}
        wrong = tuple(
            f"{name} holds {after[name]} instead of {old}" for name, old in before.items() if after[name] != old
        )
        self.report(self._row(f"revert {kind}", f"exit {code}", began, wrong, right=code == 0, said=said))

    def recovered(self, point: At, occurrence: int) -> None:
        """A calibration that is killed in mid-write, then `recover`: all old values or all new ones."""
        began = time.monotonic()
        truth = self.rig.truth.parameters(self.rig.autopilot)
        names = [n for n in truth if "GYR" in n and "OFF" in n and self.rig.read(n) is not None]
        for name in names:  # something to write
            self.rig.set(name, float(np.float32(truth[name] + _aging(name))))
        time.sleep(SETTLED_S)
        before = {name: self.rig.read(name) for name in names}
        arguments = ["calibrate", "gyro", "--apply", "--connect", self.rig.url, "--data-dir", str(self.folder)]
        killer = [sys.executable, "-m", "bench.campaign.cli_process", str(point), str(occurrence)]
        died = _killed([*killer, *arguments])
        code, document, said = command("recover", "--connect", self.rig.url, "--data-dir", str(self.folder))
        states = [str(job.get("state")) for job in document.get("recovered", [])]
        after = {name: self.rig.read(name) for name in names}
        unchanged, changed = after == before, all(after[n] != before[n] for n in names)
        untrue = () if unchanged or changed else (f"a mixture of old and new: {after}",)
        if "reverted" in states and not unchanged:
            untrue += (f"reverted, but {after} is not {before}",)
        untrue += died
        self.report(
            self._row(
                f"kill at {point} {occurrence}",
                ", ".join(states) or "nothing",
                began,
                untrue,
                said=said,
                right=code == 0,
            )
        )

    def preflight(self, fault: Fault | None, *, well_s: float = SETTLED_S) -> None:
        """A preflight of the vehicle as it is, or with one fault."""
        began = time.monotonic()
        broken = fault.sensor if fault else None
        if broken is not None:
            self.rig.call("set", **broken.change(broken=True))
        old = {name: self.rig.read(name) for name in (fault.change if fault else {})}
        for name, value in (fault.change if fault else {}).items():
            self.rig.set(name, value)
        time.sleep(well_s)
        code, document, said = command("preflight", "--connect", self.rig.url, "--data-dir", str(self.folder))
        for name, value in old.items():
            if value is not None:
                self.rig.set(name, value)
        if broken is not None:
            self.rig.call("set", **broken.change(broken=False))
        time.sleep(well_s)
        checks = document.get("checks", [])
        failed = [c for c in checks if c["verdict"] != "pass"]
        told = "; ".join(f"{c['id']}: {c['verdict']}: {c['reason']}" for c in failed) or document.get("summary", said)
        if fault is None:
            untrue, right = tuple(f"{c['id']}: {c['reason']}" for c in failed), code == 0
        else:
            right = any(fault.fails in c["id"] and fault.blames in c["reason"].lower() for c in failed)
            untrue = () if right else (f"{fault.name} passes as: {told}",)
        name = f"preflight: {fault.name if fault else 'healthy'}"
        self.report(self._row(name, f"exit {code}", began, untrue, right=right, said=told))

    def _truth(self, job: JobModel, taken: Mapping[str, float]) -> dict[str, float]:
        """True value by name; of a thermal job about the temperatures of its plan, or those of before."""
        found = self.rig.truth.parameters(self.rig.autopilot)
        planned = {c.name: float(c.new) for c in job.plan.changes} if job.plan is not None else {}
        if job.kind != "thermal":
            return found
        return found | thermal_truth(self.rig.autopilot, self.rig.truth, {**taken, **planned})

    def _row(
        self, step: str, ended: str, began: float, untrue: tuple[str, ...], *, right: bool = True, said: str = ""
    ) -> Row:
        seconds = time.monotonic() - began
        return Row(self.rig.autopilot, self.name, step, ended, "", (), "", seconds, untrue, said, right)


@contextmanager
def running(rig: Rig) -> Iterator[Rig]:
    """The firmware, ended with the block."""
    try:
        rig.start()
        yield rig
    finally:
        rig.stop()


def _killed(command: Sequence[str]) -> tuple[str, ...]:
    """Run what kills itself; what it did instead, if it did not."""
    none = subprocess.DEVNULL
    try:
        done = subprocess.run(
            command, stdin=none, capture_output=True, text=True, timeout=KILL_S, env=ending_with_us(), check=False
        )
    except subprocess.TimeoutExpired:
        return (f"it was not killed within {KILL_S:g} s",)
    if done.returncode == -signal.SIGKILL:
        return ()
    return (f"it ended with {done.returncode} before it was killed: {done.stderr[-300:]}",)


def _aging(name: str) -> float:
    """How far an older calibration is off, in the unit of that parameter."""
    if "ACC" in name:
        return 0.3 if "OFF" in name else 0.02
    if "GYR" in name:
        return 0.02
    if name.startswith("COMPASS_OFS"):
        return 60.0
    return 0.06 if "OFF" in name else 0.04


Report = Callable[[Row], None]
NOISES_MGAUSS = (0.0, 3.0)
TESTED = ("gyro", "accel", "level", "mag")

KILLS = ((At.BEFORE_SEND, 1), (At.AFTER_ECHO, 2), (At.READ_BACK, 1))

PX4_FAULTS = (
    Fault("accelerometer 1 is 1 m/s2 off", {"CAL_ACC0_XOFF": 1.4}, "parameters", "cal_acc0_xoff"),
    Fault("compass 1 is 0.5 G off", {"CAL_MAG0_XOFF": 0.5}, "parameters", "cal_mag0_xoff"),
    Fault("compass 1 dead", sensor=Broken("mag", 0, "dead"), fails="sensors_heard", blames="compass 1"),
    Fault("gyroscope 1 frozen", sensor=Broken("gyro", 0, "frozen"), fails="sensors_heard", blames="gyroscope 1"),
    Fault("accelerometer 1 dead", sensor=Broken("accel", 0, "dead"), fails="", blames="accelerometer"),
)

ARDUPILOT_FAULTS = (
    Fault("compass 2 dead", {"SIM_MAG2_FAIL": 1}, "sensors_heard", "compass 2"),
    Fault("compass 3 dead", {"SIM_MAG3_FAIL": 1}, "sensors_heard", "compass 3"),
    Fault("gyroscope 2 frozen", {"SIM_GYR_FAIL_MSK": 2}, "sensors_heard", "gyroscope 2"),
    Fault("accelerometer 2 is 1 m/s2 off", {"INS_ACC2OFFS_X": 1.4}, "accel", "accelerometer 2"),
    Fault("declination of 34 deg", {"COMPASS_DEC": 0.6, "COMPASS_AUTODEC": 0}, "compass", "declination"),
)


def arducopter(binary: Path, folder: Path, seed: int, instance: int, only: Sequence[str], report: Report) -> None:
    """Every round of ArduCopter with these errors."""
    for number, noise in enumerate(NOISES_MGAUSS):
        truth = drawn(10 * seed + number, 2, 3)
        home = _fresh(folder / f"noise-{noise:g}")
        # A compass without noise reads one value at rest, dead or alive: no preflight can pass it.
        asked = [kind for kind in only if noise or kind != "preflight"]
        with running(ArduCopter(binary, home, truth, instance, noise_mgauss=noise)) as rig:
            _on_one_vehicle(Round(f"factory, {noise:g} mG", rig, home / "data", report), asked, ARDUPILOT_FAULTS)
    if "thermal" in only:
        truth = drawn(10 * seed + 5, 2, 1)
        home = _fresh(folder / "thermal")
        rig = ArduCopter(binary, home, truth, instance, noise_mgauss=0.0)
        with (home / "defaults.parm").open("a") as defaults:
            defaults.writelines(f"{name} {value:.9g}\n" for name, value in drifting(truth, 5.0, 65.0).items())
        with running(rig):
            Round("factory", rig, home, report).calibrations(["thermal"])


def px4(build: Path, folder: Path, seed: int, instance: int, only: Sequence[str], report: Report) -> None:
    """Every round of PX4 with these errors."""
    truth = drawn(100 + seed, 1, 1)
    home = _fresh(folder)
    rig = Px4(build, home, truth, instance)
    with running(rig):
        rig.quick_calibrated()
        fresh = Round("factory", rig, home / "data", report)
        _on_one_vehicle(fresh, only, PX4_FAULTS)
        if "thermal" in only:
            rig.drift()
            fresh.calibrations(["thermal"])


def _on_one_vehicle(fresh: Round, only: Sequence[str], faults: Sequence[Fault]) -> None:
    """Every calibration from the factory's values and on an older one, undo, kills and preflights."""
    fresh.folder.mkdir()
    rig, kinds = fresh.rig, [kind for kind in TESTED if kind in only]
    ended = fresh.calibrations(kinds)
    if kinds:
        fresh.stays(ended)
        again = replace(fresh, name=fresh.name.replace("factory", "on an older one"))
        again.aged()
        again.taken_back(kinds[-1])
        again.calibrations(kinds)
    if "kills" in only:
        rig.restart()
        for point, occurrence in KILLS:
            fresh.recovered(point, occurrence)
    if "preflight" in only and len(kinds) == len(TESTED):
        rig.restart()
        fresh.preflight(None)
        for fault in faults:
            rig.restart()  # an estimator remembers what a fault has taught it
            fresh.preflight(fault)


def _fresh(folder: Path) -> Path:
    folder.mkdir(parents=True)
    return folder
