"""Live commands in a row on one simulated vehicle, and what each says: recorded once, and compared ever after.

`python -m tests.service.golden_cli NAME...` records scenarios again. Numbers, ids and places are left out of what is
kept, and so is what depends on the clock: progress, and the lines for those who wait.
"""

from __future__ import annotations

import io
import json
import logging
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import structlog

from bench.running import RunningService, service
from mavcal.service.cli import main
from mavcal.service.simvehicle import SimulatedVehicle

FOLDER = Path(__file__).with_name("golden")
COUNTED = frozenset({"plan", "results", "verification", "checks", "progress", "segments"})
"""What samples decide: of these parts only names and types are kept."""
MOMENTARY = frozenset({"silent", "writable", "obstacles", "evidence", "texts"})
"""What an instant decides: nothing is kept but the name."""
_UNTIMELY = re.compile(r"^ +\d+%|still looking|^waiting up to|> The vehicle is silent|^\d{4}-\d\d-\d\d|^\{")
_CHANGE = re.compile(r"^    [A-Z0-9_]+ +\S+ -> ")
_NUMBER = re.compile(r"(?<![\w.])[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w])")
_ID = re.compile(r"\b[0-9a-f]{12}(?:[0-9a-f]{4})?\b|\b\d{8}T\d+Z\b")

Step = dict[str, Any]


@dataclass
class Run:
    """A vehicle, a place, and what was said so far."""

    sim: SimulatedVehicle
    place: tuple[str, ...]
    hidden: dict[str, str]
    data_dir: str = ""
    """Where everything is kept, by this process or by the service."""
    steps: list[Step] = field(default_factory=list)
    last: str = ""
    """The job that was told last."""

    def __call__(self, *words: str, place: Sequence[str] | None = None, text: bool = False) -> Any:
        """One command; ``JOB`` among the words is the job that was told last."""
        said = [self.last if word == "JOB" else word for word in words]
        json_too = () if text else ("--json",)
        code, out, err = mavcal(*said, *(self.place if place is None else place), *json_too)
        told = None if text else json.loads(out)
        if told is not None and isinstance(told.get("id"), str) and "kind" in told:
            self.last = told["id"]
        self.steps.append(
            {
                "command": " ".join(self._plain(word) for word in words) + (" (text)" if text else ""),
                "code": code,
                "out": [self._plain(line) for line in out.splitlines()] if told is None else self._shape(told),
                "said": self._said(err),
            }
        )
        return told

    @property
    def without_vehicle(self) -> tuple[str, ...]:
        """The place without a vehicle."""
        return self.place if "--url" in self.place else ("--data-dir", self.data_dir)

    def first_log(self) -> str:
        """A copy of what was recorded so far: a service goes on with its file."""
        tlogs = Path(self.data_dir) / "tlogs"
        return str(shutil.copy(min(tlogs.glob("*.tlog")), tlogs.parent / "first.tlog"))

    def shifted(self, by: float) -> None:
        """Every gyro reads so much more from now on, rad/s, which the next calibration writes and proves."""
        for instance in range(3):
            self.sim.call("add", sensor="gyro", instance=instance, by=[by, by, by])

    def _said(self, text: str) -> list[str]:
        lines = [line for line in text.splitlines() if line.strip() and not _UNTIMELY.search(line)]
        return [self._plain(line) for line in lines if not _CHANGE.match(line) and not line.startswith("    note: ")]

    def _plain(self, text: str) -> str:
        for place, name in self.hidden.items():
            text = text.replace(place, name)
        return _NUMBER.sub("#", _ID.sub("<id>", text))

    def _shape(self, found: Any, *, counted: bool = False) -> Any:
        if isinstance(found, dict):
            return {
                name: "..." if name in MOMENTARY else self._shape(value, counted=counted or name in COUNTED)
                for name, value in found.items()
            }
        if isinstance(found, list):
            shapes = [self._shape(value, counted=counted) for value in found]
            return [shape for n, shape in enumerate(shapes) if shape not in shapes[:n]] if counted else shapes
        if isinstance(found, bool | None):
            return "..." if counted else found
        if isinstance(found, str):
            return "..." if counted else self._plain(found)
        return type(found).__name__


def mavcal(*arguments: str) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a command in this process."""
    handlers = len(logging.getLogger().handlers)
    out, err = io.StringIO(), io.StringIO()
    code: object = None
    try:
        with redirect_stdout(out), redirect_stderr(err):
            main(arguments)
    except SystemExit as ended:
        code = ended.code
    finally:
        structlog.reset_defaults()
        for handler in logging.getLogger().handlers[handlers:]:
            logging.getLogger().removeHandler(handler)
    return int(str(code or 0)), out.getvalue(), err.getvalue()


@contextmanager
def _vehicle(autopilot: str = "ardupilot", **config: Any) -> Iterator[SimulatedVehicle]:
    keeps = {"ardupilot": {"INS_GYR_CAL": 0}, "px4": {"IMU_GYRO_CAL_EN": 0}}[autopilot]
    given = {"thermal": False, "parameters": keeps, **config}
    with SimulatedVehicle(autopilot, seed=11, speed=20, config=given) as sim:
        sim.call("still")
        yield sim


@contextmanager
def _beside(autopilot: str = "ardupilot", **config: Any) -> Iterator[Run]:
    """A vehicle, and a data directory of this process."""
    with tempfile.TemporaryDirectory() as folder, _vehicle(autopilot, **config) as sim:
        yield Run(sim, ("--connect", sim.url, "--data-dir", folder), {sim.url: "<vehicle>", folder: "<dir>"}, folder)


@contextmanager
def _served(autopilot: str = "ardupilot", **config: Any) -> Iterator[tuple[Run, RunningService]]:
    """A vehicle, and a service that runs elsewhere."""
    with tempfile.TemporaryDirectory() as folder, _vehicle(autopilot, **config) as sim:
        data_dir = Path(folder) / "data"
        with service(sim.url, data_dir) as found:
            found.found()
            hidden = {sim.url: "<vehicle>", str(data_dir): "<dir>", folder: "<dir>", found.url: "<service>"}
            yield Run(sim, ("--url", found.url), hidden, str(data_dir)), found


@contextmanager
def _through_service(autopilot: str = "ardupilot", **config: Any) -> Iterator[Run]:
    with _served(autopilot, **config) as (run, _):
        yield run


Opened = Callable[..., AbstractContextManager[Run]]
WAYS: dict[str, Opened] = {"--connect": _beside, "--url": _through_service}


def looked_at(opened: Opened) -> list[Step]:
    """What a vehicle is asked for without a calibration."""
    with opened() as run:
        run("status")
        run("preflight")
        run("recover")
        run("recover", text=True)
        run("restore")
        run("accept", "nojob")
        run("revert", "nojob")
        run("calibrate", "gyro", "--option", "colour=1")
        run("calibrate", "gyro", "--only", "mag0")
        run("revert", "--all")
        run("campaign", "preflight")
        run("campaign", "preflight", "--vehicle", "nobody")
        run.sim.call("arm")
        run("calibrate", "gyro")
        run("calibrate", "gyro", text=True)
        run("preflight")
        run("preflight", text=True)
        run("preflight", "--all")
        run("status", "--all")
        return run.steps


def silent() -> list[Step]:
    """No vehicle, or no endpoint."""
    with tempfile.TemporaryDirectory() as folder:
        run = Run(None, (), {folder: "<dir>"})  # type: ignore[arg-type]
        (Path(folder) / "rest.csv").write_text("t,gyro_x,gyro_y,gyro_z\n0,0,0,0\n")
        kept = ("--data-dir", folder)
        for url in ("udpin:127.0.0.1:0", "bogus", "tcp:127.0.0.1:1"):
            place = ("--connect", url, "--wait", "1", *kept)
            for words in (
                *(("status",), ("preflight",), ("preflight", "--all"), ("calibrate", "gyro"), ("restore",)),
                *(("accept", "nojob"), ("revert", "nojob"), ("revert", "--all"), ("recover",)),
                *(("campaign", "preflight"), ("campaign", "calibrate", "gyro")),
                ("plan", "gyro-rest", str(Path(folder) / "rest.csv")),
            ):
                run(*words, place=place)
            run("status", place=place, text=True)
        for words in (("status", "--all"), ("preflight", "--all"), ("campaign", "resume", "nojob")):
            run(*words, place=kept)
        return run.steps


def calibrated(opened: Opened) -> list[Step]:
    """A calibration planned, accepted, taken back, made again and restored."""
    with opened() as run:
        run("calibrate", "gyro")
        log = run.first_log()
        run("accept", "JOB")
        run("accept", "JOB")
        run("revert", "JOB")
        run("revert", "JOB")
        run.shifted(0.02)
        run("calibrate", "gyro", "--apply", "--option", "uncertainty=0.02", "--require-proof")
        run.shifted(-0.02)
        run("calibrate", "gyro", "--apply", text=True)
        run("restore", "--apply")
        run("status")
        run("plan", "gyro-rest", log)
        run("revert", "--all")
        run("jobs", place=run.without_vehicle, text=True)
        return run.steps


def px4(opened: Opened) -> list[Step]:
    """Another autopilot, long after its start."""
    with opened("px4") as run:
        run.sim.wait(120.0)
        run("status")
        run.shifted(0.02)
        run("calibrate", "gyro", "--apply")
        run("status")
        return run.steps


def every(opened: Opened) -> list[Step]:
    """What is done of every vehicle."""
    with opened() as run:
        run("preflight", "--fix", "gyro", "--apply")
        run.shifted(0.02)
        run("calibrate", "gyro", "--all", "--apply")
        run.shifted(-0.02)
        run("calibrate", "gyro", "--all", "--apply", text=True)
        run("status", "--all", text=True)
        run("revert", "--all", text=True)
        return run.steps


def campaigns(opened: Opened) -> list[Step]:
    """One campaign after the other."""
    with opened() as run:
        told = run("campaign", "preflight")
        run("campaign", "items", told["id"], place=run.without_vehicle)
        run("campaign", "items", told["id"], "--outcome", "refused", place=run.without_vehicle, text=True)
        run("campaign", "items", told["id"], "--outcome", "done", place=run.without_vehicle)
        run("campaign", "items", "nojob", place=run.without_vehicle)
        run("campaign", "calibrate", "gyro")
        run("campaign", "calibrate", "gyro", "--apply", "--at-once", "1")
        run("campaign", "calibrate", "gyro", "--option", "colour=1")
        run.shifted(0.02)
        run("campaign", "calibrate", "gyro", "--apply", text=True)
        run("campaign", "resume", told["id"], place=run.without_vehicle)
        run("campaign", "resume", told["id"])
        run("campaign", "resume", "nojob")
        return run.steps


def remote() -> list[Step]:
    """Commands that ask a running service."""
    with _served() as (run, found):
        run("fleet", text=True)
        run.last = found.client.start_job(found.found(), kind="gyro").id
        run("follow", "JOB")
        run("follow", "JOB", text=True)
        run("accept", "JOB")
        run("accept", "JOB")
        run("accept", "JOB", text=True)
        run("revert", "JOB")
        run("revert", "JOB")
        run("revert", "nojob")
        run("cancel", "JOB")
        run("answer", "JOB", "finish")
        run("follow", "nojob")
        run("jobs", text=True)
        run("jobs")
        run.sim.call("arm")
        run.last = found.client.list_jobs()[0].id
        run("accept", "JOB")
        return run.steps


SCENARIOS: dict[str, Callable[[], list[Step]]] = {made.__name__: made for made in (silent, remote)}
BOTH_WAYS: dict[str, Callable[[Opened], list[Step]]] = {
    made.__name__: made for made in (looked_at, calibrated, px4, every, campaigns)
}
"""Told in one file for both ways: what differs with ``--url`` stands in a second one, and why in :data:`DIFFERENT`."""
_OTHERS = "a service is shared: every write of a vehicle may be somebody else's, so that --all is refused there"
_CODE = "the API has one code for invalid input, the application in the command's process tells the class"
_WHO = "a service keeps who asked by the name of the key"
_AT_ONCE = "the vehicle is that of the job, which is asked for first"
DIFFERENT: dict[str, dict[str, str]] = {
    "looked_at": {
        "accept nojob": _AT_ONCE,
        "revert nojob": _AT_ONCE,
        "calibrate gyro --option colour=#": _CODE,
        "calibrate gyro --only mag0": _CODE,
        "revert --all": _OTHERS,
        "campaign preflight --vehicle nobody": "the vehicles of a service are told with their system ids",
    },
    "calibrated": {
        "revert --all": _OTHERS,
        "jobs (text)": "what `revert --all` did not take back",
    },
    "px4": {},
    "every": {"revert --all (text)": _OTHERS},
    "campaigns": {
        "campaign items <id>": "HTTP tells neither how often an item was begun nor what the fleet keeps of a preflight",
        "campaign items nojob": "a service has many kinds of jobs, and this is none of them",
        "campaign calibrate gyro": _WHO,
        "campaign calibrate gyro --apply --at-once #": _WHO,
        "campaign calibrate gyro --option colour=#": _CODE,
        "campaign resume nojob": "without a vehicle the data directory of the command is named in place of the service",
    },
}
"""Commands that say something else with ``--url``, and why."""


def differences(by_url: Sequence[Step], by_connect: Sequence[Step]) -> dict[str, Step]:
    """Those steps through a service that say something else, by their place.

    That the next command is named with its own way is no difference.
    """
    pairs = enumerate(zip(by_url, by_connect, strict=True))
    return {str(n): there for n, (there, here) in pairs if _placed(there) != _placed(here)}


def _placed(step: Step) -> str:
    text = json.dumps(step, ensure_ascii=False, sort_keys=True)
    return (
        text.replace(" --connect <vehicle>", " <place>")
        .replace(" --data-dir <dir>", "")
        .replace(" --url <service>", " <place>")
    )


def by_url(name: str) -> Path:
    """The file of what differs with ``--url``."""
    return FOLDER / f"{name}_by_url.json"


def record(names: Sequence[str]) -> None:
    """Write what the commands say now as what they are to say."""
    for name in names or [*SCENARIOS, *BOTH_WAYS]:
        if name in SCENARIOS:
            _keep(FOLDER / f"{name}.json", SCENARIOS[name]())
            continue
        told = {way: BOTH_WAYS[name](opened) for way, opened in WAYS.items()}
        _keep(FOLDER / f"{name}.json", told["--connect"])
        _keep(by_url(name), differences(told["--url"], told["--connect"]))


def _keep(path: Path, found: Any) -> None:
    path.write_text(f"{json.dumps(found, indent=1, ensure_ascii=False)}\n", encoding="utf-8")


if __name__ == "__main__":
    record(sys.argv[1:])
