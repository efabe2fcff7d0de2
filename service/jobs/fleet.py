"""The vehicles of :mod:`service.vehicle` as jobs see them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress

from calib.firmware.plan import ParameterKind, Value
from calib.recording import Identity
from calib.wire import Frame
from service.errors import CommandRefused, DiskFull
from service.jobs.port import Condition, FramesCallback, Reading, TlogPosition
from service.link import Batch
from service.vehicle import Vehicle, VehicleRegistry
from service.vehicle.encoding import Parameter
from service.vehicle.encoding import ParameterKind as WireKind
from service.vehicle.streams import DEFAULT_INTERVAL, get_interval, measure, set_interval

SLOW = 0.7
"""A stream that brings less than this share of what was asked for is called slow."""


class FleetVehicle:
    """One vehicle; see :class:`service.jobs.port.JobVehicle`."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle

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
        state, now = vehicle.state, vehicle.clock()
        running = state.onboard_calibration
        place = (vehicle.system, vehicle.component)
        address = vehicle.link.peers.get(place)
        return Condition(
            armed=bool(state.armed),
            silent=state.silent(now),
            reboots=state.rebooted,
            calibrating=running is not None and not running.over(now),
            obstacles=vehicle.writable().reasons,
            conflict=next(iter(vehicle.conflicts), None),
            peer="" if address is None else f"{address[0]}:{address[1]}",
        )

    async def identify(self) -> Identity:
        """See JobVehicle."""
        await self._vehicle.identify()
        return self.identity

    async def list_parameters(self) -> dict[str, Reading]:
        """See JobVehicle."""
        listed = await self._vehicle.list_parameters()
        return {name: _reading(parameter) for name, parameter in listed.parameters.items()}

    async def read_parameter(self, name: str) -> Reading:
        """See JobVehicle."""
        return _reading(await self._vehicle.parameters.read(name))

    async def set_parameter(self, name: str, value: Value, kind: ParameterKind) -> Reading:
        """See JobVehicle."""
        echo = await self._vehicle.parameters.set(name, value, WireKind[kind.name])
        return _reading(echo.parameter)

    async def command(self, command: int, params: Sequence[float]) -> None:
        """See JobVehicle."""
        await self._vehicle.command(command, params)

    async def intervals(self, message_ids: Iterable[int]) -> dict[int, int]:
        """See JobVehicle."""
        return {i: await get_interval(self._vehicle, i) or DEFAULT_INTERVAL for i in message_ids}

    async def set_intervals(self, intervals: Mapping[int, int]) -> None:
        """See JobVehicle."""
        for message_id, interval in intervals.items():
            with suppress(CommandRefused):
                await set_interval(self._vehicle, message_id, interval)

    async def measure(self, rates: Mapping[int, float], seconds: float) -> tuple[str, ...]:
        """See JobVehicle."""
        _, own = await measure(self._vehicle, tuple(rates), seconds)
        return _slow({message: own[message] / rate for message, rate in rates.items() if own[message] > 0.0})

    def subscribe(self, message_ids: frozenset[int], callback: FramesCallback) -> Callable[[], None]:
        """See JobVehicle."""

        def hand_on(frames: Sequence[Frame], batch: Batch) -> None:
            callback(frames, batch.tlog_error)

        return self._vehicle.subscribe(message_ids, hand_on)

    def on_parameter(self, callback: Callable[[Reading], None]) -> Callable[[], None]:
        """See JobVehicle."""
        return self._vehicle.parameters.listen(lambda heard, _before: callback(_reading(heard)))

    def tlog_position(self) -> TlogPosition:
        """See JobVehicle."""
        tlog = self._vehicle.link.tlog
        return TlogPosition(tlog.path, tlog.position)

    async def sync_tlog(self) -> None:
        """See JobVehicle."""
        tlog = self._vehicle.link.tlog
        if tlog.error is not None:
            raise DiskFull(str(tlog.error))
        await tlog.sync()


class Fleet:
    """Every vehicle of a registry; see :class:`service.jobs.port.VehicleSource`."""

    def __init__(self, registry: VehicleRegistry) -> None:
        self._registry = registry

    def vehicle(self, vehicle_id: str) -> FleetVehicle:
        """See VehicleSource."""
        return FleetVehicle(self._registry.get(vehicle_id))


def _reading(parameter: Parameter) -> Reading:
    return Reading(parameter.name, parameter.value, ParameterKind[parameter.kind.name])


def _slow(shares: Mapping[int, float]) -> tuple[str, ...]:
    """What comes slower than asked for, in one sentence; streams that never come are the procedure's to judge."""
    slowest = min(shares.values(), default=1.0)
    if slowest >= SLOW:
        return ()
    times = 1.0 / max(slowest, 0.01)
    text = f"the link is slow: the slowest stream comes at {slowest:.0%} of its rate"
    return (f"{text}, the job takes up to {times:.1f} times as long",)
