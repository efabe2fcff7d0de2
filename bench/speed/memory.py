"""Memory of the service over an hour of streaming while a job captures all of it."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.rows import Row, Section
from bench.running import service
from mavcal.client import Client
from mavcal.service.simvehicle import SimulatedVehicle

SPEED = 30.0
HOUR_S = 3600.0
SETTLED_SHARE = 0.25
"""The first part of the run, in which caches fill, does not count for the slope."""
MOST_GROWTH = 0.05
"""Growth over the run that is called flat, as a share of the memory at its start."""
WALL_LIMIT_S = 480.0
CAPTURES_WITHIN_S = 60.0
CAPTURING = frozenset({"running", "waiting_for_operator"})
WARM_UP = {"start": 22.0, "end": 70.0, "tau_s": 2000.0}
"""Slow enough that the temperature still moves after an hour, and the job never reaches its span."""
SPAN_C = 100.0
MIB = 2.0**20


@dataclass(frozen=True)
class Reading:
    """Memory and the size of the recording, bytes, at a time of the vehicle's clock."""

    at: float
    resident: int
    tlog: int


def growth(readings: Sequence[Reading]) -> float:
    """Slope of the memory after it has settled, bytes per second of the run's clock; least squares."""
    t = np.array([reading.at for reading in readings])
    late = t >= t[0] + SETTLED_SHARE * (t[-1] - t[0])
    resident = np.array([reading.resident for reading in readings], dtype=float)
    return float(np.polyfit(t[late], resident[late], 1)[0])


def run() -> Section:
    """Measure an hour of the vehicle's clock."""
    readings, state = _capturing()
    first, last = readings[0], readings[-1]
    grown = growth(readings) * (last.at - first.at)
    share = grown / first.resident
    said = f"{share:+.1%} ({grown / MIB:+.1f} MiB; the recording on disk {(last.tlog - first.tlog) / MIB:+.0f} MiB)"
    largest = max(reading.resident for reading in readings)
    held = f"start {first.resident / MIB:.0f}, end {last.resident / MIB:.0f}, largest {largest / MIB:.0f} MiB"
    rows = (
        Row(f"growth in {last.at / 3600:.2f} h", f"<= {MOST_GROWTH:.0%}", said, share <= MOST_GROWTH),
        Row("resident", "", held),
        Row("the job at the end", "still captures", state, state in CAPTURING),
    )
    note = "What grows is the job's samples, which its fit needs: 86 bytes of 3 units at 50 Hz are 44 MiB in an hour."
    return Section("Memory over an hour of streaming", rows, (note,))


def _capturing() -> tuple[list[Reading], str]:
    """Memory until an hour of the vehicle has gone, the job ends, or patience does."""
    config = {"temperature": WARM_UP["start"], "parameters": {"INS_GYR_CAL": 0}}
    with (
        tempfile.TemporaryDirectory(prefix="mavcal-bench-") as folder,
        SimulatedVehicle("ardupilot", speed=SPEED, config=config) as vehicle,
        service(vehicle.url, Path(folder) / "data") as running,
    ):
        vehicle_id = running.found()
        vehicle.call("warm_up", **WARM_UP)
        job = begin_capture(running.client, vehicle_id)
        readings: list[Reading] = []
        began, limit = vehicle.state()["time"], time.monotonic() + WALL_LIMIT_S
        while (now := vehicle.state()["time"] - began) <= HOUR_S and time.monotonic() < limit:
            readings.append(Reading(now, running.resident_bytes(), sum(p.stat().st_size for p in running.tlogs())))
            state = running.client.get_job(job).state.value
            if state not in CAPTURING:
                break
            time.sleep(1.0)
    return readings, state


def begin_capture(client: Client, vehicle_id: str) -> str:
    """A job that captures until it is ended, because the temperature never reaches the span; its id."""
    job = client.start_job(vehicle_id, kind="thermal", options={"span": SPAN_C, "extend": False}).id
    until = time.monotonic() + CAPTURES_WITHIN_S
    while client.get_job(job).progress is None:
        if time.monotonic() > until:
            raise RuntimeError(f"the job does not capture: {client.get_job(job)}")
        time.sleep(0.1)
    return job
