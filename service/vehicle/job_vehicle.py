"""One vehicle as jobs and preflights use it, over whichever of its links is in use."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

from mavcal.calib.firmware.plan import ParameterKind, Value
from mavcal.calib.recording import Identity
from mavcal.calib.wire.frames import Frame
from mavcal.calib.wire.parameters import ParamType
from mavcal.service.errors import CommandTimeout, DiskFull, ParameterMissing
from mavcal.service.link.capacity import slowdown
from mavcal.service.link.types import Batch
from mavcal.service.vehicle.intervals import get_intervals
from mavcal.service.vehicle.parameter_bits import Parameter
from mavcal.service.vehicle.rate_ledger import RateLedger
from mavcal.service.vehicle.registry import VehicleRegistry
from mavcal.service.vehicle.streams import StreamReport, demand_streams, request_streams
from mavcal.service.vehicle.vehicle import Vehicle

SLOW = 1.2
"""Slowdown of the collection of samples from which a job reports a slow link."""
READS_IN_FLIGHT = 10
"""ArduPilot queues 20 reads and answers 5 at a time; what exceeds that is dropped (FLIGHT_CONTROLLERS 3.1)."""


@dataclass(frozen=True)
class ParameterReading:
    """A parameter as the vehicle states it."""

    name: str
    value: Value
    kind: ParameterKind


@dataclass(frozen=True)
class Condition:
    """The vehicle's state at this instant, as far as a job needs it."""

    armed: bool
    silent: bool
    """No heartbeat for 3 s, by what the reader of the link has read: a late event loop is no silence."""
    reboots: int
    """Number of restarts seen since it was first heard."""
    calibrating: bool
    """It runs an onboard calibration."""
    obstacles: tuple[str, ...]
    """Why nothing may be written now (DESIGN 6 rule 1), one sentence each; empty: it may."""
    conflict: str | None
    """Why it is not certain which vehicle answers (DESIGN 6 rule 3); None: it is."""
    peer: str = ""
    """The address that it speaks from, on the link in use."""
    way: str = ""
    """Name of the link in use: another one of the same vehicle takes its place when it falls silent."""
    boot_time: float | None = None
    """Its own clock, s since its start; None: it has not said."""
    armings: int = 0
    """Number of times it armed since it was first heard; the next two likewise."""
    silences: int = 0
    calibrations: int = 0


@dataclass(frozen=True)
class TlogPosition:
    """A byte position in a link's telemetry log."""

    path: Path
    byte: int


FramesCallback = Callable[[Sequence[Frame], DiskFull | None], None]
Doubted = Callable[[str], str | None]
"""Why the vehicle of that id may not be ours to write to; None: it is."""
Release = Callable[[str, Collection[int]], Awaitable[Mapping[int, int]]]
"""Returns the message rates of those who watch a vehicle; gives intervals (us) that could not be returned."""


async def _nobody_watches(_vehicle_id: str, _message_ids: Collection[int]) -> Mapping[int, int]:
    return {}


class JobVehicle:
    """One vehicle, even if it turned out to be one known on another link.

    Parameters
    ----------
    vehicle
        As it was found.
    doubted, release
        See :data:`Doubted`, :data:`Release`.
    """

    def __init__(self, vehicle: Vehicle, doubted: Doubted = lambda _: None, release: Release = _nobody_watches) -> None:
        self._found = vehicle
        self._doubted = doubted
        self._release = release

    @property
    def _vehicle(self) -> Vehicle:
        return self._found.unit

    @property
    def id(self) -> str:
        """Stable and URL-safe."""
        return self._vehicle.id

    @property
    def rates(self) -> RateLedger:
        """The ledger of its message rates."""
        return self._vehicle.rates

    @property
    def identity(self) -> Identity:
        """Autopilot, firmware version and uid, as last stated by the vehicle."""
        known = self._vehicle.identity
        return Identity(
            autopilot=known.autopilot.value,
            vehicle_type=known.vehicle_type,
            firmware=known.version,
            uid=known.uid2,
            system=self._vehicle.system,
            component=self._vehicle.component,
        )

    def condition(self) -> Condition:
        """The state now."""
        vehicle = self._vehicle
        state, now = vehicle.state, vehicle.heard_until
        running = state.onboard_calibration
        address = vehicle.link.peers.get((vehicle.system, vehicle.component))
        return Condition(
            armed=bool(state.armed),
            silent=state.silent(now),
            reboots=state.rebooted,
            armings=state.armings,
            silences=state.silences,
            calibrations=state.calibrations,
            calibrating=running is not None and not running.over(now),
            obstacles=vehicle.writable().reasons,
            conflict=self._doubted(vehicle.id) or next(iter(vehicle.conflicts), None),
            peer="" if address is None else f"{address[0]}:{address[1]}",
            boot_time=state.boot_time,
            way=vehicle.way,
        )

    async def caught_up(self) -> None:
        """Return once everything received from it by now shows in `condition`. Raises LinkDown."""
        await self._vehicle.caught_up()

    async def identify(self) -> Identity:
        """Ask who it is. Raises VehicleError if it does not say."""
        await self._vehicle.identify()
        return self.identity

    async def read_parameter(self, name: str) -> ParameterReading:
        """Ask for one parameter. Raises ParameterMissing or ParameterTimeout."""
        return _reading(await self._vehicle.parameters.read(name))

    async def set_parameter(self, name: str, value: Value, kind: ParameterKind) -> ParameterReading:
        """Write one parameter and wait for the echo of this very value. Raises ParameterError."""
        echo = await self._vehicle.parameters.set(name, value, ParamType[kind.name])
        return _reading(echo.parameter)

    async def command(self, command: int, params: Sequence[float]) -> None:
        """Send a MAV_CMD. Raises CommandRefused or CommandTimeout."""
        await self._vehicle.command(command, params)

    async def intervals(self, message_ids: Iterable[int]) -> dict[int, int]:
        """Message intervals, us: -1 off, 0 the vehicle's default (also where it does not say).

        The caller has claimed the vehicle and is about to change them. Rates that were set for somebody who watches
        are returned first.
        """
        wanted = tuple(message_ids)
        known = await self._release(self.id, wanted)
        asked = [message_id for message_id in wanted if message_id not in known]
        return {**known, **await get_intervals(self._vehicle, asked)}

    async def request_streams(
        self, rates: Mapping[int, float], *, measure_s: float, before: Mapping[int, int]
    ) -> tuple[str, ...]:
        """Ask for messages at rates in Hz, or what the link carries of them, and measure what comes.

        `before` are the intervals (us) as they were, by message.
        Returns sentences about what comes slower or not at all, and what that means for the job's length.
        """
        report = await request_streams(self._vehicle, rates, measure_s=measure_s, before=before)
        if report.slowdown <= SLOW:
            return ()
        return (f"the link is slow: collecting the samples takes {report.slowdown:.1f} times as long",)

    def demand_streams(self, rates: Mapping[int, float]) -> float:
        """Ask for messages at rates in Hz, or what the link carries of them, without waiting for any answer.

        Returns how many times longer it takes to collect as many samples; 1: the link carries everything.
        """
        return slowdown(rates, demand_streams(self._vehicle, rates))

    async def set_intervals(self, intervals: Mapping[int, int]) -> None:
        """Put message intervals back, us. Raises CommandTimeout naming those that were not confirmed, LinkDown."""
        failed = await StreamReport(self._vehicle, {}, intervals).restore()
        if failed:
            raise CommandTimeout(f"not confirmed for messages {', '.join(map(str, failed))}")

    def subscribe(self, message_ids: frozenset[int], callback: FramesCallback) -> Callable[[], None]:
        """Call back with this vehicle's frames of these ids, in order; returns how to stop."""
        return self._vehicle.subscribe(message_ids, _handing_on(callback))

    async def record(
        self, message_ids: frozenset[int], callback: FramesCallback
    ) -> tuple[TlogPosition, Callable[[], None]]:
        """Like `subscribe`, for exactly what the telemetry log holds from the place returned. Raises LinkDown."""
        byte, forget = await self._vehicle.record(message_ids, _handing_on(callback))
        return TlogPosition(self._vehicle.link.tlog.path, byte), forget

    def on_parameter(self, callback: Callable[[ParameterReading], None]) -> Callable[[], None]:
        """Call back with every PARAM_VALUE heard, requested or not; returns how to stop."""
        return self._vehicle.parameters.listen(lambda heard, _before: callback(_reading(heard)))

    def tlog_position(self) -> TlogPosition:
        """Byte position in the telemetry log behind all that was delivered so far."""
        tlog = self._vehicle.link.tlog
        return TlogPosition(tlog.path, tlog.position)

    def unbroken_tlog(self) -> AbstractContextManager[None]:
        """Keep the telemetry log in one file meanwhile, so that a segment of it can be begun and ended."""
        return self._vehicle.link.unbroken()

    async def sync_tlog(self) -> None:
        """Force the telemetry log to the disk. Raises DiskFull."""
        tlog = self._vehicle.link.tlog
        if tlog.error is not None:
            raise DiskFull(str(tlog.error))
        await tlog.sync()


class VehicleSource:
    """Finds vehicles for jobs by their id.

    Parameters
    ----------
    registry
        Every vehicle that is heard.
    doubted, release
        As for :class:`JobVehicle`.
    """

    def __init__(
        self, registry: VehicleRegistry, doubted: Doubted = lambda _: None, release: Release = _nobody_watches
    ) -> None:
        self._registry = registry
        self._doubted = doubted
        self._release = release

    def vehicle(self, vehicle_id: str) -> JobVehicle:
        """The vehicle of that id. Raises VehicleUnknown."""
        return self._of(self._registry.get(vehicle_id))

    def nameless(self, identity: Identity) -> Sequence[JobVehicle]:
        """Vehicles without a unique id whose stated identity equals `identity`, on any link."""
        alike = (identity.autopilot, identity.vehicle_type, identity.firmware, identity.system, identity.component)
        found = [self._of(vehicle) for vehicle in self._registry.all() if vehicle.identity.known]
        return tuple(
            one
            for one in found
            if (known := one.identity).uid is None
            and (known.autopilot, known.vehicle_type, known.firmware, known.system, known.component) == alike
        )

    def _of(self, vehicle: Vehicle) -> JobVehicle:
        return JobVehicle(vehicle, self._doubted, self._release)


async def read_values(
    vehicle: JobVehicle,
    names: Iterable[str],
    *,
    absent: bool = False,
    progress: Callable[[int], None] | None = None,
) -> dict[str, ParameterReading]:
    """Fresh values of `names`, a few requests at a time.

    Parameters
    ----------
    vehicle, names
        Whom to ask for what.
    absent
        Whether a name that the vehicle does not have is left out; otherwise it is an error.
    progress
        Called with how many were answered so far.

    Raises
    ------
    ParameterMissing, ParameterTimeout
    """
    gate = asyncio.Semaphore(READS_IN_FLIGHT)
    found: dict[str, ParameterReading | None] = {}

    async def one(name: str) -> None:
        async with gate:
            try:
                found[name] = await vehicle.read_parameter(name)
            except ParameterMissing:
                if not absent:
                    raise
                found[name] = None
        if progress is not None:
            progress(len(found))

    wanted = tuple(dict.fromkeys(names))
    try:
        async with asyncio.TaskGroup() as group:
            for name in wanted:
                group.create_task(one(name))
    except ExceptionGroup as errors:
        raise errors.exceptions[0] from None
    return {name: reading for name in wanted if (reading := found[name]) is not None}


def _handing_on(callback: FramesCallback) -> Callable[[Sequence[Frame], Batch], None]:
    return lambda frames, batch: callback(frames, batch.tlog_error)


def _reading(parameter: Parameter) -> ParameterReading:
    return ParameterReading(parameter.name, parameter.value, ParameterKind[parameter.kind.name])
