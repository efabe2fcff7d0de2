"""Block sums against plain least squares, curves in other variables, and what keeps samples from a fit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.recording import Channel, Rounding, Sensor, Stage
from mavcal.calib.stats.correlated import ColouredCovariance
from mavcal.calib.thermal.drift import DriftBlocks, DriftCurve, DriftData, powers_about, repeated_rows
from tests.examples import examples

ALL, NONE = np.ones(3, dtype=bool), np.zeros(3, dtype=bool)


def gyro(values, **more):
    return Channel(Sensor.GYRO, 0, np.arange(len(values)) / 50.0, values, "rad/s", Stage.RAW, "made", **more)


def warming(n=600, seed=0, noise=0.01):
    rng = np.random.default_rng(seed)
    T = np.linspace(20.0, 60.0, n)
    return T, np.outer(T, [1e-3, -2e-3, 0.0]) + [0.1, 5.0, -3.0] + noise * rng.normal(size=(n, 3))


@given(seed=st.integers(0, 1000), degree=st.integers(1, 4), n=st.integers(10, 900))
@settings(max_examples=examples(20), deadline=None)
def test_blocks_sum_to_the_least_squares_of_all_samples(seed, degree, n):
    rng = np.random.default_rng(seed)
    x, y = np.sort(rng.uniform(-1.0, 1.0, n)), rng.normal((0.0, 10.0, -1e4), size=(n, 3))
    blocks = DriftBlocks.of(x, np.arange(n) * 1.0, y, degree=degree)
    V = np.vander(x, degree + 1, increasing=True)
    plain, squares, *_ = np.linalg.lstsq(V, y, rcond=None)
    assert blocks.ordinary == pytest.approx(plain, rel=1e-6, abs=1e-6)
    assert blocks.gram == pytest.approx(V.T @ V)
    assert blocks.residual_sd() == pytest.approx(np.sqrt(squares / max(n - degree - 1, 1)), rel=1e-5)
    assert blocks.counts.sum() == n
    assert blocks.counts @ blocks.series / n == pytest.approx(y.mean(axis=0))
    assert blocks.condition == pytest.approx(np.linalg.cond(V.T @ V), rel=1e-6)


def test_weights_are_repetitions():
    rng = np.random.default_rng(2)
    x, y, counts = np.linspace(-1.0, 1.0, 40), rng.normal(size=(40, 2)), rng.integers(1, 9, 40)
    weighted = DriftBlocks.of(x, np.arange(40.0), y, degree=2, weights=counts.astype(float))
    listed = DriftBlocks.of(
        np.repeat(x, counts), np.repeat(np.arange(40.0), counts), np.repeat(y, counts, axis=0), degree=2
    )
    assert weighted.ordinary == pytest.approx(listed.ordinary)
    assert weighted.gram == pytest.approx(listed.gram)
    assert weighted.squares == pytest.approx(listed.squares)


def test_curves_through_a_point_have_no_other_constant():
    rng = np.random.default_rng(3)
    x, origin = rng.uniform(-1.0, 1.0, 300), np.array([4.0, -2.0])
    y = origin + np.outer(x, [0.5, 0.7]) + 0.1 * rng.normal(size=(300, 2))
    blocks = DriftBlocks.of(x, np.arange(300.0), y, degree=1, origin=origin)
    assert blocks.ordinary == pytest.approx((x @ (y - origin) / (x @ x))[None])
    left = y - origin - np.outer(x, blocks.ordinary[0])
    assert blocks.squares == pytest.approx((left**2).sum(axis=0), rel=1e-9)


def test_a_far_constant_costs_no_digit_of_the_scatter():
    T, y = warming(noise=1e-6)
    x = (T - 40.0) / 20.0
    near = DriftBlocks.of(x, np.arange(600.0), y - [0.1, 5.0, -3.0], degree=1)
    far = DriftBlocks.of(x, np.arange(600.0), y + 1e5, degree=1)
    assert far.residual_sd() == pytest.approx(near.residual_sd(), rel=1e-3)


@given(t_ref=st.floats(-10.0, 80.0), middle=st.floats(0.0, 60.0), half=st.floats(2.0, 50.0), seed=st.integers(0, 100))
def test_powers_about_another_temperature_are_the_same_curve(t_ref, middle, half, seed):
    c = np.random.default_rng(seed).normal(size=4)
    moved = powers_about(t_ref, middle, half, 4) @ c
    T = np.linspace(middle - half, middle + half, 9)
    before = Polynomial(c)((T - middle) / half)
    assert Polynomial(moved)(T - t_ref) == pytest.approx(before, abs=1e-6 * (1.0 + np.abs(before).max()))


def noise_of(covariances, whiteness=1.0, excess=1.0):
    return ColouredCovariance(np.array(covariances), np.full(3, whiteness), np.full(3, excess))


def test_the_drift_is_the_range_over_the_span_whatever_the_constant():
    c = np.array([[100.0, 0.0, -7.0], [3.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    curve = DriftCurve.of(c, noise_of([np.zeros((3, 3))] * 3), 40.0, 20.0, 25.0)
    assert curve.drift == pytest.approx([6.0, 2.0, 0.0])
    assert not curve.drift_sd.any()


def test_the_sd_of_a_drift_is_that_of_the_curve_about_its_mean():
    spread = np.diag([4.0, 0.09, 0.0])
    curve = DriftCurve.of(np.zeros((3, 3)), noise_of([spread] * 3), 40.0, 20.0, 40.0)
    assert curve.drift_sd == pytest.approx(np.full(3, 0.3))  # the slope's, at either end; the constant does not count
    assert curve.covariances[0] == pytest.approx(np.diag([4.0, 0.09 / 400.0, 0.0]))


def test_a_nuisance_widens_the_covariance_by_its_square():
    curve = DriftCurve.of(np.zeros((2, 3)), noise_of([np.eye(2)] * 3), 0.0, 1.0, 0.0)
    change = np.array([[1.0, 0.0, 2.0], [3.0, 0.0, -1.0]])
    wide = curve.widened(change)
    assert wide.covariances[0] == pytest.approx(np.array([[2.0, 3.0], [3.0, 10.0]]))
    assert wide.covariances[1] == pytest.approx(np.eye(2))
    assert wide.covariances[2] == pytest.approx(np.array([[5.0, -2.0], [-2.0, 2.0]]))


@pytest.mark.parametrize(
    ("drift", "whiteness", "excess", "declined"),
    [
        (3.9, 0.01, 10.0, True),
        (4.1, 0.01, 10.0, False),  # half of it is beyond two sd
        (3.9, 0.06, 10.0, False),  # the noise may be white
        (3.9, 0.01, 8.0, False),  # hardly more than white noise says
    ],
)
def test_a_drift_within_its_own_wander_is_not_repeatable(drift, whiteness, excess, declined):
    curve = DriftCurve(np.zeros((2, 3)), np.zeros((3, 2, 2)), np.full(3, drift), np.ones(3))
    noise = noise_of([np.eye(2)] * 3, whiteness, excess)
    assert curve.not_repeatable(noise).tolist() == [declined] * 3


@pytest.mark.parametrize("shape_only", [False, True])
def test_a_model_has_what_is_estimated_and_names_the_rest(shape_only):
    T, y = warming()
    data = DriftData.of(gyro(y), T)
    c = np.array([[1.0, 2.0, 3.0], [0.1, 0.2, 0.3], [0.01, 0.02, 0.03]])
    covariances = np.array([k * np.ones((3, 3)) for k in (1.0, 2.0, 3.0)])
    curve = DriftCurve(c, covariances, np.ones(3), np.ones(3))
    model, covariance, undetermined = curve.model(data, 35.0, np.array([True, False, True]), shape_only=shape_only)
    assert model.polynomial.coefficients.tolist() == [[0.1, 0.01], [0.0, 0.0], [0.3, 0.03]]
    assert (model.polynomial.t_ref, model.polynomial.t_min, model.polynomial.t_max) == (35.0, 20.0, 60.0)
    assert covariance.shape == (18, 18)
    assert covariance[12:14, 12:14].tolist() == [[1.0, 1.0], [1.0, 1.0]]
    assert not covariance[14:16].any()
    assert not covariance[12:14, 16:18].any()  # axes are fitted apart
    if shape_only:
        assert model.offset.tolist() == [0.0, 0.0, 0.0]
        assert undetermined == ("offset_x", "offset_y", "poly1_y", "poly2_y", "offset_z")
        assert not covariance[:3].any()
    else:
        assert model.offset.tolist() == [1.0, 0.0, 3.0]
        assert undetermined == ("offset_y", "poly1_y", "poly2_y")
        assert covariance[2, [2, 16, 17]].tolist() == [3.0, 3.0, 3.0]


@pytest.mark.parametrize(("n", "said"), [(4, "4 finite rows: 5 are needed for degree 1"), (5, "")])
def test_five_rows_are_the_least(n, said):
    T, y = warming(n)
    assert DriftData.of(gyro(y), T).refusal(1, 2.0) == said


def test_a_higher_degree_needs_more_rows_and_more_temperatures():
    T, y = warming(6)
    data = DriftData.of(gyro(y), T)
    assert data.refusal(4, 2.0) == ""
    assert data.refusal(5, 2.0) == "6 finite rows: 7 are needed for degree 5"
    T = np.resize([20.0, 30.0, 40.0], 60)
    data = DriftData.of(gyro(warming(60)[1]), T)
    assert data.refusal(1, 2.0) == ""
    assert data.refusal(2, 2.0) == "3 different temperatures are not enough for degree 2"


@pytest.mark.parametrize(
    ("low", "high", "said"),
    [
        (-100.0, 160.0, ""),
        (-101.0, 50.0, "temperatures of -101 to 50 are no degrees Celsius: is it the raw column, or another unit?"),
        (20.0, 161.0, "temperatures of 20 to 161 are no degrees Celsius: is it the raw column, or another unit?"),
    ],
)
def test_temperatures_that_no_sensor_has_are_another_unit(low, high, said):
    _, y = warming(60)
    assert DriftData.of(gyro(y), np.linspace(low, high, 60)).refusal(1, 2.0) == said


@pytest.mark.parametrize(("span", "enough"), [(9.9, False), (10.0, True)])
def test_the_least_span_is_told_with_what_there_was(span, enough):
    _, y = warming(60)
    said = DriftData.of(gyro(y), np.linspace(20.0, 20.0 + span, 60)).refusal(1, 10.0)
    assert bool(said) is not enough
    if said:
        assert said.startswith("the temperature moved by 9.9 degC (20.0 to 29.9): 10 are needed; start with a cold")


def test_a_constant_sensor_is_stuck_unless_its_bins_are_wide():
    T = np.linspace(20.0, 60.0, 60)
    stuck = gyro(np.full((60, 3), 0.25))
    assert DriftData.of(stuck, T).refusal(1, 2.0).startswith("every axis reads one constant value")
    in_bins = gyro(np.full((60, 3), 0.25), quantum=0.5, rounding=Rounding.NEAREST)
    assert DriftData.of(in_bins, T).refusal(1, 2.0) == ""
    one_moves = gyro(np.column_stack([np.full((60, 2), 0.25), np.arange(60.0)]))
    assert DriftData.of(one_moves, T).refusal(1, 2.0) == ""


@pytest.mark.parametrize("shape", [(59,), (60, 1), (0,)])
def test_every_row_needs_its_temperature(shape):
    with pytest.raises(InvalidInputError, match=r"gyro: 60 rows of 3 axes with temperatures of shape"):
        DriftData.of(gyro(warming(60)[1]), np.zeros(shape))


def test_two_axes_are_not_three():
    with pytest.raises(InvalidInputError, match="60 rows of 2 axes"):
        DriftData.of(gyro(warming(60)[1][:, :2]), np.zeros(60))


def test_rows_of_other_times_are_sorted_with_all_that_belongs_to_them():
    T, y = warming(60)
    y[7, 1] = np.nan
    order = np.r_[30:60, 0:30]
    t = np.arange(60) / 50.0
    shuffled = Channel(
        Sensor.GYRO, 0, t[order], y[order], "rad/s", Stage.RAW, "made", quantum=0.01, rounding=Rounding.NEAREST
    )
    data = DriftData.of(shuffled, T[order])
    assert (data.unsorted, data.ignored, data.n) == (1, 1, 59)
    keep = np.arange(60) != 7
    assert data.time.tolist() == t[keep].tolist()
    assert data.t.tolist() == T[keep].tolist()
    assert data.y.tolist() == y[keep].tolist()
    assert data.half.shape == (59, 3)


@pytest.mark.parametrize(("n", "found"), [(49, 0), (50, 1)])
def test_a_spike_is_told_among_fifty_rows(n, found):
    T, y = warming(n)
    y[20, 0] += 10.0
    data = DriftData.of(gyro(y), T)
    assert (data.spiked, data.n) == (found, n - found)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("ranges", "found"), [(3.5, 0), (4.5, 1)])
def test_a_spike_lies_four_ranges_beyond_the_rest(side, ranges, found):
    T, y = warming(1000, noise=0.0)
    y[:, 2] = np.where(np.arange(1000) % 2, 1.0, -1.0)
    y[500, 2] = side * (1.0 + 2.0 * ranges)
    assert DriftData.of(gyro(y), T).spiked == found


def test_a_constant_axis_shows_no_spike():
    T, y = warming(100)
    y[:, 2] = 3.0
    y[50, 2] = 4.0
    assert DriftData.of(gyro(y), T).spiked == 0


def test_other_temperatures_leave_the_samples_and_forget_the_old_range():
    T, y = warming(60)
    data = DriftData.of(gyro(y), T)
    assert (data.t_min, data.t_max, data.span) == (20.0, 60.0, 40.0)
    moved = data.warmed(T + 5.0)
    assert (moved.t_min, moved.t_max) == (25.0, 65.0)
    np.testing.assert_array_equal(moved.y, data.y)
    assert DriftData(data.time, T, y, None, NONE, 0, limits=(18.0, 63.0)).span == 45.0


def test_what_is_taken_away_leaves_the_rest_of_each_row():
    T, y = warming(60)
    shift = np.outer(np.arange(60.0), [1.0, 2.0, 3.0])
    lower = DriftData.of(gyro(y), T).lowered(shift)
    np.testing.assert_array_equal(lower.y, y - shift)
    assert lower.n == 60


def test_single_samples_carry_their_bins_only_where_there_are_any():
    T, y = warming(60)
    assert DriftData.of(gyro(y), T).bins(0) is None
    data = DriftData.of(gyro(y, quantum=0.5, rounding=Rounding.NEAREST), T)
    bins = data.bins(1)
    assert bins.values.tolist() == y[:, 1].tolist()
    assert bins.half.tolist() == [0.25] * 60
    assert bins.counts.sum() == data.samples == 60
    assert bins.rows.tolist() == list(range(60))


def test_a_stretch_that_was_pasted_again_is_found_and_a_constant_one_is_none():
    T, y = warming(40)
    data = DriftData.of(gyro(np.concatenate([y, y[5:15]])), np.concatenate([T, T[5:15]]))
    assert np.flatnonzero(repeated_rows(data)).tolist() == list(range(40, 50))
    short = DriftData.of(gyro(np.concatenate([y, y[5:12]])), np.concatenate([T, T[5:12]]))
    assert not repeated_rows(short).any()  # seven rows alike may be chance
    at_rest = DriftData.of(gyro(np.concatenate([y, np.tile(y[-1], (30, 1))])), np.append(T, np.full(30, T[-1])))
    assert not repeated_rows(at_rest).any()


def test_long_records_are_not_searched_for_pasted_rows():
    T, y = warming(1000)
    twice = DriftData.of(gyro(np.concatenate([y, y])), np.concatenate([T, T]))
    assert repeated_rows(twice).sum() == 1000
    longer = DriftData.of(gyro(np.concatenate([y, y, y[:1]])), np.concatenate([T, T, T[:1]]))
    assert not repeated_rows(longer).any()
