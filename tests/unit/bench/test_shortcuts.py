"""``python -m bench.shortcuts``: what each shortcut of the search saves."""

from __future__ import annotations

import pytest

from bench import shortcuts as bench
from bench.varied_search import SHORTCUTS, WITHOUT, Answer
from mavcal.calib.gap.search import prices

SAME: Answer = ("explained", False, (("accel_bias", (1,)),))
OTHER: Answer = ("no_gap", False, ())


def test_every_shortcut_is_a_price_that_can_be_absent() -> None:
    assert set(SHORTCUTS) <= set(WITHOUT)
    for name in SHORTCUTS:
        before = getattr(prices, name)
        with bench.absent(name):
            assert getattr(prices, name) == WITHOUT[name] != before
        assert getattr(prices, name) == before


def case(plain: float, *, without: float, answer: Answer = SAME) -> bench.Timed:
    """A case in which the first shortcut saves time, and no other does."""
    first = bench.TimedAnswer(answer, without)
    others = (bench.TimedAnswer(SAME, plain),) * (len(SHORTCUTS) - 1)
    return bench.TimedAnswer(SAME, plain), (first, *others)


def test_a_row_has_the_ratio_of_all_cases_the_largest_and_the_answers_that_change() -> None:
    rows = bench.table([case(1.0, without=4.0), case(3.0, without=4.0, answer=OTHER)]).splitlines()[2:]
    first, second, *_ = SHORTCUTS
    assert rows[0] == f"| `{first}` | 2.00 | 4.00 | 1 of 2 |"
    assert rows[1] == f"| `{second}` | 1.00 | 1.00 | 0 of 2 |"
    assert len(rows) == len(SHORTCUTS)


def test_without_a_case_there_is_no_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert bench.main(["--cases", "0"]) == 1
    assert capsys.readouterr().out == "0 of 0 cases from seed 70000; 0 take too long\n"
