"""How fast the service answers while frames pour in: a real service, a real vehicle beside the stream, one client."""

from __future__ import annotations

import multiprocessing
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx

from bench.memory import begin_capture
from bench.rows import Row, Section, milliseconds, percentile
from bench.running import RunningService, service
from bench.sender import MARKER, Spec, started
from mavcal.client import Client
from mavcal.service.simvehicle import SimulatedVehicle, free_udp_port

RATE = 20_000.0
SECONDS = 20.0
REQUESTS_PER_S = 20.0
TARGET_S = 0.050
SPAWN = multiprocessing.get_context("spawn")


@dataclass(frozen=True)
class Answers:
    """How long the answers took, and what the service's process needed meanwhile."""

    seconds: tuple[float, ...]
    late: tuple[float, ...]
    """How late a process that only sleeps was woken in the same seconds: what the machine itself added."""
    processor_share: float
    sent: int = 0
    recorded: int = 0


def run(rate: float = RATE, seconds: float = SECONDS) -> Section:
    """Idle, under the stream, and under the stream while a job captures and every frame reaches the event loop."""
    idle = _measured(rate=0.0, seconds=seconds, job=False)
    streaming = _measured(rate=rate, seconds=seconds, job=False)
    capturing = _measured(rate=rate, seconds=seconds, job=True)
    rows = [
        Row("GET /api/v1/vehicles, no stream", "", _told(idle)),
        Row("- meanwhile a process that only sleeps woke late by", "", milliseconds(idle.late)),
    ]
    for what, answers in ((f"{rate:.0f} msg/s", streaming), (f"{rate:.0f} msg/s, a job capturing", capturing)):
        p99 = percentile(answers.seconds, 0.99)
        rows += [
            Row(
                f"GET /api/v1/vehicles, {what}",
                f"p99 < {TARGET_S * 1e3:.0f} ms",
                f"{_told(answers)}; p99 {p99 / percentile(idle.seconds, 0.99):.1f} x that without a stream",
                p99 < TARGET_S,
            ),
            Row("- meanwhile a process that only sleeps woke late by", "", milliseconds(answers.late)),
            Row(
                f"frames recorded by the service, {what}",
                "none lost",
                f"{answers.recorded} of {answers.sent}",
                answers.recorded == answers.sent,
            ),
        ]
    note = (
        f"{REQUESTS_PER_S:.0f} requests a second for {seconds:.0f} s, each on a connection of its own; a simulated "
        "vehicle speaks on the same link. With a job, RAW_IMU is asked for, and so every frame goes to the event loop."
    )
    return Section("Answers of the service while frames come in", tuple(rows), (note,))


def _told(answers: Answers) -> str:
    return f"{milliseconds(answers.seconds)}, {answers.processor_share:.0%} of a core"


def _measured(*, rate: float, seconds: float, job: bool) -> Answers:
    port = free_udp_port()
    with (
        tempfile.TemporaryDirectory(prefix="mavcal-bench-") as folder,
        service(f"udpin:127.0.0.1:{port}", Path(folder) / "data") as running,
        SimulatedVehicle("ardupilot", link=f"udpout:127.0.0.1:{port}", config={"parameters": {"INS_GYR_CAL": 0}}),
    ):
        vehicle_id = running.found()
        if job:
            begin_capture(running.client, vehicle_id)
        with ProcessPoolExecutor(1, mp_context=SPAWN) as pool:
            pool.submit(oversleeping, 0.1).result()  # started before anything is measured
            with _streaming(port, rate, seconds) as sent:
                late = pool.submit(oversleeping, seconds)
                began, used = time.monotonic(), running.processor_s()
                durations = asked_at_rate(running.url, REQUESTS_PER_S, seconds)
                share = (running.processor_s() - used) / (time.monotonic() - began)
            probe = tuple(late.result())
        recorded = _recorded(running, sent)
    return Answers(tuple(durations), probe, share, sent, recorded)


@contextmanager
def _streaming(port: int, rate: float, seconds: float) -> Iterator[int]:
    """A sender at work; gives the number of frames that it sends."""
    if not rate:
        yield 0
        return
    spec = Spec("udp", int(rate * seconds), rate, port)
    with started(spec) as sender:
        sender.go()
        yield len(spec.sent())
        sender.finish()


def _recorded(running: RunningService, sent: int) -> int:
    """Frames of the sender in the recording; waits a little for the last."""
    for _ in range(20):
        found = sum(path.read_bytes().count(MARKER) for path in running.tlogs())
        if found >= sent:
            break
        time.sleep(0.1)
    return found


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


def oversleeping(seconds: float) -> list[float]:
    """How late this machine wakes a process that sleeps for 10 ms: what nothing that runs here can do better than."""
    until, late = time.monotonic() + seconds, []
    while (begin := time.monotonic()) < until:
        time.sleep(0.01)
        late.append(time.monotonic() - begin - 0.01)
    return late
