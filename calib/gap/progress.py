"""Progress of a diagnosis, and the work left out to keep a time limit.

There is no clock here: the caller measures the time. The parts of the time are estimates from recordings of minutes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.gap.schema import GapReport, GapVerdict


class GapStage(StrEnum):
    """Stages of a diagnosis, in this order."""

    AIRFRAME = "airframe"
    REFERENCE = "reference"
    SELECTION = "selection"
    RIVALS = "rivals"
    HELD_OUT = "held_out"
    BLOCKS = "blocks"
    REPORT = "report"


_BEGINS = {
    GapStage.AIRFRAME: 0.0,
    GapStage.REFERENCE: 0.2,
    GapStage.SELECTION: 0.4,
    GapStage.RIVALS: 0.55,
    GapStage.HELD_OUT: 0.67,
    GapStage.BLOCKS: 0.7,
    GapStage.REPORT: 0.97,
}
"""Fraction of the whole time after which a stage begins. Source: decision 36, recordings of minutes."""
_MAY_TAKE = {
    GapStage.AIRFRAME: 0.3,
    GapStage.REFERENCE: 0.4,
    GapStage.SELECTION: 0.65,
    GapStage.RIVALS: 0.8,
    GapStage.HELD_OUT: 0.87,
    GapStage.BLOCKS: 0.9,
    GapStage.REPORT: math.inf,
}
"""Fraction of the limit after which no work begins in a stage; infinite: it is never left out. Source: decision 36."""
_REPORTED_FROM = 0.9
"""Fraction of the limit for the search and held-out blocks; the rest is for the report. Source: decision 36, flights of
minutes."""
DEFAULT_LIMIT_S = 60.0
"""Processor time, s, after which a diagnosis ends unless more is asked for. Chosen, not measured: nobody waits longer
beside a vehicle."""
_TOLD_EVERY_S = 0.5
"""Interval, s, of progress reports during a step. Chosen, not measured: a line that changes twice a second looks
alive."""
_FITS_AFTERWARDS = {GapStage.SELECTION: 12.0, GapStage.RIVALS: 12.0, GapStage.HELD_OUT: 5.0}
"""Whole-model fits per effect that are needed after a stage. Source: decision 36, flights of minutes."""
_MANY = 8
"""Steps after which half of a stage counts as done. Chosen, not measured: the size of a usual search."""
_TEXT = {
    GapStage.AIRFRAME: "comparing airframe and air",
    GapStage.REFERENCE: "making the reference",
    GapStage.SELECTION: "selecting effects",
    GapStage.RIVALS: "comparing them with their rivals",
    GapStage.HELD_OUT: "holding blocks out",
    GapStage.BLOCKS: "repeating the selection in each block",
    GapStage.REPORT: "writing the report",
}
_LEFT_OUT = {
    GapStage.AIRFRAME: "not every effect of airframe and air was looked for",
    GapStage.REFERENCE: "not all that the other recording shows of its own was looked for",
    GapStage.SELECTION: "further effects were not looked for",
    GapStage.RIVALS: "not every other effect or shape was tried in the place of those that were found",
    GapStage.HELD_OUT: "not every block was held out with everything fitted again",
    GapStage.BLOCKS: "the selection was not repeated in every block that was held out",
}


@dataclass(frozen=True)
class GapProgress:
    """Progress of a diagnosis: `share` of the work, 0 to 1, and the seconds left, None if unknown."""

    stage: GapStage
    share: float
    left_s: float | None

    @property
    def text(self) -> str:
        """The present activity."""
        return _TEXT[self.stage]


def _ignore(_standing: GapProgress) -> None:
    """Ignore the progress, for callers without a listener."""


@dataclass(eq=False)
class GapPace:
    """Time limit of a diagnosis, the work left out to keep it, and its progress listener.

    Parameters
    ----------
    elapsed
        Seconds since the beginning; None: no clock and no limit.
    limit_s
        After which it should end.
    on_progress
        Called at every step.
    """

    elapsed: Callable[[], float] | None = None
    limit_s: float = math.inf
    on_progress: Callable[[GapProgress], None] = _ignore
    stage: GapStage = GapStage.REFERENCE
    left_out: dict[GapStage, None] = field(default_factory=dict)
    began: dict[GapStage, float] = field(default_factory=dict)
    steps: int = 0
    fits_s: float = 0.0
    share: float = 0.0
    reported_s: float = -math.inf

    def __post_init__(self) -> None:
        if not self.limit_s > 0.0:
            raise InvalidInputError(f"the limit is {self.limit_s:g} s; it has to be above zero")
        if self.elapsed is None and math.isfinite(self.limit_s):
            raise InvalidInputError("a limit needs somebody who measures the time")

    def begin(self, stage: GapStage, part: float = 0.0) -> None:
        """Begin a stage, or report that a `part` of it, 0 to 1, is done."""
        if stage is not self.stage:
            self.steps = 0
        self.stage = stage
        self.began.setdefault(stage, self.now)
        begins = list(_BEGINS.values())
        k = list(_BEGINS).index(stage)
        end = begins[k + 1] if k + 1 < len(begins) else 1.0
        self.share = begins[k] + part * (end - begins[k])
        self._notify()

    def _notify(self) -> None:
        self.reported_s = self.now
        self.on_progress(GapProgress(self.stage, self.share, self._left(self.share)))

    def advance(self) -> None:
        """Count one more step of the present stage, whose number of steps is unknown.

        Held-out blocks are counted themselves; steps inside them are not.
        """
        if self.stage is GapStage.BLOCKS:
            return
        self.steps += 1
        self.begin(self.stage, self.steps / (self.steps + _MANY))

    def reserve(self, effects: int, fit_s: float) -> None:
        """Reserve time after the search: a model of that many effects took `fit_s` for one fit."""
        self.fits_s = effects * fit_s

    @property
    def now(self) -> float:
        """Seconds since the diagnosis began; 0 without a clock."""
        return 0.0 if self.elapsed is None else self.elapsed()

    def duration_of(self, stage: GapStage) -> float:
        """Seconds from the beginning of a stage to that of the next one."""
        later = [at for other, at in self.began.items() if at > self.began[stage] and other is not stage]
        return min(later, default=self.now) - self.began[stage]

    def _left(self, share: float) -> float | None:
        """Seconds left after a `share` of the work, at most those up to the limit."""
        done = share - (_BEGINS[next(iter(self.began))] if self.began else 0.0)  # airframes are not always asked for
        if self.elapsed is None or done <= 0.0:
            return None
        took = self.now
        return max(min(took * (1.0 - share) / done, self.limit_s - took), 0.0)

    def ends(self, needs_s: float = 0.0) -> bool:
        """Whether work of `needs_s` must be left out of this stage; if so, this is recorded.

        It is called before every piece of work, so progress is also reported during long steps.
        """
        if self.now - self.reported_s > _TOLD_EVERY_S:
            self._notify()
        if self.elapsed is None or self.now + needs_s <= self._may_take:
            return False
        self.left_out[self.stage] = None
        return True

    @property
    def _may_take(self) -> float:
        """Seconds after which no more work begins in this stage."""
        share = _MAY_TAKE[self.stage] * self.limit_s
        if self.stage not in _FITS_AFTERWARDS:
            return share
        return min(share, _REPORTED_FROM * self.limit_s - _FITS_AFTERWARDS[self.stage] * self.fits_s)

    @property
    def ended(self) -> bool:
        """Whether work of this stage was left out."""
        return self.stage in self.left_out


def with_limit(report: GapReport, pace: GapPace) -> GapReport:
    """The report with the stages that the limit left out, and no verdict based on work that was not done."""
    if not pace.left_out:
        return report
    missing = "; ".join(_LEFT_OUT[stage] for stage in pace.left_out)
    text = f"the limit of {pace.limit_s:g} s ended the diagnosis: {missing}; allow more time for the whole answer"
    verdict = report.verdict
    if GapStage.SELECTION in pace.left_out:
        verdict = _NOT_SEARCHED.get(verdict, verdict)
    elif GapStage.RIVALS in pace.left_out:
        verdict = _NOT_COMPARED.get(verdict, verdict)
    elif GapStage.REFERENCE in pace.left_out:
        verdict = _NOT_COMPARED.get(verdict, verdict) if verdict is GapVerdict.EXPLAINED else verdict
    left_out = tuple(stage.value for stage in pace.left_out)
    return replace(report, verdict=verdict, warnings=(text, *report.warnings), left_out=left_out)


def unsearched(report: GapReport, pace: GapPace) -> GapReport:
    """The joint report; its verdict is no gap only if everything was searched for and compared."""
    cut = {GapStage.AIRFRAME, GapStage.SELECTION, GapStage.RIVALS} & pace.left_out.keys()
    nothing = report.verdict is GapVerdict.NO_GAP
    return replace(report, verdict=GapVerdict.NOT_TESTABLE) if cut and nothing else report


_NOT_COMPARED = {GapVerdict.EXPLAINED: GapVerdict.PARTLY_EXPLAINED, GapVerdict.NO_GAP: GapVerdict.NOT_TESTABLE}
_NOT_SEARCHED = {**_NOT_COMPARED, GapVerdict.UNKNOWN: GapVerdict.NOT_TESTABLE}
"""Verdicts that replace those that claim a complete search."""
