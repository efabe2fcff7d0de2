"""The equation ``|C (m - b)| = g``: against scipy, against numbers that are known, and what few poses leave open."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from mavcal.calib.stats.norm_fit import (
    NEUTRAL,
    PAIRS,
    UNDETERMINED,
    NormProblem,
    model_of,
    solve,
    unlearnt,
    weighted_along,
    with_neutral,
    without_crosses,
)
from mavcal.calib.stats.quantisation import QuantisedMean
from mavcal.calib.stats.stillness import PoseMean
from tests.examples import examples

G = 9.80665
OFFSET = np.array([0.3, -0.2, 0.5])
MATRIX = np.array([[1.02, 0.01, -0.004], [0.01, 0.97, 0.006], [-0.004, 0.006, 1.01]])
FACES = np.concatenate([np.eye(3), -np.eye(3)])
NOISE = 0.002


def symmetric(c):
    matrix = np.zeros((3, 3))
    for value, (i, j) in zip(c, PAIRS, strict=True):
        matrix[i, j] = matrix[j, i] = value
    return matrix


def poses_of(directions, *, noise=0.0, seed=0, scale=1.0, sd=NOISE, offset=OFFSET):
    """What a sensor of `OFFSET` and `MATRIX` reads where gravity lies along `directions` (K, 3)."""
    rng = np.random.default_rng(seed)
    readings = offset + G * directions @ np.linalg.inv(MATRIX) + noise * rng.normal(size=directions.shape)
    covariance = (scale * sd) ** 2 * np.eye(3)
    return [PoseMean(float(k), k + 1.0, scale * reading, covariance, 100) for k, reading in enumerate(readings)]


def everywhere(n=24, seed=7):
    return Rotation.random(n, random_state=seed).as_matrix()[:, 2]


def problem_of(poses, *, cross_sd=None):
    return NormProblem.of(poses, in_si=True, gravity=G, cross_sd=cross_sd)


def test_exact_poses_give_the_exact_sensor():
    problem = problem_of(poses_of(everywhere()))
    found = solve(problem, weak=False)
    assert found.parameters[:3] * G == pytest.approx(OFFSET, abs=1e-9)
    assert symmetric(found.parameters[3:]) == pytest.approx(MATRIX, abs=1e-10)
    assert np.abs(found.lengths).max() < 1e-12


@given(seed=st.integers(0, 1000))
@settings(max_examples=10, deadline=None)
def test_scipy_finds_the_same_minimum(seed):
    poses = poses_of(everywhere(20, seed), noise=0.02, seed=seed)
    found = solve(problem_of(poses), weak=False)
    means = np.array([pose.mean for pose in poses]) / G

    def residuals(x):
        """With the weight of the solution: the one that the method moves along with its steps."""
        return (np.linalg.norm((means - x[:3]) @ symmetric(x[3:]), axis=1) - 1.0) / weight

    weight = found.lengths / found.residuals
    best = least_squares(residuals, NEUTRAL, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert found.parameters == pytest.approx(best.x, abs=1e-6)
    assert np.linalg.inv(best.jac.T @ best.jac) == pytest.approx(found.covariance, rel=1e-3, abs=1e-10)


def test_errors_are_those_of_the_covariance():
    directions = everywhere(18)
    z = []
    for seed in range(60):
        found = solve(problem_of(poses_of(directions, noise=NOISE, seed=seed)), weak=False)
        truth = np.concatenate([OFFSET / G, [MATRIX[pair] for pair in PAIRS]])
        z.append((found.parameters - truth) / np.sqrt(np.diag(found.covariance)))
    assert 0.8 < np.mean(np.square(z)) < 1.25


@given(scale=st.floats(1e-3, 1e5))
@settings(max_examples=examples(15), deadline=None)
def test_a_sensor_of_unknown_unit_is_the_same_in_radii(scale):
    one = NormProblem.of(poses_of(everywhere(), noise=0.01), in_si=False, gravity=G, cross_sd=None)
    other = NormProblem.of(poses_of(everywhere(), noise=0.01, scale=scale), in_si=False, gravity=G, cross_sd=None)
    assert other.radius == pytest.approx(scale * one.radius, rel=1e-9)
    left, right = solve(one, weak=False), solve(other, weak=False)
    assert right.parameters == pytest.approx(left.parameters, abs=1e-9)
    assert right.covariance == pytest.approx(left.covariance, rel=1e-6, abs=1e-14)


def test_six_faces_leave_the_cross_terms_to_the_prior():
    problem = problem_of(poses_of(FACES), cross_sd=0.01)
    assert problem.prior.tolist() == [0.0] * 6 + [1.0 / 0.01**2] * 3
    found = solve(problem, weak=False)
    assert np.sqrt(np.diag(found.covariance))[6:] == pytest.approx(np.full(3, 0.01), rel=0.01)
    assert unlearnt(problem, found, 0.01) == [6, 7, 8]
    assert solve(problem_of(poses_of(FACES)), weak=False) is None


def test_a_prior_that_the_poses_beat_is_learnt():
    problem = problem_of(poses_of(everywhere()), cross_sd=0.01)
    assert unlearnt(problem, solve(problem, weak=False), 0.01) == []


@pytest.mark.parametrize(("sd", "open_terms"), [(0.9, []), (1.1, [6, 7, 8])])
def test_without_a_prior_a_cross_term_needs_to_be_known_to_a_fiftieth(sd, open_terms):
    problem = problem_of(poses_of(everywhere()))
    found = solve(problem, weak=False)
    found.covariance[6:, 6:] = (sd * UNDETERMINED) ** 2 * np.eye(3)
    assert unlearnt(problem, found, None) == open_terms


def test_cross_terms_that_are_held_at_zero_are_never_open():
    problem = problem_of(poses_of(FACES), cross_sd=0.0)
    assert unlearnt(problem, solve(problem, weak=False), 0.0) == []


def test_a_weak_prior_shows_what_no_pose_determines():
    upright = poses_of(FACES[[2, 5]])
    problem = problem_of(upright, cross_sd=0.01)
    assert solve(problem, weak=False) is None
    sd = np.sqrt(np.diag(solve(problem, weak=True).covariance))
    assert sd[[0, 1, 3, 4]] == pytest.approx(np.ones(4), abs=0.05)
    assert (sd[[2, 5]] < 0.05).all()  # the reading along gravity, as far as the cross terms let it


def test_what_is_held_stays_and_has_no_variance():
    problem = problem_of(poses_of(everywhere(), noise=0.01))
    found = solve(problem, weak=False, held=[0, 7])
    assert found.parameters[[0, 7]].tolist() == [problem.centre[0], 0.0]
    assert not found.covariance[[0, 7]].any()
    assert (np.diag(found.covariance)[[1, 2, 3, 4, 5, 6, 8]] > 0.0).all()


def test_readings_without_numbers_have_no_solution():
    problem = problem_of([*poses_of(everywhere()), PoseMean(0.0, 1.0, np.full(3, np.nan), np.eye(3), 9)])
    assert solve(problem, weak=False) is None


def test_zeroed_cross_terms_pass_their_scatter_on_to_the_rest():
    """Across many sensors whose cross terms scatter by the prior, the other numbers are off as much as is said."""
    rng = np.random.default_rng(3)
    sd, z = 0.01, []
    for _ in range(150):
        crosses = sd * rng.normal(size=3)
        sensor = np.linalg.inv(symmetric(np.concatenate([np.ones(3), crosses])))
        directions = np.concatenate([FACES, Rotation.from_rotvec([0.1, -0.2, 0.15]).apply(FACES)])
        poses = [PoseMean(0.0, 1.0, G * d @ sensor, 1e-6 * np.eye(3), 50) for d in directions]
        problem = problem_of(poses, cross_sd=sd)
        x, covariance = without_crosses(problem, solve(problem, weak=False), [6, 7, 8])
        assert not x[6:].any()
        z.append((x[:6] - NEUTRAL[:6]) / np.sqrt(np.diag(covariance)[:6]))
    assert 0.5 < np.mean(np.square(z)[:, 3:]) < 1.5


def test_readings_along_the_axes_lengthen_by_the_square_of_what_is_zeroed():
    """``|C d|`` of an axis with cross terms c1 and c2 is longer by half of their squares, to no first order."""
    rng = np.random.default_rng(4)
    sd, squares = 0.03, []
    for _ in range(120):
        true = symmetric(np.concatenate([np.ones(3), sd * rng.normal(size=3)]))
        poses = [PoseMean(0.0, 1.0, G * d / np.linalg.norm(true @ d), 1e-14 * np.eye(3), 50) for d in FACES]
        problem = problem_of(poses, cross_sd=sd)
        x, covariance = without_crosses(problem, solve(problem, weak=False), [6, 7, 8])
        squares.append((x[3:6] - 1.0) ** 2 / np.diag(covariance)[3:6])
    assert 0.6 < np.mean(squares) < 1.5


def test_without_open_cross_terms_the_solution_stays():
    problem = problem_of(poses_of(everywhere()), cross_sd=0.01)
    found = solve(problem, weak=False)
    x, covariance = without_crosses(problem, found, [])
    assert x is found.parameters
    assert covariance is found.covariance
    bare = problem_of(poses_of(everywhere()))  # no prior: nothing says how far off a zero may be
    assert without_crosses(bare, found, [6])[0] is found.parameters


def test_unknown_numbers_become_neutral_ones_without_variance():
    x, covariance = np.arange(9.0) + 3.0, np.full((9, 9), 0.1)
    y, spread = with_neutral(x, covariance, [1, 4, 8])
    assert y.tolist() == [3.0, 0.0, 5.0, 6.0, 1.0, 8.0, 9.0, 10.0, 0.0]
    assert not spread[[1, 4, 8]].any()
    assert not spread[:, [1, 4, 8]].any()
    assert spread[0, 2] == 0.1
    assert x[1] == 4.0  # what was given is left alone
    assert covariance[1, 1] == 0.1


@pytest.mark.parametrize("form", ["symmetric", "upper"])
def test_the_model_gives_every_pose_the_length_of_gravity(form):
    poses = poses_of(everywhere(), scale=100.0)
    problem = NormProblem.of(poses, in_si=False, gravity=G, cross_sd=None)
    found = solve(problem, weak=False)
    model, _ = model_of(problem, found.parameters, found.covariance, form)
    corrected = (np.array([pose.mean for pose in poses]) - model.offset) @ model.matrix.T
    assert np.linalg.norm(corrected, axis=1) == pytest.approx(np.full(len(poses), G), rel=1e-9)
    assert model.offset == pytest.approx(100.0 * OFFSET, abs=1e-6)
    if form == "upper":
        assert not np.tril(model.matrix, -1).any()


@pytest.mark.parametrize("form", ["symmetric", "upper"])
def test_the_covariance_of_the_model_is_that_of_its_numbers(form):
    problem = NormProblem.of(poses_of(everywhere(), scale=50.0), in_si=False, gravity=G, cross_sd=None)
    found = solve(problem, weak=False)
    covariance = 1e-8 * (np.eye(9) + 0.3)
    stated = model_of(problem, found.parameters, covariance, form)[1]
    rng = np.random.default_rng(1)
    drawn = rng.multivariate_normal(found.parameters, covariance, size=3000)
    models = [model_of(problem, x, covariance, "symmetric")[0] for x in drawn]
    if form == "upper":
        models = [model.upper_triangular() for model in models]
    numbers = np.array([np.concatenate([model.offset, model.matrix.ravel()]) for model in models])
    scattered = np.cov(numbers.T)
    sd = np.sqrt(np.diag(stated))
    known = sd > 1e-9 * sd.max()
    assert np.sqrt(np.diag(scattered))[known] == pytest.approx(sd[known], rel=0.08)
    assert np.sqrt(np.diag(scattered))[~known] == pytest.approx(0.0, abs=1e-7)


def test_sway_across_gravity_is_no_noise_along_it():
    """A pose of a hand: samples scatter across gravity ten times more than along it."""
    rng = np.random.default_rng(8)
    poses = []
    for direction, pose in zip(everywhere(), poses_of(everywhere()), strict=True):
        across = np.cross(direction, [0.3, 0.5, 0.8])
        influence = 0.02 * np.outer(rng.normal(size=400), across / np.linalg.norm(across))
        influence += 0.002 * rng.normal(size=(400, 3))
        estimate = QuantisedMean(
            pose.mean,
            np.cov(influence.T) / 400,
            400,
            400.0,
            np.ones(3),
            (False,) * 3,
            influence - influence.mean(axis=0),
            np.zeros(3),
        )
        poses.append(PoseMean(0.0, 1.0, pose.mean, estimate.covariance, 400, estimate=estimate))
    problem = problem_of(poses)
    found = solve(problem, weak=False)
    along = weighted_along(problem, poses, found)
    sd = np.sqrt(along.covariances[:, 0, 0]) * G
    assert sd == pytest.approx(np.full(len(poses), 0.002 / 20.0), rel=0.35)
    assert np.sqrt(np.trace(problem.covariances[0])) * G > 0.0008
    assert along.covariances[3] == pytest.approx(along.covariances[3, 0, 0] * np.eye(3))


def test_poses_without_single_samples_keep_their_covariance():
    poses = poses_of(everywhere())
    problem = problem_of(poses)
    same = weighted_along(problem, poses, solve(problem, weak=False))
    np.testing.assert_array_equal(same.covariances, problem.covariances)
