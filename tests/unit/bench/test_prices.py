"""``python -m bench.prices``: each price of the table can be made smaller and larger."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from bench import prices as bench
from bench.varied_search import FACTORS, SHORTCUTS, WITHOUT, names, other_values, scaled
from mavcal.calib.gap.search import prices
from mavcal.calib.withheld_check import make_case


@pytest.mark.parametrize("name", names())
def test_every_price_becomes_smaller_and_larger(name: str) -> None:
    value = getattr(prices, name)
    less, more = (scaled(value, factor) for factor in FACTORS)
    flat = [np.ravel(list(v.values()) if isinstance(v, dict) else v).astype(float) for v in (less, value, more)]
    assert (flat[0] < flat[1]).all()
    assert (flat[1] < flat[2]).all()
    assert bench.shown(value)


def test_a_count_stays_a_count() -> None:
    assert (scaled(3, 0.7), scaled(3, 1.3)) == (2, 4)
    assert (scaled(1, 0.7), scaled(1, 1.3)) == (0, 2)


@pytest.mark.parametrize("name", WITHOUT)
def test_a_price_that_does_nothing_is_of_the_same_kind(name: str) -> None:
    *others, nothing = other_values(name, without=True)
    assert len(others) == len(other_values(name, without=False)) == len(FACTORS)
    value = getattr(prices, name)
    if isinstance(value, dict):
        assert nothing == dict.fromkeys(value, 0)
    else:
        assert nothing == WITHOUT[name] != value


def varied(seed: int, *, right: bool, **changed: list[tuple[bool, bool]]) -> bench.Varied:
    return bench.Varied("T1", seed, right=right, prices=changed)


def test_a_row_says_how_many_answers_change_and_how_many_more_are_right() -> None:
    cases = [
        varied(1, right=False, DRIFT_PRICE=[(True, True), (False, False)]),
        varied(2, right=True, DRIFT_PRICE=[(True, False), (True, False)]),
        varied(3, right=True),
    ]
    value = bench.shown(prices.DRIFT_PRICE)
    assert bench.row("DRIFT_PRICE", cases) == f"| `DRIFT_PRICE` | {value} | 2 | 2 (+0) | 1 (-1) | |"
    cases += [varied(4, right=True, DRIFT_PRICE=[(False, True), (False, True), (True, False)])]
    assert bench.row("DRIFT_PRICE", cases) == f"| `DRIFT_PRICE` | {value} | 3 | 2 (+0) | 1 (-1) | 1 (-1) of 1 |"
    del cases[-1]
    long, flight = bench.Varied("T1", 5, right=True, prices=None), bench.Varied("sitl_mix", 1, right=False, prices={})
    page = bench.page([*cases, long, flight])
    assert "The first table has 3 cases; 2 answers name the true effects" in page
    assert "1 more cases are left out" in page
    assert "the 1 flights of known answer in `bench/flights.toml`; 0 answers are right" in " ".join(page.split())
    assert f"{len(names()) - 1} of {len(names())} prices change no answer" in " ".join(page.split())
    idle = set(WITHOUT) - set(SHORTCUTS) - {"DRIFT_PRICE"}
    assert f"None of the answers below changes without these {len(idle)} others" in " ".join(page.split())
    assert all(name in page.split("## ")[0] for name in idle)


def test_a_kept_case_is_not_run_again(tmp_path: Path) -> None:
    case = varied(bench.FIRST_SEED, right=True, DRIFT_PRICE=[(False, True), (True, False)])
    path = tmp_path / "kept.jsonl"
    path.write_text(json.dumps(asdict(case)) + "\n")
    [one] = bench.cases_in(path)
    assert (one.seed, one.right, list(one.prices or ())) == (bench.FIRST_SEED, True, ["DRIFT_PRICE"])
    assert bench.main(["--cases", "1", "--keep", str(path)]) == 0
    assert path.read_text().count("\n") == 1


def test_the_next_of_its_kind_comes_for_a_case_that_takes_too_long() -> None:
    first = bench.FIRST_SEED
    long = bench.Varied(bench.TIERS[0].value, first, right=True, prices=None)
    unread = bench.Varied(bench.TIERS[1].value, first + 1, right=True, prices={})
    assert bench.chosen(3, [long, unread]) == [(bench.TIERS[2], first + 2), (bench.TIERS[0], first + 4)]


def test_a_flight_is_right_with_its_known_effects_and_those_that_may_stand_beside_them() -> None:
    known = {"verdict": ["explained"], "effects": ["gyro_bias 1"], "also": ["accel_temp_linear 1"]}
    right = bench._as_known
    assert right(("explained", False, (("gyro_bias", (1,)),)), known)
    assert right(("explained", False, (("accel_temp_linear", (1,)), ("gyro_bias", (1,)))), known)
    assert not right(("unknown", True, (("gyro_bias", (1,)),)), known)
    assert not right(("explained", False, (("gyro_bias", (1, 2)),)), known)
    assert not right(("explained", False, ()), known)


def test_flights_that_were_flown_are_not_flown_again(tmp_path: Path) -> None:
    flown = [name for name, _ in bench.flights()]
    assert [of for _, of in bench.left_of(0, tmp_path, [])] == [(k, tmp_path) for k, _ in enumerate(flown)]
    assert bench.left_of(0, tmp_path, [bench.Varied(name, 0, right=True, prices={}) for name in flown]) == []
    assert bench.left_of(0, None, []) == []


@pytest.mark.long  # three diagnoses
@pytest.mark.timeout(600)
def test_only_prices_that_a_diagnosis_reads_are_varied(tmp_path: Path) -> None:
    path = tmp_path / "kept.jsonl"
    read, unread = "DRIFT_PRICE", "FLIGHT_DIFFERENCE"
    assert bench.main(["--cases", "1", "--workers", "1", "--keep", str(path), "--only", read, unread]) == 0
    [case] = bench.cases_in(path)
    assert case.right
    assert list(case.prices or ()) == [read]
    assert getattr(prices, read) == 16.0  # the process that varied it is gone


@pytest.mark.long  # six diagnoses
@pytest.mark.timeout(600)
def test_a_divided_diagnosis_answers_as_one_that_had_the_price_from_the_beginning() -> None:
    [(tier, seed)] = bench.chosen(1, [])
    [found] = bench.all_varied([(bench.varied, (tier, seed))], ["THERMAL_PRICE", "EFFECT_COUNT_PRICE"], 1)
    question = bench.question_of(make_case(tier, seed))
    before = question.answer()
    for name, answers in (found.prices or {}).items():
        value = getattr(prices, name)
        for factor, answer in zip(FACTORS, answers, strict=True):
            with patch.object(prices, name, scaled(value, factor)):
                after = question.answer()
            assert tuple(answer) == (after != before, question.right(after))


def test_every_kind_of_case_has_its_share() -> None:
    tiers = [tier for tier, _ in bench.chosen(8, [])]
    assert sorted(map(tiers.count, bench.TIERS)) == [2, 2, 2, 2]
    assert len({seed for _, seed in bench.chosen(8, [])}) == 8
