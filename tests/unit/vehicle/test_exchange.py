from __future__ import annotations

import math
from random import Random

import pytest

from mavcal.service.vehicle.exchange import MISSED, MOST_S, Pace


def test_patience_follows_what_answers_took_and_stays_within_its_bounds() -> None:
    pace = Pace()
    assert pace.patience(1.0, 0.5) == 1.0  # nothing is known yet
    for _ in range(50):
        pace.answered(0.02)
    assert pace.patience(1.0, 0.5) == 0.5
    for _ in range(50):
        pace.answered(1.4)
    assert pace.patience(1.0, 0.5) == pytest.approx(1.4, rel=0.05)
    pace.answered(60.0)
    assert pace.patience(1.0, 0.5) == MOST_S


def test_answers_that_vary_are_waited_for_longer_than_their_mean() -> None:
    pace = Pace()
    for k in range(100):
        pace.answered(1.0 + 0.4 * (k % 2))
    assert pace.patience(1.0, 0.5) > 1.6


def told(*answered: bool) -> Pace:
    pace = Pace()
    for one in answered:
        pace.trip(answered=one)
    return pace


def test_silence_proves_absence_sooner_where_every_question_was_answered() -> None:
    assert told().silences() == told(*[True] * 3).silences() == 5
    assert told(*[True] * 12).silences() == 3
    assert told(*[True] * 50).silences() == 2
    assert told(*[True] * 50, *[False] * 5).silences() == 3
    assert told(*[False, True] * 25).silences() == 5


def test_what_was_lost_long_ago_is_forgotten() -> None:
    assert told(*[False] * 50, *[True] * 200).silences() == 2


def test_no_loss_makes_a_parameter_that_exists_absent_more_often_than_it_did() -> None:
    """At any loss, with what was asked before lost by the same loss: once in 200 times, or as often as with five."""
    chance = Random(5)
    for loss in (0.02, 0.1, 0.3, 0.5):
        missed = sum(_missed(chance, loss) for _ in range(2000)) / 2000
        five = (loss / (1 + loss)) ** 5
        assert missed <= max(MISSED, five) + 2 * math.sqrt(max(MISSED, five) / 2000), (loss, missed)


def _missed(chance: Random, loss: float) -> bool:
    """Whether a parameter that exists is missed: each question, and its neighbour's, is lost by this chance."""
    pace = told(*[chance.random() >= loss for _ in range(40)])
    if chance.random() >= loss:
        return False
    silences = 0
    for _ in range(15):
        if chance.random() >= loss:
            return False
        beside = chance.random() >= loss
        pace.trip(answered=beside)
        silences += beside
        if silences >= pace.silences():
            return True
    return False
