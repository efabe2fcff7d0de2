"""Whether the vehicle would arm after a calibration, and the reasons against it."""

from __future__ import annotations

from dataclasses import dataclass

from mavcal.calib.preflight.check import CheckId, Report, Verdict

_ORDER = (Verdict.FAIL, Verdict.WARN, Verdict.UNKNOWN)


@dataclass(frozen=True)
class Readiness:
    """Whether a vehicle would arm after its calibration."""

    verdict: Verdict
    """That of the whole report; unknown where there is none."""
    text: str
    against: tuple[str, ...] = ()
    """Every check that does not pass with its reason, failures first; the vehicle's own texts are quoted."""


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
