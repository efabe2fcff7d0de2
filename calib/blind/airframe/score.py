"""The scores of an airframe's campaign: every figure that the method promises, with its interval."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.blind.airframe.answers import AirAnswer, honest, told_of
from mavcal.calib.blind.airframe.cases import AirTier
from mavcal.calib.blind.answers import CaseAnswer
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
from mavcal.calib.blind.intervals import brier_skill, calibration_error

Array = NDArray[np.float64]

BINS = 5
"""Of probabilities."""
LEAST_P = 0.01
"""Probabilities below are left out: hundreds of effects that nobody asked for would hide the others."""
WEAK = 0.03
"""Loss of thrust from which a weak motor should be named by its number. Source: AIRFRAME 6."""
FORCES = frozenset({"thrust_scale", "thrust_expo", "rotor_drag", "body_drag", "payload_step", "battery_sag"})
"""Effects that move the vehicle's centre of mass: without them there is no error of velocity to close."""
SIZES: tuple[tuple[str, str, tuple[str, ...], bool, str], ...] = (
    ("thrust ratio", "thrust_scale", ("s",), True, "<= 0.005"),
    ("expo", "thrust_expo", ("expo",), False, "<= 0.03"),
    ("rotor drag ratio", "rotor_drag", ("c1",), True, "<= 0.04"),
    ("body drag ratio", "body_drag", ("c2",), True, "<= 0.15"),
    ("inertia ratio", "inertia", ("x", "y", "z"), True, "<= 0.03"),
    ("motor lag, s", "motor_lag", ("tau_up", "tau_down"), False, "<= 0.003"),
    ("delay, s", "actuator_delay", ("delay",), False, "<= 0.003"),
    ("weak motor", "motor_weak", ("s",), False, "<= 0.01"),
)
"""Figure, effect, parameters, whether the error is relative to the true ratio, and the target of AIRFRAME 6."""


def air_score(answers: Sequence[CaseAnswer]) -> dict[str, Any]:
    """All figures, tables by effect and by probability, and failures by type, ready for JSON."""
    all_of_them = [AirAnswer.of(answer) for answer in answers]
    by_tier: dict[AirTier, list[AirAnswer]] = defaultdict(list)
    for answer in all_of_them:
        by_tier[AirTier(answer.label["tier"])].append(answer)
    nulls, singles, mixed = by_tier[AirTier.NULL], by_tier[AirTier.SINGLE], by_tier[AirTier.MIXED]
    sih = by_tier[AirTier.SIH]
    foreign, unknown, left = by_tier[AirTier.FOREIGN], by_tier[AirTier.UNKNOWN], by_tier[AirTier.LEFT_OUT]
    known = [*singles, *sih, *mixed]
    pairs = _probabilities([*nulls, *known, *foreign, *unknown])
    figures = [
        share("null: a false name, or unknown", [bool(a.false_names) or a.unknown for a in nulls], "<= 0.01"),
        share("null: a false name of the day's air", [bool(a.surplus - a.false_names) for a in nulls]),
        *_singles("single", singles, (">= 0.95", ">= 0.99", "<= 2")),
        *_singles("sih", sih, (">= 0.95", ">= 0.99", "<= 2")),
        *_singles("foreign", foreign, ("", "", "")),
        *_weak_motors([*known, *foreign]),
        *_sizes(known),
        *_mixtures(mixed),
        share("a sensor named for an airframe or the reverse", [a.misplaced for a in known], "<= 0.02"),
        share("false unknown on known effects", [a.unknown for a in known], "<= 0.02"),
        *_unknowns(unknown, left),
        held([hit for a in [*known, *foreign] for told in told_of(a) if (hit := told.held) is not None]),
        *_reliability(pairs),
        *_closed(known),
        *_abstention(singles, by_tier[AirTier.LOGGING]),
        *times(all_of_them),
        *errors(all_of_them),
    ]
    return {
        "figures": [asdict(figure) for figure in figures],
        "by_effect": _by_effect([*singles, *sih, *foreign]),
        "by_probability": _by_probability(pairs),
        "failures": {
            "null": _failed(nulls, lambda a: str(a.label["frame"]), lambda a: not (a.surplus or a.unknown)),
            "single": _failed(singles, _what, _right),
            "sih": _failed(sih, _what, _right),
            "mixed": _failed(mixed, _what, _exact),
            "foreign": _failed(foreign, _what, _right),
            "unknown": _failed(unknown, _what, lambda a: a.unknown),
            "left_out": _failed(left, _what, _rejected),
            "logging": _failed(by_tier[AirTier.LOGGING], lambda a: f"{a.label['thinning']} {_what(a)}", _silent),
        },
        "errors": Counter(a.failed for a in answers if a.failed).most_common(20),
    }


def _failed(
    answers: Sequence[AirAnswer], kind: Callable[[AirAnswer], str], right: Callable[[AirAnswer], bool]
) -> list[dict[str, Any]]:
    """Failures by type; beside each seed stands the size of what was put in."""
    return failures(answers, kind, right, _size)


def _size(answer: CaseAnswer) -> float:
    return max((round(abs(e["size"]), 3) for e in (*answer.label["effects"], *answer.label["unknown"])), default=0.0)


def _what(answer: CaseAnswer) -> str:
    return " + ".join(sorted(e["id"] for e in (*answer.label["effects"], *answer.label["unknown"])))


def _right(answer: AirAnswer) -> bool:
    return answer.first in answer.true


def _exact(answer: AirAnswer) -> bool:
    return answer.true <= set(answer.named) and not answer.surplus


def _silent(answer: AirAnswer) -> bool:
    """Nothing was said but that it cannot be told."""
    return answer.excused and not answer.told


def _rejected(answer: AirAnswer) -> bool:
    """A left-out effect: called unknown, or by nothing but honest names."""
    true = next(iter(answer.true))
    names = {str(e["id"]) for e in answer.told}
    return answer.unknown or (bool(names) and all(honest(true, name) or name in answer.beside for name in names))


def _singles(name: str, answers: Sequence[AirAnswer], targets: tuple[str, str, str]) -> list[Figure]:
    detected = [a for a in answers if a.detected]
    blamed = [a for a in detected if a.label["effects"][0]["domain"] == "airframe"]
    sizes = [len(a.set_of) for a in answers if a.told]
    return [
        share(f"{name}: detected", [a.detected for a in answers]),
        share(f"{name}: top-1, detected", map(_right, detected), targets[0]),
        share(f"{name}: top-1, detected, of the airframe alone", map(_right, blamed)),
        share(f"{name}: truth in the set, detected", [bool(a.true & a.set_of) for a in detected], targets[1]),
        of_rows(f"{name}: mean size of the set", mean, sizes, targets[2]),
        share(f"{name}: exact", map(_exact, detected)),
    ]


def _weak_motors(answers: Iterable[AirAnswer]) -> list[Figure]:
    hits = [
        list(said["instances"]) == entry["instances"]
        for a in answers
        if (entry := a.entry("motor_weak")) is not None and entry["size"] >= WEAK
        for said in a.effects
        if said["id"] == "motor_weak"
    ]
    return [share(f"weak motor of {100.0 * WEAK:.0f} % and more, named: its number", hits, ">= 0.98")]


def _sizes(answers: Iterable[AirAnswer]) -> list[Figure]:
    told = [one for a in answers for one in told_of(a)]
    figures = []
    for name, effect, params, relative, target in SIZES:
        rows = [
            one.size_error(relative=relative)
            for one in told
            if one.exact and one.effect == effect and one.name in params
        ]
        figures.append(of_rows(f"error of {name}: median", quantile(0.5), rows, target))
        figures.append(of_rows(f"error of {name}: p90", quantile(0.9), rows))
    return figures


def _mixtures(answers: Sequence[AirAnswer]) -> list[Figure]:
    counts = [(len(a.true & set(a.named)), len(a.surplus), len(a.true - set(a.named))) for a in answers]
    return [
        of_rows("mixed: F1", lambda rows: ratio(rows, (2, 0, 0), (2, 1, 1)), counts, ">= 0.85"),
        of_rows("mixed: precision", lambda rows: ratio(rows, (1, 0, 0), (1, 1, 0)), counts),
        of_rows("mixed: recall", lambda rows: ratio(rows, (1, 0, 0), (1, 0, 1)), counts),
        share("mixed: exact", map(_exact, answers)),
    ]


def _unknowns(unknown: Sequence[AirAnswer], left: Sequence[AirAnswer]) -> list[Figure]:
    seen = [a for a in left if a.detected]
    return [
        share("unknown: flagged", [a.unknown for a in unknown], ">= 0.85"),
        share("unknown: flagged or described in part", [a.unknown or bool(set(a.named) & a.beside) for a in unknown]),
        share("unknown: a false name", [bool(a.false_names) for a in unknown]),
        share("left out: detected", [a.detected for a in left]),
        share("left out: unknown or honest, detected", map(_rejected, seen), ">= 0.7"),
        share("left out: unknown, detected", [a.unknown for a in seen]),
    ]


def _probabilities(answers: Iterable[AirAnswer]) -> list[tuple[float, bool]]:
    """Of each effect of the airframe or the air that was tested: that it is there, and whether it is."""
    return [
        (float(p), effect in answer.true | answer.beside)
        for answer in answers
        for effect, p in ((answer.report.get("airframe") or {}).get("probabilities") or {}).items()
        if p >= LEAST_P
    ]


def _reliability(pairs: Sequence[tuple[float, bool]]) -> list[Figure]:
    if not pairs:
        return [Figure("probabilities: ECE", None, 0, target="<= 0.05")]
    return [
        of_rows("probabilities: ECE", lambda rows: calibration_error(rows[:, 0], rows[:, 1], BINS), pairs, "<= 0.05"),
        of_rows("probabilities: Brier skill", lambda rows: brier_skill(*rows.T), pairs, ">= 0"),
    ]


def _by_probability(pairs: Sequence[tuple[float, bool]]) -> list[dict[str, Any]]:
    rows = []
    for k in range(BINS):
        mine = [(p, hit) for p, hit in pairs if min(int(p * BINS), BINS - 1) == k]
        said = sum(p for p, _ in mine) / len(mine) if mine else None
        right = asdict(share("right", [hit for _, hit in mine]))
        rows.append({"p": [k / BINS, (k + 1) / BINS], "mean": said, "right": right})
    return rows


def _closed(answers: Sequence[AirAnswer]) -> list[Figure]:
    moved = [a for a in answers if FORCES & a.true and a.told]
    found = [share_closed for a in moved if (share_closed := a.closed(1.0)) is not None]
    return [
        of_rows("1 s velocity error closed, held out: median", quantile(0.5), found, ">= 0.9"),
        of_rows("1 s velocity error closed, held out: p10", quantile(0.1), found),
        share("… told at all", [a.closed(1.0) is not None for a in moved]),
    ]


def _abstention(singles: Sequence[AirAnswer], poor: Sequence[AirAnswer]) -> list[Figure]:
    quiet = [a for a in singles if not a.detected]
    return [
        share("single: nothing named, said to be not testable", [a.excused for a in quiet]),
        share("poor log: a false name, or unknown", [bool(a.false_names) or a.unknown for a in poor], "<= 0.01"),
        share("poor log: anything named", [bool(a.told) for a in poor]),
        share("poor log: said to be not testable", [a.excused for a in poor]),
    ]


def _by_effect(answers: Sequence[AirAnswer]) -> list[dict[str, Any]]:
    groups: dict[str, list[AirAnswer]] = defaultdict(list)
    for answer in answers:
        groups[_what(answer)].append(answer)
    tests: dict[str, Callable[[AirAnswer], bool]] = {
        "detected": lambda a: a.detected,
        "top1": _right,
        "in_set": lambda a: bool(a.true & a.set_of),
    }
    return [
        {"effect": name, **{key: asdict(share(key, map(test, rows))) for key, test in tests.items()}}
        for name, rows in sorted(groups.items())
    ]
