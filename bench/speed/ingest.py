"""Live ingest: what the link takes without loss, whether its own count of losses is true, and what mavutil does.

Every frame carries a number of 64 bits: the truth is counted from these; the link's own count has nothing but the 8-bit
sequence and what the socket says. The peer is pymavlink's mavutil.recv_match with its own socket; it records nothing.
"""

from __future__ import annotations

import asyncio
import multiprocessing
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bench.rows import Row, Section, milliseconds
from bench.speed.sender import COMPONENT, MARKER, RAW_IMU, SYSTEM, Sender, Spec, numbers_of, started
from mavcal.service.link.link import Link
from mavcal.service.link.types import Batch

REACHED = 0.95
"""A sender that reaches less than this share of its rate does not test the receiver at that rate."""
_PATIENCE_S = 4.0
"""Without a new frame for so long after the sender has ended, the rest is lost."""
_RUN_LIMIT_S = 120.0


@dataclass(frozen=True)
class Case:
    """One sender; `most_loss` is the share that may be lost here."""

    name: str
    spec: Spec
    most_loss: float
    peer: bool = False
    attempts: int = 1
    """Other programs on the machine only take away: so often it is tried until the loss is small enough."""


CASES = (
    Case("UDP 20000 msg/s", Spec("udp", 60_000, 20_000.0), 0.0, peer=True),
    Case("UDP 100000 msg/s", Spec("udp", 300_000, 100_000.0), 0.001, peer=True, attempts=3),
    Case("TCP unthrottled", Spec("tcp", 300_000, 0.0), 0.0, peer=True),
    Case("UDP 20000 msg/s, 1% lost on the way", Spec("udp", 60_000, 20_000.0, loss=0.01), 0.0),
)


@dataclass(frozen=True)
class Received:
    """What one receiver made of one sender.

    `arrived` counts different numbers; `missing` is the truth, everything numbered that did not arrive. `own_lost` is
    what the receiver itself says, `recorded` the frames in its recording.
    """

    offered: int
    missing_on_the_way: int
    arrived: int
    missing: int
    own_lost: int
    recorded: int
    sending_s: float
    receiving_s: float
    cpu_us: float
    """Processor time of the receiving process for each frame that arrived."""
    handoff_s: tuple[float, ...] = ()
    """From the reader's last drain to the subscriber, for each batch."""

    @property
    def arrived_per_s(self) -> float:
        """The rate that the receiver has reached."""
        return self.arrived / self.receiving_s

    @property
    def dropped(self) -> int:
        """Frames that were sent and did not arrive."""
        return self.missing - self.missing_on_the_way

    @property
    def loss(self) -> float:
        """Lost share of what was sent, 0..1."""
        return self.dropped / self.offered


def run() -> Section:
    """Measure every case; the peer right after the link, with the same sender."""
    rows: list[Row] = []
    for case in CASES:
        for attempt in range(1, case.attempts + 1):
            ours = _apart(_link_run, case.spec)
            rows += link_rows(case, ours)
            if ours.loss <= case.most_loss or attempt == case.attempts:
                break
        if case.peer:
            rows.append(peer_row(ours, _apart(_mavutil_run, case.spec)))
    return Section("Live ingest", tuple(rows))


def link_rows(case: Case, ours: Received) -> list[Row]:
    """What the link took, and whether it knows what it did not."""
    took = f"{ours.dropped} of {ours.offered} lost ({ours.loss:.3%}), {ours.arrived_per_s:.0f} msg/s; "
    took += f"{ours.cpu_us:.1f} us of processor each; to the event loop {milliseconds(ours.handoff_s)}"
    if case.spec.count / ours.sending_s < REACHED * case.spec.rate:
        took += "; the sender did not reach its rate"
    allowed = f"lost <= {case.most_loss:.1%}" if case.most_loss else "none lost"
    counted = f"{ours.own_lost} counted, {ours.missing} missing"
    return [
        Row(case.name, allowed, took, ours.loss <= case.most_loss),
        Row("- own count of the missing", "equal to the truth", counted, ours.own_lost == ours.missing),
        Row("- recorded", "all that arrived", f"{ours.recorded} of {ours.arrived}", ours.recorded >= ours.arrived),
    ]


def peer_row(ours: Received, peer: Received) -> Row:
    """The peer beside the link: what it lost, its own count, and ratios."""
    text = (
        f"{peer.dropped} of {peer.offered} lost ({peer.loss:.1%}), {peer.own_lost} counted; link : mavutil "
        f"arrived {ours.arrived / max(peer.arrived, 1):.2f}, processor time each {ours.cpu_us / peer.cpu_us:.2f}, "
        f"msg/s {ours.arrived_per_s / peer.arrived_per_s:.2f}"
    )
    return Row("- mavutil", "", text)


class _Arrivals:
    """Numbers of the frames that came, kept as bytes until the run is over."""

    def __init__(self, spec: Spec) -> None:
        self._spec = spec
        self._parts: list[bytes] = []
        self.first_at = self.last_at = 0.0
        self.complete = False

    def take(self, raws: list[bytes]) -> None:
        if not raws:
            return
        now = time.monotonic()
        self.first_at = self.first_at or now
        numbers = numbers_of(raws)
        self._parts.append(numbers)
        self.complete = self.complete or int.from_bytes(numbers[-8:], "little") == self._spec.count
        if not self.complete or len(raws) > 1:  # the last frame comes after a pause that is nobody's work
            self.last_at = now

    def outcome(
        self, sending_s: float, cpu_s: float, own_lost: int, recorded: int = 0, handoff_s: tuple[float, ...] = ()
    ) -> Received:
        numbered, offered = self._spec.count + 1, len(self._spec.sent())
        arrived = int(np.unique(np.frombuffer(b"".join(self._parts), "<u8")).size)
        receiving_s, cpu_us = max(self.last_at - self.first_at, 1e-9), cpu_s / max(arrived, 1) * 1e6
        lost = numbered - arrived
        return Received(
            offered, numbered - offered, arrived, lost, own_lost, recorded, sending_s, receiving_s, cpu_us, handoff_s
        )


def _apart(run: Callable[[Spec], Received], spec: Spec) -> Received:
    """In a process of its own."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(run, spec).result()


def _link_run(spec: Spec) -> Received:
    return asyncio.run(_link_receives(spec))


async def _link_receives(spec: Spec) -> Received:
    arrivals, handoff = _Arrivals(spec), list[float]()

    def take(batch: Batch) -> None:
        handoff.append(time.monotonic() - batch.received_at)
        arrivals.take([frame.raw for frame in batch.frames])

    async def opened(url: str, folder: str) -> Link:
        link = Link("bench", url, tlog_dir=Path(folder))
        link.subscribe(take, frozenset({RAW_IMU}))
        await link.open()
        return link

    with tempfile.TemporaryDirectory(prefix="mavcal-bench-") as folder:
        if spec.kind == "tcp":
            with started(spec) as sender:
                link = await opened(f"tcp:127.0.0.1:{sender.port}", folder)
                sending, cpu = await _received(arrivals, sender)
        else:
            link = await opened("udpin:127.0.0.1:0", folder)
            with started(replace(spec, port=link.local_port or 0)) as sender:
                sending, cpu = await _received(arrivals, sender)
        lost = link.statistics(SYSTEM, COMPONENT).lost
        await link.close()
        recorded = link.tlog.path.read_bytes().count(MARKER)
    return arrivals.outcome(sending, cpu, lost, recorded, tuple(handoff))


async def _received(arrivals: _Arrivals, sender: Sender) -> tuple[float, float]:
    """Seconds of sending, and of this process."""
    cpu = time.process_time()
    sender.go()
    async with asyncio.timeout(_RUN_LIMIT_S):
        sending = await asyncio.to_thread(sender.finish)
        until = time.monotonic() + _PATIENCE_S
        while not arrivals.complete and time.monotonic() < max(until, arrivals.last_at + _PATIENCE_S):  # noqa: ASYNC110 - frames change it
            await asyncio.sleep(0.05)
    return sending, time.process_time() - cpu


def _mavutil_run(spec: Spec) -> Received:
    from pymavlink import mavutil  # it sets a global dialect: only in this process

    arrivals = _Arrivals(spec)

    def received(sender: Sender) -> tuple[float, float]:
        cpu = time.process_time()
        sender.go()
        until = time.monotonic() + _RUN_LIMIT_S
        while not arrivals.complete and time.monotonic() < until:
            message = peer.recv_match(type="RAW_IMU", blocking=True, timeout=_PATIENCE_S)
            if message is None:
                break
            arrivals.take([bytes(message.get_msgbuf())])
        cpu = time.process_time() - cpu
        return sender.finish(), cpu

    if spec.kind == "tcp":
        with started(spec) as sender:
            peer = mavutil.mavlink_connection(f"tcp:127.0.0.1:{sender.port}", dialect="ardupilotmega")
            sending, cpu = received(sender)
    else:
        peer = mavutil.mavlink_connection("udpin:127.0.0.1:0", dialect="ardupilotmega")
        with started(replace(spec, port=peer.port.getsockname()[1])) as sender:
            sending, cpu = received(sender)
    peer.close()
    return arrivals.outcome(sending, cpu, peer.mav_loss)
