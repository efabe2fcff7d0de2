"""What amplitudes are worth: nothing is paid for what the movement does not excite, and no unit matters."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcal.calib.gap.effects import by_id
from mavcal.calib.gap.effects.base import CatalogueEffect
from mavcal.calib.gap.search.evidence import (
    evidence,
    price_of_fixed,
    price_of_kind,
    price_of_noise,
    price_of_repetition,
    price_of_search,
)
from mavcal.calib.recording import Sensor

ONE = np.zeros(3, np.intp)


def normal(seed: int, size: float, p: int = 3, n: int = 200) -> tuple[np.ndarray, np.ndarray, float]:
    """Gram matrix, right side and gain of `p` amplitudes of `size` in unit noise."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n, p))
    y = X @ np.full(p, size) + rng.normal(size=n)
    gram, right = X.T @ X, X.T @ y
    return gram, right, float(right @ np.linalg.solve(gram, right))


@pytest.mark.parametrize("seed", range(5))
def test_a_direction_that_nothing_excites_is_not_charged_for(seed):
    gram, right, _ = normal(seed, 0.3)
    wider = np.zeros((5, 5))
    wider[:3, :3] = gram
    padded = np.append(right, [0.0, 0.0])
    assert evidence(wider, padded, np.zeros(5, np.intp)) == pytest.approx(evidence(gram, right, ONE))


def test_a_direction_that_is_hardly_seen_costs_less_than_one_that_is_seen():
    right = np.array([40.0, 0.0])
    costs = [evidence(np.diag([100.0, seen]), right, np.zeros(2, np.intp)) for seen in (100.0, 1.0, 1e-4)]
    assert costs[0] < costs[1] < costs[2]
    assert costs[2] == pytest.approx(evidence(np.array([[100.0]]), right[:1], np.zeros(1, np.intp)), abs=0.01)


@pytest.mark.parametrize("seed", range(5))
def test_evidence_grows_with_the_gain_and_stays_below_it(seed):
    gram, right, gain = normal(seed, 0.3)
    worth = [evidence(gram, k * right, ONE) for k in np.linspace(0.0, 4.0, 30)]
    assert (np.diff(worth) > 0.0).all()
    assert worth[0] <= 0.0
    assert evidence(gram, right, ONE) < gain


def test_amplitudes_that_are_not_there_are_worth_less_than_nothing_on_average():
    worth = [evidence(gram, right, ONE) for gram, right, _ in (normal(seed, 0.0) for seed in range(200))]
    assert np.mean(worth) < 0.0
    assert np.quantile(worth, 0.99) < 6.0


@pytest.mark.parametrize("seed", range(5))
def test_the_unit_of_a_group_does_not_matter(seed):
    gram, right, _ = normal(seed, 0.3, p=4)
    groups = np.array([0, 0, 1, 1], np.intp)
    unit = np.array([1.0, 1.0, 1e4, 1e4])
    other = evidence(gram * np.outer(unit, unit), right * unit, groups)
    assert other == pytest.approx(evidence(gram, right, groups))


def test_an_amplitude_costs_the_logarithm_of_its_own_evidence_and_not_of_the_recordings_length():
    for gain in (30.0, 300.0, 3000.0):
        short = evidence(np.array([[1e2]]), np.array([math.sqrt(gain * 1e2)]), ONE[:1])
        long = evidence(np.array([[1e8]]), np.array([math.sqrt(gain * 1e8)]), ONE[:1])
        assert long == pytest.approx(short)
        assert gain - short == pytest.approx(1.0 + math.log(gain), abs=0.2)


def test_nothing_at_all_has_no_evidence():
    assert evidence(np.zeros((3, 3)), np.zeros(3), ONE) == 0.0
    assert evidence(np.zeros((0, 0)), np.zeros(0), np.zeros(0, np.intp)) == 0.0


def test_a_search_costs_no_more_than_its_grid_and_no_more_than_the_evidence_tells_apart():
    assert price_of_search(1, 1e6) == 0.0
    for grid in (2, 13, 100, 101, 2000, 100_000):
        prices = [price_of_search(grid, gain) for gain in (0.0, 10.0, 100.0, 1e4, 1e9)]
        assert (np.diff(prices) >= 0.0).all()
        assert prices[0] == 0.0
        assert prices[-1] == pytest.approx(2.0 * math.log(grid))
    assert price_of_search(100_000, 50.0) == pytest.approx(2.0 * math.log(50.0))
    assert price_of_search(2000, 1e9) == pytest.approx(2.0 * math.log(2000.0))


def test_a_shape_alone_pays_more_the_better_it_is_seen():
    prices = [price_of_fixed(gain) for gain in (-5.0, 0.0, 10.0, 1e4)]
    assert prices[0] == prices[1] > 0.0
    assert (np.diff(prices[1:]) > 0.0).all()


def test_more_amplitudes_of_noise_cost_more():
    known = np.array([1e4, 1e4, 1e4])
    one, two, three = (price_of_noise(np.full(k, 0.1), known[:k]) for k in (1, 2, 3))
    assert 0.0 < one < two < three
    assert price_of_noise(np.zeros(3), known) == 0.0
    assert price_of_noise(np.zeros(0), np.zeros(0)) == 0.0


def test_an_axis_on_which_noise_is_excluded_costs_more_than_one_that_says_nothing():
    amplitudes = np.array([0.1, 0.1, 0.0])
    excluded = price_of_noise(amplitudes, np.array([1e4, 1e4, 1e4]))
    silent = price_of_noise(amplitudes, np.array([1e4, 1e4, 1e-4]))
    assert excluded > silent + 1.0


def shape(family: str, *, part: bool = False) -> CatalogueEffect:
    return CatalogueEffect("unknown", Sensor.GYRO, (), "", "", family=family, part=part)


def test_what_fits_anything_is_believed_after_a_named_cause():
    named = price_of_kind(by_id()["accel_bias"])
    assert named == price_of_kind(by_id()["accel_noise"]) == 0.0
    assert 0.0 < price_of_kind(by_id()["reference_attitude"]) < price_of_kind(by_id()["gyro_random_walk"])
    warm = {
        price_of_kind(by_id()[f"gyro_{kind}"]) for kind in ("temp_linear", "temp_poly", "temp_scale", "thermal_lag")
    }
    assert len(warm) == 1, "kinds of one cause are compared on equal terms"
    assert 0.0 < warm.pop() < price_of_kind(by_id()["reference_attitude"])
    driver, line, time = (price_of_kind(shape(family)) for family in ("driven", "line", "time"))
    assert 0.0 < driver < line == price_of_kind(by_id()["gyro_flicker"]) < time


def test_one_signal_of_many_that_were_looked_through_costs_more_than_all_of_them():
    assert price_of_kind(shape("product", part=True)) > price_of_kind(shape("product"))


def test_a_direction_that_is_hardly_below_nothing_by_rounding_says_nothing():
    right, units = np.array([1e4, 0.0]), np.zeros(2, np.intp)
    below, nothing = (evidence(np.diag([1.0, value]), right, units) for value in (-3e-8, 0.0))
    assert below == pytest.approx(nothing, rel=1e-6)


def test_a_fault_on_one_axis_costs_little_more_than_an_effect_that_has_one_amplitude():
    gram, right = np.diag(np.full(3, 100.0)), np.array([400.0, 0.0, 0.0])
    one = evidence(gram[:1, :1], right[:1], ONE[:1])
    assert one - 4.0 < evidence(gram, right, ONE) < one
    even = np.full(3, 400.0 / math.sqrt(3.0))
    assert evidence(gram, even, ONE) < evidence(gram, right, ONE) - 2.0


def test_orders_of_a_curve_that_take_each_other_back_are_as_dear_as_orthogonal_ones():
    t = np.linspace(0.5, 1.5, 400)
    orders = np.stack([t, t**2, t**3])
    triangle, _ = np.linalg.qr(orders.T)
    y = 8.0 * triangle @ np.array([1.0, 0.8, -0.9])
    plain, orthogonal = (evidence(X.T @ X, X.T @ y, np.arange(3)) for X in (orders.T, triangle))
    assert plain == pytest.approx(orthogonal, abs=1.5)


def test_noise_on_one_axis_costs_less_than_as_much_on_three():
    known = np.full(3, 1e4)
    alone, together = price_of_noise(np.array([0.3, 0.0, 0.0]), known), price_of_noise(np.full(3, 0.3), known)
    assert alone < together - 5.0
    assert alone > price_of_noise(np.array([0.3]), known[:1]) + 3.0
    almost = price_of_noise(np.array([0.3, 0.02, 0.0]), known)
    assert alone < almost < together, "what the other axes gain is given up"


def test_the_second_event_of_a_sensor_costs_more_than_the_first():
    assert price_of_repetition(0) == 0.0
    assert 0.0 < price_of_repetition(1) == price_of_repetition(2) < price_of_kind(by_id()["gyro_random_walk"])
