from __future__ import annotations

import pytest

from mavcal.service.vehicle.pace import MOST_S, Pace


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
