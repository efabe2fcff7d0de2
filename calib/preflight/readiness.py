"""Whether the vehicle would arm after a calibration, and the reasons against it."""

from __future__ import annotations

from dataclasses import dataclass

from mavcal.calib.preflight.check import CheckId, Report, Verdict

_ORDER = (Verdict.FAIL, Verdict.WARN, Verdict.UNKNOWN)


@dataclass(frozen=True)
class Readiness:
    """What a preflight after the write says; the event `readiness` carries the same."""

    verdict: Verdict
    """That of the preflight; unknown: the vehicle could not be looked at."""
    text: str
    """This vehicle would arm now, or what stands against it in its own words."""
    against: tuple[str, ...] = ()
    """Every check that does not pass, failures first."""


def readiness(report: Report) -> Readiness:
    """The report in a sentence, and the reasons against arming."""
    against = tuple(f"{c.id.value}: {c.reason}" for v in _ORDER for c in report.checks if c.verdict == v)
    prearm = report.check(CheckId.VEHICLE_PREARM)
    if report.verdict == Verdict.PASS:
        text = report.summary
    elif report.verdict == Verdict.FAIL and prearm.verdict == Verdict.PASS:
        text = f"Not fit to fly, although the vehicle itself would arm: {report.summary}"
    elif prearm.verdict == Verdict.PASS:
        text = f"This vehicle would arm now. {report.summary}"
    elif prearm.verdict == Verdict.UNKNOWN:
        text = f"Whether this vehicle would arm now is not known. {prearm.reason}"
    else:
        text = prearm.reason
    return Readiness(report.verdict, text, against)


def unchecked(why: str) -> Readiness:
    """There is no report, for this reason."""
    return Readiness(Verdict.UNKNOWN, f"Whether this vehicle would arm now was not checked: {why}")
