"""Feeds the frames of a running capture to a procedure, and replays a closed capture through the same procedure.

Both use the same functions of ``calib``. The live one only guides the operator. The result comes from the replay of the
closed segments, which gives the same digits whenever it is repeated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from mavcal.calib.earth import EarthField, decimal_year, earth_field
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware import sensor_ids
from mavcal.calib.firmware.compose.early_warnings import STREAMED_INSTANCES
from mavcal.calib.firmware.in_force.fingerprint import BY_ITSELF, REWRITTEN_AT_REST, means_the_same
from mavcal.calib.firmware.in_force.needed import DRIFT_KINDS, needed
from mavcal.calib.firmware.in_force.rewritten import CertainOffsets, rewrites_meanwhile
from mavcal.calib.firmware.in_force.undo import KnownCalibration, Undo, calibration_changes, undo
from mavcal.calib.firmware.names import CALIBRATION_PREFIXES
from mavcal.calib.firmware.options import Key
from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.px4.parameters import without_row
from mavcal.calib.firmware.stream.assembler import Assembler
from mavcal.calib.firmware.values import shown
from mavcal.calib.procedures.protocol import Done, GaveUp, Step
from mavcal.calib.procedures.registry import create, replay, specification
from mavcal.calib.procedures.spec import OperatorAnswer, ProcedureContext
from mavcal.calib.recording import Identity, ParameterEntry, Recording, Sensor
from mavcal.calib.wire.frames import Frame
from mavcal.service.errors import CaptureDisturbed, CaptureEnded
from mavcal.service.jobs.core.model import LogSpan
from mavcal.service.jobs.core.segments import content_of

POSITION_WAIT_S = 3.0
"""Time that a compass job waits for the vehicle's position, s of its clock: the Earth's field depends on it."""

NO_KEYS: frozenset[Key] = frozenset()


@dataclass(frozen=True)
class JobFitRequest:
    """Everything that the result of a job depends on. It can be sent to another process."""

    kind: str
    options: Mapping[str, Any]
    spans: tuple[LogSpan, ...]
    system: int | None
    created_at: float
    answers: tuple[tuple[float, str], ...] = ()


@dataclass(frozen=True)
class Fitted:
    """The result of a job, with the vehicle's parameters as the segments show them at their end."""

    outcome: Done | GaveUp
    parameters: dict[str, Value]
    without_row: frozenset[Key] = NO_KEYS
    """PX4: see :func:`calib.firmware.px4.parameters.without_row`."""


class LiveDigest:
    """Feeds a procedure with live frames.

    Parameters
    ----------
    identity, parameters
        Whose frames, and the calibration in force at the start.
    created_at
        Wall-clock time of the job, for the Earth's field.
    """

    def __init__(
        self,
        kind: str,
        options: Mapping[str, Any],
        identity: Identity,
        parameters: Mapping[str, Value],
        created_at: float,
    ) -> None:
        self._assembler = Assembler(identity, parameters)
        self._certain = CertainOffsets() if rewrites_meanwhile(kind, identity.autopilot) else None
        self._undo = Undo(identity, parameters)
        self._prefixes = CALIBRATION_PREFIXES.get(identity.autopilot or "", ())
        self._known = KnownCalibration([name for name in parameters if name.startswith(self._prefixes)])
        self._parameters = dict(parameters)
        self._kind, self._options, self._created_at = kind, options, created_at
        self._waiting: list[Recording] = []
        self._scheduled: list[OperatorAnswer] = []
        """Answers from before a restart, for a procedure that has not begun."""
        self._procedure = None if Sensor.MAG in specification(kind).sensors else create(kind, options, self._context())
        self.last_time = float("-inf")
        """Newest time stamp of an inertial sample, s on the vehicle's clock."""
        self.restarted = False
        """Whether the vehicle's clock restarted among the frames."""

    @property
    def time(self) -> float:
        """The procedure's time, with which answers are stamped."""
        return float("-inf") if self._procedure is None else self._procedure.time

    @property
    def outcome(self) -> Done | GaveUp | None:
        """End of the procedure; None: it goes on."""
        return None if self._procedure is None else self._procedure.outcome

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of the procedure."""
        return () if self._procedure is None else tuple(self._procedure.warnings)

    def feed(self, frames: Sequence[Frame]) -> tuple[Step, ...]:
        """Feed frames; returns the steps of the procedure that they caused.

        Raises
        ------
        CaptureEnded
            If a calibration parameter changed: the samples before and after cannot be compared.
        """
        chunk = self._assembler.feed([(None, frame) for frame in frames])
        self._refuse_changes(chunk.parameters.entries)
        self.restarted |= any(event.kind == "reboot" for event in chunk.events)
        ends = [float(c.t[-1]) for c in chunk.channels if len(c) and c.sensor in (Sensor.ACCEL, Sensor.GYRO)]
        self.last_time = max([self.last_time, *ends])
        certain = chunk if self._certain is None else self._certain.feed(chunk)
        raw = self._known.feed(self._undo.feed(certain))
        if self._procedure is not None:
            return self._procedure.feed(raw)
        self._waiting.append(raw)
        return self._begun()

    def answer(self, value: str) -> tuple[Step, ...]:
        """Hand an operator's answer on. Raises ProcedureError if it does not fit the present prompt."""
        return () if self._procedure is None else self._procedure.answer(value)

    def schedule(self, answers: Sequence[tuple[float, str]]) -> None:
        """Schedule answers that were given in an earlier run of the service."""
        given = [OperatorAnswer(t, value) for t, value in answers]
        if self._procedure is None:
            self._scheduled += given
        else:
            self._procedure.schedule(given)

    def _begun(self) -> tuple[Step, ...]:
        """Start a compass procedure once the position is known, or the wait for it is over."""
        spans = [chunk.span for chunk in self._waiting if chunk.channels]
        begun = min((s[0] for s in spans), default=self.last_time)
        field = next((f for f in (field_of(chunk, self._created_at) for chunk in self._waiting) if f), None)
        if field is None and not self.last_time - begun > POSITION_WAIT_S:
            return ()
        self._procedure = create(self._kind, self._options, self._context(field))
        self._procedure.schedule(self._scheduled)
        chunks, self._waiting = self._waiting, []
        return tuple(step for chunk in chunks for step in self._procedure.feed(chunk))

    def _context(self, field: EarthField | None = None) -> ProcedureContext:
        return context_of(self._kind, self._assembler.identity, self._parameters, field)

    def _refuse_changes(self, entries: Sequence[ParameterEntry]) -> None:
        for entry in entries:
            if not entry.name.startswith(self._prefixes):
                continue
            before = self._parameters.setdefault(entry.name, entry.value)
            require_unchanged(self._kind, entry.name, before, entry.value)
            self._parameters[entry.name] = entry.value


def context_of(
    kind: str, identity: Identity, parameters: Mapping[str, Value], field: EarthField | None
) -> ProcedureContext:
    """The procedure's context: sensors that the parameters name are expected to stream."""
    wanted = specification(kind).sensors
    instances: dict[Sensor, tuple[int, ...]] = {}
    for sensor, instance in sorted(sensor_ids(identity.autopilot, parameters)):
        if sensor in wanted and instance < STREAMED_INSTANCES:
            instances[sensor] = (*instances.get(sensor, ()), instance)
    return ProcedureContext(identity, instances, field, parameters)


def voids_capture(kind: str, name: str, before: Value, after: Value) -> bool:
    """Whether this change of a parameter makes the capture of a job of `kind` useless.

    While a vehicle warms up, PX4 rewrites the offsets of its gyros whenever they have drifted by 0.01 rad/s. That is no
    loss: :class:`~calib.firmware.in_force.undo.Undo` takes each value out from its time on, and
    :class:`~calib.firmware.in_force.rewritten.CertainOffsets` leaves out the samples around the change.
    """
    if before == after or means_the_same(name, before, after):
        return False
    if kind in DRIFT_KINDS and name in REWRITTEN_AT_REST:
        return False
    return Sensor.GYRO in specification(kind).measured or name not in BY_ITSELF


def require_unchanged(kind: str, name: str, before: Value, after: Value) -> None:
    """Raise CaptureEnded if a change makes the capture useless; CaptureDisturbed if the vehicle may have made it."""
    if not voids_capture(kind, name, before, after):
        return
    who = "another ground station, or the vehicle itself"
    remedy = "Leave the vehicle's calibration alone while a job runs, and start the job again."
    if name.startswith("CAL_GYRO"):
        who += " (PX4's gyro_calibration, while IMU_GYRO_CAL_EN is 1)"
        remedy += " If it happens again, set IMU_GYRO_CAL_EN to 0 and restart the vehicle first."
    error = CaptureDisturbed if name in BY_ITSELF else CaptureEnded
    raise error(
        f"{name} changed from {shown(before)} to {shown(after)} during the capture, set by {who}", remedy=remedy
    )


def field_of(recording: Recording, at: float) -> EarthField | None:
    """The Earth's magnetic field at the first position that the vehicle reports; None: it reports none."""
    position = next((c for c in recording.channels if c.sensor == Sensor.POSITION and len(c)), None)
    year = decimal_year(datetime.fromtimestamp(at, UTC))
    for latitude, longitude, altitude in () if position is None else position.values:
        if latitude or longitude:  # (0, 0) is "no fix"
            with suppress(InvalidInputError):
                return earth_field(float(latitude), float(longitude), float(altitude), year)
    return None


def fit_segments(request: JobFitRequest) -> Fitted:
    """Replay closed segments through the job's procedure: the result of the job.

    Raises
    ------
    CaptureEnded
        If a segment is not what it was, or a calibration parameter changed in it.
    UnreadableError, InvalidInputError, FirmwareError
    """
    from mavcal.calib.logs.tlog import read_tlog  # readers of logs are not loaded before there is something to fit

    recording = read_tlog(b"".join(content_of(span) for span in request.spans), system=request.system)
    for entry in calibration_changes(recording):
        before = next(e.value for e in recording.parameters.entries if e.name == entry.name)
        require_unchanged(request.kind, entry.name, before, entry.value)
    parameters = recording.parameters.final()
    context = context_of(request.kind, recording.identity, parameters, field_of(recording, request.created_at))
    answers = [OperatorAnswer(t, value) for t, value in request.answers]
    known = KnownCalibration(_read_at_first(request.kind, recording.identity, parameters))
    if rewrites_meanwhile(request.kind, recording.identity.autopilot):
        recording = CertainOffsets(whole=True).feed(recording)
    outcome = replay(request.kind, request.options, context, known.feed(undo(recording)), answers)
    px4 = recording.identity.autopilot == "px4"
    return Fitted(outcome, parameters, without_row(recording.events, recording.parameters.entries) if px4 else NO_KEYS)


def _read_at_first(kind: str, identity: Identity, parameters: Mapping[str, Value]) -> list[str]:
    """The calibration parameters that the capture read before it fed its procedure."""
    autopilot = identity.autopilot or ""
    names = needed(autopilot, specification(kind).sensors, parameters, drift=kind in DRIFT_KINDS)
    return [name for name in names if name in parameters and name.startswith(CALIBRATION_PREFIXES[autopilot])]
