"""The sim-to-real gap: seconds that a diagnosis takes, beside how long was recorded."""

from __future__ import annotations

import time
from dataclasses import dataclass

from bench.rows import Row, Section
from mavcal.calib import gap
from tests.unit.gap.recorded import CLEAN, REAL, recorded

SEED = 20261122
_LIMIT_S = 20.0


@dataclass(frozen=True)
class _Log:
    """A recording to be diagnosed, and in what time: where and which, and with the selection inside the folds."""

    seconds: float
    rate: float
    which_s: float
    shrink_s: float = 15.0


LOGS = (_Log(70.0, 200.0, 3.0), _Log(600.0, 400.0, 10.0))


def run(logs: tuple[_Log, ...] = LOGS) -> Section:
    """Measure on generated flights with and without an effect."""
    rows = [row for log in logs for row in _rows(log)]
    rows.append(_limit_row(logs[-1]))
    notes = (
        f"Generated flights (seed {SEED}) beside their ideal readings: three sensors, the magnetometer at 100 Hz; "
        "nothing wrong, or four effects on two sensors (offset and drift of the accelerometer, hard and soft iron). "
        "Processor time of one core, alignment, blocks that are held out and report included; nested is with the "
        "selection repeated in each of those.",
        "Limited: nested, by the clock, with the time that the limit allows.",
    )
    return Section("Diagnosing the gap", tuple(rows), notes)


def _limit_row(log: _Log) -> Row:
    """A diagnosis that has less time than it needs."""
    recording = recorded(REAL, SEED, seconds=log.seconds, rate=log.rate)
    began = time.monotonic()
    report = gap.run(recording, pace=gap.GapPace(lambda: time.monotonic() - began, _LIMIT_S))
    took = time.monotonic() - began
    what = f"{log.seconds:.0f} s at {log.rate:.0f} Hz, four effects, nested, limited to {_LIMIT_S:g} s by the clock"
    left_out = ", ".join(report.left_out) or "nothing"
    measured = f"{took:.1f} s: {report.verdict.value}, {len(report.effects)} effects, left out: {left_out}"
    return Row(what, f"<= {_LIMIT_S:g} s", measured, took <= _LIMIT_S)


def _rows(log: _Log) -> list[Row]:
    found = []
    for name, suite in (("nothing wrong", CLEAN), ("four effects", REAL)):
        recording = recorded(suite, SEED, seconds=log.seconds, rate=log.rate)
        for nested, limit in ((False, log.which_s), (True, log.shrink_s)):
            began = time.process_time()
            report = gap.run(recording, nested=nested)
            took = time.process_time() - began
            said = ", ".join(effect.id for effect in report.effects) or report.verdict.value
            what = f"{log.seconds:.0f} s at {log.rate:.0f} Hz, {name}" + (", nested" if nested else "")
            measured = f"{took:.1f} s, {log.seconds / took:.0f} x as fast as flown: {said}"
            found.append(Row(what, f"<= {limit:.0f} s", measured, took <= limit))
    return found
