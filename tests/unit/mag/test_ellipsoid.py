from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavcal.calib.earth import EarthField
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus, parameter_names
from mavcal.calib.mag.distance import bisquare, score_rows
from mavcal.calib.mag.ellipsoid import fit_ellipsoid
from mavcal.calib.mag.shape import Ellipsoid, correction, six_numbers
from mavcal.calib.mag.shape_fit import estimate_variance
from tests.examples import examples
from tests.fields import field_of

FIELD = field_of(49.0, math.radians(66.0), norm_sd=0.15)


def shape_of(fit: Any) -> Ellipsoid:
    return Ellipsoid(np.array(fit.native["b"]), np.array(fit.native["shape"]))


def errors(fit: Any, truth: Ellipsoid) -> Any:
    found = shape_of(fit)
    return np.concatenate([found.offset - truth.offset, six_numbers(found.shape - truth.shape)])


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("count", "tilt", "runs"), [(100, None, 80), (1000, None, 40), (100, 45.0, 80), (1000, 45.0, 40)]
)
def test_reaches_the_bound_and_states_it(compass: Any, count: int, tilt: float | None, runs: int) -> None:
    """RMSE over the Cramer-Rao bound of 9 parameters, and how often the 95 % intervals hold.

    The intervals of the 12 stored numbers are counted. The three cross terms come twice: nine are independent.
    """
    rng = np.random.default_rng(count)
    squares, held = 0.0, 0
    truth = np.concatenate([compass.truth.offset, correction(compass.truth, None).matrix.ravel()])
    for _ in range(runs):
        u = compass.everywhere(rng, count) if tilt is None else compass.tilted(rng, count, tilt)
        rows = score_rows(compass.read(u, rng, noise=0.0), compass.truth)
        fit = fit_ellipsoid(compass.read(u, rng))
        assert fit.status == FitStatus.OK
        error = errors(fit, compass.truth)
        squares += float(error @ (rows @ rows.T) @ error) / 0.3**2 / 9
        held += int(np.count_nonzero(np.abs(fit.values - truth) < 1.96 * fit.sd))
    assert math.sqrt(squares / runs) <= 1.05 + 2.0 / math.sqrt(2 * runs * 9)
    assert held / (12 * runs) == pytest.approx(0.95, abs=2.5 * math.sqrt(0.95 * 0.05 / (9 * runs)))


@pytest.mark.long
def test_intervals_hold_with_five_residuals(compass: Any) -> None:
    rng, held, used = np.random.default_rng(11), 0, 0
    truth = np.concatenate([compass.truth.offset, correction(compass.truth, None).matrix.ravel()])
    for _ in range(150):
        fit = fit_ellipsoid(compass.read(compass.everywhere(rng, 14), rng), robust=False)
        if fit.status == FitStatus.OK:
            used += 1
            held += int(np.count_nonzero(np.abs(fit.values - truth) < 1.96 * fit.sd))
    assert used > 140
    assert held / (12 * used) == pytest.approx(0.95, abs=2.5 * math.sqrt(0.95 * 0.05 / (9 * used)))


@pytest.mark.parametrize("count", [1000, 4000])
def test_five_percent_of_outliers_cost_a_tenth(compass: Any, count: int) -> None:
    rng, runs, squares = np.random.default_rng(5), 20, 0.0
    for _ in range(runs):
        u = compass.everywhere(rng, count)
        rows = score_rows(compass.read(u, rng, noise=0.0), compass.truth)
        samples = compass.read(u, rng)
        off = rng.random(count) < 0.05
        samples[off] += rng.uniform(-15.0, 15.0, (np.count_nonzero(off), 3))
        fit = fit_ellipsoid(samples)
        assert fit.quality["n_outliers"] > 0.5 * np.count_nonzero(off)
        error = errors(fit, compass.truth)
        squares += float(error @ (rows @ rows.T) @ error) / 0.3**2 / 9
    assert math.sqrt(squares / runs) <= 1.10 + 2.0 / math.sqrt(2 * runs * 9)


def test_a_quarter_of_outliers_on_one_side_is_survived(compass: Any, rng: np.random.Generator) -> None:
    samples = compass.read(compass.everywhere(rng, 800), rng)
    samples[:200] = compass.truth.offset + [70.0, 0.0, 0.0] + 5.0 * rng.normal(size=(200, 3))
    fit = fit_ellipsoid(samples)
    assert fit.status == FitStatus.OK
    assert fit.quality["n_outliers"] >= 195
    assert np.abs((fit.model.offset - compass.truth.offset) / fit.sd[:3]).max() < 4.5


def test_when_nearly_half_is_off_the_fit_is_refused(compass: Any, rng: np.random.Generator) -> None:
    samples = compass.read(compass.everywhere(rng, 800), rng)
    samples[:360] += rng.uniform(-40.0, 40.0, (360, 3))
    fit = fit_ellipsoid(samples)
    assert fit.status == FitStatus.REFUSED
    assert "off" in fit.message


def test_the_known_field_ties_the_scale_and_its_error_is_in_the_matrix(compass: Any, rng: np.random.Generator) -> None:
    samples = compass.read(compass.everywhere(rng, 2000), rng, noise=0.05)
    fit = fit_ellipsoid(samples, field=FIELD)
    length = np.linalg.norm(fit.model.apply(samples), axis=1)
    assert length.mean() == pytest.approx(49.0, abs=0.02)
    assert fit.quality["field_ratio"] == pytest.approx(compass.truth.mean_radius / 49.0, abs=0.001)
    assert fit.sd[3] / fit.model.matrix[0, 0] == pytest.approx(0.15 / 49.0, rel=0.05)
    exact = fit_ellipsoid(samples, field=field_of(49.0, 1.0))
    assert exact.sd[3] < 0.2 * fit.sd[3]
    assert fit.quality["heading_sd_deg"] < 0.05


def test_without_a_field_the_scale_stays_and_says_so(compass: Any, rng: np.random.Generator) -> None:
    fit = fit_ellipsoid(compass.read(compass.everywhere(rng, 500), rng))
    assert np.linalg.det(fit.model.matrix) == pytest.approx(1.0)
    assert fit.quality["field_ratio"] is None
    assert any("field strength unknown" in w for w in fit.warnings)


def test_a_magnet_near_by_is_said(compass: Any, rng: np.random.Generator) -> None:
    fit = fit_ellipsoid(compass.read(compass.everywhere(rng, 500), rng), field=field_of(30.0, 0.5))
    assert fit.status == FitStatus.OK
    assert fit.quality["field_ratio"] == pytest.approx(49.1 / 30.0, abs=0.02)
    assert any("30.0 uT of the magnetic model" in w for w in fit.warnings)


def test_the_stated_date_of_the_field_is_judged(compass: Any, rng: np.random.Generator) -> None:
    late = EarthField(FIELD.north_east_down, 0.3, valid=False, model="WMM-2025")
    fit = fit_ellipsoid(compass.read(compass.everywhere(rng, 500), rng), field=late)
    assert any("extrapolated" in w for w in fit.warnings)


def test_example_of_magcal(rng: np.random.Generator) -> None:
    """Centre (-50, 20, 100), radii (30, 20, 50): expected field strength 31.0723 (MATLAB's documentation)."""
    u = rng.normal(size=(400, 3))
    samples = u / np.linalg.norm(u, axis=1, keepdims=True) * [30.0, 20.0, 50.0] + [-50.0, 20.0, 100.0]
    fit = fit_ellipsoid(samples)
    np.testing.assert_allclose(fit.native["b"], [-50.0, 20.0, 100.0], atol=1e-8)
    np.testing.assert_allclose(fit.native["A"], np.diag([1.0357441687, 1.553616253, 0.6214465012]), atol=1e-8)
    assert fit.native["expmfs"] == pytest.approx(31.0723, abs=5e-5)


@settings(max_examples=examples(20), deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(1e-3, 1e4), st.floats(-1e3, 1e3))
def test_answers_turn_scale_and_shift_with_the_samples(seed: int, scale: float, shift: float) -> None:
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(60, 3))
    samples = u / np.linalg.norm(u, axis=1, keepdims=True) * [60.0, 48.0, 50.0] + 0.2 * rng.normal(size=(60, 3))
    turn = Rotation.random(rng=rng).as_matrix()
    order = rng.permutation(60)
    fit = fit_ellipsoid(samples, robust=False, unit="counts")
    moved = fit_ellipsoid((scale * samples @ turn.T + shift * scale)[order], robust=False, unit="counts")
    tolerance = 1e-5 * 50.0 * scale
    np.testing.assert_allclose(moved.model.offset, scale * (turn @ fit.model.offset + shift), atol=tolerance)
    np.testing.assert_allclose(moved.model.matrix, turn @ fit.model.matrix @ turn.T, atol=1e-5)


def test_a_known_noise_counts_where_samples_are_few(twelve_points: Any) -> None:
    own = fit_ellipsoid(twelve_points, unit="counts")
    told = fit_ellipsoid(twelve_points, noise_sd=4.0, quantum=1.0, unit="counts")
    np.testing.assert_allclose(told.sd[:3] / own.sd[:3], math.sqrt((16.0 + 1.0 / 12.0) / 2.0549 / 2.64), rtol=2e-3)
    assert told.quality["noise_from"] == "given"
    assert told.quality["chi2"] == pytest.approx(6.1648 / (16.0 + 1.0 / 12.0), rel=1e-3)
    assert any("itself uncertain" in w for w in own.warnings)


def test_misfit_that_is_correlated_in_time_widens_the_uncertainty(compass: Any) -> None:
    """A bump of the field that comes and goes with a time constant of 20 samples, 3 times the noise."""
    rng = np.random.default_rng(2)
    angles = np.cumsum(np.full((6000, 2), [0.011, 0.0137]), axis=0)
    u = np.column_stack(
        [np.cos(angles[:, 0]) * np.cos(angles[:, 1]), np.sin(angles[:, 0]) * np.cos(angles[:, 1]), np.sin(angles[:, 1])]
    )
    bump = np.zeros(6000)
    for k in range(1, 6000):
        bump[k] = 0.95 * bump[k - 1] + 0.9 * math.sqrt(1 - 0.95**2) * rng.normal()
    fit = fit_ellipsoid(compass.read(u, rng) + bump[:, None] * u)
    assert fit.quality["variance_inflation"] > 10.0
    assert any("times the noise" in w for w in fit.warnings)
    assert np.abs((fit.model.offset - compass.truth.offset) / fit.sd[:3]).max() < 4.0
    white = fit_ellipsoid(compass.read(u, rng))
    assert white.quality["variance_inflation"] < 1.5


def test_a_prior_holds_what_a_small_movement_leaves_open(compass: Any) -> None:
    """At 15 degrees of tilt nine free parameters leave the offset to 9 % of the field; soft iron of 5 % does not."""
    rng = np.random.default_rng(12)
    truth = Ellipsoid(compass.truth.offset, 49.0 * (np.eye(3) + 0.02 * np.array([[1, 1, 0], [1, -1, 1], [0, 1, 0]])))
    samples = compass.tilted(rng, 2000, 10.0) @ truth.shape + truth.offset
    samples += 0.3 * rng.normal(size=samples.shape)
    free, held = fit_ellipsoid(samples), fit_ellipsoid(samples, prior_sd=0.02)
    assert free.status == FitStatus.REFUSED
    assert held.status == FitStatus.OK
    assert np.abs((held.model.offset - truth.offset) / held.sd[:3]).max() < 3.5
    assert held.quality["heading_sd_deg"] < 5.0


def test_a_prior_does_nothing_where_the_samples_say_it_all(compass: Any, rng: np.random.Generator) -> None:
    samples = compass.read(compass.everywhere(rng, 3000), rng)
    free, held = fit_ellipsoid(samples), fit_ellipsoid(samples, prior_sd=0.1)
    assert np.abs((free.model.offset - held.model.offset) / free.sd[:3]).max() < 0.05
    np.testing.assert_allclose(held.sd, free.sd, rtol=0.01)


def circle(rng: np.random.Generator, count: int = 400) -> Any:
    angle = rng.uniform(0.0, 2.0 * math.pi, count)
    level = 20.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.column_stack([level, np.full(count, 45.0)]) + 0.3 * rng.normal(size=(count, 3))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (circle, ["one plane", "top-bottom axis"]),
        (lambda rng: circle(rng)[:, [2, 0, 1]], ["one plane", "nose-tail axis"]),
        (lambda rng: np.tile([1.0, 2.0, 3.0], (50, 1)), ["the same", "stuck"]),
        (lambda rng: rng.normal(size=(9, 3)), ["9 magnetometer samples", "too few"]),
        (lambda rng: np.linspace([0, 0, 0], [1, 2, 3], 50), ["line"]),
        (lambda rng: 50.0 * rng.normal(size=(300, 3)), ["did not converge", "field changed"]),
    ],
    ids=["yaw only", "roll only", "constant", "few", "line", "cloud"],
)
@pytest.mark.parametrize("prior_sd", [None, 0.05])
def test_refuses_by_name_what_is_not_determined(make: Any, words: list[str], prior_sd: float | None) -> None:
    fit = fit_ellipsoid(make(np.random.default_rng(4)), prior_sd=prior_sd, field=FIELD, instance=2)
    assert fit.status == FitStatus.REFUSED
    assert fit.instance == 2
    assert all(w in fit.message for w in words), fit.message
    assert set(fit.undetermined) <= set(parameter_names())


@pytest.mark.sampled
@pytest.mark.parametrize("tilt", [3.0, 5.0, 8.0])
def test_never_a_wrong_answer_from_a_small_movement(compass: Any, tilt: float) -> None:
    """Either refused with the movement that is missing, or right within its own uncertainty."""
    rng = np.random.default_rng(int(tilt))
    for _ in range(10):
        fit = fit_ellipsoid(compass.read(compass.tilted(rng, 300, tilt), rng), field=FIELD)
        if fit.status == FitStatus.OK:
            assert np.abs((fit.model.offset - compass.truth.offset) / fit.sd[:3]).max() < 4.5
        else:
            assert "turn" in fit.message or "tilt" in fit.message


@pytest.mark.parametrize(
    ("samples", "options"),
    [
        ([[1.0, 2.0, math.nan]] * 30, {}),
        ([[1.0, 2.0]] * 30, {}),
        ([1.0, 2.0, 3.0], {}),
        ([[1.0, 2.0, 3.0]] * 30, {"prior_sd": 0.0}),
        ([[1.0, 2.0, 3.0]] * 30, {"noise_sd": -1.0}),
        ([[1.0, 2.0, 3.0]] * 30, {"quantum": math.inf}),
    ],
)
def test_wrong_input_is_an_error(samples: Any, options: Any) -> None:
    with pytest.raises(InvalidInputError):
        fit_ellipsoid(samples, **options)


def test_samples_far_from_the_origin_lose_nothing(compass: Any, rng: np.random.Generator) -> None:
    samples = compass.read(compass.everywhere(rng, 200), rng)
    near, far = fit_ellipsoid(samples), fit_ellipsoid(samples + 1e7)
    np.testing.assert_allclose(far.model.offset - 1e7, near.model.offset, atol=1e-6)
    np.testing.assert_allclose(far.sd, near.sd, rtol=1e-5)


def test_bisquare_costs_five_percent_of_variance() -> None:
    """Its efficiency on normal noise at 4.685 sd is 0.95; v divided by the mean weight is the variance per sample."""
    residuals = np.random.default_rng(6).normal(size=1_000_000)
    weights, _ = bisquare(residuals, 1.0)
    assert estimate_variance(residuals, weights) / weights.mean() == pytest.approx(1.0 / 0.95, rel=0.01)
    assert estimate_variance(residuals, np.ones(len(residuals))) == pytest.approx(1.0, rel=0.01)


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(6))
def test_garbage_is_refused_without_a_warning(seed: int) -> None:
    """Warnings are errors here: heavy tails, magnitudes far apart, four points again and again."""
    rng = np.random.default_rng(seed)
    for garbage in (
        rng.standard_cauchy((60, 3)),
        rng.normal(size=(40, 3)) * 10.0 ** rng.uniform(-100.0, 100.0, 3),
        np.repeat(rng.normal(size=(4, 3)), 5, axis=0),
        rng.normal(size=(200, 3)),
    ):
        assert fit_ellipsoid(garbage, prior_sd=0.05 if seed % 2 else None).status == FitStatus.REFUSED
