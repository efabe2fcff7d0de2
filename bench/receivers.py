"""The real link, and pymavlink's mavutil as its peer, receiving the same frames; judged by the frames' numbers."""

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

from bench.sender import COMPONENT, MARKER, RAW_IMU, SYSTEM, Spec, numbers_of, started
from mavcal.service.link import Batch, Link

_PATIENCE_S = 4.0
"""Without a new frame for so long after the sender has ended, the rest is lost."""
_RUN_LIMIT_S = 120.0


@dataclass(frozen=True)
class Received:
    """What one receiver made of one sender.

    `arrived` counts different numbers; `missing` is the truth, everything numbered that did not arrive. `own_lost`
    is what the receiver itself says. `recorded` counts the frames in the recording, None where there is none.
    """

    offered: int
    missing_on_the_way: int
    arrived: int
    missing: int
    own_lost: int
    own_inferred: int
    recorded: int | None
    sending_s: float
    receiving_s: float
    cpu_us: float
    """Processor time of the receiving process for each frame that arrived."""
    handoff_s: tuple[float, ...] = ()
    """From the reader's last drain to the subscriber, for each batch."""

    @property
    def offered_per_s(self) -> float:
        """The rate that the sender has reached."""
        return self.offered / self.sending_s

    def sending_rate(self, spec: Spec) -> float:
        """Frames a second that the sender has kept up, those that it left out included."""
        return spec.count / self.sending_s

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


class _Arrivals:
    """Numbers of the frames that came, kept as bytes until the run is over."""

    def __init__(self, spec: Spec) -> None:
        self._last = spec.count
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
        self.complete = self.complete or int.from_bytes(numbers[-8:], "little") == self._last
        if not self.complete or len(raws) > 1:  # the last frame comes after a pause that is nobody's work
            self.last_at = now

    def different(self) -> int:
        return int(np.unique(np.frombuffer(b"".join(self._parts), "<u8")).size)


def on_link(spec: Spec) -> Received:
    """Receive with :class:`service.link.Link`, in a process of its own."""
    return _apart(_link_run, spec)


def on_mavutil(spec: Spec) -> Received:
    """Receive with ``mavutil.recv_match``, in a process of its own."""
    return _apart(_mavutil_run, spec)


def _apart(run: Callable[[Spec], Received], spec: Spec) -> Received:
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(run, spec).result()


def _link_run(spec: Spec) -> Received:
    return asyncio.run(_link_receives(spec))


async def _link_receives(spec: Spec) -> Received:
    arrivals, handoff = _Arrivals(spec), list[float]()

    def take(batch: Batch) -> None:
        handoff.append(time.monotonic() - batch.received_at)
        arrivals.take([frame.raw for frame in batch.frames])

    with tempfile.TemporaryDirectory(prefix="mavcal-bench-") as folder:
        if spec.kind == "tcp":
            with started(spec) as sender:
                link = Link("bench", f"tcp:127.0.0.1:{sender.port}", tlog_dir=Path(folder))
                link.subscribe(take, frozenset({RAW_IMU}))
                await link.open()
                cpu = time.process_time()
                sender.go()
                sending = await _until_received(arrivals, sender.finish)
        else:
            link = Link("bench", "udpin:127.0.0.1:0", tlog_dir=Path(folder))
            link.subscribe(take, frozenset({RAW_IMU}))
            await link.open()
            with started(replace(spec, port=link.local_port or 0)) as sender:
                cpu = time.process_time()
                sender.go()
                sending = await _until_received(arrivals, sender.finish)
        cpu = time.process_time() - cpu
        counted = link.statistics(SYSTEM, COMPONENT)
        await link.close()
        recorded = link.tlog.path.read_bytes().count(MARKER)
    return _outcome(spec, arrivals, sending, cpu, counted.lost, counted.lost_inferred, recorded, tuple(handoff))


async def _until_received(arrivals: _Arrivals, finish: Callable[[], float]) -> float:
    async with asyncio.timeout(_RUN_LIMIT_S):
        sending = await asyncio.to_thread(finish)
        until = time.monotonic() + _PATIENCE_S
        while time.monotonic() < max(until, arrivals.last_at + _PATIENCE_S):
            if arrivals.complete:
                break
            await asyncio.sleep(0.05)
    return sending


def _mavutil_run(spec: Spec) -> Received:
    from pymavlink import mavutil  # it sets a global dialect: only in this process

    arrivals = _Arrivals(spec)
    if spec.kind == "tcp":
        with started(spec) as sender:
            peer = mavutil.mavlink_connection(f"tcp:127.0.0.1:{sender.port}", dialect="ardupilotmega")
            cpu = time.process_time()
            sender.go()
            _mavutil_receives(peer, arrivals)
            cpu, sending = time.process_time() - cpu, sender.finish()
    else:
        peer = mavutil.mavlink_connection("udpin:127.0.0.1:0", dialect="ardupilotmega")
        with started(replace(spec, port=peer.port.getsockname()[1])) as sender:
            cpu = time.process_time()
            sender.go()
            _mavutil_receives(peer, arrivals)
            cpu, sending = time.process_time() - cpu, sender.finish()
    peer.close()
    return _outcome(spec, arrivals, sending, cpu, peer.mav_loss, 0, None, ())


def _mavutil_receives(peer: object, arrivals: _Arrivals) -> None:
    receive = peer.recv_match  # type: ignore[attr-defined]
    until = time.monotonic() + _RUN_LIMIT_S
    while not arrivals.complete and time.monotonic() < until:
        message = receive(type="RAW_IMU", blocking=True, timeout=_PATIENCE_S)
        if message is None:
            return
        arrivals.take([bytes(message.get_msgbuf())])


def _outcome(
    spec: Spec,
    arrivals: _Arrivals,
    sending_s: float,
    cpu_s: float,
    own_lost: int,
    own_inferred: int,
    recorded: int | None,
    handoff_s: tuple[float, ...],
) -> Received:
    arrived, offered = arrivals.different(), len(spec.sent())
    return Received(
        offered=offered,
        missing_on_the_way=spec.count + 1 - offered,
        arrived=arrived,
        missing=spec.count + 1 - arrived,
        own_lost=own_lost,
        own_inferred=own_inferred,
        recorded=recorded,
        sending_s=sending_s,
        receiving_s=max(arrivals.last_at - arrivals.first_at, 1e-9),
        cpu_us=cpu_s / max(arrived, 1) * 1e6,
        handoff_s=handoff_s,
    )
