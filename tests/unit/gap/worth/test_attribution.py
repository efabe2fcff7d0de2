"""How probable an effect is beside what could stand in its place, and which of that is listed as a rival."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib.gap.effects import by_id, catalogue
from mavcal.calib.gap.effects.traits import Trait
from mavcal.calib.gap.search import prices
from mavcal.calib.gap.search.exchange import Alternative, Comparison
from mavcal.calib.gap.worth import attribution
from mavcal.calib.gap.worth.attribution import TEMPERATURE, Attribution
from tests.examples import examples

OWN = 100.0
"""Penalised evidence of the effect itself."""
NAMELESS = SimpleNamespace(
    id="shape",
    nameless=True,
    family=next(iter(prices.SHAPE_PRICES)),
    part=0,
    excited_by="bursts",
    traits=frozenset(),
)
GROWING = SimpleNamespace(**{**vars(NAMELESS), "excited_by": "time", "traits": frozenset({Trait.GROWING})})


def score(effect, delta, *, p=1e-6, instances=(0,)):
    hypothesis = SimpleNamespace(effect=effect, instances=instances)
    return SimpleNamespace(hypothesis=hypothesis, delta=delta, p=p)


def other(effect, behind, *, kappa=0.5, **more):
    """Something that is so far behind the effect."""
    return Alternative(score(effect, OWN - behind, **more), kappa)


NOBODY = other(NAMELESS, 1e6)


def judged(*others, own="accel_bias", second=0.0):
    place = Comparison((*others, NOBODY), OWN)
    hypothesis = SimpleNamespace(effect=by_id()[own], instances=(0,))
    return attribution._rivals_and_probabilities(hypothesis, place, None, second)


def probability(*others, **more):
    return judged(*others, **more)[1]


BIAS, ROTATION, SCALE, WALK = (by_id()[f"accel_{name}"] for name in ("bias", "rotation", "scale", "random_walk"))


def test_an_effect_without_a_rival_is_sure_and_nothing_is_unknown():
    rivals, sure, unknown = judged()
    assert (rivals, sure, unknown) == ((), pytest.approx(1.0), pytest.approx(0.0))


def test_beside_a_temperature_that_rises_with_time_both_are_named_with_what_decides():
    rivals, sure, _ = judged(other(GROWING, 1.0, kappa=0.99), own="gyro_temp_linear")
    (rival,) = rivals
    assert (rival.id, rival.kappa, rival.delta) == ("drift_in_time", 0.99, 1.0)
    assert "cool" in rival.fix
    assert sure < 0.6
    assert judged(other(GROWING, 100.0), own="gyro_temp_linear")[0] == ()  # the temperature did not follow the time
    assert judged(other(GROWING, 1.0), own="accel_bias")[0] == ()


@settings(max_examples=examples(30))
@given(st.lists(st.floats(-20.0, 200.0), max_size=5))
def test_probabilities_are_those_of_the_flattened_evidence(behind):
    """By hand: each stands for exp(-evidence behind / (2 temperature))."""
    weights = [math.exp(-d / (2.0 * TEMPERATURE)) for d in behind]
    assert probability(*(other(ROTATION, d) for d in behind)) == pytest.approx(1.0 / (1.0 + sum(weights)))


def test_a_rival_as_good_as_the_effect_takes_half():
    assert probability(other(ROTATION, 0.0)) == pytest.approx(0.5)
    assert probability(other(ROTATION, 0.0), other(SCALE, 0.0)) == pytest.approx(1.0 / 3.0)
    assert probability(other(ROTATION, -50.0)) < 1e-3


def test_the_same_name_in_another_form_is_no_rival():
    rivals, sure, _ = judged(other(BIAS, 0.0))
    assert (rivals, sure) == ((), pytest.approx(1.0))
    assert probability(other(BIAS, 0.0, instances=(1,))) == pytest.approx(0.5)  # of another unit it is


def test_the_likeliest_of_what_has_no_name_counts_once():
    _, sure, unknown = judged(other(NAMELESS, 0.0), other(NAMELESS, 0.0), other(NAMELESS, 30.0))
    assert (sure, unknown) == (pytest.approx(0.5), pytest.approx(0.5))
    assert judged(other(NAMELESS, 0.0))[0] == ()  # and is no rival by name


def test_noise_that_the_instances_do_not_show_is_no_rival():
    assert judged(other(ROTATION, 0.0, p=1.0)) == judged()
    assert probability(other(ROTATION, 0.0, p=1.0), other(SCALE, 0.0)) == pytest.approx(0.5)  # the next one is


def test_beside_a_second_order_differences_count_for_less():
    plain, wide = probability(other(ROTATION, 20.0)), probability(other(ROTATION, 20.0), second=64.0)
    assert wide < plain
    assert wide == pytest.approx(1.0 / (1.0 + math.exp(-20.0 / 16.0)))


def test_noise_that_wanders_is_never_quite_sure():
    assert probability(own="accel_random_walk") == pytest.approx(0.8)


def test_rivals_are_listed_nearest_first_and_each_once():
    rivals, _, _ = judged(
        other(ROTATION, 9.0, kappa=0.9), other(SCALE, 2.0), other(ROTATION, 5.0, kappa=0.7), other(SCALE, 11.0)
    )
    assert [(r.id, r.delta, r.kappa) for r in rivals] == [("accel_scale", 2.0, 0.5), ("accel_rotation", 5.0, 0.7)]
    assert {r.fix for r in rivals} == {BIAS.fix}  # what would tell the effect from them


@pytest.mark.parametrize(("effect", "price"), [(ROTATION, 0.0), (WALK, prices.DRIFT_PRICE)])
def test_a_rival_is_listed_within_its_reach(effect, price):
    assert judged(other(effect, 11.9 + price))[0]
    assert not judged(other(effect, 12.1 + price))[0]


@pytest.mark.parametrize(("own", "reach"), [(500.0, 12.0), (1000.0, 20.0), (1e5, prices.RIVAL_REACH)])
def test_of_a_strong_effect_rivals_farther_behind_are_listed(own, reach):
    def listed(behind):
        place = Comparison((Alternative(score(ROTATION, own - behind), 0.5), NOBODY), own)
        hypothesis = SimpleNamespace(effect=BIAS, instances=(0,))
        return bool(attribution._rivals_and_probabilities(hypothesis, place, None, 0.0)[0])

    assert listed(reach - 0.1)
    assert not listed(reach + 0.1)


def test_the_shape_is_that_of_the_likeliest_without_a_name():
    waves = SimpleNamespace(**{**vars(NAMELESS), "excited_by": "waves"})
    assert attribution._likeliest_shape([other(NAMELESS, 5.0), other(waves, 3.0), other(ROTATION, 0.0)]) == "waves"
    assert attribution._likeliest_shape([other(ROTATION, 0.0)]) == ""


def test_an_effect_is_doubted_if_what_has_no_name_is_likelier():
    found = Attribution(("accel_bias", (0,)), 10.0, 3, 0.5, 0.4, 0.51, ())
    assert found.doubted
    assert not Attribution(("accel_bias", (0,)), 10.0, 3, 0.5, 0.4, 0.5, ()).doubted


def test_every_effect_says_what_would_tell_it_from_its_rivals():
    assert all(effect.fix for effect in catalogue())
    assert np.isfinite([probability(own=effect.id) for effect in catalogue()]).all()
