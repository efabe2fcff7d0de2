"""Contents of a recording: channels, rates, gaps, ranges, damage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.firmware.ardupilot.doubts import learning_warnings
from mavcal.calib.firmware.stream.auxiliary import telemetry
from mavcal.calib.recording import Array, Channel, Recording, Sensor, Stage

GAP_PERIODS = 5.0
"""A pause this many median periods long counts as a gap."""
STUCK_S = 1.0
STUCK_PERIODS = 10.0
"""Time, s, and median periods for which a constant value in a changing channel counts as stuck."""
PAUSE_S = 1.0
PAUSE_PERIODS = 20.0
"""Time, s, and median periods of the densest channel, without any sample that count as a pause of the log."""
MOST_GAPS_LISTED = 20
TRIADS = (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG)
COUNTED = ("reboot", "gap", "drop", "clipping", "damage", "left_out")
"""Kinds of events that are counted."""
TOLD = ("dead", "damage", "clipping", "left_out")
"""Kinds of events whose texts are warnings."""
MISSING = {
    Sensor.ACCEL: "no accelerometer was recorded: only a gyroscope or a compass can be calibrated from it",
    Sensor.GYRO: "no gyroscope was recorded",
    Sensor.MAG: "no compass was recorded: no magnetometer can be calibrated from it",
}


@dataclass(frozen=True)
class Gap:
    """A pause in a channel, s on the recording's clock."""

    start: float
    length: float


@dataclass(frozen=True)
class ChannelSummary:
    """One channel in numbers; ranges and means have one entry a column, None where no sample is finite."""

    sensor: str
    instance: int
    source: str
    stage: str
    unit: str
    samples: int
    start: float
    end: float
    rate: float | None
    quantum: float
    gaps: tuple[Gap, ...]
    n_gaps: int
    backward_steps: int
    not_finite: int
    longest_constant: float
    repeated: int
    """Samples equal to the one before in every column."""
    norm: tuple[float, float] | None
    """Mean length of the vector and its standard deviation; None: not a sensor with three axes."""
    least: tuple[float | None, ...]
    mean: tuple[float | None, ...]
    most: tuple[float | None, ...]


def summarise(channel: Channel) -> ChannelSummary:
    """Numbers of one channel that has at least one sample."""
    t, values = channel.t, channel.values
    period, backward = _period(t)
    wide = np.flatnonzero(np.diff(t) > GAP_PERIODS * period) if period else np.empty(0, dtype=np.intp)
    finite = np.isfinite(values)
    same = _same(values)
    run = _longest_run(t, same, period)
    return ChannelSummary(
        sensor=channel.sensor.value,
        instance=channel.instance,
        source=channel.source,
        stage=channel.stage.value,
        unit=channel.unit,
        samples=len(t),
        start=float(t[0]),
        end=float(t[-1]),
        rate=1.0 / period if period else None,
        quantum=channel.quantum,
        gaps=tuple(Gap(float(t[i]), float(t[i + 1] - t[i])) for i in wide[:MOST_GAPS_LISTED]),
        n_gaps=len(wide),
        backward_steps=backward,
        not_finite=int((~finite.all(axis=1)).sum()),
        longest_constant=0.0 if run is None else run.length,
        repeated=int(same.sum()),
        norm=_norm(channel),
        least=_columns(values, finite, np.min),
        mean=_columns(values, finite, np.mean),
        most=_columns(values, finite, np.max),
    )


def pauses(recording: Recording) -> tuple[Gap, ...]:
    """Pauses of the whole recording: no channel has a sample there. Many vehicles log only while armed."""
    densest = max(recording.channels, key=len, default=None)
    period = _period(densest.t)[0] if densest is not None and len(densest) > 1 else None
    if densest is None or period is None:
        return ()
    least = max(PAUSE_S, PAUSE_PERIODS * period)
    found = []
    for i in np.flatnonzero(np.diff(densest.t) > least).tolist():
        start, end = float(densest.t[i]), float(densest.t[i + 1])
        for channel in recording.channels:  # what the others still have of it is no pause
            first, last = np.searchsorted(channel.t, (start + 0.5 * (end - start),) * 2)
            start = max(start, float(channel.t[first - 1])) if first > 0 else start
            end = min(end, float(channel.t[last])) if last < len(channel) else end
        if end - start > least:
            found.append(Gap(start, end - start))
    return tuple(found)


def inspect(recording: Recording) -> dict[str, Any]:
    """Everything about a recording as one JSON-able document."""
    channels = [summarise(c) for c in recording.channels if len(c)]
    stood = pauses(recording)
    changes = recording.parameters.changes()
    identity = recording.identity
    start, end = recording.span
    return {
        "source": recording.source,
        "duration": end - start if channels else 0.0,
        "identity": {
            "autopilot": identity.autopilot,
            "firmware": list(identity.firmware) if identity.firmware else None,
            "uid": identity.uid,
            "system": identity.system,
        },
        "channels": [_document(c) for c in channels],
        "parameters": {
            "count": len(recording.parameters.final()),
            "end_observed": recording.parameters.end_observed,
            "changes": [{"t": _or_none(e.t), "name": e.name, "value": _or_none(e.value)} for e in changes],
        },
        "pauses": [vars(p) for p in stood],
        "segments": [{"label": s.label, "start": s.start, "end": s.end} for s in recording.segments],
        "events": [{"t": _or_none(e.t), "kind": e.kind, "text": e.text} for e in recording.events],
        "reference": [_document(summarise(c)) for c in recording.reference if len(c)],
        "armed": _armed(recording),
        "counts": {kind: sum(e.kind == kind for e in recording.events) for kind in COUNTED},
        "missing": _missing(recording),
        "warnings": [
            *_missing(recording),
            *(e.text for e in recording.events if e.kind in TOLD),
            *learning_warnings(recording.parameters.final()),
            *_of_pauses(stood, telemetry(recording)),
            *(w for c in channels for w in _warnings(c, stood)),
        ],
    }


def _armed(recording: Recording) -> list[dict[str, float]]:
    """Spans in which the vehicle was armed, s; one that the recording does not end ends with it."""
    spans: list[dict[str, float]] = []
    since: float | None = None
    for event in recording.events:
        if event.kind == "armed" and since is None:
            since = event.t
        elif event.kind == "disarmed" and since is not None:
            spans.append({"start": since, "end": event.t})
            since = None
    end = recording.span[1]
    if since is not None and np.isfinite(end):
        spans.append({"start": since, "end": max(end, since)})
    return spans


def _missing(recording: Recording) -> list[str]:
    """One sentence for each thing that the recording lacks, and its consequence."""
    have = {c.sensor for c in recording.channels if len(c) and c.stage != Stage.DEBIASED}
    dead = {e.odd.sensor for e in recording.events if e.kind == "dead" and e.odd is not None}
    if not have & set(TRIADS):
        none = "no accelerometer, gyroscope or compass was recorded"
        return [f"{'every sensor that was recorded is dead' if dead else none}: there is nothing to calibrate"]
    if recording.identity.autopilot is None:  # a table holds what its maker wanted
        return []
    found = [text for sensor, text in MISSING.items() if sensor not in have | dead]
    if not recording.parameters:
        found.append("no parameters were recorded: fits are relative to the calibration in force, and are not exported")
    return found


def _norm(channel: Channel) -> tuple[float, float] | None:
    if channel.sensor not in TRIADS:
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.einsum("ij,ij->i", channel.values, channel.values)
        np.sqrt(length, out=length)
    if not np.isfinite(length).all():
        length = length[np.isfinite(length)]
    if not len(length):
        return None
    mean = float(length.mean())
    length -= mean
    return mean, float(np.sqrt(length @ length / len(length)))


def _period(t: Array) -> tuple[float | None, int]:
    """Median positive step, s (None: time never advances), and how often time goes back."""
    steps = np.diff(t)
    backward = int((steps < 0).sum())
    if not (steps > 0).all():
        steps = steps[steps > 0]
    return (float(np.median(steps, overwrite_input=True)) if len(steps) else None), backward


def _same(values: Array) -> NDArray[np.bool_]:
    """Mask of the samples, from the second on, that equal the one before in every column."""
    same = np.ones(max(len(values) - 1, 0), dtype=np.bool_)
    for column in values.T:
        same &= column[1:] == column[:-1]
    return same


def constant_run(channel: Channel) -> Gap | None:
    """The longest span of equal consecutive samples; None: no two are equal."""
    return _longest_run(channel.t, _same(channel.values), _period(channel.t)[0])


def _longest_run(t: Array, same: NDArray[np.bool_], period: float | None) -> Gap | None:
    """The longest run of equal samples; a gap ends a run."""
    if len(t) < 2 or period is None:
        return None
    held = np.flatnonzero(np.diff(same & (np.diff(t) <= GAP_PERIODS * period), prepend=False, append=False))
    if not len(held):
        return None
    begins, ends = t[held[::2]], t[held[1::2]]  # begins and ends of runs, in turn
    longest = int(np.argmax(ends - begins))
    return Gap(float(begins[longest]), float(ends[longest] - begins[longest]))


def _columns(values: Any, finite: Any, reduce: Any) -> tuple[float | None, ...]:
    found: list[float | None] = []
    for column, good in zip(values.T, finite.T, strict=True):
        if good.all():
            found.append(float(reduce(column)))
        else:
            found.append(float(reduce(column[good])) if good.any() else None)
    return tuple(found)


def _of_pauses(stood: tuple[Gap, ...], streamed: bool) -> list[str]:
    if not stood:
        return []
    longest = max(stood, key=lambda p: p.length)
    often = "once" if len(stood) == 1 else f"{len(stood)} times"
    why = "nothing came over the link" if streamed else "it may record while armed only"
    return [f"the log pauses {often}, for {longest.length:.1f} s at {longest.start:.1f} s: {why}"]


def _warnings(channel: ChannelSummary, stood: tuple[Gap, ...]) -> list[str]:
    name = f"{channel.sensor}[{channel.instance}] of {channel.source}"
    found = []
    if channel.not_finite:
        found.append(f"{name}: {channel.not_finite} of {channel.samples} samples are not finite")
    if channel.backward_steps:
        found.append(f"{name}: time goes back {channel.backward_steps} times")
    own = channel.n_gaps - sum(any(_overlap(gap, pause) for pause in stood) for gap in channel.gaps)
    if own > 0:
        longest = max(
            (g for g in channel.gaps if not any(_overlap(g, p) for p in stood)), key=lambda g: g.length, default=None
        )
        where = "" if longest is None else f", one of {longest.length:.2f} s at {longest.start:.2f} s"
        found.append(f"{name}: {own} gaps{where}")
    inertial = channel.sensor in {"accel", "gyro", "mag"} and not channel.quantum
    limit = max(STUCK_S, STUCK_PERIODS / channel.rate) if channel.rate else np.inf
    if inertial and channel.samples > 2 and channel.longest_constant > limit:
        found.append(f"{name}: the value did not change for {channel.longest_constant:.1f} s: a stuck sensor")
    return found


def _overlap(one: Gap, other: Gap) -> bool:
    return one.start < other.start + other.length and other.start < one.start + one.length


def _document(channel: ChannelSummary) -> dict[str, Any]:
    document = dict(vars(channel))
    document["gaps"] = [vars(g) for g in channel.gaps]
    return document


def _or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None
