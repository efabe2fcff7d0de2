from __future__ import annotations

import math

import numpy as np
import pytest

from mavcal.calib.gap.diagnose import _setup_of
from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.model.joint import Setting
from mavcal.calib.gap.search.column_cache import ColumnCache, numbers_of
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import problem_of

BIAS, SCALE, TONE = "gyro_bias", "gyro_scale", "gyro_tone"


@pytest.fixture(scope="module")
def made() -> tuple[Setting, dict[str, Hypothesis]]:
    effects = tuple(e for e in catalogue() if e.id in {BIAS, SCALE, TONE})
    task = _setup_of(problem_of(np.random.default_rng(1), (Sensor.GYRO,)), effects)
    assert task is not None
    return task.bare.setting, {h.effect.id: h for h in task.contest.hypotheses if not h.again}


def test_what_was_made_once_is_the_same_object(made) -> None:
    setting, of = made
    kept = ColumnCache(10_000_000)
    for name, theta in ((BIAS, math.nan), (TONE, 3.0)):
        assert kept.of(of[name], theta, setting) is kept.of(of[name], theta, setting)
    assert kept.of(of[TONE], 3.0, setting) is not kept.of(of[TONE], 4.0, setting)


def test_an_array_that_axes_share_counts_once(made) -> None:
    setting, of = made
    columns = ColumnCache(0).of(of[BIAS], math.nan, setting)
    assert len(columns.parts) == 3
    assert numbers_of(columns) == columns.parts[0].X.size


def test_without_a_budget_nothing_stays(made) -> None:
    setting, of = made
    kept = ColumnCache(0)
    for name, theta in ((BIAS, math.nan), (TONE, 3.0)):
        assert kept.of(of[name], theta, setting) is not kept.of(of[name], theta, setting)


def test_shapes_that_were_picked_make_room_for_later_ones_and_never_take_that_of_a_grid(made) -> None:
    setting, of = made
    tone, bias = (numbers_of(ColumnCache(0).of(of[n], t, setting)) for n, t in ((TONE, 3.0), (BIAS, math.nan)))
    kept = ColumnCache(max(8 * tone, 8 * bias))  # a quarter: two tones
    first = kept.of(of[TONE], 3.0, setting)
    for theta in (4.0, 5.0, 6.0, 7.0):
        kept.of(of[TONE], theta, setting)
    steady = kept.of(of[BIAS], math.nan, setting)
    assert kept.of(of[TONE], 7.0, setting) is kept.of(of[TONE], 7.0, setting)
    assert kept.of(of[TONE], 3.0, setting) is not first
    assert kept.of(of[BIAS], math.nan, setting) is steady


def test_of_what_was_picked_the_last_asked_for_stays(made) -> None:
    setting, of = made
    tone = numbers_of(ColumnCache(0).of(of[TONE], 3.0, setting))
    kept = ColumnCache(8 * tone)
    first = kept.of(of[TONE], 3.0, setting)
    kept.of(of[TONE], 4.0, setting)
    assert kept.of(of[TONE], 3.0, setting) is first
    kept.of(of[TONE], 5.0, setting)  # the one of 4 Hz goes
    assert kept.of(of[TONE], 3.0, setting) is first


def test_columns_that_are_larger_than_the_room_are_given_and_not_kept(made) -> None:
    setting, of = made
    tone = numbers_of(ColumnCache(0).of(of[TONE], 3.0, setting))
    kept = ColumnCache(4 * tone - 4)
    columns = kept.of(of[TONE], 3.0, setting)
    assert np.array_equal(columns.parts[0].X, kept.of(of[TONE], 3.0, setting).parts[0].X)
    assert columns is not kept.of(of[TONE], 3.0, setting)
