"""``python -m bench.small``: what mavcal asks of a small computer; exit 1 if a target is missed.

Measured are the size of what is installed, and the processor time of a start and of the help. So is the memory of an
idle service with one vehicle, and after its first jobs. Memory of the process from which fits are forked is its share
(PSS) once it has loaded all. It measures the environment that it runs in: packages of the extra `dev` that others load
if they are there count too.
"""

from __future__ import annotations

import os
import platform
import re
import sys
import tempfile
import time
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

from bench import startup
from bench.page import machine, shown
from bench.rows import Row, Section
from bench.running import RunningService, service
from bench.scale import sphere
from mavcal.service.simvehicle import SimulatedVehicle

RESIDENT_MB = 120.0
IDLE_S = 20.0
LARGEST = 6
MB = 1e6
_NAME = re.compile(r"[A-Za-z0-9._-]+")


def needed(root: str = "mavcal") -> list[metadata.Distribution]:
    """What the program needs at run time, with what that needs; without extras nobody asked for."""
    found: dict[str, metadata.Distribution] = {}
    waiting = [(root, frozenset[str]())]
    asked: set[tuple[str, frozenset[str]]] = set()
    while waiting:
        name, extras = waiting.pop()
        if (name, extras) in asked:
            continue
        asked.add((name, extras))
        try:
            found[name] = metadata.distribution(name)
        except metadata.PackageNotFoundError:
            continue  # for another system or an older Python
        waiting += _requirements(found[name], extras)
    return list(found.values())


def _requirements(distribution: metadata.Distribution, extras: frozenset[str]) -> Iterator[tuple[str, frozenset[str]]]:
    for line in distribution.requires or ():
        what, _, marker = line.partition(";")
        extra = re.search(r"extra == ['\"]([^'\"]+)['\"]", marker)
        if extra is not None and extra[1] not in extras:
            continue
        name = _NAME.match(what.strip())
        assert name is not None
        asked = re.search(r"\[([^\]]+)\]", what)
        yield _canonical(name[0]), frozenset() if asked is None else frozenset(asked[1].replace(" ", "").split(","))


def _canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def installed_bytes(distribution: metadata.Distribution) -> int:
    """What its files take, compiled ones included; of mavcal itself, the files of the checkout where it is linked."""
    paths = {Path(str(distribution.locate_file(file))) for file in distribution.files or ()}
    total = sum(path.stat().st_size for path in paths if path.is_file())
    if _canonical(distribution.metadata["Name"]) == "mavcal" and total < MB:  # an editable installation
        root = Path(__file__).resolve().parents[1]
        folders = (root / name for name in ("calib", "client", "service", "web"))
        total = sum(path.stat().st_size for folder in folders for path in folder.rglob("*") if path.is_file())
    return total


def _size() -> list[Row]:
    sizes = sorted(((installed_bytes(d), d.metadata["Name"], d.version) for d in needed()), reverse=True)
    total = sum(size for size, _, _ in sizes)
    largest = ", ".join(f"{name} {version} {size / MB:.0f}" for size, name, version in sizes[:LARGEST])
    return [
        Row("installed files of mavcal and what it needs", "", f"{total / MB:.0f} MB in {len(sizes)} packages"),
        Row("- the largest, MB", "", largest),
    ]


def _resident() -> list[Row]:
    with (
        tempfile.TemporaryDirectory(prefix="mavcal-bench-") as folder,
        SimulatedVehicle("ardupilot") as vehicle,
        service(vehicle.url, Path(folder) / "data") as running,
    ):
        found = running.found()
        time.sleep(IDLE_S)
        used = running.processor_s()
        time.sleep(IDLE_S)
        share = (running.processor_s() - used) / IDLE_S
        held = _memory(running.pid)
        calibrated = _after(running, running.client.start_job(found, kind="gyro").id)
        recording = running.client.upload_recording(sphere(), name="sphere.csv").id
        fitted = _after(running, running.client.start_fit(method="mag-ellipsoid", recording=recording).id)
        nursery = sum(_memory(pid)["Pss"] for pid in running.children())
    return [
        Row(
            "resident memory, idle, one vehicle",
            f"<= {RESIDENT_MB:.0f} MB",
            f"{held['Rss']:.0f} MB, {held['Anonymous']:.0f} MB of it its own",
            held["Rss"] <= RESIDENT_MB,
        ),
        Row("- after the calibration of its gyroscope", "", calibrated),
        Row(
            "- after the fit of an upload",
            "",
            f"{fitted}, and {nursery:.0f} MB of the process from which fits are forked",
        ),
        Row("processor, idle, one vehicle", "", f"{share:.1%} of a core"),
    ]


def _after(running: RunningService, job: str) -> str:
    """Resident memory some time after a job."""
    state = running.rested(job)
    if state not in {"review", "succeeded"}:
        raise RuntimeError(f"the job {job} ended as {state}")
    time.sleep(IDLE_S / 2)
    return f"{_memory(running.pid)['Rss']:.0f} MB"


def _memory(pid: int) -> dict[str, float]:
    """MB by kind, of a process (Linux: smaps_rollup)."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()[1:]
    return {name: int(rest.split()[0]) * 1024 / MB for name, _, rest in (line.partition(":") for line in lines)}


def run() -> Section:
    """Everything in one section."""
    rows = [*_size(), *_resident(), *startup.run().rows]
    return Section(
        "A small computer",
        tuple(rows),
        (f"Python {platform.python_version()} on {platform.machine()}, {os.cpu_count()} cores.",),
    )


def main() -> int:
    section = run()
    print(shown(section))
    print(machine())
    return 0 if section.met else 1


if __name__ == "__main__":
    sys.exit(main())
