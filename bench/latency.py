"""How long a gyro job takes from end to end, and how much of that is the length of its data."""

from __future__ import annotations

import asyncio
import socket
import struct
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

from bench.rows import Row, Section, milliseconds
from bench.running import RunningService, service
from mavcal.calib.wire import RawMessage, encode
from mavcal.client.events import ProgressEvent, StateEvent
from mavcal.client.problems import VehicleArmed
from mavcal.service.link import Batch, Link
from mavcal.service.simvehicle import Operator, SimulatedVehicle

SPEEDS = (1.0, 30.0)
WRITING_SPEED = 4.0
"""At most so fast while parameters are written: a disarmed vehicle is waited for on the wall clock."""
SYSTEM_TIME = 2
_STAMP = struct.Struct("<QI")
_STAMP_AT = 10
_ENDED = frozenset({"succeeded", "reverted", "failed", "cancelled", "interrupted", "in_doubt"})
_ACCEPT_WITHIN_S = 10.0


@dataclass
class Watched:
    """When a job reached its states (wall clock of the service, s), and how long its data was (vehicle's clock, s)."""

    submitted: float
    states: list[tuple[str, float]] = field(default_factory=list)
    data_s: float = 0.0
    first_progress: float = 0.0

    def at(self, state: str) -> float:
        """When it reached `state` first. Raises KeyError if it never did."""
        for name, when in self.states:
            if name == state:
                return when
        raise KeyError(f"the job never was {state}: {self.states}")

    def stages(self) -> list[tuple[str, float]]:
        """How long it stayed in every state, in order; the last one has no length."""
        following = [when for _, when in self.states[1:]]
        return [(name, after - when) for (name, when), after in zip(self.states, following, strict=False)]


def run() -> Section:
    """The way of single frames through the link, and the job at the speed of the clock and faster."""
    rows = [Row("frame sent -> subscriber on the event loop, 200 a second", "", milliseconds(asyncio.run(hand_off())))]
    notes = []
    for speed in SPEEDS:
        watched = _job(speed)
        rows += _rows(speed, watched)
        shown = ", ".join(f"{name} {seconds:.2f}" for name, seconds in watched.stages())
        notes.append(f"Seconds in each state, vehicle {speed:g} times as fast as the clock: {shown}.")
    notes.append(
        "The data's own length is what the offsets' uncertainty needs at rest (0.01 deg/s, 5 s at least); "
        f"parameters are written with the vehicle at most {WRITING_SPEED:g} times as fast as the clock."
    )
    return Section("A gyro job from end to end", tuple(rows), tuple(notes))


def _rows(speed: float, watched: Watched) -> list[Row]:
    review = watched.at("review") - watched.submitted
    data = watched.data_s / speed
    done = watched.at("succeeded") - watched.at("applying")
    name = f"vehicle x {speed:g}"
    return [
        Row(f"submit -> review, {name}", "", f"{review:.2f} s: data {data:.2f} s, ours {review - data:.2f} s"),
        Row(f"- submit -> first progress, {name}", "", f"{watched.first_progress - watched.submitted:.2f} s"),
        Row(f"- fit from the closed segment, and plan, {name}", "", f"{_stage(watched, 'fitting'):.2f} s"),
        Row(f"apply -> succeeded, {name}", "", f"{done:.2f} s"),
    ]


def _stage(watched: Watched, state: str) -> float:
    return sum(seconds for name, seconds in watched.stages() if name == state)


# --- a frame ----------------------------------------------------------------------------------------------------------


async def hand_off(count: int = 1000, rate: float = 200.0) -> list[float]:
    """Seconds from before a datagram is sent until its frame is in a subscriber's hands, on the event loop."""
    taken: list[float] = []

    def take(batch: Batch) -> None:
        now = time.monotonic_ns()
        taken.extend((now - _STAMP.unpack_from(frame.raw, _STAMP_AT)[0]) * 1e-9 for frame in batch.frames)

    with tempfile.TemporaryDirectory(prefix="mavcal-bench-") as folder:
        link = Link("bench", "udpin:127.0.0.1:0", tlog_dir=Path(folder))
        link.subscribe(take, frozenset({SYSTEM_TIME}))
        await link.open()
        try:
            thread = threading.Thread(target=_send_stamps, args=(link.local_port, count, rate))
            thread.start()
            await asyncio.to_thread(thread.join)
            await asyncio.sleep(0.5)
        finally:
            await link.close()
    return taken


def _send_stamps(port: int, count: int, rate: float) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        for k in range(count):
            time.sleep(1.0 / rate)
            stamp = RawMessage(SYSTEM_TIME, _STAMP.pack(time.monotonic_ns(), 0x7FFFFFFF))
            out.sendto(encode(stamp, 1, 1, k), ("127.0.0.1", port))


# --- a job ------------------------------------------------------------------------------------------------------------


def _job(speed: float) -> Watched:
    with (
        tempfile.TemporaryDirectory(prefix="mavcal-bench-") as folder,
        SimulatedVehicle("ardupilot", speed=speed, config={"parameters": {"INS_GYR_CAL": 0}}) as vehicle,
        service(vehicle.url, Path(folder) / "data") as running,
    ):
        Operator(vehicle).rest()
        vehicle_id = running.found()
        watched = Watched(time.time())
        job = running.client.start_job(vehicle_id, kind="gyro").id
        _follow(running, job, watched, {"review"})
        fits = running.client.get_job(job).results
        watched.data_s = max(float(fit.quality["duration"]) for fit in fits)
        vehicle.call("speed", value=min(speed, WRITING_SPEED))
        _apply(running, job)
        _follow(running, job, watched, set(_ENDED))
        if watched.states[-1][0] != "succeeded":
            raise RuntimeError(f"the job has not succeeded: {running.client.get_job(job).outcome}")
    return watched


def _follow(running: RunningService, job: str, watched: Watched, until: set[str]) -> None:
    """Note states and progress until one of these states; states that were noted before are passed over."""
    known = len(watched.states)
    for message in running.client.follow_job(job):
        event = message.data
        if isinstance(event, ProgressEvent):
            watched.first_progress = watched.first_progress or event.at
        elif isinstance(event, StateEvent):
            if known:
                known -= 1
                continue
            watched.states.append((event.data.state.value, event.at))
            if event.data.state in until:
                return
            if event.data.state in _ENDED:
                raise RuntimeError(f"the job ended early: {running.client.get_job(job).outcome}")
    raise RuntimeError(f"the events of job {job} ended early")


def _apply(running: RunningService, job: str) -> None:
    """Accept the plan; a vehicle that was not seen disarmed for 2 s yet is asked again."""
    digest = running.client.get_plan(job).sha256
    until = time.monotonic() + _ACCEPT_WITHIN_S
    while True:
        try:
            running.client.apply_plan(job, plan_sha256=digest, reboot=True, prove_s=0.0, idempotency_key=job)
        except VehicleArmed:
            if time.monotonic() > until:
                raise
            time.sleep(0.1)
            continue
        return
