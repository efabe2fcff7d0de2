"""Normal equations beside least squares, where all directions exist and where some do not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib.gap.model.normal_equations import eigh, solved
from tests.examples import examples


def system(seed, rows=40, columns=4, scale=None):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(rows, columns)) * (1.0 if scale is None else scale)
    y = rng.normal(size=rows)
    return X, y


@settings(max_examples=examples(25), deadline=None)
@given(seed=st.integers(0, 500), columns=st.integers(1, 6))
def test_a_full_system_is_least_squares_with_its_covariance(seed, columns):
    X, y = system(seed, columns=columns)
    solution, covariance, rank = solved(X.T @ X, X.T @ y)
    np.testing.assert_allclose(solution, np.linalg.lstsq(X, y, rcond=None)[0], atol=1e-9)
    np.testing.assert_allclose(covariance, np.linalg.inv(X.T @ X), atol=1e-9)
    assert rank == columns


@settings(max_examples=examples(15), deadline=None)
@given(seed=st.integers(0, 500), units=st.lists(st.floats(-6.0, 6.0), min_size=4, max_size=4))
def test_units_of_the_parameters_do_not_matter(seed, units):
    X, y = system(seed)
    size = 10.0 ** np.array(units)
    plain, covariance, rank = solved(X.T @ X, X.T @ y)
    scaled = X * size
    other, spread, same = solved(scaled.T @ scaled, scaled.T @ y)
    np.testing.assert_allclose(other * size, plain, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(spread * np.outer(size, size), covariance, rtol=1e-6, atol=1e-9)
    assert rank == same == 4


@pytest.mark.parametrize("seed", range(5))
def test_a_column_that_is_there_twice_is_shared_and_costs_a_rank(seed):
    X, y = system(seed)
    twice = np.column_stack([X, X[:, 1]])
    solution, covariance, rank = solved(twice.T @ twice, twice.T @ y)
    assert rank == 4
    assert solution[1] == pytest.approx(solution[4])
    np.testing.assert_allclose(twice @ solution, X @ np.linalg.lstsq(X, y, rcond=None)[0], atol=1e-8)
    hidden = np.array([0.0, 1.0, 0.0, 0.0, -1.0])
    np.testing.assert_allclose(covariance @ hidden, 0.0, atol=1e-9)


def test_a_column_of_nothing_has_no_part_in_anything():
    X, y = system(1)
    empty = np.column_stack([X, np.zeros(len(X))])
    solution, covariance, rank = solved(empty.T @ empty, empty.T @ y)
    assert (solution[4], rank) == (0.0, 4)
    assert not covariance[4].any()
    np.testing.assert_allclose(solution[:4], np.linalg.lstsq(X, y, rcond=None)[0], atol=1e-9)


def test_no_parameter_at_all_is_no_trouble():
    solution, covariance, rank = solved(np.zeros((0, 0)), np.zeros(0))
    assert (solution.shape, covariance.shape, rank) == ((0,), (0, 0), 0)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_eigenvalues_rise_and_rebuild_the_matrix(count):
    X, _ = system(3, columns=count)
    gram = X.T @ X
    values, vectors = eigh(gram)
    assert (np.diff(values) >= 0.0).all()
    np.testing.assert_allclose(vectors @ np.diag(values) @ vectors.T, gram, atol=1e-9)
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(count), atol=1e-12)
