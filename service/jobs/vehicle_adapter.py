"""Adapts the vehicles of :mod:`service.vehicle` to what jobs ask of one."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Collection, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager

from mavcal.calib.firmware.plan import ParameterKind, Value
from mavcal.calib.recording import Identity
from mavcal.calib.wire import Frame, ParamType
from mavcal.service.errors import CommandTimeout, DiskFull
from mavcal.service.jobs.port import Condition, FramesCallback, ParameterReading, TlogPosition
from mavcal.service.link import Batch
from mavcal.service.link.capacity import slowdown
from mavcal.service.vehicle import Vehicle, VehicleRegistry
from mavcal.service.vehicle.encoding import Parameter
from mavcal.service.vehicle.intervals import get_intervals
from mavcal.service.vehicle.streams import StreamReport, demand_streams, request_streams

SLOW = 1.2
"""From here on a job takes so much longer that it is said."""


Doubted = Callable[[str], str | None]
GiveWay = Callable[[str, Collection[int]], Awaitable[Mapping[int, int]]]
"""See :meth:`service.jobs.live_rates.LiveRates.give_way`."""


async def _nobody_watches(_vehicle_id: str, _message_ids: Collection[int]) -> Mapping[int, int]:
    return {}


class VehicleAdapter:
    """One vehicle; see :class:`service.jobs.port.JobVehicle`. `give_way` puts back the rates of whoever watches it."""

    def __init__(
        self, vehicle: Vehicle, doubted: Doubted = lambda _: None, give_way: GiveWay = _nobody_watches
    ) -> None:
        self._known = vehicle
        self._doubted = doubted
        self._give_way = give_way

    @property
    def _vehicle(self) -> Vehicle:
        """The unit, also where it turned out to be one that was known on another link."""
        return self._known.unit

    @property
    def id(self) -> str:
        """See JobVehicle."""
        return self._vehicle.id

    @property
    def identity(self) -> Identity:
        """See JobVehicle."""
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
        """See JobVehicle."""
        vehicle = self._vehicle
        state, now = vehicle.state, vehicle.heard_until
        running = state.onboard_calibration
        place = (vehicle.system, vehicle.component)
        address = vehicle.link.peers.get(place)
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
        """See JobVehicle."""
        await self._vehicle.caught_up()

    async def identify(self) -> Identity:
        """See JobVehicle."""
        await self._vehicle.identify()
        return self.identity

    async def read_parameter(self, name: str) -> ParameterReading:
        """See JobVehicle."""
        return _reading(await self._vehicle.parameters.read(name))

    async def set_parameter(self, name: str, value: Value, kind: ParameterKind) -> ParameterReading:
        """See JobVehicle."""
        echo = await self._vehicle.parameters.set(name, value, ParamType[kind.name])
        return _reading(echo.parameter)

    async def command(self, command: int, params: Sequence[float]) -> None:
        """See JobVehicle."""
        await self._vehicle.command(command, params)

    async def intervals(self, message_ids: Iterable[int]) -> dict[int, int]:
        """See JobVehicle."""
        wanted = tuple(message_ids)
        known = await self._give_way(self.id, wanted)
        asked = [message_id for message_id in wanted if message_id not in known]
        return {**known, **await get_intervals(self._vehicle, asked)}

    async def request_streams(
        self, rates: Mapping[int, float], *, measure_s: float, before: Mapping[int, int]
    ) -> tuple[str, ...]:
        """See JobVehicle."""
        report = await request_streams(self._vehicle, rates, measure_s=measure_s, before=before)
        if report.slowdown <= SLOW:
            return ()
        return (f"the link is slow: collecting the samples takes {report.slowdown:.1f} times as long",)

    def demand_streams(self, rates: Mapping[int, float]) -> float:
        """See JobVehicle."""
        return slowdown(rates, demand_streams(self._vehicle, rates))

    async def set_intervals(self, intervals: Mapping[int, int]) -> None:
        """See JobVehicle."""
        failed = await StreamReport(self._vehicle, {}, intervals).restore()
        if failed:
            raise CommandTimeout(f"not confirmed for messages {', '.join(map(str, failed))}")

    def subscribe(self, message_ids: frozenset[int], callback: FramesCallback) -> Callable[[], None]:
        """See JobVehicle."""

        def hand_on(frames: Sequence[Frame], batch: Batch) -> None:
            callback(frames, batch.tlog_error)

        return self._vehicle.subscribe(message_ids, hand_on)

    async def record(
        self, message_ids: frozenset[int], callback: FramesCallback
    ) -> tuple[TlogPosition, Callable[[], None]]:
        """See JobVehicle."""

        def hand_on(frames: Sequence[Frame], batch: Batch) -> None:
            callback(frames, batch.tlog_error)

        byte, forget = await self._vehicle.record(message_ids, hand_on)
        return TlogPosition(self._vehicle.link.tlog.path, byte), forget

    def on_parameter(self, callback: Callable[[ParameterReading], None]) -> Callable[[], None]:
        """See JobVehicle."""
        return self._vehicle.parameters.listen(lambda heard, _before: callback(_reading(heard)))

    def tlog_position(self) -> TlogPosition:
        """See JobVehicle."""
        tlog = self._vehicle.link.tlog
        return TlogPosition(tlog.path, tlog.position)

    def unbroken_tlog(self) -> AbstractContextManager[None]:
        """See JobVehicle."""
        return self._vehicle.link.unbroken()

    async def sync_tlog(self) -> None:
        """See JobVehicle."""
        tlog = self._vehicle.link.tlog
        if tlog.error is not None:
            raise DiskFull(str(tlog.error))
        await tlog.sync()


class RegistryAdapter:
    """Every vehicle of a registry; see :class:`service.jobs.port.VehicleSource`.

    `doubted` says why a vehicle may not be ours to write to, if there are other instances of the service; `give_way`
    puts back the rates of whoever watches one.
    """

    def __init__(
        self, registry: VehicleRegistry, doubted: Doubted = lambda _: None, give_way: GiveWay = _nobody_watches
    ) -> None:
        self._registry = registry
        self._doubted = doubted
        self._give_way = give_way

    def vehicle(self, vehicle_id: str) -> VehicleAdapter:
        """See VehicleSource."""
        return self._adapted(self._registry.get(vehicle_id))

    def nameless(self, identity: Identity) -> tuple[VehicleAdapter, ...]:
        """See VehicleSource."""
        alike = (identity.autopilot, identity.vehicle_type, identity.firmware, identity.system, identity.component)
        found = [self._adapted(vehicle) for vehicle in self._registry.all() if vehicle.identity.known]
        return tuple(
            one
            for one in found
            if (known := one.identity).uid is None
            and (known.autopilot, known.vehicle_type, known.firmware, known.system, known.component) == alike
        )

    def _adapted(self, vehicle: Vehicle) -> VehicleAdapter:
        return VehicleAdapter(vehicle, self._doubted, self._give_way)


def _reading(parameter: Parameter) -> ParameterReading:
    return ParameterReading(parameter.name, parameter.value, ParameterKind[parameter.kind.name])
