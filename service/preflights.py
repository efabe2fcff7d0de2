"""A preflight of one vehicle: streams on, its own checks run, parameters read, streams back, a report within 10 s.

A link that brings too few samples in that time is waited for, for half a minute at most: that is no sensor's fault.
So is an ArduPilot that has just started, until it has seen its IMUs agree for 10 s.

Nothing is written to the vehicle. No job may begin during a preflight, and no preflight during a job: both request
message rates and restore them.
"""

from __future__ import annotations

import asyncio
import dataclasses
import time
from collections.abc import Awaitable, Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial

from mavcal.calib.firmware.plan import Value
from mavcal.calib.preflight.check import CheckId, Report, Snapshot, VerifiedCalibration, stated_device_ids
from mavcal.calib.preflight.collect import (
    Gathered,
    collect,
    counted_messages,
    gathered,
    preflight_streams,
    wanted_messages,
    watched_s,
    without_words,
)
from mavcal.calib.preflight.installed import STREAMED, announced
from mavcal.calib.preflight.rest import RestReading, rest_readings
from mavcal.calib.preflight.run import looked_up, preflight
from mavcal.calib.preflight.self_report import AGREES_S, agrees_soon
from mavcal.calib.recording import Identity
from mavcal.calib.wire.frames import Frame
from mavcal.service.errors import CommandRefused, CommandTimeout, DiskFull, PreflightRunning, ServiceError, VehicleError
from mavcal.service.rates.ledger import RateLedgers
from mavcal.service.vehicle.commands import RUN_PREARM_CHECKS
from mavcal.service.vehicle.job_vehicle import SLOW, JobVehicle, ParameterReading, read_values
from mavcal.service.vehicle.rate_ledger import RateUser

History = Callable[[JobVehicle], Awaitable[tuple[VerifiedCalibration, ...]]]
"""The verified calibrations of a vehicle, oldest first."""
DEADLINE_S = 8.5
"""Time from the start to the last sample, s; the rest of ten seconds restores the streams and computes."""
LONGEST_S = 26.0
"""Time from the start to the last sample on a slow link, s; a client waits for thirty seconds in all."""
STILL_S = 15.0
"""Time from the start to the last sample if a compass reads a constant value, s. The quietest part known has 15 nT of
noise (RM3100, datasheet). Read 10 times a second, it shows a step of 100 nT within 6 s in 97 of 100 simulated cases,
within 13 s in 99."""
LOOK_S = 0.5
"""Period of the count of samples, s."""
AGAIN = 8
"""Number of looks after which the streams are requested again."""
SILENT_ASKS = 6
"""Number of repeated requests, LOOK_S apart, if an announced sensor sends nothing at all. On a link that loses every
third message both ways, all nine requests are lost once in 50 000 times."""
FIRST_S = 3.5
"""Time for parameters and present rates before the streams begin, s; a rate not heard counts as the default."""
DEMANDS, DEMAND_S = 3, 0.3
"""Number of requests for the streams, and s between them: a link that loses every third message carries one."""
IDENTIFY_S = 2.0
"""Longest wait for the identity of a vehicle that is not identified yet, s."""
ANSWER_S = 1.5
"""Wait for the answer to a second request, and again for texts and SYS_STATUS (two a second), s."""
RESTORE_S = 1.0
"""Longest wait for the old rates before the verdict is given, s; putting them back goes on afterwards."""


@dataclass(frozen=True)
class Preflight:
    """What a preflight found, of whom and when (wall clock)."""

    vehicle_id: str
    identity: Identity
    at: float
    seconds: float
    report: Report
    notes: tuple[str, ...] = ()
    readings: tuple[RestReading, ...] = ()
    """Readings of the inertial units at rest, for the fleet."""


@dataclass
class _Heard:
    """Frames and parameters received during a preflight."""

    frames: list[Frame] = field(default_factory=list)
    parameters: dict[str, Value] = field(default_factory=dict)
    rewritten: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def take(self, frames: Sequence[Frame], _disk: DiskFull | None) -> None:
        self.frames += frames

    def hear(self, reading: ParameterReading) -> None:
        """Store a reading, and note a changed value; NaN equals nothing, and shows no change."""
        before = self.parameters.get(reading.name, reading.value)
        if before == before and before != reading.value:
            self.rewritten.append(reading.name)
        self.parameters[reading.name] = reading.value


class Preflights:
    """Runs preflights, one at a time on each vehicle."""

    def __init__(
        self,
        capture_s: float,
        ledgers: RateLedgers,
        wall: Callable[[], float] = time.time,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._capture_s, self._ledgers = capture_s, ledgers
        self._wall, self._clock = wall, clock
        self._running: set[str] = set()
        self._looks: dict[str, asyncio.Task[Preflight]] = {}
        """Unrequested preflights by vehicle, which give way to a preflight or a job."""

    def require_idle(self, vehicle_id: str) -> None:
        """Raise PreflightRunning while a preflight of this vehicle runs; a look without a request is ended instead."""
        look = self._looks.pop(vehicle_id, None)
        if look is not None:
            self._end(vehicle_id, look)
        if vehicle_id in self._running:
            raise PreflightRunning

    def holds(self, vehicle_id: str) -> bool:
        """Whether a preflight of this vehicle is under way."""
        return vehicle_id in self._running or vehicle_id in self._looks

    async def run(
        self,
        vehicle: JobVehicle,
        history: History,
        *,
        heading: float | None = None,
    ) -> Preflight:
        """Look at a vehicle that the caller has claimed, and that no job claims.

        Raises
        ------
        VehicleError, LinkDown
        FirmwareError
            If the autopilot is neither ArduPilot nor PX4.
        """
        rates = preflight_streams(vehicle.identity.autopilot or "")
        began, at, heard = self._clock(), self._wall(), _Heard()
        before = self._ledgers.of(vehicle.id).taken_over(RateUser.PREFLIGHT)
        if vehicle.identity.firmware is None:
            await _identified(vehicle, heard)
        known = await history(vehicle)
        forget = vehicle.subscribe(wanted_messages(vehicle.identity), heard.take)
        listening = vehicle.on_parameter(heard.hear)
        reading = asyncio.create_task(self._read(vehicle, known))
        asking = asyncio.create_task(vehicle.command(RUN_PREARM_CHECKS, ()))
        try:
            await _present_rates(vehicle, rates, before, heard)
            # the parameters first: on a slow link the streams leave no room for them
            await asyncio.wait({reading}, timeout=max(FIRST_S - (self._clock() - began), 0.0))
            demanded = self._clock()
            slower = vehicle.demand_streams(rates)
            if slower > SLOW:
                heard.notes.append(f"the link is slow: {slower:.1f} times fewer samples come")
            for _ in range(1, DEMANDS):
                await asyncio.sleep(DEMAND_S)
                vehicle.demand_streams(rates)
            await asyncio.sleep(max(min(demanded + self._capture_s, began + DEADLINE_S) - self._clock(), 0.0))
            await self._gather(vehicle, rates, began, heard)
            await _silent_asked(vehicle, rates, known, heard)
            complete = await self._finished(reading, began, heard)
            look = partial(_judged, vehicle, heard, at, known, heading, complete=complete)
            snapshot, report = await look(asked=_asked(asking, heard))
            if agrees_soon(vehicle.identity.autopilot or "", report.check(CheckId.VEHICLE_PREARM), snapshot.view.texts):
                asking = await self._asked_again(vehicle, began, heard)
                snapshot, report = await look(asked=_asked(asking, heard))
        finally:
            for task in (reading, asking):
                task.cancel()
            await asyncio.gather(reading, asking, return_exceptions=True)
            listening()
            forget()
            await self._return(vehicle, before)
        readings = await asyncio.to_thread(rest_readings, snapshot)
        seconds = self._clock() - began
        return Preflight(vehicle.id, vehicle.identity, at, seconds, report, tuple(heard.notes), readings=readings)

    async def look(self, vehicle: JobVehicle, history: History) -> Preflight | None:
        """As :meth:`run` for an unclaimed vehicle; None: it was claimed meanwhile, and the look ended."""
        look = asyncio.create_task(self.run(vehicle, history), name=f"look at {vehicle.id}")
        self._looks[vehicle.id] = look
        try:
            await asyncio.wait({look})
        finally:
            if self._looks.get(vehicle.id) is look:
                del self._looks[vehicle.id]
            if not look.done():
                self._end(vehicle.id, look)
        return None if look.cancelled() else look.result()

    @contextmanager
    def claimed(self, vehicle_id: str) -> Iterator[None]:
        """Block other preflights and jobs of this vehicle inside the block. Raises PreflightRunning."""
        self.require_idle(vehicle_id)
        self._running.add(vehicle_id)
        try:
            yield
        finally:
            self._running.discard(vehicle_id)

    async def _read(self, vehicle: JobVehicle, known: Iterable[VerifiedCalibration]) -> None:
        """Every parameter that a check looks at; they are heard as they come."""
        autopilot = vehicle.identity.autopilot or ""
        found: dict[str, Value] = {}
        asked: set[str] = set()
        while missing := looked_up(autopilot, found, known) - asked:
            asked |= missing
            readings = await read_values(vehicle, sorted(missing), absent=True)
            found |= {name: reading.value for name, reading in readings.items()}

    async def _gather(self, vehicle: JobVehicle, rates: dict[int, float], began: float, heard: _Heard) -> None:
        """Wait until every stream has enough samples; missing streams are requested again."""
        autopilot = vehicle.identity.autopilot or ""
        found, looks = await _looked(heard, autopilot), 0
        while not found.enough and (left := LONGEST_S - (self._clock() - began)) > 0.0:
            if looks % AGAIN == 0:  # a slow link has lost the request, or carries nothing else if it comes too often
                vehicle.demand_streams(rates)
            await asyncio.sleep(min(LOOK_S, left))
            found, looks = await _looked(heard, autopilot), looks + 1
        if looks:
            heard.notes.append(
                f"the link is slow: {found.text}, and {self._clock() - began:.0f} s were waited for more"
            )
        while found.still and (left := STILL_S - (self._clock() - began)) > 0.0:
            await asyncio.sleep(min(LOOK_S, left))
            found = await _looked(heard, autopilot)
        if found.still:
            which = ", ".join(str(i + 1) for i in sorted(found.still))
            heard.notes.append(f"compass {which} was watched for {STILL_S:g} s for one step of change")

    async def _asked_again(self, vehicle: JobVehicle, began: float, heard: _Heard) -> asyncio.Task[None]:
        """Run the vehicle's checks a second time, once its IMUs had 10 s to agree."""
        autopilot = vehicle.identity.autopilot or ""
        watched = watched_s(heard.frames, autopilot)
        looks = (began + LONGEST_S - 2.0 * ANSWER_S - self._clock()) / LOOK_S
        for _ in range(max(round(looks), 0)):
            if watched >= AGREES_S:
                break
            await asyncio.sleep(LOOK_S)
            watched = watched_s(heard.frames, autopilot)
        heard.frames = without_words(heard.frames)
        asking = asyncio.create_task(vehicle.command(RUN_PREARM_CHECKS, ()))
        await asyncio.wait({asking}, timeout=ANSWER_S)
        await asyncio.sleep(ANSWER_S)
        heard.notes.append(
            f"the vehicle ran its checks again after {watched:.0f} s: ArduPilot arms once its IMUs have agreed for 10 s"
        )
        return asking

    async def _finished(self, reading: asyncio.Task[None], began: float, heard: _Heard) -> bool:
        """Whether every parameter was read in time; the vehicle's answer to the last one is waited for a little."""
        left = max(LONGEST_S - (self._clock() - began), 0.0)
        await asyncio.wait({reading}, timeout=left)
        if not reading.done():
            heard.notes.append(f"not every parameter could be read in {LONGEST_S:.0f} s: the link is slow")
            return False
        error = reading.exception()
        if isinstance(error, ServiceError):
            heard.notes.append(f"not every parameter could be read: {error}")
            return False
        if error is not None:
            raise error
        return True

    async def _return(self, vehicle: JobVehicle, before: dict[int, int]) -> None:
        """Return the message rates; on a slow link that goes on after the verdict."""
        if before:
            ledger = self._ledgers.of(vehicle.id)
            task = ledger.begin_return(RateUser.PREFLIGHT, _put_back(vehicle, before), intervals=before)
            await asyncio.wait({task}, timeout=RESTORE_S)

    def _end(self, vehicle_id: str, look: asyncio.Task[Preflight]) -> None:
        """End a look that gives way; it returns the rates that it has changed."""
        look.cancel()
        self._ledgers.of(vehicle_id).begin_return(RateUser.PREFLIGHT, look)

    async def stop(self) -> None:
        """Wait until every vehicle has its rates back."""
        for ledger in self._ledgers.all():
            await ledger.returned(RateUser.PREFLIGHT)


async def _identified(vehicle: JobVehicle, heard: _Heard) -> None:
    try:
        async with asyncio.timeout(IDENTIFY_S):
            await vehicle.identify()
    except (TimeoutError, VehicleError):
        heard.notes.append("the vehicle did not say in time which unit and which version it is")


async def _present_rates(vehicle: JobVehicle, rates: Iterable[int], before: dict[int, int], heard: _Heard) -> None:
    """Add to `before` how often the vehicle sends these messages by itself, us."""
    missing = [message_id for message_id in rates if message_id not in before]
    with suppress(TimeoutError):
        async with asyncio.timeout(FIRST_S):
            for message_id in missing:
                before |= await vehicle.intervals([message_id])
    silent = [message_id for message_id in missing if message_id not in before]
    if silent:
        heard.notes.append(f"the rates of {len(silent)} messages were not heard in time; their defaults are put back")
        before |= dict.fromkeys(silent, 0)


def _asked(asking: asyncio.Task[None], heard: _Heard) -> bool:
    """Whether the vehicle ran its own checks; what it says comes as texts and in SYS_STATUS."""
    if not asking.done():
        heard.notes.append("the vehicle did not confirm in time that it ran its checks")
        return False
    error = asking.exception()
    if error is None:
        return True
    if not isinstance(error, CommandRefused | CommandTimeout):
        raise error
    heard.notes.append(f"the vehicle did not run its checks when asked: {error}")
    return False


async def _looked(heard: _Heard, autopilot: str) -> Gathered:
    """Progress of the streams; messages are decoded outside the event loop."""
    return await asyncio.to_thread(gathered, tuple(heard.frames), autopilot)


async def _silent_asked(
    vehicle: JobVehicle, rates: dict[int, float], known: tuple[VerifiedCalibration, ...], heard: _Heard
) -> None:
    """Ask again for the streams of announced sensors that send nothing: their requests may have been lost."""
    autopilot = vehicle.identity.autopilot or ""
    for _ in range(SILENT_ASKS):
        there = announced(autopilot, heard.parameters, stated_device_ids(known, heard.parameters))
        counts = counted_messages(heard.frames, autopilot)
        if all(counts[instance] for _, instance in there if instance < STREAMED):
            return
        vehicle.demand_streams(rates)
        await asyncio.sleep(LOOK_S)


async def _judged(
    vehicle: JobVehicle,
    heard: _Heard,
    at: float,
    known: tuple[VerifiedCalibration, ...],
    heading: float | None,
    *,
    complete: bool,
    asked: bool,
) -> tuple[Snapshot, Report]:
    """The snapshot of all frames so far and the report on it, both computed in a thread."""
    made = await asyncio.to_thread(
        _snapshot, vehicle.identity, heard, at, known, heading, complete=complete, asked=asked
    )
    view = dataclasses.replace(made.view, calibrating=vehicle.condition().calibrating)
    snapshot = dataclasses.replace(made, view=view)
    return snapshot, await asyncio.to_thread(preflight, snapshot)


async def _put_back(vehicle: JobVehicle, before: dict[int, int]) -> None:
    with suppress(ServiceError):
        await vehicle.set_intervals(before)


def _snapshot(
    identity: Identity,
    heard: _Heard,
    at: float,
    history: tuple[VerifiedCalibration, ...],
    heading: float | None,
    *,
    complete: bool,
    asked: bool,
) -> Snapshot:
    stated = stated_device_ids(history, heard.parameters)
    found = collect(heard.frames, identity, heard.parameters, asked=asked, complete=complete, stated=stated)
    return Snapshot(
        found.recording,
        identity,
        heard.parameters,
        at,
        history,
        found.shaking,
        found.view,
        heading,
        found.current_known,
        rewritten=tuple(dict.fromkeys(heard.rewritten)),
        complete=complete,
        messages=found.messages,
        uncorrected=found.uncorrected,
    )
