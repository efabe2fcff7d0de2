"""Memory of the service over an hour of streaming while a job captures all of it."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.rows import Row, Section
from bench.running import RunningService, service
from service.simvehicle.client import SimulatedVehicle

SPEED = 30.0
HOUR_S = 3600.0
PERIOD_S = 1.0
SETTLED_SHARE = 0.25
"""The first part of the run, in which caches fill, does not count for the slope."""
MOST_GROWTH = 0.05
"""Growth over an hour that is called flat, as a share of the memory at its start."""
WALL_LIMIT_S = 480.0
WARM_UP = {"start": 22.0, "end": 70.0, "tau_s": 2000.0}
"""Slow enough that the temperature still moves after an hour, and the job never reaches its span."""
SPAN_C = 100.0
MIB = 2.0**20


@dataclass(frozen=True)
class Reading:
    """Memory at a time of the vehicle's clock; `state` is that of the job."""

    vehicle_s: float
    resident: int
    tlog: int


def growth(readings: Sequence[Reading]) -> float:
    """Slope of the memory after it has settled, bytes per second of the vehicle's clock; least squares."""
    t = np.array([reading.vehicle_s for reading in readings])
    late = t >= t[0] + SETTLED_SHARE * (t[-1] - t[0])
    resident = np.array([reading.resident for reading in readings], dtype=float)
    return float(np.polyfit(t[late], resident[late], 1)[0])


def run(vehicle_s: float = HOUR_S) -> Section:
    """Measure an hour of the vehicle's clock."""
    rows: list[Row] = []
    notes: list[str] = []
    for kind, options in (("thermal", {"span": SPAN_C}), (None, {})):
        readings, said = _watched(kind, options, vehicle_s)
        found, note = _judged(kind, readings)
        rows += found
        notes += [note, *said]
    return Section("Memory over an hour of streaming", tuple(rows), tuple(notes))


def _watched(kind: str | None, options: dict[str, float], vehicle_s: float) -> tuple[list[Reading], list[str]]:
    with (
        tempfile.TemporaryDirectory(prefix="mavcal-bench-") as folder,
        SimulatedVehicle(
            "ardupilot", speed=SPEED, config={"temperature": WARM_UP["start"], "parameters": {"INS_GYR_CAL": 0}}
        ) as vehicle,
        service(vehicle.url, Path(folder) / "data") as running,
    ):
        vehicle_id = running.found()
        said = []
        job = None
        if kind is not None:
            vehicle.call("warm_up", **WARM_UP)
            job = running.client.post(f"/vehicles/{vehicle_id}/jobs", {"kind": kind, "options": options})["id"]
            _until_captures(running, job)
        readings = _sampled(vehicle, running, vehicle_s)
        page = running.client.get(f"/vehicles/{vehicle_id}")
        said.append(f"{page['received']} frames, {page['lost']} lost ({kind or 'no'} job).")
        if job is not None:
            state = running.client.get(f"/jobs/{job}")
            said.append(f"The {kind} job at the end: {state['state']}, {state['progress']}, {state['outcome']}")
            running.client.delete(f"/jobs/{job}")
    return readings, said


def _until_captures(running: RunningService, job: str) -> None:
    until = time.monotonic() + 60.0
    while running.client.get(f"/jobs/{job}")["progress"] is None:
        if time.monotonic() > until:
            raise RuntimeError(f"the job does not capture: {running.client.get(f'/jobs/{job}')}")
        time.sleep(0.1)


def _sampled(vehicle: SimulatedVehicle, running: RunningService, vehicle_s: float) -> list[Reading]:
    readings: list[Reading] = []
    until = time.monotonic() + WALL_LIMIT_S
    began = vehicle.state()["time"]
    while (now := vehicle.state()["time"] - began) <= vehicle_s and time.monotonic() < until:
        readings.append(Reading(now, running.resident_bytes(), running.tlog_bytes()))
        time.sleep(PERIOD_S)
    return readings


def _judged(kind: str | None, readings: Sequence[Reading]) -> tuple[list[Row], str]:
    first, last = readings[0], readings[-1]
    per_hour = growth(readings) * HOUR_S
    share = per_hour / first.resident
    what = f"{kind} job capturing" if kind else "link and vehicle alone"
    hours = (last.vehicle_s - first.vehicle_s) / HOUR_S
    rows = [
        Row(
            f"growth, {what}",
            f"<= {MOST_GROWTH:.0%} in an hour",
            f"{share:+.1%} ({per_hour / MIB:+.1f} MiB)",
            share <= MOST_GROWTH,
        ),
        Row(
            f"resident, {what}",
            "",
            f"start {first.resident / MIB:.0f}, end {last.resident / MIB:.0f}, "
            f"largest {max(r.resident for r in readings) / MIB:.0f} MiB",
        ),
    ]
    note = (
        f"{what.capitalize()}: {hours:.2f} h of the vehicle's clock, {len(readings)} readings; the recording on "
        f"the disk grew by {(last.tlog - first.tlog) / MIB:.0f} MiB, as it should."
    )
    return rows, note
