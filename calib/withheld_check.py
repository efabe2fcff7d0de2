"""The withheld-effect checks: cases whose cause is known, their seal, and the score of what was answered.

Only this module imports the independent generators ``calib.blind`` and ``calib.blind.airframe``. It is not part of
them, because a seal covers every byte of a generator. Nothing else in ``calib`` imports it: the diagnosis must not know
its examiner.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mavcal.calib.blind.airframe.cases import AirCase, AirTier, make_air_case, make_air_label
from mavcal.calib.blind.airframe.score import air_score
from mavcal.calib.blind.airframe.seal import AIR_PLAN, air_generator_sha256, air_scorer_sha256
from mavcal.calib.blind.answers import CaseAnswer
from mavcal.calib.blind.cases import Case, Tier, make_case, make_label
from mavcal.calib.blind.real import KINDS, halves, injected
from mavcal.calib.blind.score import score
from mavcal.calib.blind.seal import PLAN, generator_sha256, labels_sha256, scorer_sha256, seeds


@dataclass(frozen=True)
class Check:
    """One generator with its tiers, its seal and its scorer.

    `case` and `label` take a tier's name and a seed; `plan` has the cases of a full sealed run by tier.
    """

    plan: Mapping[str, int]
    case: Callable[[str, int], Case | AirCase]
    label: Callable[[str, int], dict[str, Any]]
    score: Callable[[Sequence[CaseAnswer]], dict[str, Any]]
    generator_sha256: Callable[[], str]
    scorer_sha256: Callable[[], str]


SENSORS = Check(
    {tier.value: count for tier, count in PLAN.items()},
    lambda tier, seed: make_case(Tier(tier), seed),
    lambda tier, seed: make_label(Tier(tier), seed),
    score,
    generator_sha256,
    scorer_sha256,
)
AIRFRAME = Check(
    {tier.value: count for tier, count in AIR_PLAN.items()},
    lambda tier, seed: make_air_case(AirTier(tier), seed),
    lambda tier, seed: make_air_label(AirTier(tier), seed),
    air_score,
    air_generator_sha256,
    air_scorer_sha256,
)


def check_of(tier: str) -> Check:
    """The check that a tier belongs to.

    Raises
    ------
    KeyError
        If there is no such tier.
    """
    for check in (SENSORS, AIRFRAME):
        if tier in check.plan:
            return check
    raise KeyError(f"there is no tier {tier}; there are {', '.join((*SENSORS.plan, *AIRFRAME.plan))}")


__all__ = [
    "AIRFRAME",
    "KINDS",
    "SENSORS",
    "AirCase",
    "Case",
    "CaseAnswer",
    "Check",
    "check_of",
    "halves",
    "injected",
    "labels_sha256",
    "seeds",
]
