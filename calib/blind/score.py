"""The scores of a campaign: every figure that the method promises, with its interval, and failures by type."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.blind.answers import CaseAnswer, covered, honest_without
from mavcal.calib.blind.cases import LADDER, Tier
from mavcal.calib.blind.intervals import brier_skill, calibration_error, detection_limit, resampled, wilson
from mavcal.calib.blind.nuisance import EXPECTED

Array = NDArray[np.float64]

BINS = ((20.0, 50.0), (50.0, 100.0), (100.0, 300.0), (300.0, 1000.0), (1000.0, 2000.0))
STRONG = 100.0
"""Where top-1 is asked for; also where a gap of lambda/2 nats exceeds five of its standard errors sqrt(lambda)."""
HELD = 0.02
"""Two standard deviations of the share of intervals that hold, up to which it says that they do: 475 of them."""
SHORT_OF_LIMIT = 0.03
"""By which a diagnosis may find less often than the test that knows what it looks for."""
NOTEWORTHY = 0.05
"""Share of a ladder's step below which it has no target: one that is never missed says nothing."""
RANDOM = ("random_walk", "flicker", "noise")


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


def score(answers: Sequence[CaseAnswer]) -> dict[str, Any]:
    """All figures, tables by severity, and failures by type, ready for JSON."""
    by_tier: dict[Tier, list[CaseAnswer]] = defaultdict(list)
    for answer in answers:
        by_tier[Tier(answer.label["tier"])].append(answer)
    singles, mixed = by_tier[Tier.SINGLE], by_tier[Tier.MIXED]
    figures = [
        *_nulls(by_tier[Tier.NULL], by_tier[Tier.NULL_TILTED]),
        *_singles(singles),
        *_mixtures(mixed),
        *_unknowns(by_tier[Tier.UNKNOWN], by_tier[Tier.LEFT_OUT], by_tier[Tier.KNOWN_AND_UNKNOWN]),
        _share("false unknown on known effects", [a.unknown for a in (*singles, *mixed)], "<= 0.02"),
        *_intervals((*singles, *mixed, *by_tier[Tier.LADDER])),
        *_probabilities((*singles, *mixed, *by_tier[Tier.UNKNOWN], *by_tier[Tier.KNOWN_AND_UNKNOWN])),
        *_closed((*singles, *mixed)),
        *_ladder(by_tier[Tier.LADDER]),
        *_nuisances(by_tier[Tier.NUISANCE]),
        *_times(answers),
        *_errors(answers),
    ]
    return {
        "figures": [asdict(f) for f in figures],
        "by_severity": _by_severity(singles, by_tier[Tier.UNKNOWN]),
        "failures": {
            "single": _failures(singles, lambda a: sorted(a.true)[0], _single_right),
            "mixed": _failures(mixed, lambda a: " + ".join(sorted(a.true)), _exact),
            "unknown": _failures(by_tier[Tier.UNKNOWN], _unknown_name, lambda a: a.unknown),
            "left_out": _failures(by_tier[Tier.LEFT_OUT], lambda a: sorted(a.true)[0], _rejected),
            "null": _failures(by_tier[Tier.NULL], lambda a: str(a.label["mission"]), lambda a: not a.detected),
            "nuisance": _failures(by_tier[Tier.NUISANCE], lambda a: str(a.label["nuisance"]), _undisturbed),
        },
        "errors": Counter(a.failed for a in answers if a.failed).most_common(20),
    }


def _share(name: str, hits: Iterable[bool], target: str = "") -> Figure:
    """A proportion with Wilson's interval; the target is `>= x` or `<= x`."""
    each = list(hits)
    if not each:
        return Figure(name, None, 0, target=target)
    low, high = wilson(sum(each), len(each))
    value = sum(each) / len(each)
    return Figure(name, value, len(each), low, high, target, _judged(low, high, target))


def _judged(low: float, high: float, target: str) -> FigureVerdict | None:
    """A target is reached where the worse end of the interval meets it, and missed where the better end does not."""
    if not target:
        return None
    relation, _, text = target.partition(" ")
    bound = float(text)
    worse, better = (low - bound, high - bound) if relation == ">=" else (bound - high, bound - low)
    if worse >= 0.0:
        return FigureVerdict.REACHED
    return FigureVerdict.UNDECIDED if better >= 0.0 else FigureVerdict.MISSED


def _of_rows(name: str, statistic: Callable[[Array], float | None], each: Sequence[Any], target: str = "") -> Figure:
    """A figure of rows of numbers that is no proportion, with the interval of rows drawn again."""
    rows = np.asarray(each, dtype=np.float64)
    value = statistic(rows) if len(rows) else None
    if value is None:
        return Figure(name, None, len(rows), target=target)
    low, high = resampled(statistic, rows)
    return Figure(name, value, len(rows), low, high, target, _judged(low, high, target))


def _nulls(plain: Sequence[CaseAnswer], tilted: Sequence[CaseAnswer]) -> list[Figure]:
    def false_alarm(answer: CaseAnswer) -> bool:
        return bool(set(answer.named) - {"reference_attitude"}) or answer.unknown

    return [
        _share("null: something reported", [a.detected for a in plain], "<= 0.01"),
        _share("null with 0.3 deg of reference error: a sensor or unknown blamed", map(false_alarm, tilted), "<= 0.01"),
        _share("the same: the reference named", ["reference_attitude" in a.named for a in tilted]),
    ]


def _single_right(answer: CaseAnswer) -> bool:
    return bool(answer.named) and answer.named[0] in answer.true


def _exact(answer: CaseAnswer) -> bool:
    return answer.true <= set(answer.named) and not answer.surplus


def _singles(answers: Sequence[CaseAnswer]) -> list[Figure]:
    strong = [a for a in answers if a.severity >= STRONG]
    detected = [a for a in answers if a.detected]
    sizes = [len(a.reach) for a in answers if a.named]
    return [
        _share("single: detected", [a.detected for a in answers]),
        _share("single: top-1, lambda >= 100", map(_single_right, strong), ">= 0.97"),
        _share("single: top-1, detected", map(_single_right, detected)),
        _share("single: exact set, lambda >= 100", map(_exact, strong)),
        _share("single: truth in the reported set, detected", [bool(a.true & a.reach) for a in detected], ">= 0.99"),
        _of_rows("single: mean size of the set", _mean, sizes, "<= 2.5"),
        _share("single: where names the sensor", [w for a in detected if (w := _where(a)) is not None]),
    ]


def _where(answer: CaseAnswer) -> bool | None:
    """Whether the strongest place is of a true sensor; None: no place was told, or it is of all sensors."""
    places = answer.report.get("where") or []
    sensors = {e["sensor"] for e in answer.label["effects"]}
    if not places or "all" in sensors:
        return None
    best = max(places, key=lambda p: float(p.get("nats_per_sample") or 0.0))
    return str(best.get("channel", "")).split(".")[0] in sensors


def _mixtures(answers: Sequence[CaseAnswer]) -> list[Figure]:
    counts = [(len(a.true & set(a.named)), len(a.surplus), len(a.true - set(a.named))) for a in answers]
    return [
        _of_rows("mixed: strict F1", lambda rows: _ratio(rows, (2, 0, 0), (2, 1, 1)), counts, ">= 0.93"),
        _of_rows("mixed: precision", lambda rows: _ratio(rows, (1, 0, 0), (1, 1, 0)), counts),
        _of_rows("mixed: recall", lambda rows: _ratio(rows, (1, 0, 0), (1, 0, 1)), counts),
        _share("mixed: exact set", map(_exact, answers)),
    ]


def _ratio(rows: Array, above: Sequence[int], below: Sequence[int]) -> float | None:
    """Of sums over rows of (right, surplus, missed) names with these weights; None without any name."""
    sums = rows.sum(axis=0)
    total = float(sums @ np.asarray(below))
    return float(sums @ np.asarray(above)) / total if total else None


def _mean(values: Array) -> float:
    return float(values.mean())


def _rejected(answer: CaseAnswer) -> bool:
    """A left-out effect: called unknown, or by nothing but honest synonyms."""
    true = next(iter(answer.true))
    named = [n for n in answer.named if n != "reference_attitude" or true == "reference_attitude"]
    return answer.unknown or (bool(answer.named) and all(honest_without(true, n) for n in named))


def _unknowns(unknown: Sequence[CaseAnswer], left: Sequence[CaseAnswer], both: Sequence[CaseAnswer]) -> list[Figure]:
    strong = [a for a in unknown if a.severity >= STRONG]
    net = [a for a in unknown if a.label["unknown"][0]["net_lambda"] >= STRONG]
    one = [a for a in left if len(a.label["without"]) == 1]
    family = [a for a in left if len(a.label["without"]) > 1]
    return [
        _share("unknown types rejected, all severities", [a.unknown for a in unknown], ">= 0.90"),
        _share("unknown types rejected, lambda >= 100", [a.unknown for a in strong]),
        _share("unknown types rejected, lambda beyond an affine error >= 100", [a.unknown for a in net]),
        _share("… of which foreseen", [a.unknown for a in net if a.label["unknown"][0]["foreseen"]]),
        _share("… of which unforeseen", [a.unknown for a in net if not a.label["unknown"][0]["foreseen"]]),
        _share("one effect left out: detected", [a.detected for a in one]),
        _share("one effect left out: rejected or synonym, detected", [_rejected(a) for a in one if a.detected]),
        _share("a family left out: detected", [a.detected for a in family]),
        _share(
            "a family left out: rejected or synonym, detected", [_rejected(a) for a in family if a.detected], ">= 0.75"
        ),
        _share("left out: rejected strictly, detected", [a.unknown for a in left if a.detected]),
        _share("known and unknown together: flagged", [a.unknown for a in both], ">= 0.85"),
    ]


def _intervals(answers: Iterable[CaseAnswer]) -> list[Figure]:
    hits = [
        hit
        for a in answers
        for true in a.label["effects"]
        for said in a.effects
        if said["id"] == true["id"]
        for hit in covered(true, said)
    ]
    if not hits:
        return [Figure("95 % intervals hold", None, 0, target="0.95 within 2 binomial sd")]
    value = sum(hits) / len(hits)
    slack = 2.0 * (0.95 * 0.05 / len(hits)) ** 0.5
    low, high = wilson(sum(hits), len(hits))
    verdict = FigureVerdict.REACHED if abs(value - 0.95) <= slack else FigureVerdict.MISSED
    if verdict is FigureVerdict.REACHED and slack > HELD:
        verdict = FigureVerdict.UNDECIDED  # so few would look right whatever the intervals are
    return [Figure("95 % intervals hold", value, len(hits), low, high, f"0.95 +- {slack:.3f}", verdict)]


def _probabilities(answers: Iterable[CaseAnswer]) -> list[Figure]:
    """Of each reported effect that it is there; pooled over single, mixed and unknown cases."""
    p, hit = [], []
    for answer in answers:
        for effect in answer.effects:
            probability = (effect.get("evidence") or {}).get("probability")
            if probability is not None:
                p.append(float(probability))
                hit.append(str(effect["id"]) in answer.true)
    if not p:
        return [Figure("probabilities: ECE", None, 0, target="<= 0.05")]
    pairs = list(zip(p, hit, strict=True))
    return [
        _of_rows("probabilities: ECE", lambda rows: calibration_error(*rows.T), pairs, "<= 0.05"),
        _of_rows("probabilities: Brier skill", lambda rows: brier_skill(*rows.T), pairs, ">= 0"),
        _of_rows("probabilities: mean", _mean, p),
        _share("probabilities: share that is right", hit),
    ]


def _closed(answers: Iterable[CaseAnswer]) -> list[Figure]:
    found: dict[bool, list[float]] = {True: [], False: []}
    limits: list[float] = []
    for answer in answers:
        closed = (answer.report.get("shrink") or {}).get("closed")
        if closed is not None and answer.severity >= STRONG:
            noisy = any(str(e["id"]).endswith(RANDOM) for e in answer.label["effects"])
            found[noisy].append(float(closed))
            if not noisy:
                # Each fitted parameter costs half a nat on new data; the gap is lambda/2 nats.
                limits.append(1.0 - sum(e["df"] for e in answer.label["effects"]) / answer.severity)

    steady, random = found[False], found[True]
    return [
        _of_rows("held-out gap closed: median", _quantile(0.5), steady, ">= 0.99"),
        _of_rows("held-out gap closed: p10", _quantile(0.1), steady, ">= 0.98"),
        _of_rows("… of a fit that knows the effect (1 - p/lambda): median", _quantile(0.5), limits),
        _of_rows("… of a fit that knows the effect (1 - p/lambda): p10", _quantile(0.1), limits),
        _of_rows("held-out gap closed, noise, flicker and random walk: median", _quantile(0.5), random),
    ]


def _quantile(q: float) -> Callable[[Array], float]:
    return lambda values: float(np.quantile(values, q))


def _ladder(answers: Sequence[CaseAnswer]) -> list[Figure]:
    """Detection at each severity against the test that knows what it looks for, at the same corrected level."""
    figures = []
    for step in LADDER:
        rows = [a for a in answers if abs(a.severity / step - 1.0) < 0.1]
        if not rows:
            continue
        limits = []
        for a in rows:
            testing = a.report.get("multiple_testing") or {}
            alpha = float(testing.get("alpha_family") or 0.005) / float(testing.get("m") or 60)
            limits.append(detection_limit(step, int(a.label["effects"][0]["df"]), alpha))
        limit = float(np.mean(limits))
        target = f">= {limit - SHORT_OF_LIMIT:.3f}" if limit - SHORT_OF_LIMIT >= NOTEWORTHY else ""
        figures.append(_share(f"detected at lambda {step:g} (limit {limit:.2f})", [a.detected for a in rows], target))
    return figures


def _undisturbed(answer: CaseAnswer) -> bool:
    """Nothing was blamed but what was put in and what the nuisance honestly is."""
    allowed = EXPECTED.get(str(answer.label["nuisance"]), set())
    return not (answer.surplus - allowed)


def _nuisances(answers: Sequence[CaseAnswer]) -> list[Figure]:
    names = sorted({str(a.label["nuisance"]) for a in answers})
    figures = []
    for name in names:
        rows = [a for a in answers if a.label["nuisance"] == name]
        figures.append(_share(f"nuisance {name}: nothing else blamed", map(_undisturbed, rows)))
        with_effect = [a for a in rows if a.label["effects"] and a.severity >= STRONG]
        if with_effect:
            figures.append(_share(f"nuisance {name}: truth in the set", [bool(a.true & a.reach) for a in with_effect]))
    return figures


def _times(answers: Sequence[CaseAnswer]) -> list[Figure]:
    seconds = [a.seconds for a in answers if a.failed is None]
    if not seconds:
        return []
    return [
        _of_rows("seconds a case: median", _quantile(0.5), seconds),
        _of_rows("seconds a case: p95", _quantile(0.95), seconds, "<= 15"),
    ]


def _errors(answers: Sequence[CaseAnswer]) -> list[Figure]:
    """A promise of every case, not of a share: one error is a miss, and no number of cases without one is a doubt."""
    name, failed = "failed with an error", [a.failed is not None for a in answers]
    if not failed:
        return [Figure(name, None, 0, target="none")]
    low, high = wilson(sum(failed), len(failed))
    verdict = FigureVerdict.MISSED if any(failed) else FigureVerdict.REACHED
    return [Figure(name, sum(failed) / len(failed), len(failed), low, high, "none", verdict)]


def _by_severity(singles: Sequence[CaseAnswer], unknown: Sequence[CaseAnswer]) -> list[dict[str, Any]]:
    rows = []
    for low, high in BINS:
        mine = [a for a in singles if low <= a.severity < high * 1.001]
        strange = [a for a in unknown if low <= a.severity < high * 1.001]
        rows.append(
            {
                "lambda": [low, high],
                "detected": asdict(_share("detected", [a.detected for a in mine])),
                "top1": asdict(_share("top-1", map(_single_right, mine))),
                "in_set": asdict(_share("in set", [bool(a.true & a.reach) for a in mine])),
                "unknown_rejected": asdict(_share("unknown rejected", [a.unknown for a in strange])),
            }
        )
    return rows


def _unknown_name(answer: CaseAnswer) -> str:
    entry = answer.label["unknown"][0]
    return f"{entry['sensor']} {entry['id'].removeprefix('unknown_')}"


def _failures(
    answers: Sequence[CaseAnswer], kind: Callable[[CaseAnswer], str], right: Callable[[CaseAnswer], bool]
) -> list[dict[str, Any]]:
    """A row for each type with a failure: how many, what was said instead, and the seeds that repeat it."""
    groups: dict[str, list[CaseAnswer]] = defaultdict(list)
    for answer in answers:
        groups[kind(answer)].append(answer)
    rows = []
    for name, members in groups.items():
        wrong = [a for a in members if not right(a)]
        if wrong:
            said = Counter(_said(a) for a in wrong)
            seeds = [(a.label["seed"], round(a.severity)) for a in wrong][:8]
            rows.append(
                {"type": name, "n": len(members), "wrong": len(wrong), "said": said.most_common(5), "seeds": seeds}
            )
    return sorted(rows, key=lambda r: (-r["wrong"] / r["n"], r["type"]))


def _said(answer: CaseAnswer) -> str:
    if answer.failed:
        return f"error: {answer.failed[:80]}"
    parts = [*answer.named[:4], *(["unknown"] if answer.unknown else [])]
    return " + ".join(parts) or answer.verdict
