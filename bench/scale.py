"""``python -m bench.scale [VEHICLES ...]``: many vehicles on one instance; exit 1 if a target is missed.

One process sends for all of them: frames are packed beforehand, only sequence, checksum and time differ. Every vehicle
sends HEARTBEAT once a second and VFR_HUD and EXTENDED_SYS_STATE, so that the service asks for nothing; the first tenth
streams RAW_IMU at 50 Hz as well. System ids go to 250, so vehicles are spread over links, 250 on each.
"""

from __future__ import annotations

import json
import socket
import struct
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import httpx
import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from bench.api import SPAWN, oversleeping
from bench.page import machine, shown
from bench.rows import Row, Section, milliseconds, percentile
from bench.running import RunningService, service
from bench.sender import MARKER
from mavcal.calib.wire import RawMessage, encode, raw_message
from mavcal.service.simvehicle import free_udp_port

FLEETS = (10, 100, 1000)
A_LINK = 250
STREAMING_SHARE = 0.1
RATE_HZ = 50
SECONDS = 30.0
SETTLE_S = 8.0
ANSWERS_S = 20.0
REQUESTS_PER_S = 20.0
LISTS_PER_S = 2.0
TARGET_S = 0.050
JOBS = 100
JOBS_WITHIN_S = 240.0
ENDED = frozenset({"succeeded", "failed", "cancelled", "interrupted"})
MB = 1e6
_BODY = MARKER + struct.pack("<hhhhhhBh", 4, 5, 6, 7, 8, 9, 1, 3500)


@dataclass(frozen=True)
class Cost:
    """What a fleet cost: share of a core, resident bytes, durations of answers, frames sent and recorded."""

    vehicles: int
    known: int
    processor: float
    resident: int
    answers: tuple[float, ...]
    single: tuple[float, ...]
    late: tuple[float, ...]
    """How late a process that only sleeps was woken meanwhile: what the machine itself added."""
    sent: int
    recorded: int


def main() -> int:
    if len(sys.argv) > 1 and sys.argv[1] == "send":
        return send(json.loads(sys.argv[2]))
    fleets = tuple(int(word) for word in sys.argv[1:]) or FLEETS
    sections = [run(fleets), jobs()]
    for section in sections:
        print(shown(section), flush=True)
    print(machine())
    return 0 if all(section.met for section in sections) else 1


def run(fleets: tuple[int, ...] = FLEETS) -> Section:
    """Each fleet on a service of its own."""
    rows: list[Row] = []
    for count in fleets:
        cost = measured(count)
        streaming = int(count * STREAMING_SHARE)
        rows += [
            Row(
                f"{count} vehicles, {streaming} of them at {RATE_HZ} Hz: known",
                "all",
                f"{cost.known}",
                cost.known == count,
            ),
            Row("- processor, resident memory", "", f"{cost.processor:.0%} of a core, {cost.resident / MB:.0f} MB"),
            Row("- GET /api/v1/vehicles", "", milliseconds(cost.answers)),
            Row(
                "- GET /api/v1/vehicles/{id}",
                f"p99 < {TARGET_S * 1e3:.0f} ms",
                milliseconds(cost.single),
                percentile(cost.single, 0.99) < TARGET_S,
            ),
            Row("- meanwhile a process that only sleeps woke late by", "", milliseconds(cost.late)),
            Row(
                "- frames recorded of those sent",
                "none lost",
                f"{cost.recorded} of {cost.sent}",
                cost.recorded == cost.sent,
            ),
        ]
    return Section("Many vehicles on one instance", tuple(rows))


def measured(count: int) -> Cost:
    links = -(-count // A_LINK)
    ports = [free_udp_port() for _ in range(links)]
    order = {"ports": ports, "vehicles": count, "streaming": int(count * STREAMING_SHARE), "seconds": SECONDS}
    with ExitStack() as held:
        folder = Path(held.enter_context(tempfile.TemporaryDirectory(prefix="mavcal-bench-")))
        running = held.enter_context(service(f"udpin:127.0.0.1:{ports[0]}", folder / "data"))
        for port in ports[1:]:
            running.client.open_link(url=f"udpin:127.0.0.1:{port}")
        command = [sys.executable, "-m", "bench.scale", "send", json.dumps(order)]
        root = Path(__file__).resolve().parents[1]
        sender = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=root)
        held.callback(sender.wait)
        held.callback(sender.terminate)
        time.sleep(SETTLE_S)
        began, used = time.monotonic(), running.processor_s()
        with ProcessPoolExecutor(1, mp_context=SPAWN) as pool:
            late = pool.submit(oversleeping, ANSWERS_S)
            answers = _asked(running.url, ["api/v1/vehicles"], LISTS_PER_S, ANSWERS_S / 2)
            vehicles = running.client.list_vehicles()
            paths = [f"api/v1/vehicles/{vehicle.id}" for vehicle in vehicles]
            single = _asked(running.url, paths, REQUESTS_PER_S, ANSWERS_S / 2)
            probe = tuple(late.result())
        share = (running.processor_s() - used) / (time.monotonic() - began)
        resident = running.resident_bytes()
        assert sender.stdout is not None
        sent = int(json.loads(sender.stdout.readline())["sent"])
        recorded = _recorded(running, sent)
        return Cost(count, len(vehicles), share, resident, tuple(answers), tuple(single), probe, sent, recorded)


def _asked(url: str, paths: list[str], rate: float, seconds: float) -> list[float]:
    """Durations of GET requests in turn, on a schedule; from when each was sent until its bytes are here."""
    began, took = time.monotonic(), []
    with httpx.Client(base_url=url, timeout=60.0) as client:
        for k in range(int(rate * seconds)):
            time.sleep(max(0.0, began + k / rate - time.monotonic()))
            start = time.monotonic()
            client.get(paths[k * 37 % len(paths)]).raise_for_status()
            took.append(time.monotonic() - start)
    return took


def _recorded(running: RunningService, sent: int) -> int:
    found = 0
    for _ in range(50):
        found = sum(path.read_bytes().count(MARKER) for path in running.tlogs())
        if found >= sent:
            break
        time.sleep(0.1)
    return found


# --- jobs


def jobs(count: int = JOBS) -> Section:
    """So many fits asked for at once, while the service goes on answering."""
    with tempfile.TemporaryDirectory(prefix="mavcal-bench-") as folder:
        port = free_udp_port()
        with service(f"udpin:127.0.0.1:{port}", Path(folder) / "data") as running:
            recording = running.client.upload_recording(sphere(), name="sphere.csv").id
            began, used = time.monotonic(), running.processor_s()
            for _ in range(count):
                running.client.start_fit(method="mag-ellipsoid", recording=recording)
            asked, took = time.monotonic() - began, list[float]()
            while True:
                start = time.monotonic()
                found = running.client.list_jobs(kind="fit", order="newest", limit=count)
                took.append(time.monotonic() - start)
                if all(job.state in ENDED for job in found) or start - began > JOBS_WITHIN_S:
                    break
                time.sleep(0.2)
            seconds, spent = time.monotonic() - began, running.processor_s() - used
            done = sum(job.state == "succeeded" for job in found)
    rows = (
        Row(f"{count} fits of 4000 samples asked for at once", "all done", f"{done} in {seconds:.1f} s", done == count),
        Row("- asking for them", "", f"{asked:.1f} s"),
        Row("- processor of the service itself", "", f"{spent:.1f} s"),
        Row("- GET /api/v1/jobs meanwhile", "", milliseconds(took)),
    )
    return Section("Many jobs at once", rows)


def sphere() -> bytes:
    rng = np.random.default_rng(5)
    directions = rng.normal(size=(4000, 3))
    values = 50.0 * directions / np.linalg.norm(directions, axis=1, keepdims=True) + (20.0, -10.0, 5.0)
    values += rng.normal(scale=0.05, size=values.shape)
    lines = [f"{i / 50},{x:.6f},{y:.6f},{z:.6f}" for i, (x, y, z) in enumerate(values)]
    return ("t,mag_x,mag_y,mag_z\n" + "\n".join(lines) + "\n").encode()


# --- the sender


def send(order: dict[str, object]) -> int:
    """Speak for every vehicle until the time is over; says how many streamed frames left."""
    ports: list[int] = order["ports"]  # type: ignore[assignment]
    count, streaming = int(str(order["vehicles"])), int(str(order["streaming"]))
    slots, now = _frames(count, streaming), time.monotonic()
    out = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in ports]
    for one, port in zip(out, ports, strict=True):
        one.connect(("127.0.0.1", port))
    began, sent, tick = now, 0, 0
    ticks = int(float(str(order["seconds"])) * RATE_HZ)
    while tick < ticks:
        due = began + tick / RATE_HZ
        time.sleep(max(0.0, due - time.monotonic()))
        for link, frames in slots[tick % len(slots)]:
            for k, frame in enumerate(frames):
                out[link].send(frame)
                if k % 16 == 15:
                    time.sleep(0)
        sent += streaming
        tick += 1
        for one in out:
            drained(one)
    print(json.dumps({"sent": sent}), flush=True)
    time.sleep(1.0)
    return 0


def drained(one: socket.socket) -> None:
    """Take what the service sends, so that nothing piles up."""
    one.settimeout(0.0)
    try:
        while True:
            one.recv(2048)
    except (BlockingIOError, ConnectionRefusedError):
        pass
    one.settimeout(None)


def _frames(count: int, streaming: int) -> list[list[tuple[int, list[bytes]]]]:
    """What leaves in each of the 256 x 50 Hz ticks of a cycle, by link; loss is counted in the recording, because the
    sequence numbers jump where the cycle ends."""
    cycle = 256
    slots: list[dict[int, list[bytes]]] = [{} for _ in range(cycle)]
    sequence = np.zeros(count, dtype=int)
    for tick in range(cycle):
        for k in range(count):
            link, system = k // A_LINK, k % A_LINK + 1
            messages: list[RawMessage] = []
            if k < streaming:
                messages.append(RawMessage(27, struct.pack("<Q", tick) + _BODY))
            if (tick + k) % RATE_HZ == 0:
                messages += beat(k)
            for message in messages:
                frame = encode(message, system, 1, int(sequence[k]) & 0xFF)
                sequence[k] += 1
                slots[tick].setdefault(link, []).append(frame)
    return [list(slot.items()) for slot in slots]


def beat(vehicle: int) -> list[RawMessage]:
    """What a vehicle says once a second; who it is comes unasked, because nobody here listens."""
    uid = (vehicle + 1).to_bytes(18, "little")
    no = bytes(8)
    version = dialect.MAVLink_autopilot_version_message(0, 0x040600FF, 0, 0, 0, no, no, no, 0, 0, vehicle + 1, uid)
    heartbeat = struct.pack("<IBBBBB", 0, dialect.MAV_TYPE_QUADROTOR, dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, 81, 3, 3)
    hud = struct.pack("<ffffhH", 0.0, 0.0, 0.0, 0.0, 0, 0)
    return [
        RawMessage(dialect.MAVLINK_MSG_ID_HEARTBEAT, heartbeat),
        RawMessage(dialect.MAVLINK_MSG_ID_VFR_HUD, hud),
        RawMessage(dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, bytes([0, 1])),
        RawMessage(dialect.MAVLINK_MSG_ID_SYSTEM_TIME, struct.pack("<QI", 1, 5000)),
        raw_message(version),
    ]


if __name__ == "__main__":
    sys.exit(main())
