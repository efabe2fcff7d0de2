"""The withheld-effect check: cases whose cause is known, their seal, and the score of what was answered.

This is the one way to the foreign generator ``calib.blind``. It lies outside, because every byte of the generator is
under seal; and nothing else in ``calib`` imports it, because the diagnosis must not know who examines it.
"""

from __future__ import annotations

from mavcal.calib.blind.answers import CaseAnswer
from mavcal.calib.blind.cases import Case, Tier, make_case, make_label
from mavcal.calib.blind.real import KINDS, halves, injected
from mavcal.calib.blind.score import score
from mavcal.calib.blind.seal import PLAN, generator_sha256, labels_sha256, scorer_sha256, seeds

__all__ = [
    "KINDS",
    "PLAN",
    "Case",
    "CaseAnswer",
    "Tier",
    "generator_sha256",
    "halves",
    "injected",
    "labels_sha256",
    "make_case",
    "make_label",
    "score",
    "scorer_sha256",
    "seeds",
]
