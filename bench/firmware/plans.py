"""Which rounds a firmware goes through."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from bench.firmware.arducopter import ArduCopter, drifting
from bench.firmware.px4 import Px4
from bench.firmware.rounds import Broken, Fault, Round, running
from bench.firmware.scoring import Row
from bench.firmware.truth import drawn
from mavcal.service.jobs.crashpoints import At

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
