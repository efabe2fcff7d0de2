"""What a run hands back, what a campaign has to show, and its tables as Markdown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from bench.campaign.judge import Ending
from bench.campaign.scenario import KINDS
from bench.rows import Row, grid
from mavcal.service.jobs.core.journal import JournalStep


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
    ending: Ending
    complaints: tuple[str, ...]
    strikes: Mapping[str, int]
    """How often each kind of fault struck after the first PARAM_SET."""
    doubts: int = 0
    """How often the job was seen in doubt, each with its list compared."""
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


def of_faults(reports: Sequence[FaultReport]) -> list[Row]:
    """What the fault runs have to show."""
    ends = Counter(report.ending for report in reports)
    runs, verified, failed = len(reports), ends[Ending.VERIFIED], ends[Ending.FAILURE]
    kind, least = min(strikes(reports).items(), key=lambda item: item[1])
    clear = [pin for report in reports for pin in report.pinned if pin.effect > CLEAR_SD]
    caught = sum(not pin.missed for pin in clear)
    stops, unheeded = sum(report.stops for report in reports), _unheeded(reports)
    stopped = "a stopping fault in mid-write puts the job in doubt, and no PARAM_SET follows it"
    unapplied = f"accepted but not applied is caught, of the changes above {CLEAR_SD:g} sd"
    return [
        Row("runs", f">= {LEAST_RUNS}", f"{runs}", runs >= LEAST_RUNS),
        Row("runs that end verified, as before, or in doubt with a true list", "all", f"{failed} do not", not failed),
        Row(stopped, "always", f"{stops} faults, {unheeded} not heeded", stops > 0 and not unheeded),
        Row("runs that end verified", "half", f"{verified} of {runs}", 2 * verified >= runs),
        Row("strikes of each fault", f">= {LEAST_STRIKES}", f"fewest: {kind}, {least}", least >= LEAST_STRIKES),
        Row(unapplied, f"{CAUGHT:.0%}", f"{caught} of {len(clear)}", bool(clear) and caught >= CAUGHT * len(clear)),
    ]


def _unheeded(reports: Sequence[FaultReport]) -> int:
    """Runs in which something was sent after a stopping fault, or nobody doubted."""
    said = ("never in doubt", "PARAM_SETs arrived", "PARAM_SETs reached")
    return sum(any(text in c for c in report.complaints for text in said) for report in reports)


def of_kills(reports: Sequence[KillReport]) -> list[Row]:
    """The criteria that the SIGKILL runs of the service must meet."""
    count = sum(len(report.struck) for report in reports)
    failed = sum(report.ending == Ending.FAILURE for report in reports)
    steps = struck_steps(reports)
    step, least = min(((step.value, steps[step.value]) for step in JournalStep), key=lambda item: item[1])
    return [
        Row("SIGKILLs", f">= {LEAST_KILLS}", f"{count}", count >= LEAST_KILLS),
        Row("kills at each step of the journal", f">= {REPEATS}", f"fewest: {step}, {least}", least >= REPEATS),
        Row("killed services that end verified or as before", "all", f"{failed} do not", not failed),
    ]


def of_cli_kills(reports: Sequence[KillReport]) -> list[Row]:
    """The criteria that the SIGKILL runs of the command line must meet."""
    failed = sum(report.ending == Ending.FAILURE for report in reports)
    text = "killed command lines that the next run puts right, verified or as before"
    return [Row(text, "all", f"{failed} of {len(reports)} are not", bool(reports) and not failed)]


def fault_table(reports: Sequence[FaultReport]) -> str:
    """By fault."""
    total, rows = strikes(reports), []
    for kind in KINDS:
        hit = [report for report in reports if report.strikes.get(kind)]
        rows.append((kind, total[kind], len(hit), *_endings(hit)))
    rows.append(("**all runs**", sum(total.values()), len(reports), *_endings(reports)))
    return grid(("fault", "strikes", "runs struck", *Ending), rows)


def kill_table(reports: Sequence[KillReport]) -> str:
    """By the step of the journal at which the process died."""
    steps, rows = struck_steps(reports), []
    for step in JournalStep:
        hit = [report for report in reports if step.value in report.struck]
        rows.append((step.value, steps[step.value], *_endings(hit)))
    rows.append(("**all runs**", sum(steps.values()), *_endings(reports)))
    return grid(("last step before SIGKILL", "kills", *Ending), rows)


def cli_table(reports: Sequence[KillReport]) -> str:
    """By the instant at which the command line died, and what came next."""
    return grid(("scene", "killed at (which time), then", "ended"), [(r.scene, r.aimed, r.ending) for r in reports])


def _endings(reports: Iterable[FaultReport | KillReport]) -> list[int]:
    ends = Counter(report.ending for report in reports)
    return [ends[ending] for ending in Ending]
