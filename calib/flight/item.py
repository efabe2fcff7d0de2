"""One check of a log: its number, the limit and the source of the limit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import Any


class FlightVerdict(StrEnum):
    """Verdict on one check; the worst one is that of the log."""

    PASS = "pass"  # noqa: S105  a verdict
    NOT_TESTABLE = "not_testable"  # the text says why
    WARN = "warn"
    FAIL = "fail"


@dataclass(frozen=True)
class FlightLimit:
    """Beyond `warn` a number is suspicious, beyond `fail` the vehicle should not fly; `source` says whose limits."""

    warn: float
    fail: float
    unit: str
    source: str


def worded_bounds(warn: float, fail: float | None, unit: str) -> str:
    """Limits in display units: fractions in percent, rates in deg/s; `fail` None: there is only one."""
    factor, unit = {"1": (100.0, "%"), "rad/s": (math.degrees(1.0), "deg/s")}.get(unit, (1.0, unit))
    return f"{factor * warn:.3g} {unit}" if fail is None else f"{factor * warn:.3g} and {factor * fail:.3g} {unit}"


@dataclass(frozen=True)
class JudgedItem:
    """A judged number.

    `value` is None where nothing was measured; `subject` is the sensor, as ``accel 1``; `numbers` are JSON-able.
    """

    name: str
    subject: str
    verdict: FlightVerdict
    text: str
    value: float | None = None
    sd: float | None = None
    limit: FlightLimit | None = None
    numbers: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def document(self) -> dict[str, Any]:
        """As JSON."""
        limit = None if self.limit is None else vars(self.limit)
        return {**vars(self), "verdict": self.verdict.value, "limit": limit, "numbers": dict(self.numbers)}


def judged(
    name: str, subject: str, value: float, limit: FlightLimit, text: str, *, sd: float | None = None, **numbers: Any
) -> JudgedItem:
    """An item of which a larger `value` is worse; an excess within its own `sd` is not a finding."""
    sure = value - 2.0 * (sd or 0.0)
    verdict = (
        FlightVerdict.FAIL if sure > limit.fail else FlightVerdict.WARN if sure > limit.warn else FlightVerdict.PASS
    )
    return JudgedItem(name, subject, verdict, text, value, sd, limit, numbers)


def not_testable(name: str, subject: str, reason: str, **numbers: Any) -> JudgedItem:
    """An item that cannot be judged."""
    return JudgedItem(name, subject, FlightVerdict.NOT_TESTABLE, reason, numbers=numbers)
