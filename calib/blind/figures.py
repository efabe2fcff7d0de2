"""Figures of a campaign: a share or a statistic with its interval, held against a target; and failures by type."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.blind.answers import CaseAnswer
from mavcal.calib.blind.intervals import resampled, wilson

Array = NDArray[np.float64]
Answer = TypeVar("Answer", bound=CaseAnswer)

HELD = 0.02
"""Two standard deviations of the share of intervals that hold, up to which it says that they do: 475 of them."""


class FigureVerdict(StrEnum):
    """What a figure's 95 % interval says of its target: all of it meets it, none of it does, or a part."""

    REACHED = "reached"
    MISSED = "missed"
    UNDECIDED = "undecided"


@dataclass(frozen=True)
class Figure:
    """One line of the table. `verdict` is None where no target is set or no case was run."""

    name: str
    value: float | None
    n: int
    low: float | None = None
    high: float | None = None
    target: str = ""
    verdict: FigureVerdict | None = None


def share(name: str, hits: Iterable[bool], target: str = "") -> Figure:
    """A proportion with Wilson's interval; the target is `>= x` or `<= x`."""
    each = list(hits)
    if not each:
        return Figure(name, None, 0, target=target)
    low, high = wilson(sum(each), len(each))
    value = sum(each) / len(each)
    return Figure(name, value, len(each), low, high, target, judged(low, high, target))


def judged(low: float, high: float, target: str) -> FigureVerdict | None:
    """A target is reached where the worse end of the interval meets it, and missed where the better end does not."""
    if not target:
        return None
    relation, _, text = target.partition(" ")
    bound = float(text)
    worse, better = (low - bound, high - bound) if relation == ">=" else (bound - high, bound - low)
    if worse >= 0.0:
        return FigureVerdict.REACHED
    return FigureVerdict.UNDECIDED if better >= 0.0 else FigureVerdict.MISSED


def of_rows(name: str, statistic: Callable[[Array], float | None], each: Sequence[Any], target: str = "") -> Figure:
    """A figure of rows of numbers that is no proportion, with the interval of rows drawn again."""
    rows = np.asarray(each, dtype=np.float64)
    value = statistic(rows) if len(rows) else None
    if value is None:
        return Figure(name, None, len(rows), target=target)
    low, high = resampled(statistic, rows)
    return Figure(name, value, len(rows), low, high, target, judged(low, high, target))


def held(hits: Sequence[bool]) -> Figure:
    """The share of 95 % intervals that hold the truth; it is right within two binomial deviations of 0.95."""
    if not hits:
        return Figure("95 % intervals hold", None, 0, target="0.95 within 2 binomial sd")
    value = sum(hits) / len(hits)
    slack = 2.0 * (0.95 * 0.05 / len(hits)) ** 0.5
    low, high = wilson(sum(hits), len(hits))
    verdict = FigureVerdict.REACHED if abs(value - 0.95) <= slack else FigureVerdict.MISSED
    if verdict is FigureVerdict.REACHED and slack > HELD:
        verdict = FigureVerdict.UNDECIDED  # so few would look right whatever the intervals are
    return Figure("95 % intervals hold", value, len(hits), low, high, f"0.95 +- {slack:.3f}", verdict)


def ratio(rows: Array, above: Sequence[int], below: Sequence[int]) -> float | None:
    """Of sums over rows of (right, surplus, missed) names with these weights; None without any name."""
    sums = rows.sum(axis=0)
    total = float(sums @ np.asarray(below))
    return float(sums @ np.asarray(above)) / total if total else None


def mean(values: Array) -> float:
    """A statistic for :func:`of_rows`."""
    return float(values.mean())


def quantile(q: float) -> Callable[[Array], float]:
    """A statistic for :func:`of_rows`."""
    return lambda values: float(np.quantile(values, q))


def times(answers: Sequence[CaseAnswer]) -> list[Figure]:
    """How long a diagnosis took."""
    seconds = [a.seconds for a in answers if a.failed is None]
    if not seconds:
        return []
    return [
        of_rows("seconds a case: median", quantile(0.5), seconds),
        of_rows("seconds a case: p95", quantile(0.95), seconds, "<= 15"),
    ]


def errors(answers: Sequence[CaseAnswer]) -> list[Figure]:
    """A promise of every case, not of a share: one error is a miss, and no number of cases without one is a doubt."""
    name, failed = "failed with an error", [a.failed is not None for a in answers]
    if not failed:
        return [Figure(name, None, 0, target="none")]
    low, high = wilson(sum(failed), len(failed))
    verdict = FigureVerdict.MISSED if any(failed) else FigureVerdict.REACHED
    return [Figure(name, sum(failed) / len(failed), len(failed), low, high, "none", verdict)]


def failures(
    answers: Sequence[Answer],
    kind: Callable[[Answer], str],
    right: Callable[[Answer], bool],
    size: Callable[[Answer], float] = lambda answer: round(answer.severity),
) -> list[dict[str, Any]]:
    """A row for each type with a failure: how many, what was said instead, and the seeds and sizes that repeat it."""
    groups: dict[str, list[Answer]] = defaultdict(list)
    for answer in answers:
        groups[kind(answer)].append(answer)
    rows = []
    for name, members in groups.items():
        wrong = [a for a in members if not right(a)]
        if wrong:
            said = Counter(_said(a) for a in wrong)
            seeds = [(a.label["seed"], size(a)) for a in wrong][:8]
            rows.append(
                {"type": name, "n": len(members), "wrong": len(wrong), "said": said.most_common(5), "seeds": seeds}
            )
    return sorted(rows, key=lambda r: (-r["wrong"] / r["n"], r["type"]))


def _said(answer: CaseAnswer) -> str:
    if answer.failed:
        return f"error: {answer.failed[:80]}"
    parts = [*answer.named[:4], *(["unknown"] if answer.unknown else [])]
    return " + ".join(parts) or answer.verdict
