"""Held-out blocks can deny an effect: what they gain is compared with what an effect of that evidence has to gain."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcal.calib.gap.diagnose import _Answer, _confirmed_by_blocks
from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.heldout.folds import folds_of
from mavcal.calib.gap.heldout.gates import gate_of
from mavcal.calib.gap.heldout.shrink import held_out
from mavcal.calib.gap.model.hypotheses import hypotheses_of
from mavcal.calib.gap.model.joint import setting_of
from mavcal.calib.gap.model.noise_fit import model_without_effects, noise_fitted
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.search.contest import Contest
from mavcal.calib.gap.search.exchange import stable_model
from mavcal.calib.gap.search.selection import select
from mavcal.calib.gap.search.terms import marginal_gains
from mavcal.calib.gap.unknown.verdict import NOT_LASTING
from mavcal.calib.gap.worth.attribution import attributions
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import SIGMA, problem_of

ALPHA = 0.005
BIAS = np.array([0.1, -0.05, 0.08])


def selected(seed, gap, *only):
    """The model that all data choose, of effects with the ids `only` if there are any, its contest, and eight folds."""
    views = views_of(problem_of(np.random.default_rng(seed), (Sensor.ACCEL,), gap), {}, {})
    hypotheses, _ = hypotheses_of(catalogue(), views)
    asked = [h for h in hypotheses if not only or h.effect.id in only]
    setting, contest = setting_of(views), Contest(asked)
    chosen = select(noise_fitted(model_without_effects(setting)).model, contest, ALPHA)
    return chosen, contest, folds_of(setting, 8)


@pytest.fixture(scope="module")
def offset():
    return selected(3, lambda trace: BIAS)


@pytest.fixture(scope="module")
def judged(offset):
    """What the gate says of the offset if it was due to gain `due` nats, and gained `gained`."""
    chosen, contest, folds = offset
    (term,) = chosen.model.terms
    usual = marginal_gains(chosen.model, contest)
    assert usual[term.hypothesis.key][0] > 200.0  # so that `due` is what bounds it below

    def gate(gained, due):
        gains = np.full(len(folds), gained / len(folds))
        beside = {term.hypothesis.key: (2.0 * due, *usual[term.hypothesis.key][1:])}  # lambda / 2 nats
        return gate_of(term, gains, [True] * len(folds), folds, chosen, beside).passed

    return gate


def test_what_is_true_gains_what_is_due_and_passes(offset, judged):
    chosen, contest, _ = offset
    (gate,) = held_out(chosen, contest).gates
    assert gate.passed is True
    assert all(judged(due, due) for due in (5.0, 15.0, 50.0))


@pytest.mark.parametrize("due", [30.0, 60.0, 90.0])
def test_what_gains_nothing_or_loses_where_much_was_due_is_denied(judged, due):
    assert judged(0.0, due) is False
    assert judged(-due, due) is False


def test_a_gain_that_chance_takes_from_a_true_effect_is_no_denial(judged):
    # lambda / 2 nats have the standard deviation sqrt(lambda): a lot that one true effect in 500 draws, and one in 20.
    due = 16.0
    spread = math.sqrt(2.0 * due)
    assert judged(due - 2.4 * spread, due) is True
    assert judged(due - 2.8 * spread, due) is False


def test_of_a_large_effect_a_third_is_enough_and_an_eighth_is_not(judged):
    # Models of real sensors foretell large gains roughly; an eighth is what noise that nobody modelled gains by itself.
    assert judged(30.0, 90.0) is True
    assert judged(11.0, 90.0) is False


def test_nothing_is_said_where_next_to_nothing_was_due(judged):
    assert judged(-3.0, 0.9) is None
    assert judged(-3.0, 4.0) is None  # a true effect of 4 nats loses that much by chance


def test_blocks_that_other_blocks_do_not_tell_are_not_counted(offset):
    chosen, _, folds = offset
    (term,) = chosen.model.terms
    gains = np.array([-500.0, *[40.0] * (len(folds) - 1)])
    beside = {term.hypothesis.key: (2.0 * float(gains[1:].sum()), 3, 1)}
    told = [True] * len(folds)
    assert gate_of(term, gains, told, folds, chosen, beside).passed is False
    assert gate_of(term, gains, [False, *told[1:]], folds, chosen, beside).passed is True


def unsteady(trace):
    """A scale error that holds, and an offset whose sign changes every five seconds: no block tells of the next."""
    signs = np.array([6.0, -3.0, 6.0, -3.0, 6.0, -3.0, 6.0, -3.0])
    block = np.minimum((trace.t / 5.0).astype(int), 7)
    return 0.03 * trace.ideal + signs[block][:, None] * SIGMA[trace.sensor] * np.array([1.0, 0.5, -1.0])


def test_an_offset_that_no_block_confirms_is_taken_out_of_the_answer_and_told_of_without_its_name():
    chosen, contest, _ = selected(5, unsteady, "accel_bias", "accel_scale")
    assert {t.hypothesis.effect.id for t in chosen.model.terms} == {"accel_bias", "accel_scale"}
    found = stable_model(chosen, contest, ALPHA)
    answer = _confirmed_by_blocks(_Answer(found, attributions(found, contest), contest, None), ALPHA, nested=False)
    assert {t.hypothesis.effect.id for t in answer.chosen.model.terms} == {"accel_scale"}
    assert [(one.text, one.sensor) for one in answer.withdrawn] == [(NOT_LASTING, Sensor.ACCEL)]
    assert all(answer.gates[t.hypothesis.key] is True for t in answer.chosen.model.terms)


def test_what_the_other_blocks_know_nothing_of_is_not_counted_against_an_effect(offset, monkeypatch):
    """One block is due a loss of 500 nats and loses 1000; the other seven gain what they are due."""
    chosen, contest, folds = offset
    (term,) = chosen.model.terms
    due = iter([-500.0, *[10.0] * (len(folds) - 1)])
    monkeypatch.setattr("mavcal.calib.gap.heldout.gates.expected_gain", lambda *_: next(due))
    gains = np.array([-1000.0, *[10.0] * (len(folds) - 1)])
    gate = gate_of(term, gains, [True] * len(folds), folds, chosen, marginal_gains(chosen.model, contest))
    assert gate.passed is True


def test_a_block_that_is_due_next_to_nothing_still_counts(offset, monkeypatch):
    """The limit is 5 nats: a loss of 4 was foretold, and what it loses beyond that denies the effect."""
    chosen, contest, folds = offset
    (term,) = chosen.model.terms
    due = iter([-4.0, *[10.0] * (len(folds) - 1)])
    monkeypatch.setattr("mavcal.calib.gap.heldout.gates.expected_gain", lambda *_: next(due))
    gains = np.array([-1000.0, *[10.0] * (len(folds) - 1)])
    gate = gate_of(term, gains, [True] * len(folds), folds, chosen, marginal_gains(chosen.model, contest))
    assert gate.passed is False
