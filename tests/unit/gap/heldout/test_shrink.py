"""How far: what blocks that were held out show of events, and of what is tolerated."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.diagnose import diagnose
from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.heldout.shrink import held_out
from mavcal.calib.gap.model.hypotheses import hypotheses_of
from mavcal.calib.gap.model.joint import setting_of
from mavcal.calib.gap.model.noise_fit import model_without_effects, noise_fitted
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.progress import GapPace, GapStage
from mavcal.calib.gap.search.contest import Contest
from mavcal.calib.gap.search.selection import select
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import problem_of

ALPHA = 0.005
BIAS, SCALE = np.array([0.1, -0.05, 0.08]), np.array([0.03, 0.0, -0.02])


def magnet(trace):
    """Put on and taken off: no other block knows when."""
    return ((trace.t > 11.3) & (trace.t < 27.7))[:, None] * np.array([3.0, -2.0, 20.0])


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
def test_a_magnet_that_comes_and_goes_is_closed_on_held_out_blocks_though_no_other_tells_when(seed):
    report = diagnose(problem_of(np.random.default_rng(seed), (Sensor.MAG,), magnet), nested=True)
    assert {e.id for e in report.effects} == {"mag_step"}
    assert report.shrink is not None
    assert report.shrink.nested
    assert report.shrink.closed > 0.9


def both(trace):
    return BIAS + trace.ideal * SCALE


@pytest.fixture(scope="module")
def chosen():
    views = views_of(problem_of(np.random.default_rng(3), (Sensor.ACCEL,), both), {}, {})
    hypotheses, _ = hypotheses_of(catalogue(), views)
    setting, contest = setting_of(views), Contest(hypotheses)
    return select(noise_fitted(model_without_effects(setting)).model, contest, ALPHA), contest


def keys(chosen):
    return {t.hypothesis.effect.id: t.hypothesis.key for t in chosen.model.members}


@pytest.mark.long
def test_what_is_tolerated_is_in_every_model_and_has_no_part_in_the_gap(chosen):
    found, contest = chosen
    assert set(keys(found)) == {"accel_bias", "accel_scale"}
    whole = held_out(found, contest)
    beside = held_out(found, contest, [keys(found)["accel_scale"]])
    assert [gate.key[0] for gate in beside.gates] == ["accel_bias"]
    assert [step.add for step in beside.sequence] == ["accel_bias"]
    assert beside.after.sum() < whole.after.sum() + 3.0
    assert beside.before.sum() < 0.8 * whole.before.sum()


def test_gates_that_are_known_are_not_sought_again(chosen):
    found, contest = chosen
    whole = held_out(found, contest)
    again = held_out(found, contest, known=whole.gates)
    assert again.gates == whole.gates
    assert again.losses.tolist() == whole.losses.tolist()
    beside = held_out(found, contest, [keys(found)["accel_scale"]], whole.gates)
    assert [gate.key[0] for gate in beside.gates] == ["accel_bias"]


def test_once_the_time_is_over_shapes_stay_where_all_data_have_them(chosen):
    found, contest = chosen
    late = Contest(contest.hypotheses, pace=GapPace(lambda: 1.0, 1.0, stage=GapStage.HELD_OUT))
    whole, quick = held_out(found, contest), held_out(found, late)
    assert len(quick.folds) == 2
    assert quick.losses == pytest.approx(whole.losses[:2], abs=0.5)
    assert [gate.passed for gate in quick.gates] == [gate.passed for gate in whole.gates]


@pytest.mark.long
def test_where_everything_is_tolerated_there_is_nothing_to_shrink(chosen):
    found, contest = chosen
    assert held_out(found, contest, list(keys(found).values())) is None


def nearly_level(problem):
    """The same flown so gently that gravity hardly turns: a sensitivity to force is mostly an offset."""
    down = np.array([0.0, 0.0, -9.80665])
    return dataclasses.replace(
        problem, traces=tuple(dataclasses.replace(t, force=down + 0.2 * (t.force - down)) for t in problem.traces)
    )


@pytest.mark.long
@pytest.mark.parametrize("seed", [3, 4])
def test_an_effect_whose_place_another_one_mostly_takes_is_asked_for_no_more_than_it_adds(seed):
    problem = nearly_level(problem_of(np.random.default_rng(seed), (Sensor.GYRO,)))
    offset, sensitivity = np.array([0.008, -0.005, 0.008]), np.zeros((3, 3))
    sensitivity[:, 2] = -offset / 9.80665
    for trace in problem.traces:
        trace.measured[:] += offset + trace.force @ sensitivity.T
    report = diagnose(problem, nested=False)
    assert {e.id for e in report.effects} == {"gyro_bias", "gyro_g_sensitivity"}
    assert not report.unknown.flag
    assert all(e.gates.heldout_blocks for e in report.effects)
