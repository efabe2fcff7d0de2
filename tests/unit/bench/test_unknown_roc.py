"""Curves of what is rejected as unknown: their points, their area, and what counts as before."""

from __future__ import annotations

import dataclasses
import xml.etree.ElementTree as ET

import pytest

from bench.unknown_roc import Rejected, area, at_most, curve, drawn, read, table
from mavcal.calib.gap.unknown.discrepancy import BURSTS, WAVES
from mavcal.calib.report import to_json

BLANK = Rejected("T5", 1, ("unknown_x",), 200.0, 150.0, (), flag=False, share=0.0, shape="", log_odds=-1.0)


def case(tier="T5", **changes):
    return dataclasses.replace(BLANK, tier=tier, **changes)


SHAPE = case(flag=True, share=0.7, shape="square of current on mag")
BET = case(flag=True, share=1.0, shape=f"{BURSTS} on gyro", log_odds=11.0)
ROWS = (SHAPE, BET, case(), case(log_odds=2.0), case("T0"), case("T0", log_odds=-2.0), case("T1", log_odds=1.0))


def test_what_only_a_bet_says_was_not_said_before():
    assert SHAPE.flag_before
    assert not BET.flag_before
    assert not case(flag=True, shape=f"{WAVES} 3 Hz on mag").flag_before
    assert case(flag=True, shape=f"{BURSTS} on gyro; dm_x on mag").flag_before


def test_before_everything_without_a_share_is_alike():
    assert curve(ROWS, lambda r: r.before) == [(0.0, 0.0), (0.0, 0.25), (1.0, 1.0)]


def test_after_the_bets_rank_what_has_no_share():
    points = curve(ROWS, lambda r: r.after)
    assert at_most(points, 0.0) == 0.75
    assert at_most(points, 0.4) == 0.75
    assert points[-1] == (1.0, 1.0)


def test_the_area_is_the_chance_that_an_unknown_error_ranks_above_a_known_one():
    assert area(curve(ROWS, lambda r: r.before)) == pytest.approx(0.625)
    assert area([(0.0, 0.0), (0.0, 1.0), (1.0, 1.0)]) == pytest.approx(1.0)


def test_the_table_counts_both():
    lines = table(ROWS)
    assert "| unknown errors rejected, of 4 | 1 | 2 |" in lines
    assert "| falsely called unknown, of 3 | 0 | 0 |" in lines


def test_the_picture_has_both_curves():
    assert len(ET.fromstring(drawn(ROWS)).findall("{*}polyline")) == 2


def test_kept_answers_are_read_back(tmp_path):
    import json

    kept = tmp_path / "answers.jsonl"
    kept.write_text("".join(json.dumps(to_json(dataclasses.asdict(row))) + "\n" for row in ROWS))
    assert tuple(read(kept)) == ROWS
