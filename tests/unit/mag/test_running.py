from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.mag.distance import score_rows
from mavcal.calib.mag.ellipsoid import fit_ellipsoid
from mavcal.calib.mag.moments import Moments
from mavcal.calib.mag.running import RunningEllipsoid, quadric, quadric_derivatives, squared_gradient
from mavcal.calib.mag.samples import Cloud
from mavcal.calib.mag.shape import correction, six_numbers
from tests.examples import examples

ABOUT = ([10.0, 0.0, 10.0], 50.0)


@settings(max_examples=examples(20), deadline=None)
@given(cuts=st.lists(st.integers(0, 900), max_size=6), forgetting=st.sampled_from([1.0, 0.99]))
def test_cuts_and_joins_do_not_matter(cuts: list[int], forgetting: float) -> None:
    rng = np.random.default_rng(1)
    u = rng.normal(size=(900, 3))
    samples = u / np.linalg.norm(u, axis=1, keepdims=True) * [50.0, 47.0, 52.0] + 0.3 * rng.normal(size=u.shape)
    empty = RunningEllipsoid.about(*ABOUT, forgetting=forgetting)
    whole, grown, joined = empty.added(samples), empty, empty
    for chunk in np.split(samples, sorted(cuts)):
        grown, joined = grown.added(chunk), joined.then(empty.added(chunk))
    for other in (grown, joined):
        assert other.count == 900
        for name in ("sixth", "lagged", "first", "last"):
            np.testing.assert_allclose(getattr(other, name), getattr(whole, name), rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(other.moments.gram, whole.moments.gram, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("forgetting", [1.0, 0.998])
def test_the_covariance_holds(compass: Any, forgetting: float) -> None:
    rng, runs, held, squares = np.random.default_rng(6), 120, 0, 0.0
    truth = np.concatenate([compass.truth.offset, correction(compass.truth, None).matrix.ravel()])
    for _ in range(runs):
        u = compass.everywhere(rng, 1000)
        state = RunningEllipsoid.about(*ABOUT, forgetting=forgetting).added(compass.read(u, rng))
        fit = state.fit()
        held += int(np.count_nonzero(np.abs(fit.values - truth) < 1.96 * fit.sd))
        rows = score_rows(compass.read(u, rng, noise=0.0), compass.truth)
        error = np.concatenate([fit.native["b"], six_numbers(np.array(fit.native["shape"]))])
        error -= np.concatenate([compass.truth.offset, six_numbers(compass.truth.shape)])
        squares += float(error @ rows @ rows.T @ error) / 0.3**2 / 9
    assert held / (12 * runs) == pytest.approx(0.95, abs=2.5 * math.sqrt(0.95 * 0.05 / (9 * runs)))
    if forgetting == 1.0:
        assert math.sqrt(squares / runs) <= 1.05 + 2.0 / math.sqrt(2 * runs * 9)


def test_it_says_what_the_full_fit_says(compass: Any, rng: np.random.Generator) -> None:
    samples = compass.read(compass.everywhere(rng, 5000), rng)
    full, fit = fit_ellipsoid(samples), RunningEllipsoid.about(*ABOUT).added(samples).fit(noise_sd=0.3)
    assert np.abs((fit.values - full.values) / full.sd).max() < 0.2
    np.testing.assert_allclose(fit.sd, full.sd, rtol=0.02)
    assert fit.quality["heading_sd_deg"] == pytest.approx(full.quality["heading_sd_deg"], rel=0.02)
    assert fit.residual_rms == pytest.approx(full.residual_rms, rel=0.01)
    assert 1e-3 < fit.quality["p_value"] < 1.0 - 1e-3
    assert fit.n_samples == 5000


def test_old_samples_fade(compass: Any, rng: np.random.Generator) -> None:
    """The offset jumps by 5 uT: with a memory of 500 samples that is forgotten 4000 later, and else it is not."""
    before = compass.read(compass.everywhere(rng, 4000), rng) + np.array([5.0, 0.0, 0.0])
    after = compass.read(compass.everywhere(rng, 4000), rng)
    short = RunningEllipsoid.about(*ABOUT, forgetting=1.0 - 1.0 / 500.0).added(before).added(after)
    long = RunningEllipsoid.about(*ABOUT).added(before).added(after)
    assert short.n_effective == pytest.approx(999.0, rel=0.01)
    assert np.abs((short.fit().model.offset - compass.truth.offset) / short.fit().sd[:3]).max() < 4.0
    assert long.fit().model.offset[0] - compass.truth.offset[0] > 2.0


def test_repeated_samples_do_not_count_twice(compass: Any, rng: np.random.Generator) -> None:
    samples = compass.read(compass.everywhere(rng, 2000), rng)
    once = RunningEllipsoid.about(*ABOUT).added(samples).fit()
    many = RunningEllipsoid.about(*ABOUT).added(np.repeat(samples, 4, axis=0)).fit()
    assert many.quality["first_correlation"] == pytest.approx(0.75, abs=0.01)
    assert not many.quality["white"]
    assert once.quality["white"]
    assert many.sd[0] > once.sd[0]
    np.testing.assert_allclose(many.model.offset, once.model.offset, atol=1e-9)


def test_its_moments_are_those_of_the_whole_cloud(compass: Any, rng: np.random.Generator) -> None:
    samples = compass.read(compass.everywhere(rng, 20_000), rng)
    found = RunningEllipsoid.about(*ABOUT).added(samples)
    whole = Moments.of(Cloud(samples, np.array(ABOUT[0]), ABOUT[1]))
    np.testing.assert_allclose(found.moments.gram, whole.gram, rtol=1e-10, atol=1e-8)
    np.testing.assert_allclose(found.sixth[:10, :10], whole.gram, rtol=1e-10, atol=1e-8)


def test_derivatives_of_the_quadric(compass: Any) -> None:
    truth = compass.truth.moved(np.zeros(3), 0.02)
    found = quadric_derivatives(truth)
    for k in range(9):
        step = np.zeros(9)
        step[k] = 1e-6
        numeric = (quadric(truth.stepped(step)) - quadric(truth.stepped(-step))) / 2e-6
        np.testing.assert_allclose(found[:, k], numeric, atol=1e-7)
    y = np.array([0.3, -0.8, 1.1])
    psi = np.array([*(y * y), y[0] * y[1], y[0] * y[2], y[1] * y[2], *y, 1.0])
    inverse = np.linalg.inv(truth.shape)
    gradient = 2.0 * inverse @ inverse @ (y - truth.offset)
    assert squared_gradient(quadric(truth)) @ psi == pytest.approx(float(gradient @ gradient))


@pytest.mark.parametrize("model", ["offset", "diagonal", "symmetric"])
def test_too_little_is_refused(model: str) -> None:
    empty = RunningEllipsoid.about(*ABOUT)
    angle = np.linspace(0.0, 6.0, 300)
    flat = 50.0 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    for state, words in (
        (empty, "too few"),
        (empty.added([1.0, 2.0, 3.0]), "too few"),
        (empty.added(flat), "one plane"),
    ):
        fit = state.fit(model)
        assert fit.status == FitStatus.REFUSED
        assert words in fit.message
        assert fit.movements
    assert empty.n_effective == 0.0


def test_wrong_input_is_an_error() -> None:
    empty = RunningEllipsoid.about(*ABOUT)
    with pytest.raises(InvalidInputError, match="finite"):
        empty.added([[1.0, math.nan, 2.0]])
    with pytest.raises(InvalidInputError, match="forgetting"):
        RunningEllipsoid.about(*ABOUT, forgetting=0.0)
    with pytest.raises(InvalidInputError, match="joined"):
        empty.then(RunningEllipsoid.about(*ABOUT, forgetting=0.5))
    with pytest.raises(InvalidInputError, match="merged"):
        empty.then(RunningEllipsoid.about([0.0, 0.0, 0.0], 50.0))
