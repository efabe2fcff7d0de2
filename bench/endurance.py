"""``python -m bench.endurance [HOURS]``: a day of a service in some minutes; exit 1 if anything grows.

Every *hour* is what a busy hour brings. A vehicle that was never seen comes on a link of its own, its clock 30 times as
fast as the wall's. A calibration captures and is cancelled in review, and a file is uploaded and fitted. Event streams
are opened and closed, two links come and go, some addresses speak once, and the vehicle leaves.
"""

from __future__ import annotations

import os
import socket
import struct
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from bench.rows import Row, Section, machine, shown
from bench.running import RunningService, service
from mavcal.calib.wire.codec import RawMessage, encode, raw_message
from mavcal.service.simvehicle import SimulatedVehicle, free_udp_port

HOURS = 24
SPEED = 30.0
SEED = 100
SETTLED_SHARE = 1 / 3
MOST_GROWTH = 0.05
WITHIN_S = 60.0
STREAMS = 8
STRANGERS = 40
LAZY_THREADS = min(32, (os.cpu_count() or 1) + 4) + 4
"""The pool of asyncio (ThreadPoolExecutor's default) starts one whenever none is idle: a busy machine fills it in any
hour. The pool of anyio has one a request to a file or a synchronous route. It ends idle ones only when it is asked
again; four are allowed for. A leak of one an hour shows in the 24 hours of the whole bench."""
MB = 1e6


@dataclass(frozen=True)
class Standing:
    """What the process holds: resident bytes, descriptors, threads, children, and bytes on the disk."""

    resident: int
    descriptors: int
    threads: int
    children: int
    stored: int


def standing(running: RunningService) -> Standing:
    proc = Path(f"/proc/{running.pid}")
    tasks = list((proc / "task").iterdir())
    kept = [path for path in running.data_dir.rglob("*") if path.is_file()]
    return Standing(
        running.resident_bytes(),
        len(list((proc / "fd").iterdir())),
        len(tasks),
        len(running.children()),
        sum(path.stat().st_size for path in kept),
    )


def _settled(running: RunningService) -> Standing:
    """What is held once connections that were just closed are gone: the least within two seconds."""
    seen = []
    for _ in range(8):
        time.sleep(0.25)
        seen.append(standing(running))
    return min(seen, key=lambda one: (one.descriptors, one.threads, one.children))


def run(hours: int = HOURS, seed: int = SEED) -> Section:
    """The hours, one after the other, on one service."""
    print(f"seed {seed}", file=sys.stderr)
    began = time.monotonic()
    with (
        tempfile.TemporaryDirectory(prefix="mavcal-bench-") as folder,
        service("udpin:127.0.0.1:0", Path(folder) / "data") as running,
    ):
        held, reviews = [], 0
        for hour in range(hours):
            reviews += _hour(running, seed + hour)
            held.append(_settled(running))
            print(f"hour {hour + 1}: {held[-1].resident / MB:.1f} MB", file=sys.stderr)
        links, vehicles = len(running.client.list_links()), len(running.client.list_vehicles())
        jobs = len(running.client.list_jobs(limit=1000))
    return Section(
        f"{hours} busy hours in {time.monotonic() - began:.0f} s",
        tuple(_judged(held, links, vehicles)),
        (
            f"Seed {seed}. {reviews} calibrations came to a review. {jobs} jobs and {hours} uploads are kept: they are "
            "evidence until retention says else.",
        ),
    )


def _hour(running: RunningService, seed: int) -> bool:
    """One hour; whether its calibration came to a review."""
    client = running.client
    with SimulatedVehicle(
        "ardupilot", speed=SPEED, seed=seed, config={"parameters": {"INS_GYR_CAL": 0, "INS_GYROFFS_X": 0.05}}
    ) as sim:
        sim.call("still")
        link = client.open_link(url=sim.url).id
        vehicle = _until(lambda: next((v.id for v in client.list_vehicles() if v.link == link and v.uid), None))
        job = client.start_job(vehicle, kind="gyro").id
        _streams(running)
        fit = client.start_fit(
            method="mag-ellipsoid", recording=client.upload_recording(sphere(), name=f"{seed}.csv").id
        ).id
        _strangers(running)
        _until(lambda: client.get_job(fit).state == "succeeded" or None)
        _until(lambda: client.get_job(job).state in {"review", "succeeded", "failed", "interrupted"} or None)
        reviewed = client.get_job(job).state == "review"
        if reviewed:
            client.cancel_job(job)
        client.close_link(link)
    return reviewed


def _streams(running: RunningService) -> None:
    at = urlsplit(running.url)
    clients = [socket.create_connection((at.hostname or "", at.port or 0), timeout=WITHIN_S) for _ in range(STREAMS)]
    for one in clients:
        one.sendall(f"GET /api/v1/events HTTP/1.1\r\nHost: {at.netloc}\r\n\r\n".encode())
    for one in clients:
        one.recv(4096)
        one.close()


def _strangers(running: RunningService) -> None:
    """A link on which vehicles are heard once, each from an address of its own, and which is closed."""
    port = free_udp_port()
    link = running.client.open_link(url=f"udpin:127.0.0.1:{port}").id
    for k in range(STRANGERS):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            for sequence, message in enumerate(beat(k)):
                out.sendto(encode(message, k + 1, 1, sequence), ("127.0.0.1", port))
    _until(lambda: sum(v.link == link for v in running.client.list_vehicles()) == STRANGERS or None)
    running.client.close_link(link)


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


def sphere() -> bytes:
    """A table of a compass that was turned in every direction."""
    rng = np.random.default_rng(5)
    directions = rng.normal(size=(4000, 3))
    values = 50.0 * directions / np.linalg.norm(directions, axis=1, keepdims=True) + (20.0, -10.0, 5.0)
    values += rng.normal(scale=0.05, size=values.shape)
    lines = [f"{i / 50},{x:.6f},{y:.6f},{z:.6f}" for i, (x, y, z) in enumerate(values)]
    return ("t,mag_x,mag_y,mag_z\n" + "\n".join(lines) + "\n").encode()


def _until(found: Callable[[], str | bool | None]) -> str:
    until = time.monotonic() + WITHIN_S
    while (answer := found()) is None:
        if time.monotonic() > until:
            raise RuntimeError(f"it did not come about within {WITHIN_S:g} s")
        time.sleep(0.05)
    return str(answer)


def growth(values: Sequence[float]) -> float:
    """Growth over the whole run as the hours after the first third say it; least squares."""
    late = np.arange(int(len(values) * SETTLED_SHARE), len(values))
    return float(np.polyfit(late, np.asarray(values, dtype=float)[late], 1)[0] * (len(values) - 1))


def _judged(held: Sequence[Standing], links: int, vehicles: int) -> list[Row]:
    first, last, hours = held[int(len(held) * SETTLED_SHARE)], held[-1], len(held)
    grown = growth([one.resident for one in held])
    share = grown / first.resident
    said = f"{first.resident / MB:.0f} to {last.resident / MB:.0f} MB, {share:+.1%} in {hours} hours"
    rows = [Row("resident memory", f"<= {MOST_GROWTH:.0%}", said, share <= MOST_GROWTH)]
    for name in ("descriptors", "threads", "children"):
        most = max(getattr(one, name) for one in held[: max(1, len(held) // 3)])  # pools have filled by then
        most += LAZY_THREADS if name == "threads" else 0
        end = getattr(last, name)
        rows.append(Row(f"open {name}" if name == "descriptors" else name, f"<= {most}", f"{end}", end <= most))
    known = f"{links} and {vehicles}"
    rows.append(Row("links and vehicles known at the end", "1 and 0", known, (links, vehicles) == (1, 0)))
    stored = f"{last.stored / MB:.1f} MB, {growth([one.stored for one in held]) / MB:+.1f} MB in {hours} hours"
    return [*rows, Row("on the disk", "", stored)]


def main() -> int:
    section = run(int(sys.argv[1]) if len(sys.argv) > 1 else HOURS)
    print(shown(section))
    print(machine())
    return 0 if section.met else 1


if __name__ == "__main__":
    sys.exit(main())
