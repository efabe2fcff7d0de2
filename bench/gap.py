"""The sim-to-real gap: seconds that a diagnosis takes, beside how long was recorded."""

from __future__ import annotations

import time
from dataclasses import dataclass

from bench.gap_picture import CLEAN, REAL, recorded
from bench.rows import Row, Section
from mavcal.calib import gap
from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.model.bands import split
from mavcal.calib.gap.model.hypotheses import hypotheses_of
from mavcal.calib.gap.model.joint import setting_of, starting_model
from mavcal.calib.gap.model.noise_fit import refitted, starting_noise
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.reference import build
from mavcal.calib.gap.remembered import one_diagnosis
from mavcal.calib.gap.search.contest import Contest
from mavcal.calib.gap.search.selection import select

SEED = 20261122
_BUDGET = 16_000_000
_KEPT = 1.2
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
    rows += [_kept_row(logs[0]), _limit_row(logs[-1])]
    notes = (
        f"Generated flights (seed {SEED}) beside their ideal readings: three sensors, the magnetometer at 100 Hz; "
        "nothing wrong, or four effects on two sensors (offset and drift of the accelerometer, hard and soft iron). "
        "Processor time of one core, alignment, blocks that are held out and report included; nested is with the "
        "selection repeated in each of those.",
        "Columns kept: the same selection by a contest that keeps what it has transformed, beside one that keeps "
        "nothing; both end with the same effects. Limited: nested, by the clock, with the time that the limit allows.",
    )
    return Section("Diagnosing the gap", tuple(rows), notes)


def _kept_row(log: _Log) -> Row:
    """One selection with and without columns that are kept, one after the other."""
    recording = recorded(REAL, SEED, seconds=log.seconds, rate=log.rate)
    views = split(views_of(build(recording), {}, {}))
    hypotheses, _ = hypotheses_of(catalogue(), views)
    setting = setting_of(views)
    start = refitted(starting_model(setting, starting_noise(setting))).model
    took, found = [], []
    for budget in (_BUDGET, 0):
        began = time.process_time()
        with one_diagnosis():
            chosen = select(start, Contest(hypotheses, budget=budget), 0.005)
        took.append(time.process_time() - began)
        found.append([score.hypothesis.key for score in chosen.scores])
    ratio, same = took[1] / took[0], found[0] == found[1]
    what = f"{log.seconds:.0f} s at {log.rate:.0f} Hz, four effects, one selection: columns kept"
    said = "the same effects" if same else "OTHER effects"
    measured = f"{took[0]:.1f} s, {ratio:.2f} x as fast as without ({took[1]:.1f} s); {said}"
    return Row(what, f">= {_KEPT:g} x", measured, same and ratio >= _KEPT)


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
