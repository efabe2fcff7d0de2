"""Judges which methods are worthwhile on a vehicle's log, each with its reason.

A method that takes a log has its judgement in its own entry (:class:`calib.methods.method.Suggestion`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mavcal.calib.flight.craft import craft_of
from mavcal.calib.flight.rest import Ground, Rest, how_to_rest, why_no_rest
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Array, Channel, Recording, Sensor, Stage
from mavcal.calib.stats.windows import finite_rows

_APART: Final = np.radians(30.0)  # directions of gravity that count as two poses
_POSES: Final = 4
_ALLAN: Final = 600.0  # s
_HEADINGS: Final = 8  # of twelve sectors of 30 degrees
_TILT: Final = 40.0  # degrees about the horizontal axes, for a whole ellipsoid
_LOAD: Final = 0.2  # range of throttle in flight
_CURRENT: Final = 3.0  # A


@dataclass(frozen=True)
class MethodAdvice:
    """A method that takes a log, whether it is worthwhile on this one, and why (or why not)."""

    method: str
    worthwhile: bool
    reason: str
    command: str

    @property
    def document(self) -> dict[str, str | bool]:
        """As JSON."""
        return dict(vars(self))


@dataclass(frozen=True)
class LoggedTrip:
    """A vehicle's log, and when the vehicle rested and ran its motors."""

    recording: Recording
    rests: Sequence[Rest]
    ground: Ground

    @property
    def longest_rest(self) -> float:
        """Duration of the longest rest, s."""
        return max((r.duration for r in self.rests), default=0.0)


def advice(trip: LoggedTrip) -> tuple[MethodAdvice, ...]:
    """Every method that takes a log, the worthwhile ones first."""
    suggested = [(m.name, m.suggestion) for m in METHODS.values() if m.suggestion is not None]
    name = trip.recording.source or "FILE"
    found = [
        MethodAdvice(method, *suggestion.judge(trip), f"mavcal fit {method} {name}")
        for method, suggestion in sorted(suggested, key=lambda pair: pair[1].order)
    ]
    return tuple(sorted(found, key=lambda one: not one.worthwhile))


def _usable(recording: Recording, sensor: Sensor) -> list[Channel]:
    """The best channel of every instance that is not debiased."""
    instances = recording.instances(sensor)
    kept = [i for i in instances if any(c.stage != Stage.DEBIASED for c in recording.find(sensor, i))]
    return [recording.channel(sensor, i) for i in kept]


def gyro_rest(trip: LoggedTrip) -> tuple[bool, str]:
    """Offset of the gyroscope: a rest of five seconds."""
    longest = trip.longest_rest
    if not _usable(trip.recording, Sensor.GYRO):
        return False, "the log has no usable gyroscope"
    if not trip.rests:
        return False, why_no_rest(trip.recording)
    if longest < 5.0:
        return False, f"the longest rest lasts {longest:.0f} s: 5 are needed"
    return True, f"{longest:.0f} s at rest; most autopilots measure this bias at boot anyway"


def drift(trip: LoggedTrip, *, least: float) -> tuple[bool, str]:
    """Drift with temperature: `least` degC at rest."""
    recording, rests = trip.recording, trip.rests
    thermometers = [recording.channel(Sensor.TEMPERATURE, i) for i in recording.instances(Sensor.TEMPERATURE)]
    if not thermometers:
        return False, "the log has no temperature of the inertial units"
    if not rests:
        return False, f"{why_no_rest(recording)}. {how_to_rest(recording)}"
    spans = []
    for channel in thermometers:
        values = np.concatenate([channel.between(r.start, r.end).values for r in rests])
        values = values[np.isfinite(values)]
        spans.append((float(values.min()), float(values.max())) if len(values) else (0.0, 0.0))
    low, high = max(spans, key=lambda span: span[1] - span[0])
    if high - low < least:
        return False, (
            f"at rest the temperature moved by {high - low:.1f} degC: {least:.0f} are needed; log a warm-up from cold, "
            "and give several logs at once"
        )
    return True, f"at rest the temperature went from {low:.1f} to {high:.1f} degC; several logs may be given at once"


def poses(trip: LoggedTrip) -> tuple[bool, str]:
    """Offset and matrix of the accelerometer: rests in four directions of gravity."""
    recording, rests, craft = trip.recording, trip.rests, craft_of(trip.recording.identity)
    accels = _usable(recording, Sensor.ACCEL)
    if not accels:
        return False, "the log has no accelerometer"
    if not rests:
        return False, why_no_rest(recording)
    directions: list[Array] = []
    for rest in rests:
        part = accels[0].between(rest.start, rest.end)
        mean = part.values[finite_rows(part.values)].mean(axis=0) if finite_rows(part.values).any() else np.zeros(3)
        size = float(np.linalg.norm(mean))
        if size > 0.0 and all(np.arccos(np.clip(mean / size @ d, -1.0, 1.0)) > _APART for d in directions):
            directions.append(mean / size)
    if len(directions) < _POSES:
        return False, (
            f"the rests show {len(directions)} direction{'' if len(directions) == 1 else 's'} of gravity: hold the "
            f"vehicle still in {_POSES} or more, six faces are best; a {craft.trip} cannot give this"
        )
    return True, f"the rests show {len(directions)} directions of gravity"


def mag_flight(trip: LoggedTrip) -> tuple[bool, str]:
    """Compass in flight: eight of twelve headings."""
    recording, craft = trip.recording, craft_of(trip.recording.identity)
    if not recording.instances(Sensor.MAG):
        return False, "the log has no compass"
    if not trip.ground.running:
        return False, f"the vehicle never {craft.moved}"
    sectors, tilt = _attitudes(recording)
    if sectors is None:
        if not _usable(recording, Sensor.GYRO):
            return False, "the log has neither attitude nor gyroscope"
        return True, "no attitude is logged: the gyroscope alone carries the field"
    if sectors < _HEADINGS:
        return False, (f"the {craft.trip} saw {sectors} of 12 headings and {tilt:.0f} deg of tilt: {craft.turn}")
    return True, f"the {craft.trip} saw {sectors} of 12 headings and {tilt:.0f} deg of tilt"


def mag_motor(trip: LoggedTrip) -> tuple[bool, str]:
    """Compensation of the motors: a load that changes in flight."""
    recording, craft = trip.recording, craft_of(trip.recording.identity)
    if not recording.instances(Sensor.MAG):
        return False, "the log has no compass"
    loads = []
    for sensor, least in ((Sensor.CURRENT, _CURRENT), (Sensor.THROTTLE, _LOAD), (Sensor.MOTOR, _LOAD)):
        for channel in recording.find(sensor):
            reach = float(np.nanmax(np.ptp(channel.values, axis=0))) if finite_rows(channel.values).all() else 0.0
            if reach >= least:
                loads.append(
                    f"{sensor.value} moved by {reach:.2g} {channel.unit if channel.unit != '1' else ''}".strip()
                )
    corrupt = [n for n, v in recording.parameters.final().items() if n.startswith("COMPASS_MOT") and not np.isfinite(v)]
    if corrupt:
        return True, f"{', '.join(corrupt)} in force is not a number: it corrupts the compass, set it to zero first"
    if not trip.ground.running:
        return False, "the motors never ran"
    if not loads:
        return False, f"neither current nor throttle moved enough: {craft.load}"
    return True, "; ".join(loads)


def ellipsoid(trip: LoggedTrip) -> tuple[bool, str]:
    """Ellipsoid of the compass: eight of twelve headings, and tilt."""
    recording, craft = trip.recording, craft_of(trip.recording.identity)
    if not recording.instances(Sensor.MAG):
        return False, "the log has no compass"
    sectors, tilt = _attitudes(recording)
    if sectors is None:
        return (
            False,
            "no attitude in the log says which directions were seen: try it, it refuses what they do not determine",
        )
    if sectors < _HEADINGS or tilt < _TILT:
        return False, (
            f"{sectors} of 12 headings and {tilt:.0f} deg of tilt do not determine an ellipsoid ({_TILT:.0f} needed): "
            f"mag-flight takes what a level {craft.trip} gives"
        )
    return True, f"{sectors} of 12 headings and {tilt:.0f} deg of tilt"


def _attitudes(recording: Recording) -> tuple[int | None, float]:
    """Number of 30-degree sectors that the heading visited, and the tilt exceeded for 1 % of the time, degrees."""
    found = recording.find(Sensor.ATTITUDE)
    q = found[0].values[finite_rows(found[0].values)] if found else np.zeros((0, 4))
    if len(q) < 20:
        return None, 0.0
    w, x, y, z = q.T
    heading = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    tilt = np.degrees(np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0)))
    sectors = np.unique(np.floor((heading + np.pi) / (np.pi / 6.0)).astype(int) % 12)
    return len(sectors), float(np.quantile(tilt, 0.99))


def allan(trip: LoggedTrip) -> tuple[bool, str]:
    """Allan variance: a rest of ten minutes."""
    longest = trip.longest_rest
    if not trip.rests:
        return False, why_no_rest(trip.recording)
    if not _usable(trip.recording, Sensor.GYRO) or longest < _ALLAN:
        return False, f"the longest rest lasts {longest:.0f} s: {_ALLAN:.0f} and more say something of bias instability"
    return True, f"{longest:.0f} s at rest"
