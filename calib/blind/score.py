"""The scores of a campaign: every figure that the method promises, with its interval, and failures by type."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.blind.answers import CaseAnswer, covered, honest_without
from mavcal.calib.blind.cases import LADDER, Tier
from mavcal.calib.blind.figures import (
    Figure,
    errors,
    failures,
    held,
    mean,
    of_rows,
    quantile,
    ratio,
    share,
    times,
)
from mavcal.calib.blind.intervals import brier_skill, calibration_error, detection_limit
from mavcal.calib.blind.nuisance import EXPECTED

Array = NDArray[np.float64]

BINS = ((20.0, 50.0), (50.0, 100.0), (100.0, 300.0), (300.0, 1000.0), (1000.0, 2000.0))
STRONG = 100.0
"""Where top-1 is asked for; also where a gap of lambda/2 nats exceeds five of its standard errors sqrt(lambda)."""
SHORT_OF_LIMIT = 0.03
"""By which a diagnosis may find less often than the test that knows what it looks for."""
NOTEWORTHY = 0.05
"""Share of a ladder's step below which it has no target: one that is never missed says nothing."""
RANDOM = ("random_walk", "flicker", "noise")


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
        share("false unknown on known effects", [a.unknown for a in (*singles, *mixed)], "<= 0.02"),
        *_intervals((*singles, *mixed, *by_tier[Tier.LADDER])),
        *_probabilities((*singles, *mixed, *by_tier[Tier.UNKNOWN], *by_tier[Tier.KNOWN_AND_UNKNOWN])),
        *_closed((*singles, *mixed)),
        *_ladder(by_tier[Tier.LADDER]),
        *_nuisances(by_tier[Tier.NUISANCE]),
        *times(answers),
        *errors(answers),
    ]
    return {
        "figures": [asdict(f) for f in figures],
        "by_severity": _by_severity(singles, by_tier[Tier.UNKNOWN]),
        "failures": {
            "single": failures(singles, lambda a: sorted(a.true)[0], _single_right),
            "mixed": failures(mixed, lambda a: " + ".join(sorted(a.true)), _exact),
            "unknown": failures(by_tier[Tier.UNKNOWN], _unknown_name, lambda a: a.unknown),
            "left_out": failures(by_tier[Tier.LEFT_OUT], lambda a: sorted(a.true)[0], _rejected),
            "null": failures(by_tier[Tier.NULL], lambda a: str(a.label["mission"]), lambda a: not a.detected),
            "nuisance": failures(by_tier[Tier.NUISANCE], lambda a: str(a.label["nuisance"]), _undisturbed),
        },
        "errors": Counter(a.failed for a in answers if a.failed).most_common(20),
    }


def _nulls(plain: Sequence[CaseAnswer], tilted: Sequence[CaseAnswer]) -> list[Figure]:
    def false_alarm(answer: CaseAnswer) -> bool:
        return bool(set(answer.named) - {"reference_attitude"}) or answer.unknown

    return [
        share("null: something reported", [a.detected for a in plain], "<= 0.01"),
        share("null with 0.3 deg of reference error: a sensor or unknown blamed", map(false_alarm, tilted), "<= 0.01"),
        share("the same: the reference named", ["reference_attitude" in a.named for a in tilted]),
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
        share("single: detected", [a.detected for a in answers]),
        share("single: top-1, lambda >= 100", map(_single_right, strong), ">= 0.97"),
        share("single: top-1, detected", map(_single_right, detected)),
        share("single: exact set, lambda >= 100", map(_exact, strong)),
        share("single: truth in the reported set, detected", [bool(a.true & a.reach) for a in detected], ">= 0.99"),
        of_rows("single: mean size of the set", mean, sizes, "<= 2.5"),
        share("single: where names the sensor", [w for a in detected if (w := _where(a)) is not None]),
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
        of_rows("mixed: strict F1", lambda rows: ratio(rows, (2, 0, 0), (2, 1, 1)), counts, ">= 0.93"),
        of_rows("mixed: precision", lambda rows: ratio(rows, (1, 0, 0), (1, 1, 0)), counts),
        of_rows("mixed: recall", lambda rows: ratio(rows, (1, 0, 0), (1, 0, 1)), counts),
        share("mixed: exact set", map(_exact, answers)),
    ]


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
        share("unknown types rejected, all severities", [a.unknown for a in unknown], ">= 0.90"),
        share("unknown types rejected, lambda >= 100", [a.unknown for a in strong]),
        share("unknown types rejected, lambda beyond an affine error >= 100", [a.unknown for a in net]),
        share("… of which foreseen", [a.unknown for a in net if a.label["unknown"][0]["foreseen"]]),
        share("… of which unforeseen", [a.unknown for a in net if not a.label["unknown"][0]["foreseen"]]),
        share("one effect left out: detected", [a.detected for a in one]),
        share("one effect left out: rejected or synonym, detected", [_rejected(a) for a in one if a.detected]),
        share("a family left out: detected", [a.detected for a in family]),
        share(
            "a family left out: rejected or synonym, detected", [_rejected(a) for a in family if a.detected], ">= 0.75"
        ),
        share("left out: rejected strictly, detected", [a.unknown for a in left if a.detected]),
        share("known and unknown together: flagged", [a.unknown for a in both], ">= 0.85"),
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
    return [held(hits)]


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
        of_rows("probabilities: ECE", lambda rows: calibration_error(*rows.T), pairs, "<= 0.05"),
        of_rows("probabilities: Brier skill", lambda rows: brier_skill(*rows.T), pairs, ">= 0"),
        of_rows("probabilities: mean", mean, p),
        share("probabilities: share that is right", hit),
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
        of_rows("held-out gap closed: median", quantile(0.5), steady, ">= 0.99"),
        of_rows("held-out gap closed: p10", quantile(0.1), steady, ">= 0.98"),
        of_rows("… of a fit that knows the effect (1 - p/lambda): median", quantile(0.5), limits),
        of_rows("… of a fit that knows the effect (1 - p/lambda): p10", quantile(0.1), limits),
        of_rows("held-out gap closed, noise, flicker and random walk: median", quantile(0.5), random),
    ]


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
        figures.append(share(f"detected at lambda {step:g} (limit {limit:.2f})", [a.detected for a in rows], target))
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
        figures.append(share(f"nuisance {name}: nothing else blamed", map(_undisturbed, rows)))
        with_effect = [a for a in rows if a.label["effects"] and a.severity >= STRONG]
        if with_effect:
            figures.append(share(f"nuisance {name}: truth in the set", [bool(a.true & a.reach) for a in with_effect]))
    return figures


def _by_severity(singles: Sequence[CaseAnswer], unknown: Sequence[CaseAnswer]) -> list[dict[str, Any]]:
    rows = []
    for low, high in BINS:
        mine = [a for a in singles if low <= a.severity < high * 1.001]
        strange = [a for a in unknown if low <= a.severity < high * 1.001]
        rows.append(
            {
                "lambda": [low, high],
                "detected": asdict(share("detected", [a.detected for a in mine])),
                "top1": asdict(share("top-1", map(_single_right, mine))),
                "in_set": asdict(share("in set", [bool(a.true & a.reach) for a in mine])),
                "unknown_rejected": asdict(share("unknown rejected", [a.unknown for a in strange])),
            }
        )
    return rows


def _unknown_name(answer: CaseAnswer) -> str:
    entry = answer.label["unknown"][0]
    return f"{entry['sensor']} {entry['id'].removeprefix('unknown_')}"
