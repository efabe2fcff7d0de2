"""What a run hands back, what a campaign has to show, and its tables as Markdown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from bench.campaign.judge import Ending
from bench.campaign.scenario import KINDS
from mavcal.service.jobs.journal import JournalStep


@dataclass(frozen=True)
class Pinned:
    """One parameter that the vehicle accepted but did not apply."""

    name: str
    effect: float
    """How far its stream is off, in standard deviations of the check."""
    missed: bool
    """The job ended succeeded, with this parameter proved."""
    named: bool
    """The job says by name that it has no effect."""


@dataclass(frozen=True)
class FaultReport:
    """The outcome of a fault run."""

    index: int
    seed: int
    recipe: str
    autopilot: str
    job: str
    ending: Ending
    complaints: tuple[str, ...]
    strikes: Mapping[str, int]
    """How often each kind of fault struck after the first PARAM_SET."""
    doubts: int = 0
    """How often the job was seen in doubt, each with its list compared."""
    resolved: bool = False
    """It was in doubt and came out of it by itself."""
    pinned: tuple[Pinned, ...] = ()
    says: str = ""
    """The job's own last sentence."""
    seconds: float = 0.0
    stops: int = 0
    """Stopping faults in mid-write: each was followed by a doubt and by no PARAM_SET, or the run is a failure."""

    @property
    def reproduce(self) -> str:
        """The command that repeats this run."""
        return f"scripts/campaign faults --seed {self.seed} --run {self.index}"


@dataclass(frozen=True)
class KillReport:
    """The outcome of a SIGKILL run."""

    index: int
    seed: int
    scene: str
    aimed: str
    struck: tuple[str, ...]
    """The last journal step at each kill."""
    ending: Ending
    complaints: tuple[str, ...]
    says: str = ""
    seconds: float = 0.0
    journal: tuple[str, ...] = field(default=())
    part: str = "kills"
    """Whose process was killed: the service's (``kills``) or the command line's (``cli``)."""

    @property
    def reproduce(self) -> str:
        """The command that repeats this run."""
        return f"scripts/campaign {self.part} --seed {self.seed} --run {self.index}"


REPEATS = 3
"""Every step of the journal is struck at least so often."""
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


def fault_tables(reports: Sequence[FaultReport]) -> str:
    """By fault and by setting."""
    return "\n\n".join((_by_fault(reports), _by_setting(reports)))


def _by_fault(reports: Sequence[FaultReport]) -> str:
    total = strikes(reports)
    rows = []
    for kind in KINDS:
        hit = [report for report in reports if report.strikes.get(kind)]
        rows.append((kind, total[kind], len(hit), *_endings(hit)))
    rows.append(("**all runs**", sum(total.values()), len(reports), *_endings(reports)))
    return table(("fault", "strikes", "runs struck", *Ending), rows)


def _by_setting(reports: Sequence[FaultReport]) -> str:
    rows = []
    for autopilot in sorted({report.autopilot for report in reports}):
        for job in sorted({report.job for report in reports}):
            some = [report for report in reports if (report.autopilot, report.job) == (autopilot, job)]
            rows.append((autopilot, job, len(some), *_endings(some), sum(report.resolved for report in some)))
    return table(("autopilot", "job", "runs", *Ending, "in doubt, then resolved by itself"), rows)


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
