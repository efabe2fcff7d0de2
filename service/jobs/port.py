"""The interfaces through which jobs use vehicles and uploads, narrow enough for tests to replace."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from mavcal.calib.firmware.in_force.origin import Origin
from mavcal.calib.firmware.plan import ParameterKind, Value
from mavcal.calib.fit import FitResult
from mavcal.calib.recording import Identity
from mavcal.calib.wire import Frame
from mavcal.service.errors import DiskFull, RecordingUnknown
from mavcal.service.store.rows import JobDocument


@dataclass(frozen=True)
class ParameterReading:
    """A parameter as the vehicle states it."""

    name: str
    value: Value
    kind: ParameterKind


@dataclass(frozen=True)
class Condition:
    """The vehicle's state at this instant, as far as a job cares."""

    armed: bool
    silent: bool
    """No heartbeat for 3 s, by what the reader of the link has read: a late event loop is no silence."""
    reboots: int
    """How often it was seen to restart since it was first heard."""
    calibrating: bool
    """It runs an onboard calibration."""
    obstacles: tuple[str, ...]
    """Why nothing may be written now (DESIGN 6 rule 1), one sentence each; empty: it may."""
    conflict: str | None
    """Why it is not certain whom we talk to (DESIGN 6 rule 3); None: it is."""
    peer: str = ""
    """The address that it speaks from, on the link in use."""
    way: str = ""
    """Name of the link in use: another one of the same vehicle takes its place when it falls silent."""
    boot_time: float | None = None
    """Its own clock, s since its start; None: it has not said."""
    armings: int = 0
    """How often it armed since it was first heard; the next two likewise."""
    silences: int = 0
    calibrations: int = 0


@dataclass(frozen=True)
class TlogPosition:
    """A byte position in a link's telemetry log."""

    path: Path
    byte: int


FramesCallback = Callable[[Sequence[Frame], DiskFull | None], None]


class JobVehicle(Protocol):
    """One vehicle, over whichever of its links is in use."""

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

    async def caught_up(self) -> None:
        """Return once everything that has arrived of it by now shows in `condition`. Raises LinkDown."""
        ...

    async def identify(self) -> Identity:
        """Ask who it is. Raises VehicleError if it does not say."""
        ...

    async def read_parameter(self, name: str) -> ParameterReading:
        """Ask for one parameter. Raises ParameterMissing or ParameterTimeout."""
        ...

    async def set_parameter(self, name: str, value: Value, kind: ParameterKind) -> ParameterReading:
        """Write one parameter and wait for the echo of this very value. Raises ParameterError."""
        ...

    async def command(self, command: int, params: Sequence[float]) -> None:
        """Send a MAV_CMD. Raises CommandRefused or CommandTimeout."""
        ...

    async def intervals(self, message_ids: Iterable[int]) -> dict[int, int]:
        """Message intervals, us: -1 off, 0 the vehicle's default (also where it does not say).

        Asked by who has claimed the vehicle and is about to change them: what was set for somebody who watches is put
        back before.
        """
        ...

    async def request_streams(
        self, rates: Mapping[int, float], *, measure_s: float, before: Mapping[int, int]
    ) -> tuple[str, ...]:
        """Ask for messages at rates in Hz, or what the link carries of them, and measure what comes.

        `before` are the intervals (us) as they were, by message.
        Returns sentences about what comes slower or not at all, and what that means for the job's length.
        """
        ...

    def demand_streams(self, rates: Mapping[int, float]) -> float:
        """Ask for messages at rates in Hz, or what the link carries of them, without waiting for any answer.

        Returns how many times longer it takes to collect as many samples; 1: the link carries everything.
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

    def on_parameter(self, callback: Callable[[ParameterReading], None]) -> Callable[[], None]:
        """Be called with every PARAM_VALUE heard, asked for or not; returns how to stop."""
        ...

    def tlog_position(self) -> TlogPosition:
        """Where the telemetry log stands: everything delivered so far lies before it."""
        ...

    def unbroken_tlog(self) -> AbstractContextManager[None]:
        """Meanwhile the telemetry log goes on in one file, so that a segment of it can be begun and ended."""
        ...

    async def sync_tlog(self) -> None:
        """Force the telemetry log to the disk. Raises DiskFull."""
        ...


Told = Callable[[str], None]
"""Hears how far a computation is, in words."""


@dataclass(frozen=True)
class Diagnosis:
    """What a gap diagnosis found: one sentence, and its report."""

    summary: str
    documents: tuple[JobDocument, ...]


class Computations(Protocol):
    """Computations on uploads, outside this process. When a call is cancelled, its computation is ended.

    Every method raises RecordingUnknown if an upload does not exist, and CalibError for what the computation itself
    refused. It raises ChildEnded if the computation used more than it may, and ChildrenBusy if too many are waiting.
    """

    @property
    def at_once(self) -> int:
        """How many are computed at a time; further ones wait."""
        ...

    def check(self, recording: str, method: str | None = None) -> None:
        """Raise RecordingUnknown or InvalidInputError if there is no such upload or method."""
        ...

    async def fit(
        self, recording: str, method: str, options: Mapping[str, Any], *, told: Told | None = None
    ) -> tuple[FitResult, ...]:
        """One fit a sensor."""
        ...

    async def fit_of_vehicle(
        self, recording: str, method: str, options: Mapping[str, Any]
    ) -> tuple[tuple[FitResult, ...], Origin]:
        """The same fits, and whose sensors they are of. Raises FirmwareError if the recording does not say."""
        ...

    async def diagnose(
        self,
        real: str,
        sim: str | None,
        nominal: Sequence[str],
        *,
        limit_s: float | None = None,
        told: Told | None = None,
    ) -> Diagnosis:
        """The sim-to-real gap of an upload; `limit_s` is its processor time, None: the default."""
        ...


class NoUploads:
    """The computations of an engine that has no uploads."""

    at_once = 1

    def check(self, recording: str, method: str | None = None) -> None:
        """Raise RecordingUnknown."""
        raise RecordingUnknown(f"there is no recording {recording}: uploads are not kept here")

    async def fit(
        self, recording: str, method: str, options: Mapping[str, Any], *, told: Told | None = None
    ) -> tuple[FitResult, ...]:
        """Raise RecordingUnknown."""
        raise RecordingUnknown

    async def fit_of_vehicle(
        self, recording: str, method: str, options: Mapping[str, Any]
    ) -> tuple[tuple[FitResult, ...], Origin]:
        """Raise RecordingUnknown."""
        raise RecordingUnknown

    async def diagnose(
        self,
        real: str,
        sim: str | None,
        nominal: Sequence[str],
        *,
        limit_s: float | None = None,
        told: Told | None = None,
    ) -> Diagnosis:
        """Raise RecordingUnknown."""
        raise RecordingUnknown


class VehicleSource(Protocol):
    """Where jobs find vehicles."""

    def vehicle(self, vehicle_id: str) -> JobVehicle:
        """The vehicle of that id. Raises VehicleUnknown."""
        ...

    def nameless(self, identity: Identity) -> Sequence[JobVehicle]:
        """Vehicles without a unique id of their own that say the same of themselves as `identity`, on any link."""
        ...
