"""Undoes the calibration in force: the stream as the bare sensor measured it (FLIGHT_CONTROLLERS 2.3).

Between two changes of a parameter one correction is in force. Samples count from the time at which it is known.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import FirmwareError, InvalidInputError
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.in_force.fingerprint import REWRITTEN_AT_REST
from mavcal.calib.firmware.names import CALIBRATION_PREFIXES, PX4_SLOTS
from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.firmware.slots import CALIBRATED
from mavcal.calib.recording import (
    Array,
    Channel,
    Event,
    Identity,
    ParameterEntry,
    ParameterTimeline,
    Recording,
    Sensor,
    Stage,
    join,
)
from mavcal.calib.triad import TriadModel

GUARD_BEFORE_S: Final = 0.5
GUARD_AFTER_S: Final = 0.1
"""Time, s, around a change that is left out: it acts before its echo, and the firmware's filter still settles after
it."""
PX4_BATTERIES: Final = 2
MIXING: Final = 0.1
"""Least component of an axis in its zero bin for a rotated axis to count as in the zero bin."""
Key = tuple[Sensor, int]
Parameters = dict[str, Value]
PX4_KEYS = tuple((sensor, instance) for sensor in CALIBRATED for instance in range(PX4_SLOTS))
_WORDS = {Sensor.ACCEL: ("ACC", "TC_A"), Sensor.GYRO: ("GYR", "TC_G"), Sensor.MAG: ("COMPASS", "MAG", "TC_M")}
"""Markers in a parameter's name for the sensor that it calibrates; a name without one concerns every sensor."""


@dataclass(frozen=True, eq=False)
class Piece:
    """Parameters from time `start` (s) on, and on PX4 what of them has reached its memory."""

    start: float
    parameters: Parameters
    memory: dict[Key, px4.Px4Calibration]
    changes: frozenset[str] = frozenset()
    """The parameters that changed at its start."""
    _models: dict[Key, TriadModel] = field(default_factory=dict, repr=False)

    def concerns(self, sensor: Sensor) -> bool:
        """Whether one of the changes that begin this span may affect a sensor of that kind."""
        return any(_may_concern(name, sensor) for name in self.changes)

    def completed(self, autopilot: str, first: Parameters) -> Piece:
        """The same span with parameters that were first seen later and have held all along."""
        parameters = self.parameters | first
        memory = dict(self.memory)
        if autopilot == "px4":
            for key in PX4_KEYS:
                if key not in memory:
                    loaded = _loaded(parameters, key)
                    if loaded is not None:
                        memory[key] = loaded
        return Piece(self.start, parameters, memory, self.changes)

    def changed(self, t: float, changes: Parameters) -> Piece:
        """The span that begins when `changes` are made at time `t`."""
        parameters = self.parameters | changes
        memory = {}
        for key, held in self.memory.items():
            with contextlib.suppress(FirmwareError):  # the sensor moved to a row that was never seen
                memory[key] = held.update(parameters)
        return Piece(t, parameters, memory, frozenset(changes))

    def throughout(self) -> Piece:
        """The same span, valid from any earlier time."""
        return dataclasses.replace(self, start=-np.inf)

    def model(self, autopilot: str, key: Key) -> TriadModel:
        """The correction of one sensor in this span.

        Raises
        ------
        FirmwareError, InvalidInputError
            If the parameters seen do not tell it.
        """
        if key not in self._models:
            if autopilot == "ardupilot":
                model = ardupilot.calibration_in_force(self.parameters, *key)
            else:
                model = px4.calibration_in_force(self.parameters, *key, self.memory.get(key))
            if model.polynomial is not None and not model.polynomial.coefficients.any():
                model = dataclasses.replace(model, polynomial=None)
            self._models[key] = model
        return self._models[key]

    def same(self, autopilot: str, other: Piece, key: Key) -> bool:
        """Whether both spans correct a sensor in the same way."""
        try:
            ours, theirs = self.model(autopilot, key), other.model(autopilot, key)
        except FirmwareError:
            return False
        if (ours.polynomial is None) != (theirs.polynomial is None):
            return False
        if ours.polynomial is not None and theirs.polynomial is not None:
            a, b = ours.polynomial, theirs.polynomial
            if (a.t_ref, a.t_min, a.t_max) != (b.t_ref, b.t_min, b.t_max):
                return False
            if not np.array_equal(a.coefficients, b.coefficients):
                return False
        return np.array_equal(ours.offset, theirs.offset) and np.array_equal(ours.matrix, theirs.matrix)


@lru_cache(maxsize=1024)
def _may_concern(name: str, sensor: Sensor) -> bool:
    """Whether a calibration parameter is of that kind of sensor, or of no kind alone (the board's rotation)."""
    of = [kind for kind, words in _WORDS.items() if any(word in name for word in words)]
    return not of or sensor in of


def _loaded(parameters: Parameters, key: Key) -> px4.Px4Calibration | None:
    try:
        return px4.Px4Calibration.load(parameters, *key)
    except FirmwareError:
        return None


def calibration_changes(recording: Recording) -> tuple[ParameterEntry, ...]:
    """Entries at which a calibration parameter took another value."""
    return recording.parameters.changes(CALIBRATION_PREFIXES.get(recording.identity.autopilot or "", ()))


def undo(recording: Recording) -> Recording:
    """The same recording with every accelerometer, gyroscope and compass channel at :attr:`Stage.RAW`, sensor frame.

    Each sample is undone with the parameters in force at its time (:class:`Undo`). The calibration in force of a
    channel is not known where parameters, temperature or motor current are missing. Such a channel keeps its stage, and
    an event of kind ``undo`` says why; a fit of it is relative. Debiased channels stay as they are.

    Raises
    ------
    FirmwareError
        If the recording is of neither ArduPilot nor PX4.
    """
    return Undo(recording.identity, whole=True).feed(recording)


class Undo:
    """Undoes the calibration chunk by chunk, and remembers parameters, temperatures and motor currents.

    The first value of a parameter also applies to all earlier times; later changes apply from their time. Samples
    within half a second of a relevant change are left out. On PX4 each change goes through the thresholds of its
    memory, which starts as after a boot with the first values seen.

    Parameters
    ----------
    identity
        Whose stream it is.
    parameters
        What was read before (mapping, or timeline with its changes); the chunks' own entries are added as they come.
    whole
        True: one chunk is the whole recording, so a temperature that is missing in it will never come. False: samples
        that come before the temperature or current they need are left out.
    """

    def __init__(
        self,
        identity: Identity,
        parameters: ParameterTimeline | Mapping[str, Value] | None = None,
        *,
        whole: bool = False,
    ) -> None:
        if identity.autopilot is None or identity.autopilot not in CALIBRATION_PREFIXES:
            raise FirmwareError(f"calibrations of ArduPilot and PX4 can be undone, not of {identity.autopilot!r}")
        self._autopilot: str = identity.autopilot
        self._whole = whole
        self._held: dict[Key, tuple[float, float]] = {}
        self._reported: set[tuple[Sensor, int, str]] = set()
        self._piece = Piece(-np.inf, {}, {})
        self._latest: Parameters = {}
        if not isinstance(parameters, ParameterTimeline):
            parameters = ParameterTimeline.constant(parameters or {})
        self._piece = self._pieces(parameters)[-1].throughout()

    def feed(self, chunk: Recording) -> Recording:
        """The next chunk at :attr:`Stage.RAW`."""
        pieces = self._pieces(chunk.parameters)
        self._piece = pieces[-1].throughout()
        channels, events = [], list(chunk.events)
        for channel in chunk.channels:
            if not len(channel):
                continue
            if channel.sensor not in CALIBRATED or channel.stage not in (Stage.CORRECTED, Stage.FILTERED):
                channels.append(channel)
                continue
            try:
                channels.append(self._raw(channel, chunk, pieces))
            except (FirmwareError, InvalidInputError) as reason:
                channels.append(channel)
                if channel.key not in self._reported:
                    self._reported.add(channel.key)
                    text = f"{channel.sensor} {channel.instance + 1} of {channel.source} stays as streamed: {reason}"
                    events.append(Event(float(channel.t[0]), "undo", text))
        self._hold(chunk)
        return dataclasses.replace(chunk, channels=tuple(c for c in channels if len(c)), events=tuple(events))

    def _pieces(self, timeline: ParameterTimeline) -> list[Piece]:
        """The spans of constant parameters, from the present one on."""
        prefixes = CALIBRATION_PREFIXES[self._autopilot]
        first: Parameters = {}
        changes: dict[float, Parameters] = {}
        for entry in timeline.entries:
            if not entry.name.startswith(prefixes):
                continue
            if entry.name not in self._latest:
                first[entry.name] = entry.value
            elif self._latest[entry.name] != entry.value:
                changes.setdefault(_together(changes, entry), {})[entry.name] = entry.value
            self._latest[entry.name] = entry.value
        pieces = [self._piece.completed(self._autopilot, first) if first else self._piece]
        for t, changed in changes.items():
            pieces.append(pieces[-1].changed(t, changed))
        return pieces

    def _raw(self, channel: Channel, chunk: Recording, pieces: list[Piece]) -> Channel:
        if len(pieces) == 1:
            return self._undone(channel, chunk, pieces[0])
        spans = _spans(channel, pieces, self._autopilot)
        parts = [self._undone(channel.take(rows), chunk, piece) for piece, rows in spans]
        if not parts:
            return dataclasses.replace(channel.take(slice(0)), stage=Stage.RAW)
        return join([Recording((part,)) for part in parts]).channels[0]

    def _undone(self, channel: Channel, chunk: Recording, piece: Piece) -> Channel:
        model = piece.model(self._autopilot, (channel.sensor, channel.instance))
        values, temperature = channel.values, None
        if self._autopilot == "ardupilot" and channel.sensor == Sensor.MAG:
            throttle = self._drive(Sensor.THROTTLE, 0, channel, chunk)
            current = self._drive(Sensor.CURRENT, 0, channel, chunk)
            term = ardupilot.motor_term(piece.parameters, channel.instance, throttle, current)
            values = values if term is None else values - term
        if model.polynomial is not None:
            temperature = self._drive(Sensor.TEMPERATURE, channel.instance, channel, chunk)
            if temperature is None:
                raise FirmwareError(
                    "its correction depends on temperature and none was recorded; stream RAW_IMU or SCALED_IMU too"
                )
        raw = model.invert(values, temperature)
        if self._autopilot == "px4" and channel.sensor == Sensor.MAG:
            added = self._px4_motors(channel, chunk, piece)
            raw = raw if added is None else raw - added
        known = np.isfinite(raw).all(axis=1) | ~np.isfinite(channel.values).all(axis=1)
        turned = _turned(channel.zero_bin, model.matrix)
        undone = dataclasses.replace(channel, values=raw, stage=Stage.RAW, zero_bin=turned)
        return undone if known.all() else undone.take(np.flatnonzero(known))

    def _px4_motors(self, channel: Channel, chunk: Recording, piece: Piece) -> Array | None:
        """Motor compensation that PX4 added to the raw field, uT (N, 3); None: nothing."""
        known = {k: self._drive(Sensor.CURRENT, k, channel, chunk) for k in range(PX4_BATTERIES)}
        currents = {k: current for k, current in known.items() if current is not None}
        throttle = self._drive(Sensor.THROTTLE, 0, channel, chunk)
        return px4.motor_term(piece.parameters, channel.instance, throttle, currents)

    def _drive(self, sensor: Sensor, instance: int, channel: Channel, chunk: Recording) -> Array | None:
        """Last value of `sensor` known at each sample, nan before the first; None: it will never be known."""
        found = chunk.find(sensor, instance)
        held = self._held.get((sensor, instance))
        if not found and held is None and self._whole:
            return None
        times, values = np.array([-np.inf]), np.array([np.nan if held is None else held[1]])
        if found:
            times, values = np.append(times, found[0].t), np.append(values, found[0].values[:, 0])
        return np.asarray(values[np.searchsorted(times, channel.t, side="right") - 1])

    def _hold(self, chunk: Recording) -> None:
        for channel in chunk.channels:
            if channel.sensor in (Sensor.TEMPERATURE, Sensor.CURRENT, Sensor.THROTTLE) and len(channel):
                key = channel.sensor, channel.instance
                if key not in self._held or self._held[key][0] <= channel.t[-1]:
                    self._held[key] = float(channel.t[-1]), float(channel.values[-1, 0])


def _together(changes: Mapping[float, Parameters], entry: ParameterEntry) -> float:
    """The time from which a change counts: that of the same gyro's other axes, if they changed just before.

    PX4's gyro_calibration stores the three axes of an offset at once. PX4's memory takes or leaves them by the length
    of the whole change. They are reported one after the other.
    """
    if entry.name not in REWRITTEN_AT_REST:
        return entry.t
    row = entry.name.partition("_")[2].partition("_")[0]
    near = [
        t
        for t, changed in changes.items()
        if entry.t - GUARD_BEFORE_S < t <= entry.t
        and any(name in REWRITTEN_AT_REST and f"_{row}_" in name for name in changed)
    ]
    return min(near, default=entry.t)


def _spans(channel: Channel, pieces: list[Piece], autopilot: str) -> list[tuple[Piece, NDArray[np.intp]]]:
    """Rows of `channel` by piece; rows near a change of its correction are in none."""
    starts = np.array([piece.start for piece in pieces[1:]])
    allowed = np.ones(len(channel), dtype=bool)
    key = channel.sensor, channel.instance
    guards = np.searchsorted(channel.t, (starts - GUARD_BEFORE_S, starts + GUARD_AFTER_S)).T.tolist()
    for (before, after), (first, last) in zip(itertools.pairwise(pieces), guards, strict=True):
        near = allowed[first:last]  # a log may hold thousands of changes: only those that cost samples are looked at
        if near.any() and after.concerns(channel.sensor) and not before.same(autopilot, after, key):
            near[:] = False
    edges = [0, *np.searchsorted(channel.t, starts).tolist(), len(channel)]
    spans = [
        (piece, first + np.flatnonzero(allowed[first:last]))
        for piece, first, last in zip(pieces, edges, edges[1:], strict=False)
        if last > first
    ]
    return [(piece, rows) for piece, rows in spans if len(rows)]


def _turned(zero_bin: NDArray[np.bool_] | None, matrix: Array) -> NDArray[np.bool_] | None:
    """Zero-bin marks of the body's axes, on the axes of the sensor."""
    if zero_bin is None:
        return None
    if not np.any(matrix - np.diag(np.diag(matrix))):
        return zero_bin
    weight = np.abs(np.linalg.inv(matrix))
    return np.asarray(zero_bin @ (weight > MIXING * weight.max()).T)


class KnownCalibration:
    """Leaves out samples before all of `names` have been read.

    A vehicle may have rewritten one of them before, and a calibration not in force would be undone. Chunks are
    consecutive. Positions are kept, since nothing is undone on them.
    """

    def __init__(self, names: Collection[str]) -> None:
        self._unread = set(names)
        self._since = -np.inf

    def feed(self, chunk: Recording) -> Recording:
        """The chunk without samples from before."""
        for entry in chunk.parameters.entries:
            if entry.name in self._unread:
                self._unread.remove(entry.name)
                self._since = max(self._since, entry.t + GUARD_AFTER_S)
        since = np.inf if self._unread else self._since
        kept = (c if c.sensor == Sensor.POSITION else c.between(since, np.inf) for c in chunk.channels)
        return dataclasses.replace(chunk, channels=tuple(channel for channel in kept if len(channel)))
