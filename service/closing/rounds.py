"""Result of a round, and whether another one follows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from mavcal.calib.airframe.answer import Domain, Quantity
from mavcal.calib.gap.schema import EffectEstimate, GapReport, GapVerdict, NotTestable
from mavcal.calib.gap_report.airframe_effects import phrase
from mavcal.service.closing.settings import SimSettings

Json = dict[str, Any]

_AIRFRAME = "airframe"
"""Id under which a report says that no airframe could be compared."""
_MOST_DOUBTS = 3
PREDICTED_S = 1.0
"""Length of the predicted flights whose error summarises a round, s."""


@dataclass(frozen=True)
class RoundResult:
    """One round as measured: the real flight against the simulator with `settings`.

    `closed` is the part of the held-out gap that the effects found now would close, None where it is not known;
    `rollout` as in the report; `velocity_error` that after one predicted second with the simulator as it was, m/s.
    """

    number: int
    verdict: str
    tested: bool
    effects: tuple[Json, ...]
    closed: float | None
    rollout: tuple[Json, ...]
    velocity_error: float | None
    settings: SimSettings
    to_set: SimSettings
    """Settings of the next round, with the remedy of these effects."""
    not_set: tuple[str, ...]
    """Keys of the remedy that this simulator's command cannot take."""
    log: str
    not_tested: tuple[str, ...] = ()
    """Why the airframe, or anything at all, could not be compared."""
    notes: tuple[str, ...] = ()
    """Notes on gaps of its log and flights again, and doubts where no effect is named."""

    @property
    def left(self) -> tuple[str, ...]:
        """Ids of the effects in which the flights still differ."""
        return tuple(effect["id"] for effect in self.effects if effect["material"])

    def as_json(self) -> Json:
        """Everything, as data."""
        return {
            "round": self.number,
            "verdict": self.verdict,
            "tested": self.tested,
            "effects": list(self.effects),
            "left": list(self.left),
            "closed": self.closed,
            "rollout": list(self.rollout),
            "velocity_error": self.velocity_error,
            "settings": self.settings.as_json(),
            "to_set": self.to_set.as_json(),
            "not_set": list(self.not_set),
            "log": self.log,
            "not_tested": list(self.not_tested),
            "notes": list(self.notes),
        }


class Outcome(StrEnum):
    """Why the loop ended."""

    CLOSED = "closed"  # nothing material is left
    NOTHING_TO_SET = "nothing_to_set"  # what is left has no name, or cannot be set in this simulator
    WITHOUT_EFFECT = "without_effect"  # what was set is there as before
    ROUNDS_USED = "rounds_used"  # something is left after the last round
    NOT_TESTABLE = "not_testable"  # the flights do not allow an answer


_NO_MORE = (GapVerdict.NO_GAP, GapVerdict.EXPLAINED)
_UNMOVED = 0.1
"""Relative change from which a value counts as moved. Chosen, not measured: a remedy changes more."""


def outcome_of(results: Sequence[RoundResult], rounds: int) -> Outcome | None:
    """Why there is no round after `results`; None: there is one. `rounds` may be flown with a remedy."""
    last = results[-1]
    if not last.left:
        if not last.tested or last.not_tested or last.verdict == GapVerdict.NOT_TESTABLE:
            return Outcome.NOT_TESTABLE
        return Outcome.CLOSED if last.verdict in _NO_MORE else Outcome.NOTHING_TO_SET
    if last.to_set == last.settings:
        return Outcome.NOTHING_TO_SET
    if len(results) > 1 and _values(last) and _unmoved(_values(results[-2]), _values(last)):
        return Outcome.WITHOUT_EFFECT
    return Outcome.ROUNDS_USED if len(results) > rounds else None


def _values(result: RoundResult) -> dict[tuple[str, ...], float]:
    return {
        (effect["id"], *map(str, effect["instances"]), name): parameter["value"]
        for effect in result.effects
        if effect["material"]
        for name, parameter in effect["params"].items()
    }


def _unmoved(before: Mapping[tuple[str, ...], float], now: Mapping[tuple[str, ...], float]) -> bool:
    """Whether every value is as before; values small beside the others do not count."""
    least = _UNMOVED * max(map(abs, now.values()))
    return before.keys() == now.keys() and all(
        abs(value - before[key]) <= _UNMOVED * abs(value) or max(abs(value), abs(before[key])) < least
        for key, value in now.items()
    )


def measured(
    number: int,
    report: GapReport,
    settings: SimSettings,
    log: str,
    *,
    with_frame: bool,
    notes: tuple[str, ...] = (),
) -> RoundResult:
    """The round's result from its diagnosis; without a frame file only parameters can be set."""
    wanted = settings.patched(effect for effect in report.effects if is_material(effect))
    to_set = wanted if with_frame else SimSettings(wanted.parameters, settings.frame)
    not_set = tuple(wanted.changed_from(to_set))
    rollout = () if report.airframe is None else report.airframe.rollout
    errors = [
        r.before for r in rollout if r.quantity is Quantity.VELOCITY and r.h_s == PREDICTED_S and r.part == "blocks"
    ]
    return RoundResult(
        number,
        report.verdict.value,
        report.tested,
        tuple(_effect_json(effect) for effect in report.effects),
        None if report.shrink is None else report.shrink.known,
        tuple(
            {"h_s": r.h_s, "quantity": r.quantity.value, "unit": r.unit, "part": r.part, "before": r.before,
             "after": r.after, "floor": r.floor, "closed": r.closed}
            for r in rollout
        ),
        errors[0] if errors else None,
        settings,
        to_set,
        not_set,
        log,
        (*_cut_short(report), *(_untold(n) for n in report.not_testable if _matters(n, report))),
        (*notes, *(f"note: {warning}" for warning in _doubts(report))),
    )  # fmt: skip


def _cut_short(report: GapReport) -> tuple[str, ...]:
    """The first warning of a diagnosis that found nothing before its limit; empty otherwise."""
    return report.warnings[:1] if report.left_out and report.verdict is GapVerdict.NOT_TESTABLE else ()


def _doubts(report: GapReport) -> tuple[str, ...]:
    """Warnings of a diagnosis that names no material effect: they say why the flights may differ all the same."""
    return () if any(map(is_material, report.effects)) else report.warnings[len(_cut_short(report)) :][:_MOST_DOUBTS]


def _untold(untested: NotTestable) -> str:
    return f"{untested.id}: {untested.reason}; needed: {untested.need}"


def _matters(untested: NotTestable, report: GapReport) -> bool:
    """Whether flights as a whole, not single effects, could not be compared."""
    return untested.id == _AIRFRAME or not report.tested


def is_material(effect: EffectEstimate) -> bool:
    """Whether an effect is worth another flight: all but the day's weather.

    A doubtful name is set too, as in an export: the next flight measures whether it was right.
    """
    return effect.domain is not Domain.ENVIRONMENT


def _effect_json(effect: EffectEstimate) -> Json:
    return {
        "id": effect.id,
        "said": phrase(effect),
        "domain": effect.domain.value,
        "instances": list(effect.instances),
        "probability": effect.evidence.probability,
        "material": is_material(effect),
        "params": {p.name: {"value": p.value, "unit": p.unit, "ci95": list(p.ci95)} for p in effect.params},
        "sim_patch": dict(effect.sim_patch),
    }
