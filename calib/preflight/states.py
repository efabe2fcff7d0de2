"""State of each kind of calibration of a vehicle in one line, from earlier verified results."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mavcal.calib.firmware.plan import LeftOut
from mavcal.calib.fit import FitResult
from mavcal.calib.preflight import limits
from mavcal.calib.preflight.check import Snapshot, Verdict
from mavcal.calib.preflight.history import Changed, changes, ids_changed
from mavcal.calib.recording import Sensor

DAY_S: Final = 86400.0
TILES: Final[Mapping[str, tuple[str, frozenset[str], Sensor | None]]] = {
    "gyro": ("gyros", frozenset({"gyro", "gyro-turntable", "gyro-thread", "imu-multi"}), Sensor.GYRO),
    "accel": (
        "accelerometers",
        frozenset({"accel", "accel-six-face", "accel-one-axis", "imu-multi"}),
        Sensor.ACCEL,
    ),
    "mag": ("compasses", frozenset({"mag", "mag-rings", "mag-fixed-yaw"}), Sensor.MAG),
    "thermal": ("temperature drift", frozenset({"thermal"}), None),
}
"""Each tile by the procedure that it starts: its subject, the procedures that count, and the sensor."""


@dataclass(frozen=True)
class FinishedCalibration:
    """A calibration that was verified on the vehicle."""

    kind: str
    job: str
    at: float
    """When, wall-clock seconds since 1970."""
    results: tuple[FitResult, ...]
    left_out: tuple[LeftOut, ...] = ()
    """Sensors that got no new calibration, or only a part of it."""
    dead: tuple[LeftOut, ...] = ()
    """Sensors that fell out of the recording, also those that are not calibrated by this kind."""


@dataclass(frozen=True)
class SensorState:
    """State of one kind of calibration."""

    kind: str
    """The procedure that would calibrate it."""
    verdict: Verdict
    label: str
    """The verdict in one or two words."""
    text: str
    """When it was calibrated, at what temperature, how good it is."""
    advice: str
    """What it needs; empty: nothing."""
    at: float | None
    """When it was calibrated, wall-clock time, s since 1970; None: never here."""
    job: str | None
    """The job that did; None: never here."""
    temperature: float | None
    """Temperature of the calibration, degC; None: not known."""


def sensor_states(finished: Sequence[FinishedCalibration], snapshot: Snapshot) -> tuple[SensorState, ...]:
    """The four states in their order; `finished` oldest first, `snapshot` of the present vehicle."""
    newest = {kind: _newest(finished, counting) for kind, (_, counting, _) in TILES.items()}
    return tuple(_state(kind, found, snapshot, _dead(kind, found, finished)) for kind, found in newest.items())


def summary(states: Sequence[SensorState]) -> tuple[Verdict, str]:
    """One sentence that says what the vehicle needs now."""
    for verdict in (Verdict.FAIL, Verdict.WARN):
        bad = [state for state in states if state.verdict == verdict]
        if bad:
            return verdict, f"Needs now: {_listed([_TITLES[state.kind] for state in bad])}. {bad[0].advice}"
    never = [_TITLES[state.kind] for state in states if state.at is None]
    if len(never) == len(states):
        return Verdict.UNKNOWN, "Nothing was calibrated here yet. Begin with the gyro: it takes ten seconds."
    if never:
        return Verdict.UNKNOWN, f"Not calibrated here yet: {_listed(never)}."
    return Verdict.PASS, "Needs nothing now. A preflight looks at the sensors themselves."


_TITLES_OF: Final = {Sensor.GYRO: "gyro", Sensor.ACCEL: "accelerometer", Sensor.MAG: "compass"}
_TITLES: Final = {"gyro": "gyro", "accel": "accelerometer", "mag": "compass", "thermal": "temperature"}


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _newest(finished: Sequence[FinishedCalibration], counting: frozenset[str]) -> FinishedCalibration | None:
    return next((one for one in reversed(finished) if one.kind in counting), None)


def _dead(kind: str, found: FinishedCalibration | None, finished: Sequence[FinishedCalibration]) -> tuple[LeftOut, ...]:
    """The sensors of this tile that dropped out of its newest calibration, or of a later one."""
    since, sensor = (-math.inf if found is None else found.at), TILES[kind][2]
    later = (out for one in finished if one.at >= since for out in one.dead if out.sensor == sensor)
    return tuple({out.instance: out for out in later}.values())


def _reason(out: LeftOut) -> str:
    return f"{_TITLES_OF[out.sensor].capitalize()} {out.instance + 1} was left out: {out.reason.rstrip('.')}."


def _state(
    kind: str, found: FinishedCalibration | None, snapshot: Snapshot, dead: tuple[LeftOut, ...] = ()
) -> SensorState:
    what, _, sensor = TILES[kind]
    if dead:
        at, job = (None, None) if found is None else (found.at, found.job)
        text = " ".join(map(_reason, dead))
        return SensorState(kind, Verdict.FAIL, "left out", text, "Check or replace it. Then calibrate.", at, job, None)
    if found is None:
        text = f"The {what} were not calibrated here yet." if sensor else f"The {what} was not measured here yet."
        return SensorState(kind, Verdict.UNKNOWN, "not calibrated here", text, _BEGIN[kind], None, None, None)
    fits = [fit for fit in found.results if sensor is None or fit.sensor == sensor]
    at = next((fit.temperature for fit in fits if fit.temperature is not None), None)
    quality = _quality(kind, fits)
    text = f"Calibrated {_ago(snapshot.now - found.at)}"
    text += f" at {at:.0f} °C" if at is not None and sensor is not None else ""
    text += f". {quality}" if quality else "."
    verdict, label, advice = _judged(sensor, found, at, snapshot)
    return SensorState(kind, verdict, label, text, advice, found.at, found.job, at)


def _judged(
    sensor: Sensor | None, found: FinishedCalibration, at: float | None, snapshot: Snapshot
) -> tuple[Verdict, str, str]:
    if sensor is not None:
        other = ids_changed(snapshot).get(sensor)
        if other:
            return Verdict.FAIL, "other sensor", f"{other[0][:1].upper()}{other[0][1:]}. Calibrate it."
        moved = [change for change in changes(snapshot) if change.sensor == sensor]
        if moved:
            return Verdict.FAIL, "changed", f"{_changed(moved)} Restore them, or calibrate again."
    missed = [out for out in found.left_out if out.sensor == sensor]
    if missed:
        return Verdict.WARN, "in part", " ".join(map(_reason, missed))
    age = (snapshot.now - found.at) / DAY_S
    if age > limits.CALIBRATION_AGE.value:
        return Verdict.WARN, "old", f"It is {age:.0f} days old; the limit is {limits.CALIBRATION_AGE.value:.0f}."
    now = _temperature(snapshot)
    if sensor in {Sensor.ACCEL, Sensor.GYRO} and None not in (at, now) and not _drift_known(snapshot):
        assert at is not None
        assert now is not None
        if abs(now - at) > limits.TEMPERATURE_SPAN.value:
            return Verdict.WARN, "other temperature", f"It is {now:.0f} °C now: calibrate again, or measure the drift."
    return Verdict.PASS, "good", ""


def _changed(moved: Sequence[Changed]) -> str:
    names = ", ".join(change.name for change in moved[:2])
    more = f" and {len(moved) - 2} more" if len(moved) > 2 else ""
    return f"{names}{more} changed since then."


def _drift_known(snapshot: Snapshot) -> bool:
    enabled = ("INS_TCAL1_ENABLE", "TC_A_ENABLE", "TC_G_ENABLE")
    return any(snapshot.parameters.get(name) == 1 for name in enabled)


def _temperature(snapshot: Snapshot) -> float | None:
    found = [c for c in snapshot.recording.channels if c.sensor == Sensor.TEMPERATURE and len(c)]
    return float(np.median(found[0].values[:, 0])) if found else None


def _quality(kind: str, fits: Sequence[FitResult]) -> str:
    """Uncertainty of the worst instance, as text; empty: not known."""
    if kind == "thermal":
        curves = [fit.model.polynomial for fit in fits if fit.model.polynomial is not None]
        spans = [curve.t_max - curve.t_min for curve in curves if math.isfinite(curve.t_max - curve.t_min)]
        return f"The drift is known over {min(spans):.0f} °C." if spans else ""
    if kind == "mag":
        known = [float(sd) for fit in fits if (sd := fit.quality.get("heading_sd_deg")) is not None]
        return f"Heading known to {max(known):.2g} deg." if known else ""
    of_fit = [dict(zip(fit.names, fit.sd.tolist(), strict=True)) for fit in fits]
    offsets = [sd for named in of_fit for name, sd in named.items() if name.startswith("offset") and math.isfinite(sd)]
    worst = max(offsets, default=0.0)
    if not worst:
        return ""
    return f"Offset known to {math.degrees(worst) if kind == 'gyro' else worst:.2g} {_UNITS[kind]}."


def _ago(seconds: float) -> str:
    if seconds < 120.0:
        return "just now"
    for length, name in ((DAY_S, "day"), (3600.0, "hour"), (60.0, "minute")):
        if seconds >= length:
            count = int(seconds // length)
            return f"{count} {name}{'s' if count > 1 else ''} ago"
    return "just now"


_UNITS: Final = {"gyro": "deg/s", "accel": "m/s²"}
_BEGIN: Final = {
    "gyro": "Calibrate it once, so that mavcal knows how good it is.",
    "accel": "Calibrate it once: six faces and four oblique poses, in any order.",
    "mag": "Calibrate it outdoors: turn the vehicle about all its axes.",
    "thermal": "Measure it once: switch a cold vehicle on and leave it still.",
}
