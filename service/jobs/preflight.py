"""A preflight of one vehicle: streams on, its own checks run, parameters read, streams back, a report within 10 s.

Nothing is written to the vehicle. While it is looked at no job may begin, and while a job runs it is not looked at:
both ask for message rates and put them back.
"""

from __future__ import annotations

import asyncio
import dataclasses
import time
from collections.abc import Awaitable, Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field

from mavcal.calib.firmware.in_force.needed import needed
from mavcal.calib.firmware.plan import Value
from mavcal.calib.preflight.check import Report
from mavcal.calib.preflight.collect import SENSORS, collect, preflight_streams, wanted_messages
from mavcal.calib.preflight.own import PARAMETERS
from mavcal.calib.preflight.readings import RestReading, rest_readings
from mavcal.calib.preflight.run import preflight
from mavcal.calib.preflight.snapshot import Snapshot, VerifiedCalibration
from mavcal.calib.recording import Identity
from mavcal.calib.wire import Frame
from mavcal.service.errors import CommandRefused, DiskFull, PreflightRunning, ServiceError
from mavcal.service.jobs.port import JobVehicle, ParameterReading
from mavcal.service.jobs.settings import JobSettings
from mavcal.service.jobs.write import read_values
from mavcal.service.vehicle.commands import RUN_PREARM_CHECKS

DEADLINE_S = 8.5
"""From the start to the last sample: what is left of ten seconds puts the streams back and computes."""
LEAST_S = 2.0
"""But at least so much of it is captured, however long the vehicle took to grant its streams."""
RESTORE_S = 1.0
"""So long the putting back may take before the verdict is given; it goes on by itself."""


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
    """What the inertial units read, for the fleet."""


@dataclass
class _Heard:
    """What came while the vehicle was looked at."""

    frames: list[Frame] = field(default_factory=list)
    parameters: dict[str, Value] = field(default_factory=dict)
    rewritten: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def take(self, frames: Sequence[Frame], _disk: DiskFull | None) -> None:
        self.frames += frames

    def hear(self, reading: ParameterReading) -> None:
        """NaN equals nothing, and says nothing of a change."""
        before = self.parameters.get(reading.name, reading.value)
        if before == before and before != reading.value:
            self.rewritten.append(reading.name)
        self.parameters[reading.name] = reading.value


class Preflights:
    """Looks at vehicles, each by one at a time."""

    def __init__(
        self,
        settings: JobSettings,
        wall: Callable[[], float] = time.time,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._capture_s = settings.preflight_s
        self._wall, self._clock = wall, clock
        self._running: set[str] = set()
        self._restoring: dict[str, asyncio.Task[None]] = {}

    def require_idle(self, vehicle_id: str) -> None:
        """Raise PreflightRunning while this vehicle is looked at."""
        if vehicle_id in self._running:
            raise PreflightRunning

    async def run(
        self,
        vehicle: JobVehicle,
        history: Callable[[], Awaitable[tuple[VerifiedCalibration, ...]]],
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
        await self.restored(vehicle.id)
        began, at, heard = self._clock(), self._wall(), _Heard()
        if vehicle.identity.firmware is None:
            await vehicle.identify()
        known = await history()
        forget = vehicle.subscribe(wanted_messages(vehicle.identity), heard.take)
        listening = vehicle.on_parameter(heard.hear)
        reading = asyncio.create_task(self._read(vehicle, known))
        before: dict[int, int] = {}
        try:
            before = await vehicle.intervals(rates)
            heard.notes += await vehicle.request_streams(rates, measure_s=0.0, before=before)
            heard.frames.clear()
            asked = await self._asked(vehicle, heard)
            left = DEADLINE_S - (self._clock() - began)
            await asyncio.sleep(max(min(self._capture_s, left), min(self._capture_s, LEAST_S)))
            complete = await self._finished(reading, began, heard)
        finally:
            reading.cancel()
            await asyncio.gather(reading, return_exceptions=True)
            listening()
            forget()
            await self._restored(vehicle, before)
        calibrating = vehicle.condition().calibrating
        snapshot = await asyncio.to_thread(
            _snapshot, vehicle.identity, heard, at, known, heading, complete=complete, asked=asked
        )
        view = dataclasses.replace(snapshot.view, calibrating=calibrating)
        report = await asyncio.to_thread(preflight, dataclasses.replace(snapshot, view=view))
        readings = await asyncio.to_thread(rest_readings, snapshot)
        seconds = self._clock() - began
        return Preflight(vehicle.id, vehicle.identity, at, seconds, report, tuple(heard.notes), readings=readings)

    @contextmanager
    def claimed(self, vehicle_id: str) -> Iterator[None]:
        """Meanwhile nobody else may begin anything with this vehicle. Raises PreflightRunning."""
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
        extra = {name for entry in known for name in entry.parameters} | set(PARAMETERS.get(autopilot, ()))
        asked: set[str] = set()
        while missing := (needed(autopilot, SENSORS, found, drift=False) | extra) - asked:
            asked |= missing
            readings = await read_values(vehicle, sorted(missing), absent=True)
            found |= {name: reading.value for name, reading in readings.items()}

    async def _finished(self, reading: asyncio.Task[None], began: float, heard: _Heard) -> bool:
        """Whether every parameter was read in time; the vehicle's answer to the last one is waited for a little."""
        left = max(DEADLINE_S - (self._clock() - began), 0.0)
        await asyncio.wait({reading}, timeout=left)
        if not reading.done():
            heard.notes.append("not every parameter could be read in time: the link is slow")
            return False
        error = reading.exception()
        if isinstance(error, ServiceError):
            heard.notes.append(f"not every parameter could be read: {error}")
            return False
        if error is not None:
            raise error
        return True

    async def _asked(self, vehicle: JobVehicle, heard: _Heard) -> bool:
        """Have the vehicle run its own checks; what it says comes as texts and in SYS_STATUS."""
        try:
            await vehicle.command(RUN_PREARM_CHECKS, ())
        except CommandRefused as error:
            heard.notes.append(f"the vehicle did not run its checks when asked: {error}")
            return False
        return True

    async def _restored(self, vehicle: JobVehicle, before: dict[int, int]) -> None:
        """Put the message rates back; on a slow link that goes on after the verdict."""
        if not before:
            return
        task = asyncio.create_task(_put_back(vehicle, before), name=f"rates of the preflight of {vehicle.id}")
        self._restoring[vehicle.id] = task
        await asyncio.wait({task}, timeout=RESTORE_S)

    async def restored(self, vehicle_id: str) -> None:
        """Wait until the rates of an earlier preflight are back."""
        task = self._restoring.pop(vehicle_id, None)
        if task is not None:
            await asyncio.wait({task})

    async def stop(self) -> None:
        """Wait until every vehicle has its rates back."""
        for vehicle_id in list(self._restoring):
            await self.restored(vehicle_id)


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
    found = collect(heard.frames, identity, heard.parameters, asked=asked)
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
    )
