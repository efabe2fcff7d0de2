"""Stand-ins for what jobs ask of a vehicle: one without a wire, and a registry of such."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mavcal.calib.firmware.plan import ParameterKind, Value
from mavcal.calib.recording import Identity
from mavcal.calib.wire.frames import Frame
from mavcal.service.errors import CommandRefused, ParameterMissing, ParameterRejected, ParameterTimeout, VehicleUnknown
from mavcal.service.vehicle.job_vehicle import Condition, FramesCallback, JobVehicle, ParameterReading, TlogPosition
from mavcal.service.vehicle.rate_ledger import RateLedger

FINE = Condition(armed=False, silent=False, reboots=0, calibrating=False, obstacles=(), conflict=None)


@dataclass
class FakeVehicle:
    """A vehicle that holds parameters and does as its faults say.

    `sets` lists every write that reached it as (name, value). `before_set` and `after_set` are called with the number
    of the write (from 1) before and after it takes effect: they may change :attr:`state`, write parameters as a third
    party would, or raise what the link would. `mute` names parameters whose writes and reads get no answer; `deaf`
    names those whose writes are echoed but not stored.
    """

    parameters: dict[str, ParameterReading]
    id: str = "vehicle-1"
    identity: Identity = field(default_factory=lambda: Identity("ardupilot", 2, (4, 7, 0), "00112233", 1, 1))
    state: Condition = FINE
    before_set: Callable[[int], None] = lambda _: None
    after_set: Callable[[int], None] = lambda _: None
    mute: set[str] = field(default_factory=set)
    deaf: set[str] = field(default_factory=set)
    refused_commands: set[int] = field(default_factory=set)
    sets: list[tuple[str, Value]] = field(default_factory=list)
    commands: list[int] = field(default_factory=list)
    message_intervals: dict[int, int] = field(default_factory=dict)
    tlog: Path = Path("fake.tlog")
    rates: RateLedger = field(default_factory=RateLedger)
    _frames: list[tuple[frozenset[int], FramesCallback]] = field(default_factory=list)
    _listeners: list[Callable[[ParameterReading], None]] = field(default_factory=list)

    @classmethod
    def with_floats(cls, values: Mapping[str, float], **changes: object) -> FakeVehicle:
        """A vehicle whose parameters are all REAL32."""
        readings = {n: ParameterReading(n, float(np.float32(v)), ParameterKind.REAL32) for n, v in values.items()}
        return cls(readings, **changes)  # type: ignore[arg-type]

    def values(self) -> dict[str, Value]:
        """What it holds now."""
        return {name: reading.value for name, reading in self.parameters.items()}

    def store(self, name: str, value: Value) -> None:
        """Change a parameter as another ground station would; listeners hear of it."""
        self.parameters[name] = replace(self.parameters[name], value=value)
        self._tell(self.parameters[name])

    def change_state(self, **changes: object) -> None:
        """Change the condition and let a heartbeat tell of it."""
        self.state = replace(self.state, **changes)  # type: ignore[arg-type]
        for _, callback in tuple(self._frames):
            callback((), None)

    def condition(self) -> Condition:
        """See JobVehicle."""
        return self.state

    async def caught_up(self) -> None:
        """See JobVehicle."""

    async def identify(self) -> Identity:
        """See JobVehicle."""
        await asyncio.sleep(0)
        return self.identity

    async def read_parameter(self, name: str) -> ParameterReading:
        """See JobVehicle."""
        await asyncio.sleep(0)
        if self.state.silent or name in self.mute:
            raise ParameterTimeout(f"{name}: no answer", name=name)
        if name not in self.parameters:
            raise ParameterMissing(f"{name} is unknown", name=name)
        self._tell(self.parameters[name])
        return self.parameters[name]

    async def set_parameter(self, name: str, value: Value, kind: ParameterKind) -> ParameterReading:
        """See JobVehicle."""
        await asyncio.sleep(0)
        if self.state.silent or name in self.mute:
            raise ParameterTimeout(f"{name}: no answer", name=name)
        self.sets.append((name, value))
        number = len(self.sets)
        self.before_set(number)
        echo = ParameterReading(name, value, kind)
        if name not in self.deaf:
            self.parameters[name] = echo
        self.after_set(number)
        await asyncio.sleep(0)
        if name not in self.deaf and self.parameters[name] != echo:
            raise ParameterRejected(f"{name} holds another value", name=name)
        self._tell(echo)
        return echo

    async def command(self, command: int, params: Sequence[float]) -> None:
        """See JobVehicle."""
        await asyncio.sleep(0)
        if command in self.refused_commands:
            raise CommandRefused(f"command {command} was refused", command=command, result=2)
        self.commands.append(command)

    async def intervals(self, message_ids: Iterable[int]) -> dict[int, int]:
        """See JobVehicle."""
        await asyncio.sleep(0)
        return {message: self.message_intervals.get(message, 0) for message in message_ids}

    async def request_streams(
        self, rates: Mapping[int, float], *, measure_s: float, before: Mapping[int, int]
    ) -> tuple[str, ...]:
        """See JobVehicle."""
        await asyncio.sleep(0)
        self.message_intervals |= {message: round(1e6 / rate) for message, rate in rates.items()}
        return ()

    def demand_streams(self, rates: Mapping[int, float]) -> float:
        """See JobVehicle."""
        self.message_intervals |= {message_id: int(1e6 / rate) for message_id, rate in rates.items()}
        return 1.0

    async def set_intervals(self, intervals: Mapping[int, int]) -> None:
        """See JobVehicle."""
        await asyncio.sleep(0)
        self.message_intervals |= intervals

    def subscribe(self, message_ids: frozenset[int], callback: FramesCallback) -> Callable[[], None]:
        """See JobVehicle."""
        entry = (message_ids, callback)
        self._frames.append(entry)
        return lambda: self._frames.remove(entry)

    async def record(
        self, message_ids: frozenset[int], callback: FramesCallback
    ) -> tuple[TlogPosition, Callable[[], None]]:
        """See JobVehicle."""
        await asyncio.sleep(0)
        return self.tlog_position(), self.subscribe(message_ids, callback)

    def deliver(self, frames: Sequence[Frame]) -> None:
        """Hand frames to whoever subscribed to their ids."""
        for ids, callback in tuple(self._frames):
            wanted = tuple(f for f in frames if f.message_id in ids)
            if wanted:
                callback(wanted, None)

    def on_parameter(self, callback: Callable[[ParameterReading], None]) -> Callable[[], None]:
        """See JobVehicle."""
        self._listeners.append(callback)

        def forget() -> None:
            with suppress(ValueError):
                self._listeners.remove(callback)

        return forget

    def tlog_position(self) -> TlogPosition:
        """See JobVehicle."""
        return TlogPosition(self.tlog, self.tlog.stat().st_size if self.tlog.exists() else 0)

    def unbroken_tlog(self) -> AbstractContextManager[None]:
        """See JobVehicle."""
        return nullcontext()

    async def sync_tlog(self) -> None:
        """See JobVehicle."""
        await asyncio.sleep(0)

    def _tell(self, reading: ParameterReading) -> None:
        for callback in tuple(self._listeners):
            callback(reading)


@dataclass
class FakeRegistry:
    """Vehicles by id."""

    vehicles: dict[str, JobVehicle] = field(default_factory=dict)

    def vehicle(self, vehicle_id: str) -> JobVehicle:
        """See VehicleSource."""
        if vehicle_id not in self.vehicles:
            raise VehicleUnknown(f"there is no vehicle {vehicle_id}")
        return self.vehicles[vehicle_id]

    def nameless(self, identity: Identity) -> list[JobVehicle]:
        """See VehicleSource."""
        return [vehicle for vehicle in self.vehicles.values() if vehicle.identity == replace(identity, uid=None)]
