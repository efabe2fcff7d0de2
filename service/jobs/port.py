"""What a job needs of a vehicle: a narrow view of :mod:`service.vehicle` that tests can stand in for."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from mavcal.calib.firmware.plan import ParameterKind, Value
from mavcal.calib.recording import Identity
from mavcal.calib.wire import Frame
from mavcal.service.errors import DiskFull


@dataclass(frozen=True)
class Reading:
    """A parameter as the vehicle states it."""

    name: str
    value: Value
    kind: ParameterKind


@dataclass(frozen=True)
class Condition:
    """The vehicle's state at this instant, as far as a job cares."""

    armed: bool
    silent: bool
    """No heartbeat for 3 s."""
    reboots: int
    """How often it was seen to restart since it was first heard."""
    calibrating: bool
    """It runs an onboard calibration."""
    obstacles: tuple[str, ...]
    """Why nothing may be written now (DESIGN 6 rule 1), one sentence each; empty: it may."""
    conflict: str | None
    """Why it is not certain whom we talk to (DESIGN 6 rule 3); None: it is."""
    peer: str = ""
    """The address that it speaks from."""
    boot_time: float | None = None
    """Its own clock, s since its start; None: it has not said."""


@dataclass(frozen=True)
class TlogPosition:
    """A byte position in a link's telemetry log."""

    path: Path
    byte: int


FramesCallback = Callable[[Sequence[Frame], DiskFull | None], None]


class JobVehicle(Protocol):
    """One vehicle on one link."""

    @property
    def id(self) -> str:
        """Stable and URL-safe."""
        ...

    @property
    def identity(self) -> Identity:
        """Autopilot, firmware version and uid, as last stated by the vehicle."""
        ...

    def condition(self) -> Condition:
        """The state now."""
        ...

    async def identify(self) -> Identity:
        """Ask who it is. Raises VehicleError if it does not say."""
        ...

    async def read_parameter(self, name: str) -> Reading:
        """Ask for one parameter. Raises ParameterMissing or ParameterTimeout."""
        ...

    async def set_parameter(self, name: str, value: Value, kind: ParameterKind) -> Reading:
        """Write one parameter and wait for the echo of this very value. Raises ParameterError."""
        ...

    async def command(self, command: int, params: Sequence[float]) -> None:
        """Send a MAV_CMD. Raises CommandRefused or CommandTimeout."""
        ...

    async def intervals(self, message_ids: Iterable[int]) -> dict[int, int]:
        """Message intervals as they are, us: -1 off, 0 the vehicle's default (also where it does not say)."""
        ...

    async def request_streams(
        self, rates: Mapping[int, float], *, measure_s: float, before: Mapping[int, int]
    ) -> tuple[str, ...]:
        """Ask for messages at rates in Hz, or what the link carries of them, and measure what comes.

        `before` are the intervals (us) as they were, by message.
        Returns sentences about what comes slower or not at all, and what that means for the job's length.
        """
        ...

    async def set_intervals(self, intervals: Mapping[int, int]) -> None:
        """Put message intervals back, us. Raises CommandTimeout naming those that were not confirmed, LinkDown."""
        ...

    def subscribe(self, message_ids: frozenset[int], callback: FramesCallback) -> Callable[[], None]:
        """Be called with this vehicle's frames of these ids, in order; returns how to stop."""
        ...

    async def record(
        self, message_ids: frozenset[int], callback: FramesCallback
    ) -> tuple[TlogPosition, Callable[[], None]]:
        """Like `subscribe`, for exactly what the telemetry log holds from the place returned. Raises LinkDown."""
        ...

    def on_parameter(self, callback: Callable[[Reading], None]) -> Callable[[], None]:
        """Be called with every PARAM_VALUE heard, asked for or not; returns how to stop."""
        ...

    def tlog_position(self) -> TlogPosition:
        """Where the telemetry log stands: everything delivered so far lies before it."""
        ...

    async def sync_tlog(self) -> None:
        """Force the telemetry log to the disk. Raises DiskFull."""
        ...


class VehicleSource(Protocol):
    """Where jobs find vehicles."""

    def vehicle(self, vehicle_id: str) -> JobVehicle:
        """The vehicle of that id. Raises VehicleUnknown."""
        ...
