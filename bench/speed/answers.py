"""How fast the service answers while frames pour in: a real service, a real vehicle beside the stream, one client."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import httpx

from bench.rows import Row, Section, milliseconds, percentile
from bench.running import service
from bench.speed.sender import MARKER, Spec, started
from mavcal.client import Client
from mavcal.service.simvehicle import SimulatedVehicle, free_udp_port

RATE = 20_000.0
SECONDS = 20.0
REQUESTS_PER_S = 20.0
TARGET_S = 0.050
CAPTURES_WITHIN_S = 60.0
SPAN_C = 100.0
QUIET = {"parameters": {"INS_GYR_CAL": 0}}


def run() -> Section:
    """Idle, under the stream, and under the stream while a job captures and every frame reaches the event loop."""
    rows = [Row("GET /api/v1/vehicles, no stream", "", milliseconds(_measured(0.0, job=False)[0]))]
    for what, job in ((f"{RATE:.0f} msg/s", False), (f"{RATE:.0f} msg/s, a job capturing", True)):
        took, share, sent, recorded = _measured(RATE, job=job)
        said, met = f"{milliseconds(took)}, {share:.0%} of a core", percentile(took, 0.99) < TARGET_S
        rows.append(Row(f"GET /api/v1/vehicles, {what}", f"p99 < {TARGET_S * 1e3:.0f} ms", said, met))
        rows.append(Row("- frames recorded", "none lost", f"{recorded} of {sent}", recorded == sent))
    note = f"{REQUESTS_PER_S:.0f} requests a second for {SECONDS:.0f} s, each on a connection of its own."
    return Section("Answers of the service while frames come in", tuple(rows), (note,))


def _measured(rate: float, *, job: bool) -> tuple[list[float], float, int, int]:
    """Durations of answers, share of a core, frames sent and recorded."""
    port = free_udp_port()
    with (
        tempfile.TemporaryDirectory(prefix="mavcal-bench-") as folder,
        service(f"udpin:127.0.0.1:{port}", Path(folder) / "data") as running,
        SimulatedVehicle("ardupilot", link=f"udpout:127.0.0.1:{port}", config=QUIET),
    ):
        vehicle = running.found()
        if job:
            begin_capture(running.client, vehicle)
        spec = Spec("udp", int(rate * SECONDS), rate or 1.0, port)
        with started(spec) as sender:
            if rate:
                sender.go()
            began, used = time.monotonic(), running.processor_s()
            took = asked_at_rate(running.url, REQUESTS_PER_S, SECONDS)
            share = (running.processor_s() - used) / (time.monotonic() - began)
            if rate:
                sender.finish()
        sent, until = (len(spec.sent()) if rate else 0), time.monotonic() + 2.0
        while (recorded := running.recorded(MARKER)) < sent and time.monotonic() < until:
            time.sleep(0.1)
    return took, share, sent, recorded


def asked_at_rate(url: str, rate: float, seconds: float) -> list[float]:
    """Durations of GET requests on a schedule; one held up by the answer before counts from when it was due."""
    durations = []
    with Client(url, transport=httpx.HTTPTransport(limits=httpx.Limits(max_keepalive_connections=0))) as client:
        began = time.monotonic()
        for k in range(int(rate * seconds)):
            start = due = began + k / rate
            if time.monotonic() < due:
                time.sleep(due - time.monotonic())
                start = time.monotonic()
            client.list_vehicles()
            durations.append(time.monotonic() - start)
    return durations


def begin_capture(client: Client, vehicle_id: str) -> None:
    """A job that captures until it is ended, because the temperature never reaches the span."""
    job = client.start_job(vehicle_id, kind="thermal", options={"span": SPAN_C, "extend": False}).id
    until = time.monotonic() + CAPTURES_WITHIN_S
    while client.get_job(job).progress is None:
        if time.monotonic() > until:
            raise RuntimeError(f"the job does not capture: {client.get_job(job)}")
        time.sleep(0.1)
