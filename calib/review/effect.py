"""Error of a sensor with the calibration in force and with the planned one.

Both correct the same raw readings, so the error before is ``old(new^-1(truth)) - truth``. The truths are a level turn
and tilts for a compass, all directions of gravity for an accelerometer, and rest for a gyro. The error after is the
uncertainty of the fit plus the part of it that the firmware cannot store. Sentences begin with the sensor that gains
most.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import CalibError
from mavcal.calib.firmware import calibration_in_force
from mavcal.calib.firmware.names import PX4_SLOTS, px4_names
from mavcal.calib.firmware.plan import Value, WritePlan
from mavcal.calib.firmware.slots import px4_instance
from mavcal.calib.fit import FitResult
from mavcal.calib.mag.heading import DEFAULT_INCLINATION, STEEPEST, TILT
from mavcal.calib.mag.heading import heading_tilts as tilts
from mavcal.calib.recording import Array, Sensor
from mavcal.calib.triad import TriadModel

DIRECTIONS: Final = 200
"""Number of directions of gravity that represent the sphere."""
UNITS: Final = {Sensor.GYRO: "deg/s", Sensor.ACCEL: "m/s²", Sensor.MAG: "deg"}
NAMES: Final = {Sensor.GYRO: "gyro", Sensor.ACCEL: "accelerometer", Sensor.MAG: "compass"}
_SUBJECT: Final = {
    "heading": "Heading",
    "rate at rest": "Rate at rest",
    "acceleration": "Acceleration",
    "level": "Level",
    "drift": "Drift with temperature",
}


@dataclass(frozen=True, eq=False)
class ErrorCurve:
    """Curve of the picture: errors before, and the standard deviation after, both (N,) or (N, 3), over a variable."""

    x: Array
    x_label: str
    before: Array
    after_sd: Array
    label: str


@dataclass(frozen=True, eq=False)
class SensorEffect:
    """What a plan does for one sensor."""

    sensor: Sensor
    instance: int
    quantity: str
    """Quantity in error: heading, rate at rest, acceleration, level, drift."""
    unit: str
    before: float | None
    """Largest error with the calibration in force; None: that calibration is not known."""
    after: float
    """Error after: one standard deviation of the fit, combined with what the firmware cannot store."""
    curve: ErrorCurve | None


def effects_of(fits: Sequence[FitResult], plan: WritePlan, parameters: Mapping[str, Value]) -> tuple[SensorEffect, ...]:
    """One effect for each fitted sensor that the plan changes; `parameters` are those from which it was composed."""
    changed = {(change.sensor, change.instance) for change in plan.changes if change.sensor is not None}
    after = dict(parameters) | {change.name: change.new for change in plan.changes if not change.session}
    effects = []
    for fit in fits:
        if (fit.sensor, fit.instance) not in changed and not _is_level(fit):
            continue
        old, new = (_in_force(plan, held, fit) for held in (parameters, after))
        effects.append(_effect(fit, plan, old, new))
    return tuple(effect for effect in effects if effect is not None)


def _in_force(plan: WritePlan, parameters: Mapping[str, Value], fit: FitResult) -> TriadModel | None:
    try:
        return calibration_in_force(
            plan.fingerprint.autopilot, parameters, fit.sensor, _instance(plan, parameters, fit)
        )
    except CalibError:  # a sensor without a calibration: nothing is in force
        return None


def _instance(plan: WritePlan, parameters: Mapping[str, Value], fit: FitResult) -> int:
    """Instance of the parameter row that the plan writes for this sensor; on PX4 it may differ from that of the fit."""
    if plan.fingerprint.autopilot == "px4":
        for change in plan.changes:
            if (change.sensor, change.instance) == (fit.sensor, fit.instance):
                for slot in range(PX4_SLOTS):
                    if change.name in px4_names(fit.sensor, slot).values():
                        return px4_instance(parameters, fit.sensor, slot)
    return fit.instance


def _is_level(fit: FitResult) -> bool:
    return {"roll", "pitch"} <= set(fit.native)


def _effect(fit: FitResult, plan: WritePlan, old: TriadModel | None, new: TriadModel | None) -> SensorEffect | None:
    if _is_level(fit):
        return _level(fit)
    if fit.model.polynomial is not None:
        return _drift(fit, plan, old, new)
    if fit.sensor == Sensor.MAG:
        return _heading(fit, plan, old, new)
    if fit.sensor in {Sensor.ACCEL, Sensor.GYRO}:
        return _vector(fit, plan, old, new)
    return None


def _level(fit: FitResult) -> SensorEffect:
    """Effect of a trim: the measured roll and pitch are the error before."""
    off = math.degrees(math.hypot(float(fit.native["roll"]), float(fit.native["pitch"])))
    sd = math.degrees(max(float(fit.native["roll_sd"]), float(fit.native["pitch_sd"])))
    return SensorEffect(fit.sensor, fit.instance, "level", "deg", off, sd, None)


def _heading(fit: FitResult, plan: WritePlan, old: TriadModel | None, new: TriadModel | None) -> SensorEffect:
    sd = float(fit.quality.get("heading_sd_deg") or math.nan)
    headings = np.radians(np.arange(0.0, 360.0, 5.0))
    before, curve = None, None
    if old is not None and new is not None:
        dip = math.radians(float(fit.quality.get("heading_dip_deg") or math.degrees(DEFAULT_INCLINATION)))
        strength = float(fit.quality.get("radius") or 50.0)
        errors = heading_errors(old, new, strength, dip, headings)
        before = float(np.abs(errors).max())
        level = np.full(len(headings), sd)
        curve = ErrorCurve(np.degrees(headings), "heading, deg", errors[0], level, "heading error, deg")
    return SensorEffect(fit.sensor, fit.instance, "heading", "deg", before, _left(fit, plan, sd, "deg"), curve)


def heading_errors(old: TriadModel, new: TriadModel, strength: float, dip: float, headings: Array) -> Array:
    """Heading by `old` less that by `new`, deg, (tilts, N): level first, then rolled and pitched.

    ``heading = atan2(-c_y, c_x)`` of the corrected field turned level.
    """
    dip = math.copysign(min(abs(dip), STEEPEST), dip)
    horizontal = strength * math.cos(dip)
    x, y = horizontal * np.cos(headings), -horizontal * np.sin(headings)
    level_field = np.stack([x, y, np.full(len(headings), strength * math.sin(dip))], axis=1)
    rows = []
    for level_from_body in tilts(TILT):
        raw = new.invert(level_field @ level_from_body)
        seen = old.apply(raw) @ level_from_body.T
        errors = np.arctan2(-seen[:, 1], seen[:, 0]) - headings
        rows.append(np.degrees(np.angle(np.exp(1j * errors))))
    return np.array(rows)


def _vector(fit: FitResult, plan: WritePlan, old: TriadModel | None, new: TriadModel | None) -> SensorEffect:
    """Effect on a gyro's rate at rest, or on an accelerometer's specific force over all directions."""
    gyro = fit.sensor == Sensor.GYRO
    factor = math.degrees(1.0) if gyro else 1.0
    truths = np.zeros((1, 3)) if gyro else STANDARD_GRAVITY * _sphere(DIRECTIONS)
    quantity, unit = ("rate at rest", "deg/s") if gyro else ("acceleration", "m/s²")
    sds = factor * fit.corrected_sd(truths)
    sd = float(np.linalg.norm(sds, axis=1).max()) if not gyro else float(sds.max())
    before, curve = None, None
    if old is not None and new is not None:
        at = _temperature(fit, old, new)
        errors = factor * (old.apply(new.invert(truths, at), at) - truths)
        before = float((np.abs(errors) if gyro else np.linalg.norm(errors, axis=1)).max())
        faces = np.zeros((1, 3)) if gyro else STANDARD_GRAVITY * np.vstack([np.eye(3), -np.eye(3)])
        shown = factor * (old.apply(new.invert(faces, at), at) - faces)
        if gyro:
            curve = ErrorCurve(np.arange(3.0), "axis", shown[0], sds[0], f"rate at rest, {unit}")
        else:
            lengths = factor * (np.linalg.norm(old.apply(new.invert(faces, at), at), axis=1) - STANDARD_GRAVITY)
            left = np.linalg.norm(factor * fit.corrected_sd(faces), axis=1)
            curve = ErrorCurve(np.arange(6.0), "face", lengths, left, f"|f| - g, {unit}")
    return SensorEffect(fit.sensor, fit.instance, quantity, unit, before, _left(fit, plan, sd, unit), curve)


def _drift(fit: FitResult, plan: WritePlan, old: TriadModel | None, new: TriadModel | None) -> SensorEffect | None:
    """Effect of a drift calibration: the largest uncorrected change of the offset over its temperatures."""
    measured = fit.model.polynomial
    assert measured is not None
    gyro = fit.sensor == Sensor.GYRO
    factor, unit = (math.degrees(1.0), "deg/s") if gyro else (1.0, "m/s²")
    at = np.linspace(measured.t_min, measured.t_max, 60)
    sd = factor * fit.drift_sd(at).max(axis=1)
    before, curve = None, None
    if new is not None:
        corrected = np.zeros((len(at), 3)) if old is None or old.polynomial is None else old.bias(at)
        errors = factor * (measured(at) - (corrected - corrected.mean(axis=0)))
        errors -= errors[int(np.argmin(np.abs(at - measured.t_ref)))]
        before = float(np.abs(errors).max())
        curve = ErrorCurve(at, "temperature, °C", errors, sd, f"change with temperature, {unit}")
    return SensorEffect(fit.sensor, fit.instance, "drift", unit, before, _left(fit, plan, float(sd.max()), unit), curve)


def _left(fit: FitResult, plan: WritePlan, sd: float, unit: str) -> float:
    """Uncertainty of the fit, combined with what the firmware cannot store, where that has the same unit."""
    spelled = {unit, unit.replace("²", "2")}
    costs = [
        loss.cost
        for loss in plan.losses
        if (loss.sensor, loss.instance) == (fit.sensor, fit.instance) and loss.unit in spelled
    ]
    return float(np.hypot(sd if math.isfinite(sd) else 0.0, max(costs, default=0.0)))


def _temperature(fit: FitResult, old: TriadModel, new: TriadModel) -> float | None:
    if old.polynomial is None and new.polynomial is None:
        return None
    return 25.0 if fit.temperature is None else fit.temperature


def _sphere(count: int) -> Array:
    """Unit vectors (count, 3) spread evenly (Fibonacci)."""
    i = np.arange(count) + 0.5
    polar, around = np.arccos(1.0 - 2.0 * i / count), math.pi * (1.0 + math.sqrt(5.0)) * i
    return np.stack([np.cos(around) * np.sin(polar), np.sin(around) * np.sin(polar), np.cos(polar)], axis=1)


def headline_of(effects: Sequence[SensorEffect], *, done: bool = False) -> str:
    """One sentence about the sensor that gains most; `done`: the plan has been written."""
    if not effects:
        return "This plan changes no sensor."
    known = [effect for effect in effects if effect.before is not None]
    if not known:
        worst = max(effects, key=lambda effect: effect.after)
        known_to = "is known" if done else "will be known"
        return f"{_SUBJECT[worst.quantity]} {known_to} to {amount(worst.after, worst.unit)}."
    first = max(known, key=lambda effect: (effect.before or 0.0) / max(effect.after, 1e-9))
    same = [effect for effect in known if effect.quantity == first.quantity and effect.unit == first.unit]
    before, after = max(effect.before or 0.0 for effect in same), max(effect.after for effect in same)
    now, then = amount(before, first.unit), amount(after, first.unit)
    subject = _SUBJECT[first.quantity]
    if done:
        return f"{subject} was wrong by up to {now}, and is good to {then} now."
    return f"{subject} is wrong by up to {now}, and will be good to {then}."


def text_of(effect: SensorEffect, *, done: bool = False) -> str:
    """Sentence about the plan's effect on one sensor; `done`: it has been written."""
    then = amount(effect.after, effect.unit)
    if effect.before is None:
        return f"{effect.quantity} {'is' if done else 'will be'} known to {then}"
    if done:
        return f"{effect.quantity} was off by up to {amount(effect.before, effect.unit)}, good to {then} now"
    return f"{effect.quantity} off by up to {amount(effect.before, effect.unit)} now, good to {then} afterwards"


def amount(value: float, unit: str) -> str:
    """`value` to two significant digits, with the unit."""
    return f"{value:.2g} {unit}" if value < 100 else f"{value:.0f} {unit}"
