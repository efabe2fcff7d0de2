"""Checks that every installed sensor delivers: absent, zero and frozen ones are named.

A constant sensor is frozen only if a live one would have changed. Streams are whole numbers of 1 mG, 1 mrad/s and 1
mgauss, so a quiet sensor at rest may repeat one value (FLIGHT_CONTROLLERS 2.1, 9). It is called frozen if its values
are not rounded, or if the vehicle was turned and others followed. The same applies if even a much quieter part would
have changed, or if the vehicle reports a fault. Any other constant compass does not pass either: nearly all present
parts have noise above 1 mgauss.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import scipy

from mavcal.calib.preflight import limits
from mavcal.calib.preflight.check import Check, CheckId, Snapshot, Verdict, unknown
from mavcal.calib.preflight.installed import STREAMED, WORDS, Announced, Key
from mavcal.calib.preflight.movement import ObservedMovement
from mavcal.calib.preflight.rest import LEAST
from mavcal.calib.recording import Channel, Recording, Sensor, Stage
from mavcal.calib.stats.windows import finite_rows

QUIETER: Final[Mapping[Sensor, float]] = {Sensor.GYRO: 4.0, Sensor.ACCEL: 4.0, Sensor.MAG: 10.0}
"""Largest ratio of the noise of two parts of a kind on one vehicle. Noise densities of present inertial parts differ by
up to 4; an RM3100 has 15 nT beside 150 nT of an IST8310 or LIS3MDL (datasheets)."""
CHANCE: Final = 1e-4
"""Probability of a constant reading below which a live sensor is excluded."""
STANDS: Final = 10
"""Messages per new reading above which a sensor is constant: a compass read at 10 Hz is streamed at 50 Hz."""
_HEALTHY: Final[Mapping[Sensor, float]] = {
    Sensor.GYRO: math.radians(limits.GYRO_NOISE.value),
    Sensor.ACCEL: 0.3,
    Sensor.MAG: 2.0,
}
"""Largest noise of one sample of a healthy part (rad/s, m/s2, uT); noisier ones are not compared with others."""
_TURN = "Turn the vehicle by 20 deg or more while you check again: a living compass follows."
_LINK = "Check again over a better link, or with fewer other programs on this one."
_ROW = "If the sensor is installed, look at its wiring and at its driver. If not, set the id in its row to 0."
_POWER = (
    "Look at its wiring and at its driver; restart the vehicle. If it was removed, switch it off in the parameters."
)


@dataclass(frozen=True)
class Census:
    """State of every sensor: alive, dead with the reason, or too few samples."""

    alive: frozenset[Key]
    dead: Mapping[Key, str]
    """Sentences on dead sensors."""
    thin: Mapping[Key, str]
    """Sentences on sensors with too few samples on this link."""
    constant: frozenset[Key]
    """Sensors not known to be dead that have a constant reading."""
    installed: Mapping[Sensor, int]
    """Number of sensors: announced, or heard without being announced."""
    left_over: Mapping[Key, str] = field(default_factory=dict)
    """PX4: rows of sensors that sent nothing: they are dead or were removed."""
    beyond: tuple[str, ...] = ()
    """Announced sensors that no message of either firmware carries."""

    def of(self, sensor: Sensor) -> frozenset[int]:
        """Instances whose readings can be judged."""
        return frozenset(i for kind, i in self.alive if kind == sensor)


def census(snapshot: Snapshot, announced: Mapping[Key, Announced], movement: ObservedMovement) -> Census:
    """State of every announced or streamed sensor."""
    recording = snapshot.recording
    heard = {(kind, i) for kind in WORDS for i in recording.instances(kind) if i < STREAMED}
    streamed = {key for key in announced if key[1] < STREAMED}
    alive: set[Key] = set()
    dead: dict[Key, str] = {}
    thin: dict[Key, str] = {}
    constant: set[Key] = set()
    left_over: dict[Key, str] = {}
    for key in sorted(heard | streamed):
        name, by = _name(key), f" ({announced[key].by})" if key in announced else ""
        channel = _best(recording, key)
        count = 0 if channel is None else len(channel)
        rows = count if snapshot.messages is None else snapshot.messages.get(key[1], 0)
        if key in snapshot.uncorrected:
            thin[key] = f"the calibration in force of {name} was not read"
            continue
        if channel is None or count < LEAST:
            others = max((snapshot.messages or {0: LEAST}).values(), default=0)
            if rows < LEAST and (rows or others < LEAST):
                thin[key] = f"only {rows} messages with {name} came in {_span(recording):.0f} s"
            elif rows >= LEAST and STANDS * count > rows:
                thin[key] = f"only {count} readings of {name} came in {_span(recording):.0f} s"
            elif key in announced and rows == 0 and not _was_installed(snapshot, announced[key]):
                left_over[key] = f"{name}{by} sends nothing and was not seen here before"
            elif key in announced:
                dead[key] = f"{name}{by} {_absent(recording, key, rows, count)}"
            continue
        if _repeats(channel):
            why = _frozen(snapshot, key, channel, movement)
            if why:
                if key in announced:
                    dead[key] = f"{name}{by} is frozen: {why}"
                continue
            constant.add(key)
        alive.add(key)
    presumed = {key for key in left_over if announced[key].presumed}
    present = {*(streamed - presumed), *alive, *thin}
    installed = {kind: len({key for key in present if key[0] == kind}) for kind in WORDS}
    beyond = tuple(one.name for key, one in sorted(announced.items()) if key[1] >= STREAMED)
    for kind in WORDS:
        installed[kind] += sum(key[0] == kind for key in announced if key[1] >= STREAMED)
    return Census(frozenset(alive), dead, thin, frozenset(constant), installed, left_over, beyond)


def sensors_heard(found: Census, announced: Mapping[Key, Announced], *, complete: bool) -> Check:
    """The census as a check."""
    of = CheckId.SENSORS_HEARD
    notes = [f"announced: {one.name} by {one.by}" for _, one in sorted(announced.items())]
    notes += [f"{name} is announced, and neither firmware streams so many" for name in found.beyond]
    notes += [*found.thin.values(), *found.left_over.values()]
    if found.dead:
        texts = list(found.dead.values())
        reason = f"{'; '.join(f'{line[:1].upper()}{line[1:]}' for line in texts)}."
        suspects = tuple(_name(key) for key in sorted(found.dead))
        return Check(of, Verdict.FAIL, float(len(texts)), 0.0, 0.0, "", reason, _POWER, (*texts, *notes), suspects)
    if found.thin:
        reason = f"The link brought too little: {'; '.join(found.thin.values())}. This says nothing of the sensors."
        return unknown(of, reason, _LINK, notes)
    if not complete:
        reason = "Which sensors are installed could not all be read in time; those that were heard are alive."
        return unknown(of, reason, _LINK, notes)
    settled = {key: why for key, why in found.left_over.items() if not announced[key].presumed}
    if settled:
        texts = list(settled.values())
        reason = f"{'; '.join(f'{line[:1].upper()}{line[1:]}' for line in texts)}: it is dead, or its row is left over."
        if found.constant:
            listed = ", ".join(_name(key) for key in sorted(found.constant))
            reason += f" Not one step of change was seen in {listed}: at rest a frozen one reads the same."
        suspects = tuple(_name(key) for key in sorted(settled))
        return Check(of, Verdict.WARN, float(len(texts)), 0.0, 0.0, "", reason, _ROW, (*texts, *notes), suspects)
    if not found.alive:
        return unknown(of, "No sensor is announced, and none was heard.", "Look at the link.", notes)
    still = sorted(key for key in found.constant if key[0] == Sensor.MAG)
    if still:
        listed = ", ".join(_name(key) for key in still)
        reason = f"Not one step of change was seen in {listed}: at rest a frozen compass reads the same."
        return unknown(of, reason, _TURN, notes)
    counts = [_count(found, kind) for kind in WORDS if found.installed[kind]]
    reason = f"Heard and alive: {', '.join(counts)}."
    if found.constant:
        listed = ", ".join(_name(key) for key in sorted(found.constant))
        reason += f" Not one step of change was seen in {listed}: at rest that may be so."
        notes.append(f"{listed}: one value all the time; turn the vehicle by 20 deg and check again to see them follow")
    return Check(of, Verdict.PASS, 0.0, 0.0, 0.0, "", reason, evidence=tuple(notes))


def _count(found: Census, kind: Sensor) -> str:
    alive, installed = len(found.of(kind)), found.installed[kind]
    word = WORDS[kind][0 if installed == 1 else 1]
    return f"{alive} {word}" if alive == installed else f"{alive} of {installed} {word}"


def _was_installed(snapshot: Snapshot, one: Announced) -> bool:
    """Whether the sensor was certainly present: by the firmware's own row, or heard in a verified calibration."""
    return one.kept or any(one.device in entry.heard for entry in snapshot.history)


def _absent(recording: Recording, key: Key, rows: int, count: int) -> str:
    """Reason why an announced sensor has no samples although others have."""
    if rows < LEAST:
        return "is announced and was not heard: its message does not come, those of others do"
    if count:
        return f"stands still: {rows} messages brought only {count} new readings"
    if recording.find(*key):
        return "reads no numbers (NaN)"
    return "reads 0 on every axis: it is absent or dead"


def _span(recording: Recording) -> float:
    ends = [(c.t[0], c.t[-1]) for c in recording.channels if len(c) and c.sensor in WORDS]
    return float(max(end for _, end in ends) - min(start for start, _ in ends)) if ends else 0.0


def _frozen(snapshot: Snapshot, key: Key, channel: Channel, movement: ObservedMovement) -> str:
    """Why a constant sensor is dead; empty: a live one may read that."""
    kind, _ = key
    if channel.quantum == 0.0 and kind != Sensor.MAG:
        return f"{len(channel)} readings without rounding are all the same, and a living one has noise"
    turned = movement.movement_seen_by_others(key)
    if turned:
        return f"it read one value all the time while {turned}"
    if _left_out_by_px4(snapshot, kind):
        return "it read one value all the time, and PX4, which drops a sensor that stands still, sends no attitude"
    siblings = [c for _, c in _of_same_device(snapshot.recording, key) if not _repeats(c)]
    noises = [noise for c in siblings if (noise := float(c.values.std(axis=0).min())) < _HEALTHY[kind]]
    if noises and _chance(channel, min(noises) / QUIETER[kind]) < CHANCE:
        return f"{len(channel)} readings are all the same while the others of its kind are noisy"
    if kind in snapshot.view.ill and siblings:
        return f"it read one value all the time, and the vehicle says that one of its {WORDS[kind][1]} is not healthy"
    return ""


def _left_out_by_px4(snapshot: Snapshot, kind: Sensor) -> bool:
    """Whether PX4 rejects all sensors: it drops one after 100 equal readings (``DataValidator.hpp``).

    HIGHRES_IMU shows the inertial unit that it has chosen, and ATTITUDE needs one. Two messages are not lost by chance.
    """
    if snapshot.identity.autopilot != "px4" or kind == Sensor.MAG:
        return False
    chosen = [c for c in snapshot.recording.find(kind) if c.stage == Stage.DEBIASED and len(c)]
    return not chosen and not any(len(c) for c in snapshot.recording.find(Sensor.ATTITUDE))


def _chance(channel: Channel, noise: float) -> float:
    """Largest probability that readings with this noise (1 sd) all fall into one bin, on every axis."""
    if channel.quantum == 0.0:
        return 0.0
    wide = channel.zero_bin[0] if channel.zero_bin is not None else np.zeros(channel.values.shape[1], dtype=bool)
    half = np.where(wide, channel.quantum, 0.5 * channel.quantum)
    one = np.log1p(-2.0 * scipy.special.ndtr(-half / max(noise, 1e-12)))
    return float(np.exp(len(channel) * one.sum()))


def _repeats(channel: Channel) -> bool:
    return bool((channel.values == channel.values[0]).all())


def _best(recording: Recording, key: Key) -> Channel | None:
    """The most informative stream of a sensor: an unrounded one if it has enough samples."""
    there = [c for c in recording.find(*key) if c.stage != Stage.DEBIASED]
    found = [c.take(rows) for c in there if (rows := finite_rows(c.values)).any()]
    return max(found, key=lambda c: (len(c) >= LEAST and c.quantum == 0.0, len(c)), default=None)


def _of_same_device(recording: Recording, key: Key) -> list[tuple[Key, Channel]]:
    kind, instance = key
    others: Collection[int] = [i for i in recording.instances(kind) if i not in (instance,) and i < STREAMED]
    best = {(kind, i): _best(recording, (kind, i)) for i in others}
    return [(other, channel) for other, channel in best.items() if channel is not None and len(channel) >= LEAST]


def _name(key: Key) -> str:
    return f"{WORDS[key[0]][0]} {key[1] + 1}"
