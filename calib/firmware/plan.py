"""Write plans and their verification, as data.

A :class:`WritePlan` is pure data: ``compose`` of an autopilot makes it from fits, the service executes it, ``verify``
of the autopilot judges the stream afterwards. It is bound to one vehicle and to the snapshot that it was composed on.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum

from mavcal.calib.recording import Sensor

Value = float | int


class ParameterKind(StrEnum):
    """The type that a parameter has on the wire."""

    REAL32 = "real32"
    INT32 = "int32"
    INT16 = "int16"
    INT8 = "int8"
    UINT8 = "uint8"
    UINT16 = "uint16"
    UINT32 = "uint32"


@dataclass(frozen=True)
class Change:
    """One parameter to be set."""

    name: str
    old: Value | None  # a hidden one is set by name
    """In `unit`; None: hidden, the vehicle did not list it."""
    new: Value
    """In `unit`."""
    kind: ParameterKind  # REAL32: the values are exact in float32; else they are integers
    why: str
    sd: float | None = None  # none of a flag, an id or a range
    """Standard deviation of `new`, in `unit`; None: not an estimate."""
    unit: str = ""
    """Unit of the parameter; empty: a pure number."""
    sensor: Sensor | None = None
    instance: int = 0
    """Which sensor of its kind, from 0."""
    needs_reboot: bool = False
    session: bool = False
    """A setting of this session, put back when the job ends."""


@dataclass(frozen=True)
class Loss:
    """A part of the fit that this firmware cannot hold."""

    sensor: Sensor
    instance: int
    """Which sensor of its kind, from 0."""
    what: str
    cost: float
    """Largest effect of leaving it out, over all directions, in `unit`."""
    unit: str
    text: str


@dataclass(frozen=True)
class Agreement:
    """A sensor that is left as it is: the fit agrees with what is in force."""

    sensor: Sensor
    instance: int
    """Which sensor of its kind, from 0."""
    deviation: float  # over its independent parts, each in the standard deviation of the change
    """Root mean square of the change, in standard deviations."""
    text: str


@dataclass(frozen=True)
class LeftOut:
    """A sensor that was asked for and gets no new calibration, or only a part of it."""

    sensor: Sensor
    instance: int
    """Which sensor of its kind, from 0."""
    reason: str


@dataclass(frozen=True)
class AfterWrite:
    """A MAVLink command that is sent when every parameter was read back."""

    command: int
    """MAV_CMD."""
    params: tuple[float, float, float, float, float, float, float]
    """Its seven parameters."""
    why: str


@dataclass(frozen=True)
class Fingerprint:
    """Whose plan it is: any difference means that it has to be made again."""

    autopilot: str
    uid: str
    """Hardware id, hexadecimal."""
    firmware: str
    device_ids: tuple[tuple[str, int], ...]
    """Device ids of the sensors, by parameter."""


def sensors_of(changes: Iterable[Change], agreements: Iterable[Agreement]) -> frozenset[Sensor]:
    """The sensors that a plan of these is about."""
    about = [*(change.sensor for change in changes), *(agreement.sensor for agreement in agreements)]
    return frozenset(sensor for sensor in about if sensor is not None)


@dataclass(frozen=True)
class WritePlan:
    """Parameters to write in this order, with warnings, losses and blockers.

    `blockers` not empty: nothing of it may be written.
    """

    fingerprint: Fingerprint
    snapshot_sha256: str
    changes: tuple[Change, ...]
    losses: tuple[Loss, ...] = ()
    after: tuple[AfterWrite, ...] = ()
    warnings: tuple[str, ...] = ()
    blockers: tuple[str, ...] = ()
    agreements: tuple[Agreement, ...] = ()
    left_out: tuple[LeftOut, ...] = ()
    """Sensors that were fitted and are not written, or in part only."""

    @property
    def sensors(self) -> frozenset[Sensor]:
        """The sensors that it is about."""
        return sensors_of(self.changes, self.agreements)

    @property
    def nothing_to_write(self) -> bool:
        """Whether the vehicle already holds the fitted values, without a blocker."""
        return not self.changes and not self.blockers

    @property
    def needs_reboot(self) -> bool:
        """Whether the vehicle must be restarted before the result can be judged."""
        return any(change.needs_reboot for change in self.changes)

    @property
    def sha256(self) -> str:
        """Digest over everything in the plan; ``apply`` quotes it."""
        content = dataclasses.asdict(self)
        for later in ("agreements", "left_out"):
            if not content[later]:
                del content[later]  # plans of before there were any keep their digest
        text = json.dumps(content, sort_keys=True, allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()


class ProofVerdict(StrEnum):
    """Verdict on one written parameter."""

    PROVED = "proved"  # the stream agrees with the new value and contradicts the old one
    CONSISTENT = "consistent"  # agrees with the new value, cannot tell it from another combination
    NOT_OBSERVABLE = "not_observable"  # its effect is below 3 sd of the stream in these poses
    CONTRADICTED = "contradicted"  # the stream behaves as if it had not been applied


@dataclass(frozen=True)
class ParameterVerdict:
    """What the stream says of one written parameter."""

    name: str
    verdict: ProofVerdict
    effect: float
    """How far the stream would be off without this parameter, in `unit`; None: not finite."""
    sd: float
    """Standard deviation of the check, in `unit`; None: not finite."""
    unit: str
    text: str
    acts_on_stream: bool = True  # not so a flag, an id, a trim behind the sensors
    """False: no stream depends on it; it is judged by read-back alone."""


@dataclass(frozen=True)
class Movement:
    """What would prove the parameters that are still open."""

    text: str
    faces: tuple[str, ...] = ()  # names of calib.procedures.protocol.Pose
    """Poses to be held still."""
    turn: bool = False
    """Turn the vehicle through all directions."""
    temperature: float | None = None
    """Bring the sensors to about this, degC; None: any."""


class SensorVerdict(StrEnum):
    """Whether a sensor reads, after a write, what it should."""

    RIGHT = "right"  # within the limit
    WRONG = "wrong"  # beyond the limit in every reading of it
    NOT_OBSERVABLE = "not_observable"  # it was never at rest, or nothing says what it should read


class SensorCheckId(StrEnum):
    """What a sensor should read after a write."""

    GYRO_ZERO = "gyro_zero"  # nothing, at rest
    ACCEL_GRAVITY = "accel_gravity"  # gravity, at rest
    ACCEL_DIRECTION = "accel_direction"  # the same direction as another unit of its board
    LEVEL = "level"  # no tilt, where the vehicle stands level
    ATTITUDE = "attitude"  # the estimator's tilt is that of the accelerometer; never wrong, at most open


@dataclass(frozen=True)
class SensorCheck:
    """Reading of one sensor after the write against zero, gravity, another unit's direction, or level."""

    id: SensorCheckId
    sensor: Sensor
    instance: int
    """Which sensor of its kind, from 0."""
    value: float | None
    """How far it is off, in `unit`; None: not observed."""
    limit: float | None
    """The most that noise, drift and the fit explain, in `unit`."""
    unit: str
    sd: float | None
    """Standard deviation of `value`, in `unit`."""
    verdict: SensorVerdict
    text: str


@dataclass(frozen=True)
class Verification:
    """The physical check of a plan, and the movement that would prove what is still open (None: none would).

    Two questions: do the written parameters act (`parameters`), and do the sensors read right with them (`sensors`)?
    A calibration of another vehicle acts, and leaves the sensors wrong.
    """

    parameters: tuple[ParameterVerdict, ...]
    movement: Movement | None = None
    sensors: tuple[SensorCheck, ...] = ()
    unseen: tuple[str, ...] = ()
    """Parameters whose sensor was not streamed or never at rest: another look may tell."""

    @property
    def settled(self) -> bool:
        """Whether another check of a resting vehicle would change no verdict."""
        return not self.unseen and not self.refuted

    @property
    def contradicted(self) -> tuple[str, ...]:
        """Names of the parameters that were accepted but did not take effect."""
        return tuple(p.name for p in self.parameters if p.verdict == ProofVerdict.CONTRADICTED)

    @property
    def refuted(self) -> tuple[SensorCheck, ...]:
        """The sensors that read wrong although their parameters act."""
        return tuple(check for check in self.sensors if check.verdict == SensorVerdict.WRONG)

    @property
    def must_go(self) -> str:
        """Why the write has to be taken back, in a sentence; empty if it may stay."""
        reasons = []
        if self.contradicted:
            reasons.append(f"accepted but without effect on the stream: {', '.join(self.contradicted)}")
        reasons += [check.text for check in self.refuted]
        return "; ".join(reasons)

    @property
    def proved(self) -> bool:
        """Whether every parameter that acts on a stream is proved, there is one, and no sensor reads wrong."""
        acting = [p.verdict for p in self.parameters if p.acts_on_stream]
        return bool(acting) and not self.refuted and all(verdict == ProofVerdict.PROVED for verdict in acting)


def snapshot_sha256(values: Mapping[str, Value]) -> str:
    """Digest of a parameter snapshot (the calibration parameters that a plan rests on)."""
    text = json.dumps({k: repr(v) for k, v in values.items()}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
