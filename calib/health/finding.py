"""A finding: one number of one sensor against its limit, and the action."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from mavcal.calib.health.limits import HealthLimit
from mavcal.calib.recording import Sensor

NAMES = {Sensor.ACCEL: "accelerometer", Sensor.GYRO: "gyroscope", Sensor.MAG: "compass"}


class HealthVerdict(StrEnum):
    """Condition of a sensor."""

    OK = "ok"
    CANNOT_SAY = "cannot_say"
    SUSPICIOUS = "suspicious"
    FAULTY = "faulty"


BAD = (HealthVerdict.FAULTY, HealthVerdict.SUSPICIOUS)
SUPPORTING = frozenset(
    {"vibration", "clipping", "aliasing", "motors", "stuck", "drift", "temperature", "sampling", "unhealthy"}
)
"""Checks that can show a fault but cannot show that a sensor reads right."""
_WORSE = (HealthVerdict.CANNOT_SAY, HealthVerdict.OK, HealthVerdict.SUSPICIOUS, HealthVerdict.FAULTY)
"""Order of the verdicts: the worst finding decides; checks that could not be made count only without any other."""


@dataclass(frozen=True)
class Compared:
    """A number with its standard error, and the limit that it was compared with."""

    value: float | None
    sd: float | None
    limit: HealthLimit


@dataclass(frozen=True)
class HealthFinding:
    """One check of one sensor.

    `value` and `sd` are None where nothing was measured; `start` and `end` are the evidence's time span, s, None where
    it is the whole log.
    """

    check: str
    sensor: Sensor
    instance: int
    verdict: HealthVerdict
    text: str
    action: str = ""
    value: float | None = None
    sd: float | None = None
    limit: HealthLimit | None = None
    start: float | None = None
    end: float | None = None

    @property
    def document(self) -> dict[str, Any]:
        """As JSON."""
        limit = None if self.limit is None else vars(self.limit)
        plain = {"sensor": self.sensor.value, "verdict": self.verdict.value, "limit": limit}
        return {**vars(self), **plain}


@dataclass(frozen=True)
class SensorHealth:
    """One sensor of one unit with its findings, the worst first."""

    sensor: Sensor
    instance: int
    findings: tuple[HealthFinding, ...]

    @property
    def name(self) -> str:
        """As a person counts: ``compass 1``."""
        return f"{NAMES[self.sensor]} {self.instance + 1}"

    @property
    def verdict(self) -> HealthVerdict:
        """Verdict of the worst finding; a sensor is ok only where a check of its readings says so."""
        found = worst(f.verdict for f in self.findings)
        if found == HealthVerdict.OK and all(f.check in SUPPORTING for f in self.findings if f.verdict == found):
            return HealthVerdict.CANNOT_SAY
        return found

    @property
    def bad(self) -> tuple[HealthFinding, ...]:
        """Findings against it."""
        return tuple(f for f in self.findings if f.verdict in BAD)

    @property
    def good(self) -> tuple[HealthFinding, ...]:
        """All other checks, including those that could not be made."""
        return tuple(f for f in self.findings if f.verdict not in BAD)

    @property
    def actions(self) -> tuple[str, ...]:
        """What to do about it, each once, the most urgent first; what another one says already is left out."""
        every = tuple(dict.fromkeys(f.action for f in self.bad if f.action))
        return tuple(one for one in every if not any(one != other and one in other for other in every))

    @property
    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "sensor": self.sensor.value,
            "instance": self.instance,
            "name": self.name,
            "verdict": self.verdict.value,
            "findings": [f.document for f in self.findings],
        }


def worst(verdicts: Iterable[HealthVerdict]) -> HealthVerdict:
    """The worst of `verdicts`; ``cannot_say`` of none."""
    return max(verdicts, key=_WORSE.index, default=HealthVerdict.CANNOT_SAY)


def sensor_health(sensor: Sensor, instance: int, findings: Iterable[HealthFinding]) -> SensorHealth:
    """Health of that sensor from its `findings`: the worst first, then those about its readings."""
    own = [f for f in findings if (f.sensor, f.instance) == (sensor, instance)]
    found = SensorHealth(sensor, instance, tuple(sorted(own, key=lambda f: -_WORSE.index(f.verdict))))
    if found.verdict != HealthVerdict.CANNOT_SAY:
        return found
    return SensorHealth(sensor, instance, tuple(sorted(found.findings, key=lambda f: f.check in SUPPORTING)))


def shown_sd(sd: float) -> str:
    """A standard deviation with two decimals, at least 0.01."""
    return f"{max(sd, 0.01):.2f}"


def judged_value(value: float, sd: float, limit: HealthLimit) -> HealthVerdict:
    """Verdict on a `value`, of which larger is worse, beyond two standard errors.

    Where these would hide a faulty sensor (without such a limit: one that is off by twice the suspicious) nothing can
    be said.
    """
    sure = value - 2.0 * sd
    if limit.faulty is not None and sure > limit.faulty:
        return HealthVerdict.FAULTY
    if sure > limit.suspicious:
        return HealthVerdict.SUSPICIOUS
    hidden = 2.0 * limit.suspicious if limit.faulty is None else limit.faulty
    return HealthVerdict.CANNOT_SAY if value + 2.0 * sd > hidden and sd > 0.0 else HealthVerdict.OK
