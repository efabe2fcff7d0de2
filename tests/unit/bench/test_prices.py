"""``python -m bench.prices``: each price of the table can be made smaller and larger."""

from __future__ import annotations

import numpy as np
import pytest

from bench import prices as bench
from mavcal.calib.gap.search import prices


@pytest.mark.parametrize("name", bench.names())
def test_every_price_becomes_smaller_and_larger(name: str) -> None:
    value = getattr(prices, name)
    less, more = (bench.scaled(value, factor) for factor in bench.FACTORS)
    flat = [np.ravel(list(v.values()) if isinstance(v, dict) else v).astype(float) for v in (less, value, more)]
    assert (flat[0] < flat[1]).all()
    assert (flat[1] < flat[2]).all()
    assert bench.shown(value)


def test_a_count_stays_a_count() -> None:
    assert (bench.scaled(3, 0.7), bench.scaled(3, 1.3)) == (2, 4)
    assert (bench.scaled(1, 0.7), bench.scaled(1, 1.3)) == (0, 2)


def test_a_row_says_how_many_answers_change_and_how_many_more_are_right() -> None:
    changed = bench.Changed("DRIFT_PRICE", "16", (3, 0), (151, 150))
    assert changed.row(200, 150) == "| `DRIFT_PRICE` | 16 | 3 of 200 (+1) | 0 of 200 (+0) |"


def test_every_kind_of_case_has_its_share() -> None:
    tiers = [tier for tier, _ in bench.chosen(8)]
    assert sorted(map(tiers.count, bench.TIERS)) == [2, 2, 2, 2]
    assert len({seed for _, seed in bench.chosen(8)}) == 8
