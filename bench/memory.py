"""Memory of the service over an hour of streaming while a job captures all of it."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.rows import Row, Section
from bench.running import RunningService, service
from bench.sender import MARKER, Spec, started
from mavcal.client import Client
from mavcal.service.simvehicle import SimulatedVehicle, free_udp_port

SPEED = 30.0
HOUR_S = 3600.0
PERIOD_S = 1.0
SETTLED_SHARE = 0.25
"""The first part of the run, in which caches fill, does not count for the slope."""
MOST_GROWTH = 0.05
"""Growth over the run that is called flat, as a share of the memory at its start."""
WALL_LIMIT_S = 480.0
CAPTURES_WITHIN_S = 60.0
CAPTURING = frozenset({"running", "waiting_for_operator"})
FRAMES_PER_S = 150.0
"""Three inertial units at 50 Hz."""
CONTROL_RATE = 15_000.0
"""Frames a second where no job runs: the memory does not know how fast they came."""
WARM_UP = {"start": 22.0, "end": 70.0, "tau_s": 2000.0}
"""Slow enough that the temperature still moves after an hour, and the job never reaches its span."""
SPAN_C = 100.0
MIB = 2.0**20


@dataclass(frozen=True)
class Reading:
    """Memory and the size of the recording, bytes, at a time of the run's own clock and of the wall's."""

    at: float
    wall: float
    resident: int
    tlog: int


def growth(readings: Sequence[Reading]) -> float:
    """Slope of the memory after it has settled, bytes per second of the run's clock; least squares."""
    t = np.array([reading.at for reading in readings])
    late = t >= t[0] + SETTLED_SHARE * (t[-1] - t[0])
    resident = np.array([reading.resident for reading in readings], dtype=float)
    return float(np.polyfit(t[late], resident[late], 1)[0])


def run(vehicle_s: float = HOUR_S) -> Section:
    """Measure an hour of the vehicle's clock with a job, and as many frames as an hour brings without one."""
    frames = int(vehicle_s * FRAMES_PER_S)
    watched = (
        (f"{vehicle_s / 3600:g} h, a job capturing", *_capturing(vehicle_s)),
        (f"{frames} frames, no job", *_streaming(frames)),
    )
    rows = [row for what, readings, _ in watched for row in _judged(what, readings)]
    notes = [note for _, _, said in watched for note in said]
    notes.append(
        "While a job captures, what grows is its samples, which its fit needs: 3 units at 50 Hz with 86 bytes each "
        f"(accelerometer 35, gyroscope 35, temperature 16) are {86 * FRAMES_PER_S * vehicle_s / MIB:.0f} MiB in this "
        "time. Link, recording and vehicle hold nothing."
    )
    return Section("Memory over an hour of streaming", tuple(rows), tuple(notes))


def _capturing(vehicle_s: float) -> tuple[list[Reading], list[str]]:
    config = {"temperature": WARM_UP["start"], "parameters": {"INS_GYR_CAL": 0}}
    with (
        tempfile.TemporaryDirectory(prefix="mavcal-bench-") as folder,
        SimulatedVehicle("ardupilot", speed=SPEED, config=config) as vehicle,
        service(vehicle.url, Path(folder) / "data") as running,
    ):
        vehicle_id = running.found()
        vehicle.call("warm_up", **WARM_UP)
        job = begin_capture(running.client, vehicle_id)
        began = vehicle.state()["time"]
        readings = _sampled(running, lambda: vehicle.state()["time"] - began, vehicle_s, job)
        page = running.client.get_vehicle(vehicle_id)
        ended = running.client.get_job(job)
        said = [
            f"The vehicle's clock ran {readings[-1].at:.0f} s in {readings[-1].wall - readings[0].wall:.0f} s; "
            f"{page.received} frames came, {page.lost} were lost.",
            f"The job (thermal, span {SPAN_C:g} degC) at the end: {ended.state}, "
            f"{getattr(ended.progress, 'text', None)}, {getattr(ended.outcome, 'cause', 'no outcome yet')}.",
        ]
    return readings, said


def _streaming(frames: int) -> tuple[list[Reading], list[str]]:
    port = free_udp_port()
    spec = Spec("udp", frames, CONTROL_RATE, port)
    with (
        tempfile.TemporaryDirectory(prefix="mavcal-bench-") as folder,
        service(f"udpin:127.0.0.1:{port}", Path(folder) / "data") as running,
        SimulatedVehicle("ardupilot", link=f"udpout:127.0.0.1:{port}"),
        started(spec) as sender,
    ):
        running.found()
        sender.go()
        began = time.monotonic()
        readings = _sampled(running, lambda: time.monotonic() - began, frames / CONTROL_RATE, None)
        sender.finish()
        recorded = sum(path.read_bytes().count(MARKER) for path in running.tlogs())
    return readings, [f"Without a job: {recorded} of {len(spec.sent())} frames were recorded."]


def begin_capture(client: Client, vehicle_id: str) -> str:
    """A job that captures until it is ended, because the temperature never reaches the span; its id."""
    job = client.start_job(vehicle_id, kind="thermal", options={"span": SPAN_C, "extend": False}).id
    until = time.monotonic() + CAPTURES_WITHIN_S
    while client.get_job(job).progress is None:
        if time.monotonic() > until:
            raise RuntimeError(f"the job does not capture: {client.get_job(job)}")
        time.sleep(0.1)
    return job


def _sampled(running: RunningService, clock: Callable[[], float], until: float, job: str | None) -> list[Reading]:
    """Memory until the clock reaches `until`, the job ends, or patience does."""
    readings: list[Reading] = []
    limit = time.monotonic() + WALL_LIMIT_S
    while (now := clock()) <= until and time.monotonic() < limit:
        readings.append(Reading(now, time.monotonic(), running.resident_bytes(), running.tlog_bytes()))
        if job is not None and running.client.get_job(job).state not in CAPTURING:
            break
        time.sleep(PERIOD_S)
    return readings


def _judged(what: str, readings: Sequence[Reading]) -> list[Row]:
    first, last = readings[0], readings[-1]
    grown = growth(readings) * (last.at - first.at)
    share = grown / first.resident
    return [
        Row(
            f"growth: {what}",
            f"<= {MOST_GROWTH:.0%}",
            f"{share:+.1%} ({grown / MIB:+.1f} MiB; the recording on disk {(last.tlog - first.tlog) / MIB:+.0f} MiB)",
            share <= MOST_GROWTH,
        ),
        Row(
            f"resident: {what}",
            "",
            f"start {first.resident / MIB:.0f}, end {last.resident / MIB:.0f}, "
            f"largest {max(r.resident for r in readings) / MIB:.0f} MiB",
        ),
    ]
