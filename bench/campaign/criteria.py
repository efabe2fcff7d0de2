"""What a campaign has to show, as a list of criteria with what was measured."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from bench.campaign.judge import Ending
from bench.campaign.kill_scene import REPEATS
from bench.campaign.report import FaultReport, KillReport
from bench.campaign.scenario import KINDS
from mavcal.service.jobs.journal import JournalStep

LEAST_RUNS = 200
LEAST_STRIKES = 15
LEAST_KILLS = 50
CAUGHT = 0.99
CLEAR_SD = 5.0


@dataclass(frozen=True)
class Criterion:
    """One thing to be shown, and whether it is."""

    text: str
    measured: str
    met: bool


def strikes(reports: Sequence[FaultReport]) -> Counter[str]:
    """Strikes of each kind of fault after the first PARAM_SET."""
    total: Counter[str] = Counter(dict.fromkeys(KINDS, 0))
    for report in reports:
        total.update(report.strikes)
    return total


def struck_steps(reports: Sequence[KillReport]) -> Counter[str]:
    """Kills by the last step of the journal."""
    return Counter({step.value: 0 for step in JournalStep}) + Counter(
        step for report in reports for step in report.struck
    )


def of_faults(reports: Sequence[FaultReport]) -> list[Criterion]:
    """What the fault runs have to show."""
    ends = Counter(report.ending for report in reports)
    runs, verified, failed = len(reports), ends[Ending.VERIFIED], ends[Ending.FAILURE]
    least = min(strikes(reports).items(), key=lambda item: item[1])
    clear = [pin for report in reports for pin in report.pinned if pin.effect > CLEAR_SD]
    missed = sum(pin.missed for pin in clear)
    share = 1 - missed / len(clear) if clear else 0.0
    return [
        Criterion(f"at least {LEAST_RUNS} runs", f"{runs}", runs >= LEAST_RUNS),
        Criterion(
            "every run ends verified, as before, or in doubt with a list that is true", f"{failed} do not", not failed
        ),
        Criterion(
            "a stopping fault in mid-write puts the job in doubt, and no PARAM_SET follows it",
            f"{sum(report.stops for report in reports)} such faults, {_unheeded(reports)} not heeded",
            any(report.stops for report in reports) and not _unheeded(reports),
        ),
        Criterion("at least half end verified", f"{verified} of {runs}", 2 * verified >= runs),
        Criterion(
            f"every fault strikes at least {LEAST_STRIKES} times after the first PARAM_SET",
            f"fewest: {least[0]}, {least[1]} times",
            least[1] >= LEAST_STRIKES,
        ),
        Criterion(
            f"accepted but not applied is caught in at least {CAUGHT:.0%} of the changes above {CLEAR_SD:g} sd",
            f"{len(clear) - missed} of {len(clear)}",
            share >= CAUGHT,
        ),
    ]


def _unheeded(reports: Sequence[FaultReport]) -> int:
    """Runs in which something was sent after a stopping fault, or nobody doubted."""
    said = ("never in doubt", "PARAM_SETs arrived", "PARAM_SETs reached")
    return sum(any(text in c for c in report.complaints for text in said) for report in reports)


def of_kills(reports: Sequence[KillReport]) -> list[Criterion]:
    """The criteria that the SIGKILL runs of the service must meet."""
    count = sum(len(report.struck) for report in reports)
    failed = sum(report.ending == Ending.FAILURE for report in reports)
    steps = struck_steps(reports)
    least = min(((step.value, steps[step.value]) for step in JournalStep), key=lambda item: item[1])
    return [
        Criterion(f"at least {LEAST_KILLS} SIGKILLs", f"{count}", count >= LEAST_KILLS),
        Criterion(
            f"each step of the journal is struck at least {REPEATS} times",
            f"fewest: {least[0]}, {least[1]} times",
            least[1] >= REPEATS,
        ),
        Criterion("every run ends verified or as before", f"{failed} do not", not failed),
    ]


def of_cli_kills(reports: Sequence[KillReport]) -> list[Criterion]:
    """The criteria that the SIGKILL runs of the command line must meet."""
    failed = sum(report.ending == Ending.FAILURE for report in reports)
    text = "every command line that was killed is put right by the next run, verified or as before"
    return [Criterion(text, f"{failed} of {len(reports)} are not", bool(reports) and not failed)]
