from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.mag.distance import score_rows
from mavcal.calib.mag.ellipsoid import fit_ellipsoid
from mavcal.calib.mag.moments import Moments
from mavcal.calib.mag.samples import Cloud
from mavcal.calib.mag.shape import Ellipsoid, MagModel, six_numbers

OFFSET = np.array([12.0, -8.5, 21.0])
SPHERE = 49.0 * np.eye(3)
DIAGONAL = np.diag([51.0, 47.0, 49.5])
SYMMETRIC = np.array([[51.0, 2.2, -1.5], [2.2, 47.0, 1.8], [-1.5, 1.8, 49.5]])


def read(shape: Any, u: Any, rng: np.random.Generator, noise: float = 0.3) -> Any:
    return u @ shape + OFFSET + noise * rng.normal(size=u.shape)


def state_of(fit: Any) -> Any:
    return np.concatenate([fit.native["b"], six_numbers(np.array(fit.native["shape"]))])


@pytest.mark.parametrize("model", list(MagModel))
def test_the_basis_of_a_model_is_orthonormal_and_of_its_size(model: MagModel) -> None:
    np.testing.assert_allclose(model.basis.T @ model.basis, np.eye(model.size), atol=1e-15)


@pytest.mark.parametrize(("model", "shape"), [("offset", SPHERE), ("diagonal", DIAGONAL)])
def test_a_smaller_model_is_at_its_own_bound_and_states_it(compass: Any, model: str, shape: Any) -> None:
    rng, runs, squares, held = np.random.default_rng(8), 60, 0.0, 0
    free, truth = MagModel(model).basis, Ellipsoid(OFFSET, shape)
    for _ in range(runs):
        u = compass.everywhere(rng, 200)
        rows = free.T @ score_rows(read(shape, u, rng, 0.0), truth)
        fit = fit_ellipsoid(read(shape, u, rng), model=model)
        error = free.T @ (state_of(fit) - np.concatenate([OFFSET, six_numbers(shape)]))
        squares += float(error @ rows @ rows.T @ error) / 0.3**2 / len(rows)
        held += int(np.count_nonzero(np.abs(fit.model.offset - OFFSET) < 1.96 * fit.sd[:3]))
        np.testing.assert_allclose(fit.model.matrix, fit.model.matrix * np.eye(3))
    assert math.sqrt(squares / runs) <= 1.05 + 2.0 / math.sqrt(2 * runs * len(free.T))
    assert held / (3 * runs) == pytest.approx(0.95, abs=2.5 * math.sqrt(0.95 * 0.05 / (3 * runs)))


@pytest.mark.parametrize("model", list(MagModel))
def test_scipy_finds_the_same_minimum(compass: Any, rng: np.random.Generator, model: MagModel) -> None:
    """Without the correction of bias, which is below 1e-5 here, it is the plain orthogonal distance."""
    u = compass.everywhere(rng, 60)
    shape = {MagModel.OFFSET: SPHERE, MagModel.DIAGONAL: DIAGONAL, MagModel.SYMMETRIC: SYMMETRIC}[model]
    samples = read(shape, u, rng, 0.02)
    free = model.basis

    def distance(x: Any) -> Any:
        full = free @ x
        shape = np.array([[full[3], full[6], full[7]], [full[6], full[4], full[8]], [full[7], full[8], full[5]]])
        z = np.linalg.solve(shape, (samples - full[:3]).T)
        for _ in range(50):  # foot points by projected gradient of their own: x = S z/|z|, corrected along the tangent
            z /= np.linalg.norm(z, axis=0)
            pull = shape @ ((samples - full[:3]).T - shape @ z)
            z = z + 0.3 / 49.0**2 * (pull - z * (z * pull).sum(axis=0))
        z /= np.linalg.norm(z, axis=0)
        foot = (shape @ z).T + full[:3]
        normal = np.linalg.solve(shape, z).T
        return ((samples - foot) * normal).sum(axis=1) / np.linalg.norm(normal, axis=1)

    start = free.T @ np.concatenate([OFFSET, [49.0, 49.0, 49.0, 0.0, 0.0, 0.0]])
    independent = free @ least_squares(distance, start, method="lm", xtol=1e-12, ftol=1e-12).x
    fit = fit_ellipsoid(samples, model=model, robust=False)
    np.testing.assert_allclose(state_of(fit), independent, atol=1e-4)


@pytest.mark.parametrize(
    ("shape", "name"), [(SPHERE, "offset"), (DIAGONAL, "diagonal"), (SYMMETRIC, "symmetric")], ids=str
)
def test_auto_names_the_model_and_agrees_with_it(compass: Any, rng: np.random.Generator, shape: Any, name: str) -> None:
    samples = read(shape, compass.everywhere(rng, 2000), rng)
    fit, own = fit_ellipsoid(samples, model="auto"), fit_ellipsoid(samples, model=name)
    assert fit.native["model"] == name
    assert own.native["model"] == name
    assert np.abs((fit.model.offset - own.model.offset) / own.sd[:3]).max() < 0.3
    np.testing.assert_allclose(fit.sd[:3], own.sd[:3], rtol=0.05)
    smaller = [m for m in ("offset", "diagonal") if name == "symmetric" or (name == "diagonal" and m == "offset")]
    assert all(fit.native["likelihood_ratio"][m] < 1e-6 for m in smaller)
    assert fit.native["bic"][name] == min(fit.native["bic"].values())


@pytest.mark.parametrize("soft_iron", [0.0, 0.0015, 0.01, 0.03])
def test_auto_is_honest_where_little_is_covered(compass: Any, soft_iron: float) -> None:
    """Whether there is no soft iron, a trace or three percent, the offset is within its stated uncertainty."""
    rng, squares = np.random.default_rng(31), []
    for _ in range(12):
        part = np.tril(rng.normal(size=(3, 3)))
        shape = 49.0 * (np.eye(3) + soft_iron * (part + np.tril(part, -1).T))
        samples = read(shape, compass.tilted(rng, 1000, 25.0), rng)
        fit = fit_ellipsoid(samples, model="auto")
        assert fit.status == FitStatus.OK
        squares.append(((fit.model.offset - OFFSET) / fit.sd[:3]) ** 2)
    assert math.sqrt(float(np.mean(squares))) < 1.5


def test_auto_joins_the_sphere_and_the_full_matrix_smoothly(compass: Any) -> None:
    """A sensor without soft iron: the less is covered, the more the prior helps over nine free parameters."""
    gains = []
    for tilt in (180.0, 45.0, 20.0):
        rng = np.random.default_rng(3)
        samples = read(SPHERE, compass.tilted(rng, 2000, tilt), rng)
        free, auto = fit_ellipsoid(samples), fit_ellipsoid(samples, model="auto")
        gains.append(free.sd[2] / auto.sd[2])
    assert gains[0] == pytest.approx(1.0, abs=0.15)
    assert gains[1] > 1.3
    assert gains[2] > 2.0


@pytest.mark.parametrize("model", ["offset", "diagonal", "auto"])
def test_outliers_do_not_reach_any_model(compass: Any, rng: np.random.Generator, model: str) -> None:
    samples = read(DIAGONAL if model != "offset" else SPHERE, compass.everywhere(rng, 1000), rng)
    samples[::20] += rng.uniform(-15.0, 15.0, (50, 3))
    fit = fit_ellipsoid(samples, model=model)
    assert fit.quality["n_outliers"] > 25
    assert np.abs((fit.model.offset - OFFSET) / fit.sd[:3]).max() < 4.0


@pytest.mark.parametrize("model", [*MagModel, "auto"])
@pytest.mark.parametrize("count", [1, 4, 9])
def test_too_few_samples_are_refused_with_the_movement(
    compass: Any, rng: np.random.Generator, model: str, count: int
) -> None:
    fit = fit_ellipsoid(read(SPHERE, compass.everywhere(rng, count), rng), model=model)
    if fit.status == FitStatus.REFUSED:
        assert set(fit.movements) == set(fit.undetermined)
        assert all("turn" in text for text in fit.movements.values())
    else:
        assert count > MagModel(model).size


def test_integers_are_taken_as_they_are(compass: Any, rng: np.random.Generator) -> None:
    counts = np.rint(10.0 * read(SYMMETRIC, compass.everywhere(rng, 500), rng))
    as_floats, as_integers = fit_ellipsoid(counts, quantum=1.0), fit_ellipsoid(counts.astype(np.int16), quantum=1.0)
    np.testing.assert_array_equal(as_integers.values, as_floats.values)
    np.testing.assert_array_equal(as_integers.covariance, as_floats.covariance)


def test_an_unknown_model_is_an_error() -> None:
    with pytest.raises(InvalidInputError, match="offset, diagonal, symmetric, auto"):
        fit_ellipsoid([[1.0, 2.0, 3.0]] * 20, model="cube")


def test_moments_of_a_smaller_model_hold_its_form(compass: Any, rng: np.random.Generator) -> None:
    samples = read(DIAGONAL, compass.everywhere(rng, 3000), rng)
    moments = Moments.of(Cloud(samples, OFFSET, 50.0))
    diagonal, noise = moments.ellipsoid(MagModel.DIAGONAL)
    np.testing.assert_allclose(50.0 * diagonal.shape, DIAGONAL, atol=0.1)
    assert np.count_nonzero(np.round(diagonal.shape, 12)) == 3
    assert 50.0 * noise == pytest.approx(0.3, rel=0.1)
    sphere, rough = moments.ellipsoid(MagModel.OFFSET)
    np.testing.assert_allclose(sphere.radii, sphere.radii[0])
    assert rough > noise


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(5))
def test_a_prior_does_not_keep_the_iteration_from_settling(compass: Any, seed: int) -> None:
    """The variance that weighs samples against the prior is re-estimated: that is no rise of the cost."""
    rng = np.random.default_rng(seed)
    for _ in range(12):
        samples = np.rint(read(SYMMETRIC, compass.everywhere(rng, 100), rng))
        assert fit_ellipsoid(samples, prior_sd=0.1).status == FitStatus.OK
        assert fit_ellipsoid(samples, model="auto").status == FitStatus.OK
