"""Which rounds a firmware goes through."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from bench.firmware.arducopter import ArduCopter, drifting
from bench.firmware.px4 import Px4
from bench.firmware.rounds import Fault, Round, running
from bench.firmware.scoring import Row
from bench.firmware.truth import drawn
from mavcal.service.jobs.crashpoints import At

Report = Callable[[Row], None]
NOISES_MGAUSS = (0.0, 3.0)
TESTED = ("gyro", "accel", "level", "mag")

KILLS = ((At.BEFORE_SEND, 1), (At.AFTER_ECHO, 2), (At.READ_BACK, 1))

PX4_FAULTS = (Fault("accelerometer 1 is 1 m/s2 off", {"CAL_ACC0_XOFF": 1.4}, "accel", "accelerometer"),)

ARDUPILOT_FAULTS = (
    Fault("compass 2 dead", {"SIM_MAG2_FAIL": 1}, "mag", "compass 2"),
    Fault("compass 3 dead", {"SIM_MAG3_FAIL": 1}, "mag", "compass 3"),
    Fault("gyroscope 2 frozen", {"SIM_GYR_FAIL_MSK": 2}, "gyro", "gyroscope 2"),
    Fault("accelerometer 2 is 1 m/s2 off", {"INS_ACC2OFFS_X": 1.4}, "accel", "accelerometer 2"),
    Fault("declination of 34 deg", {"COMPASS_DEC": 0.6, "COMPASS_AUTODEC": 0}, "", ""),
)


def arducopter(binary: Path, folder: Path, seed: int, instance: int, only: Sequence[str], report: Report) -> None:
    """Every round of ArduCopter with these errors."""
    for number, noise in enumerate(NOISES_MGAUSS):
        kinds = [kind for kind in TESTED if kind in only]
        if kinds or "preflight" in only or "kills" in only:
            truth = drawn(10 * seed + number, 2, 3)
            home = _fresh(folder / f"noise-{noise:g}")
            rig = ArduCopter(binary, home, truth, instance, noise_mgauss=noise)
            with running(rig):
                fresh = Round(f"factory, {noise:g} mG", rig, home / "data", report)
                fresh.folder.mkdir()
                fresh.calibrations(kinds)
                fresh.stays([n for n in truth.parameters("ardupilot") if "GYR" not in n])
                if kinds:
                    again = Round(f"on an older one, {noise:g} mG", rig, fresh.folder, report)
                    again.aged()
                    again.taken_back(kinds[-1])
                    again.calibrations(kinds)
                if "kills" in only:
                    for point, occurrence in KILLS:
                        fresh.recovered(point, occurrence)
                if "preflight" in only and len(kinds) == len(TESTED):
                    rig.restart()
                    fresh.preflight(None)
                    for fault in ARDUPILOT_FAULTS:
                        fresh.preflight(fault)
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
    with running(Px4(build, home, truth, instance)) as rig:
        fresh = Round("factory", rig, home / "data", report)
        fresh.folder.mkdir()
        kinds = [kind for kind in TESTED if kind in only]
        rig.quick_calibrated()
        fresh.calibrations(kinds)
        fresh.stays([n for n in truth.parameters("px4") if "GYRO" not in n])
        if kinds:
            again = Round("on an older one", rig, fresh.folder, report)
            again.aged()
            again.taken_back(kinds[-1])
            again.calibrations(kinds)
        if "kills" in only:
            for point, occurrence in KILLS:
                fresh.recovered(point, occurrence)
        if "preflight" in only and len(kinds) == len(TESTED):
            rig.restart()
            fresh.preflight(None)
            for fault in PX4_FAULTS:
                fresh.preflight(fault)
        if "thermal" in only:
            rig.drift()
            fresh.calibrations(["thermal"])


def _fresh(folder: Path) -> Path:
    folder.mkdir(parents=True)
    return folder
