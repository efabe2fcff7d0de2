"""The joint normal equations against dense matrices and differences, and the unknowns' own coordinates."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavcal.calib.imu.integrate import Moves
from mavcal.calib.imu.problem import (
    ImuProblem,
    Linearised,
    linearise,
    log_determinant,
    reduced,
    solve,
    turns_of,
)
from mavcal.calib.imu.unknowns import DIAGONAL, FREE, UNKNOWNS, Coordinates, ImuPrior, cross
from mavcal.calib.imu.weighting import MISFIT, GroupFit, groups, weigh
from mavcal.calib.stats.norm_fit import symmetric

POSES, RATE = 14, 50.0
TRUTH = np.concatenate(
    [
        [0.03, -0.02, 0.05, 1.02, 0.98, 1.01, 0.004, -0.003, 0.006],
        [1.01, 0.01, 0.0, -0.005, 0.99, 0.002, 0.003, 0.0, 1.02],
        [0.01, -0.02, 0.005],
    ]
)
NEUTRAL = np.concatenate([np.zeros(3), np.ones(3), np.zeros(3), np.eye(3).ravel(), np.zeros(3)])
POSE_SD, TURN_SD = 1e-3, 1e-3


def noise(rng: np.random.Generator, sd: float, *shape: int) -> np.ndarray:
    return sd * rng.normal(size=shape)


def problem_of(seed: int = 1, *, poses: int = POSES, noisy: bool = True) -> tuple[ImuProblem, np.ndarray]:
    """Poses of the sensor `TRUTH` and one-second turns between them, and the true directions."""
    rng = np.random.default_rng(seed)
    G, offset = TRUTH[9:18].reshape(3, 3), TRUTH[18:21]
    u = [np.array([0.0, 0.6, 0.8])]
    samples, spans = [], []
    for k in range(poses - 1):
        turn = rng.normal(size=3)
        turn *= rng.uniform(1.0, 2.0) / np.linalg.norm(turn)
        samples.append(np.tile(np.linalg.solve(G, turn) + offset, (int(RATE), 1)))
        spans.append((k * 1.0, k + 1.0))
        u.append(Rotation.from_rotvec(-turn).apply(u[-1]))
    values, directions = np.concatenate(samples), np.array(u)
    t = (np.arange(len(values)) + 0.5) / RATE
    means = TRUTH[:3] + directions @ np.linalg.inv(symmetric(TRUTH[3:9]))
    if noisy:
        means = means + noise(rng, POSE_SD, poses, 3)
        values = values + np.repeat(noise(rng, TURN_SD, poses - 1, 3), int(RATE), axis=0)
    problem = ImuProblem(
        means=means,
        covariances=np.tile(POSE_SD**2 * np.eye(3), (poses, 1, 1)),
        moves=Moves.of(t, values, np.array(spans), offset),
        before=np.arange(poses - 1),
        wander=np.zeros(poses),
        density=np.full(3, 1e-8),
        turn_covariances=np.tile(TURN_SD**2 * np.eye(3), (poses - 1, 1, 1)),
        rest=offset + (noise(rng, 1e-4, 3) if noisy else 0.0),
        rest_covariance=1e-8 * np.eye(3),
    )
    return problem, directions


def moved(at: Linearised, directions: np.ndarray, tangents: np.ndarray) -> np.ndarray:
    new = directions + np.einsum("kij,kj->ki", at.bases, tangents.reshape(-1, 2))
    return new / np.linalg.norm(new, axis=1)[:, None]


def cost(problem: ImuProblem, x: np.ndarray, directions: np.ndarray) -> float:
    return linearise(problem, x, directions, turns_of(problem, x)).cost


def normal_matrix(at: Linearised) -> np.ndarray:
    """The whole normal matrix, directions first."""
    n = at.band.shape[1]
    dense = np.zeros((n, n))
    for above in range(4):
        dense += np.diag(at.band[3 - above, above:], above)
    dense += np.triu(dense, 1).T
    return np.block([[dense, at.border], [at.border.T, at.corner]])


def test_the_gradient_is_the_derivative_of_the_cost():
    problem, u = problem_of()
    problem = dataclasses.replace(problem, wander=np.full(POSES, 1e-6), extra=(1e-7, 2e-7))
    x = TRUTH + noise(np.random.default_rng(2), 1e-4, UNKNOWNS)
    at = linearise(problem, x, u, turns_of(problem, x))
    for k in [*range(9), 18, 19, 20]:  # the covariance of a turn does not follow the gyroscope's matrix
        h = 1e-6 * np.eye(UNKNOWNS)[k]
        slope = (cost(problem, x + h, u) - cost(problem, x - h, u)) / 2e-6
        assert 2.0 * at.gradient[k] == pytest.approx(slope, rel=2e-3, abs=1.0)
    for k in range(0, 2 * POSES, 5):
        h = 1e-7 * np.eye(2 * POSES)[k]
        slope = (cost(problem, x, moved(at, u, h)) - cost(problem, x, moved(at, u, -h))) / 2e-7
        assert 2.0 * at.directions[k] == pytest.approx(slope, rel=2e-3, abs=1.0)


def test_eliminating_the_directions_is_the_complement_of_schur():
    problem, u = problem_of()
    at = linearise(problem, TRUTH, u, turns_of(problem, TRUTH))
    whole = normal_matrix(at)
    n = 2 * POSES
    information, gradient, solved = reduced(at)
    inner = np.linalg.inv(whole[:n, :n])
    assert information == pytest.approx(whole[n:, n:] - whole[n:, :n] @ inner @ whole[:n, n:], rel=1e-6, abs=1e-3)
    assert gradient == pytest.approx(at.gradient - whole[n:, :n] @ inner @ at.directions, rel=1e-6, abs=1e-3)
    assert solved[:, UNKNOWNS] == pytest.approx(inner @ at.directions)
    assert log_determinant(at) == pytest.approx(np.linalg.slogdet(whole)[1], rel=1e-9)


def test_exact_data_are_solved_exactly_from_a_neutral_start():
    problem, u = problem_of(noisy=False)
    found = solve(problem, NEUTRAL, u)
    assert found.x == pytest.approx(TRUTH, abs=1e-7)
    assert found.at.cost < 1e-6
    assert np.abs(found.directions - u).max() < 1e-7


def test_the_errors_are_those_of_the_information():
    """The unknowns err as the inverse of the information says, and the cost is that of its degrees of freedom."""
    z, costs = [], []
    for seed in range(25):
        problem, u = problem_of(seed)
        found = solve(problem, TRUTH, u)
        error = found.x - TRUTH
        z.append(error @ found.information @ error / UNKNOWNS)
        costs.append(found.at.cost / problem.freedom)
    assert 0.75 < np.mean(z) < 1.3
    assert 0.75 < np.mean(costs) < 1.3


def test_the_freedom_is_numbers_observed_less_numbers_fitted():
    problem, _ = problem_of()
    # three a pose less two of its direction, two a movement, three of the rest
    assert problem.freedom == 3 * POSES - 2 * POSES + 2 * (POSES - 1) + 3 - 21


def test_a_movement_that_is_left_out_leaves_the_poses():
    problem, u = problem_of()
    fewer = problem.without_move(4)
    assert fewer.before.tolist() == [0, 1, 2, 3, 5, 6, 7, 8, 9, 10, 11, 12]
    assert len(fewer.moves) == POSES - 2
    np.testing.assert_array_equal(fewer.means, problem.means)
    whole = linearise(problem, TRUTH, u, turns_of(problem, TRUTH))
    part = linearise(fewer, TRUTH, u, turns_of(fewer, TRUTH))
    np.testing.assert_allclose(part.moves, np.delete(whole.moves, 4, axis=0))
    assert part.cost == pytest.approx(whole.cost - float((whole.moves[4] ** 2).sum()))


@pytest.mark.parametrize(("pose", "before"), [(0, 12), (5, 11), (POSES - 1, 12)])
def test_a_pose_that_is_left_out_takes_its_movements_with_it(pose, before):
    problem, u = problem_of()
    fewer = problem.without_pose(pose)
    assert len(fewer.means) == len(fewer.covariances) == len(fewer.wander) == POSES - 1
    assert len(fewer.before) == len(fewer.moves) == before
    found = solve(fewer, TRUTH, np.delete(u, pose, axis=0))
    assert found.at.cost / fewer.freedom < 3.0  # the movements still join the poses that they belong to


def test_extra_variance_makes_residuals_smaller_by_its_share():
    problem, u = problem_of()
    wide = dataclasses.replace(problem, extra=(3.0 * POSE_SD**2, 3.0 * TURN_SD**2))
    one, other = (linearise(p, TRUTH, u, turns_of(p, TRUTH)) for p in (problem, wide))
    np.testing.assert_allclose(other.poses, 0.5 * one.poses)
    assert np.abs(other.moves) == pytest.approx(0.5 * np.abs(one.moves), rel=0.05)


def test_weights_multiply_the_information_of_their_group():
    problem, u = problem_of()
    turns = turns_of(problem, TRUTH)
    one, other = linearise(problem, TRUTH, u, turns), linearise(problem, TRUTH, u, turns, weights=(4.0, 9.0))
    np.testing.assert_allclose(other.poses, 2.0 * one.poses)
    np.testing.assert_allclose(other.moves, 3.0 * one.moves)


def test_a_strong_prior_holds_what_the_data_would_move():
    problem, u = problem_of()
    centre, information = NEUTRAL.copy(), np.zeros(UNKNOWNS)
    centre[3], information[3] = 1.1, 1e12
    found = solve(problem, TRUTH, u, prior=ImuPrior(centre, information))
    assert found.x[3] == pytest.approx(1.1, abs=1e-4)
    assert found.information[3, 3] < 1e10  # that of the data alone


def test_what_is_held_does_not_move():
    problem, u = problem_of()
    found = solve(problem, TRUTH, u, coordinates=Coordinates(np.array([6, 10, 20])))
    assert found.x[[6, 10, 20]].tolist() == TRUTH[[6, 10, 20]].tolist()
    assert (found.x[[0, 3, 9]] != TRUTH[[0, 3, 9]]).all()


def test_data_that_determine_nothing_have_no_solution():
    problem, u = problem_of()
    only = problem
    for _ in range(POSES - 3):
        only = only.without_pose(0)
    assert solve(only, TRUTH, u[-3:]) is None


def test_a_rigid_gyroscope_only_turns():
    free, rigid = FREE.tangents(NEUTRAL), Coordinates(np.zeros(0, dtype=np.intp), rigid=True).tangents(NEUTRAL)
    assert free.shape == (UNKNOWNS, UNKNOWNS)
    assert rigid.shape == (UNKNOWNS, 15)
    for k in range(3):
        change = rigid[9:18, 9 + k].reshape(3, 3)
        assert change == pytest.approx(-change.T)
    new = Coordinates(np.zeros(0, dtype=np.intp), rigid=True).moved(NEUTRAL, 0.3 * np.ones(15))
    G = new[9:18].reshape(3, 3)
    np.testing.assert_allclose(G @ G.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(G) == pytest.approx(1.0)
    assert not np.allclose(G, np.eye(3), atol=0.1)
    assert new[18:21] == pytest.approx(np.full(3, 0.3))


@given(held=st.lists(st.integers(0, UNKNOWNS - 1), unique=True, max_size=8))
def test_no_step_moves_what_is_held(held):
    coordinates = Coordinates(np.array(sorted(held), dtype=np.intp))
    change = np.arange(1.0, UNKNOWNS - len(held) + 1.0)
    new = coordinates.moved(TRUTH, change)
    assert new[held].tolist() == TRUTH[held].tolist()
    assert np.count_nonzero(new != TRUTH) == UNKNOWNS - len(held)


def test_a_cross_matrix_is_the_cross_product():
    rng = np.random.default_rng(4)
    v, w = rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    assert np.einsum("kij,kj->ki", cross(v), w) == pytest.approx(np.cross(v, w))


def test_the_scales_of_the_gyroscope_are_on_its_diagonal():
    assert NEUTRAL[DIAGONAL].tolist() == [1.0, 1.0, 1.0]
    assert NEUTRAL[9:18].sum() == 3.0
    assert symmetric(np.arange(1.0, 7.0)).tolist() == [[1.0, 4.0, 5.0], [4.0, 2.0, 6.0], [5.0, 6.0, 3.0]]


@pytest.mark.parametrize(("dof", "chance"), [(0.4, None), (0.5, 0.0), (4.0, 0.0174)])
def test_residuals_without_redundancy_have_no_chance(dof, chance):
    found = GroupFit(12.0, dof).p_value
    assert found == (None if chance is None else pytest.approx(chance, abs=1e-3))


def test_the_groups_share_the_degrees_of_freedom():
    problem, u = problem_of(3)
    found = solve(problem, TRUTH, u)
    poses, moves = groups(problem, found)
    # what the rest alone determines, three numbers, is in neither group
    assert poses.dof + moves.dof == pytest.approx(problem.freedom, abs=0.3)
    assert poses.chi2 + moves.chi2 <= found.at.cost
    assert min(poses.p_value, moves.p_value) > MISFIT


def test_good_data_are_weighed_as_they_are():
    problem, u = problem_of(5)
    first = solve(problem, TRUTH, u)
    done = weigh(problem, first, ImuPrior(NEUTRAL, np.zeros(UNKNOWNS)), FREE)
    assert done.problem is problem
    assert done.solution is first
    assert done.student_factor == 1.0
    assert done.kept.tolist() == list(range(POSES))
    assert done.moves_out == 0


def test_poses_that_sway_are_given_the_variance_that_they_show():
    problem, _ = problem_of(6, poses=24)
    sway = noise(np.random.default_rng(7), 4.0 * POSE_SD, 24, 3)
    shaken = dataclasses.replace(problem, means=problem.means + sway)
    u = problem_of(6, poses=24)[1]
    done = weigh(shaken, solve(shaken, TRUTH, u), ImuPrior(NEUTRAL, np.zeros(UNKNOWNS)), FREE)
    assert np.sqrt(done.problem.extra[0]) == pytest.approx(4.0 * POSE_SD, rel=0.35)
    assert done.poses.p_value < MISFIT
    assert done.student_factor > 1.0
    assert done.kept.tolist() == list(range(24))  # all of them sway: none is the one that is wrong
    assert groups(done.problem, done.solution)[0].p_value > MISFIT


def test_one_movement_that_contradicts_does_not_spoil_the_rest():
    problem, u = problem_of(8, poses=24)
    rates = problem.moves.rates.copy()
    rates[problem.moves.first[9]] += [0.0, 0.3, 0.2]
    bent = dataclasses.replace(problem, moves=dataclasses.replace(problem.moves, rates=rates))
    prior = ImuPrior(NEUTRAL, np.zeros(UNKNOWNS))
    first = solve(bent, TRUTH, u, prior=prior)
    done = weigh(bent, first, prior, FREE)
    assert set(range(24)) - set(done.kept.tolist()) <= {9, 10}  # a pose at its end may go with it
    assert done.moves_out == (1 if len(done.kept) == 24 else 2)
    error, spoilt = done.solution.x - TRUTH, first.x - TRUTH
    assert error @ done.solution.information @ error / UNKNOWNS < 2.0
    assert spoilt @ first.information @ spoilt / UNKNOWNS > 20.0


@pytest.mark.parametrize(("bent_by", "left_out"), [(0.024, False), (0.032, True)])
def test_a_movement_is_left_out_if_most_of_the_misfit_goes_with_it(bent_by, left_out):
    """Without it the reduced chi-square is 0.54 and 0.42 of what it was: half is the limit."""
    problem, u = problem_of(8, poses=24)
    rates = problem.moves.rates.copy()
    rates[problem.moves.first[9]] += [0.0, bent_by, 0.0]
    bent = dataclasses.replace(problem, moves=dataclasses.replace(problem.moves, rates=rates))
    prior = ImuPrior(NEUTRAL, np.zeros(UNKNOWNS))
    done = weigh(bent, solve(bent, TRUTH, u, prior=prior), prior, FREE)
    assert bool(sum(done.problem.extra) > 0.0) is not left_out  # what stays in widens all the others
    assert (done.moves_out > 0) is left_out
