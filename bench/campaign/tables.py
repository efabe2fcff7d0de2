"""The tables of a campaign, as Markdown that also reads well on a terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

from bench.campaign.criteria import CLEAR_SD, Criterion, strikes, struck_steps
from bench.campaign.judge import Ending
from bench.campaign.report import FaultReport, KillReport
from bench.campaign.scenario import KINDS
from mavcal.service.jobs.journal import JournalStep

WORDS = {
    "loss": "frames lost",
    "duplication": "frames doubled",
    "reordering": "frames out of order",
    "delay": "frames delayed",
    "bit_errors": "bit errors",
    "truncation": "datagrams cut short",
    "lost_echo": "parameter echo lost",
    "late_echo": "parameter echo late",
    "arm": "vehicle arms",
    "reboot": "vehicle restarts",
    "silence": "vehicle falls silent",
    "onboard_calibration": "vehicle calibrates by itself",
    "move": "peer changes its address",
    "twin": "second vehicle with the same id",
    "second_link": "the same vehicle on a second link",
    "link_dies": "one of two links dies",
    "link_deleted": "the link is to be closed",
    "not_applied": "accepted but not applied",
    "foreign_write": "another ground station writes",
    "stuck": "sensor stuck",
    "nan": "sensor not a number",
    "absent": "sensor absent",
}


def fault_tables(reports: Sequence[FaultReport]) -> str:
    """By fault, by setting, and the changes that were not applied."""
    return "\n\n".join((_by_fault(reports), _by_setting(reports), _not_applied(reports)))


def _by_fault(reports: Sequence[FaultReport]) -> str:
    total = strikes(reports)
    rows = []
    for kind in KINDS:
        hit = [report for report in reports if report.strikes.get(kind)]
        rows.append((WORDS[kind], total[kind], len(hit), *_endings(hit)))
    rows.append(("**all runs**", sum(total.values()), len(reports), *_endings(reports)))
    return table(("fault", "strikes", "runs struck", *Ending), rows)


def _by_setting(reports: Sequence[FaultReport]) -> str:
    rows = []
    for autopilot in sorted({report.autopilot for report in reports}):
        for job in sorted({report.job for report in reports}):
            some = [report for report in reports if (report.autopilot, report.job) == (autopilot, job)]
            rows.append((autopilot, job, len(some), *_endings(some), sum(report.resolved for report in some)))
    return table(("autopilot", "job", "runs", *Ending, "in doubt, then resolved by itself"), rows)


def _not_applied(reports: Sequence[FaultReport]) -> str:
    rows = []
    for text, low, high in (("up to 3 sd", 0.0, 3.0), ("3 to 5 sd", 3.0, CLEAR_SD), ("above 5 sd", CLEAR_SD, 1e9)):
        pins = [pin for report in reports for pin in report.pinned if low < pin.effect <= high]
        rows.append((text, len(pins), sum(pin.named for pin in pins), sum(pin.missed for pin in pins)))
    return table(("accepted but not applied, effect", "changes", "named by the job", "taken for proved"), rows)


def _endings(reports: Iterable[FaultReport | KillReport]) -> list[int]:
    ends = Counter(report.ending for report in reports)
    return [ends[ending] for ending in Ending]


def kill_table(reports: Sequence[KillReport]) -> str:
    """By the step of the journal at which the process died."""
    steps = struck_steps(reports)
    shown = (Ending.VERIFIED, Ending.AS_BEFORE, Ending.FAILURE)
    rows = []
    for step in JournalStep:
        hit = Counter(report.ending for report in reports if step.value in report.struck)
        rows.append((f"`{step.value}`", steps[step.value], *(hit[ending] for ending in shown)))
    ends = Counter(report.ending for report in reports)
    rows.append(("**all runs**", sum(steps.values()), *(ends[ending] for ending in shown)))
    return table(("last step before SIGKILL", "kills", *shown), rows)


def cli_table(reports: Sequence[KillReport]) -> str:
    """By the instant at which the command line died, and what came next."""
    shown = (Ending.VERIFIED, Ending.AS_BEFORE, Ending.FAILURE)
    rows = [(r.scene, r.aimed, *("x" if r.ending == ending else "" for ending in shown)) for r in reports]
    return table(("scene", "killed at (which time), then", *shown), rows)


def criteria_table(criteria: Sequence[Criterion]) -> str:
    """Every criterion with what was measured."""
    rows = [(c.text, c.measured, "yes" if c.met else "**no**") for c in criteria]
    return table(("to be shown", "measured", "met"), rows)


def table(head: Sequence[object], rows: Sequence[Sequence[object]]) -> str:
    """One table."""
    cells = [[str(cell) for cell in row] for row in (head, *rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(head))]
    lines = ["| " + " | ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) + " |" for row in cells]
    return "\n".join([lines[0], "|" + "|".join("-" * (w + 2) for w in widths) + "|", *lines[1:]])
