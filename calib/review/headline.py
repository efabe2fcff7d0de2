"""What a plan does, in sentences: the worst sensor first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from mavcal.calib.recording import Sensor
from mavcal.calib.review.effect import SensorEffect

NAMES: Final = {Sensor.GYRO: "gyro", Sensor.ACCEL: "accelerometer", Sensor.MAG: "compass"}
_SUBJECT: Final = {
    "heading": "Heading",
    "rate at rest": "Rate at rest",
    "acceleration": "Acceleration",
    "level": "Level",
    "drift": "Drift with temperature",
}


def headline_of(effects: Sequence[SensorEffect], *, done: bool = False) -> str:
    """One sentence about the sensor that gains most. `done`: the plan has been written."""
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
    """What the plan does for one sensor. `done`: it has been written."""
    then = amount(effect.after, effect.unit)
    if effect.before is None:
        return f"{effect.quantity} {'is' if done else 'will be'} known to {then}"
    if done:
        return f"{effect.quantity} was off by up to {amount(effect.before, effect.unit)}, good to {then} now"
    return f"{effect.quantity} off by up to {amount(effect.before, effect.unit)} now, good to {then} afterwards"


def amount(value: float, unit: str) -> str:
    """Two significant digits and the unit."""
    return f"{value:.2g} {unit}" if value < 100 else f"{value:.0f} {unit}"
