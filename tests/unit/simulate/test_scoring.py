"""Errors of a stored calibration against the truth, in units of what the fit stated for them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitResult, FitStatus, parameter_names
from mavcal.calib.recording import Sensor
from mavcal.calib.simulate.scoring import RecoveryScore, joint_p_value, score
from mavcal.calib.triad import ThermalPolynomial, TriadModel
from tests.examples import examples

OFFSETS = ("offset_x", "offset_y", "offset_z")


def fit_of(model, covariance=None, temperature=None):
    degree = 0 if model.polynomial is None else model.polynomial.coefficients.shape[1]
    size = 12 + 3 * degree
    known = {"method": "test", "sensor": Sensor.ACCEL, "instance": 0, "status": FitStatus.OK, "message": ""}
    numbers = {"n_samples": 9, "n_used": 9, "residual_rms": 0.0, "condition_number": 1.0, "unit": "m/s2"}
    stated = np.eye(size) if covariance is None else covariance
    return FitResult(**known, model=model, covariance=stated, temperature=temperature, **numbers)


def spd(seed, size):
    half = np.random.default_rng(seed).normal(size=(size, size))
    return half @ half.T + 0.1 * np.eye(size)


@settings(max_examples=examples(20), deadline=None)
@given(seed=st.integers(0, 200))
def test_errors_are_weighed_by_their_whole_covariance(seed):
    covariance = spd(seed, 3)
    errors = np.random.default_rng(seed + 1).normal(size=3)
    made = RecoveryScore(OFFSETS, errors, covariance)
    assert made.chi2 == pytest.approx(float(errors @ np.linalg.inv(covariance) @ errors))
    np.testing.assert_allclose(made.standardised, errors / np.sqrt(np.diag(covariance)))


@settings(max_examples=examples(20), deadline=None)
@given(units=st.lists(st.floats(-6.0, 6.0), min_size=3, max_size=3))
def test_units_of_the_parameters_do_not_matter(units):
    covariance, errors = spd(1, 3), np.array([1.0, -2.0, 0.5])
    size = 10.0 ** np.array(units)
    plain = RecoveryScore(OFFSETS, errors, covariance)
    scaled = RecoveryScore(OFFSETS, errors * size, covariance * np.outer(size, size))
    assert scaled.chi2 == pytest.approx(plain.chi2, rel=1e-6)


def test_errors_of_an_honest_fit_are_chi_square_distributed():
    covariance = spd(3, 3)
    draws = np.random.default_rng(4).multivariate_normal(np.zeros(3), covariance, size=4000)
    found = [RecoveryScore(OFFSETS, e, covariance).chi2 for e in draws]
    assert np.mean(found) == pytest.approx(3.0, rel=0.05)
    assert np.mean(np.array(found) > chi2.isf(0.05, 3)) == pytest.approx(0.05, abs=0.012)


def test_what_is_stored_is_compared_with_the_truth_and_not_with_the_fit():
    truth = TriadModel([0.1, 0.2, 0.3], np.diag([1.01, 0.99, 1.0]))
    stored = TriadModel([0.4, 0.2, 0.1], np.diag([1.0, 1.0, 1.0]))
    names = parameter_names(0)
    made = score(stored, fit_of(TriadModel([9.0, 9.0, 9.0])), truth, names)
    errors = dict(zip(made.names, made.errors, strict=True))
    assert [errors[name] for name in OFFSETS] == pytest.approx([0.3, 0.0, -0.2])
    assert made.errors[3:12].reshape(3, 3) == pytest.approx(np.diag([-0.01, 0.01, 0.0]))


def test_only_the_named_parameters_count_in_the_order_that_was_asked_for():
    covariance = np.diag(np.arange(1.0, 13.0))
    truth, stored = TriadModel(np.zeros(3)), TriadModel([1.0, 2.0, 3.0])
    made = score(stored, fit_of(truth, covariance), truth, ("offset_z", "offset_x"))
    np.testing.assert_allclose(made.errors, [3.0, 1.0])
    np.testing.assert_allclose(np.diag(made.covariance), [3.0, 1.0])


def test_a_rotation_of_the_whole_is_no_error_of_a_calibration():
    matrix = np.diag([1.1, 0.9, 1.0])
    turned = Rotation.from_rotvec([0.1, -0.2, 0.3]).as_matrix() @ matrix
    made = score(
        TriadModel(np.zeros(3), turned),
        fit_of(TriadModel(np.zeros(3))),
        TriadModel(np.zeros(3), matrix),
        parameter_names(0),
    )
    np.testing.assert_allclose(made.errors, 0.0, atol=1e-12)


def curve(coefficients, t_ref):
    return ThermalPolynomial(t_ref, -40.0, 90.0, np.array(coefficients, dtype=float))


def test_the_same_curve_about_another_reference_has_no_error():
    """p(T) = 2 (T - 20) + 0.5 (T - 20)^2 about 30 degC: slopes 12 and 0.5, and 70 that belong to the offset."""
    about_20 = TriadModel([1.0, 0.0, 0.0], np.eye(3), curve([[2.0, 0.5], [0.0, 0.0], [0.0, 0.0]], 20.0))
    about_30 = TriadModel([71.0, 0.0, 0.0], np.eye(3), curve([[12.0, 0.5], [0.0, 0.0], [0.0, 0.0]], 30.0))
    fit = fit_of(about_30, temperature=30.0)
    made = score(about_20, fit, about_30, parameter_names(2))
    np.testing.assert_allclose(made.errors, 0.0, atol=1e-9)
    off = score(about_20, fit_of(about_30, temperature=30.0), TriadModel([71.0, 0.0, 0.0]), parameter_names(2))
    named = dict(zip(made.names, off.errors, strict=True))
    curved = [value for name, value in named.items() if value and name not in OFFSETS]
    assert curved == pytest.approx([12.0, 0.5])


def test_offsets_are_compared_at_the_temperature_of_the_fit():
    warm = TriadModel(np.zeros(3), np.eye(3), curve([[0.1]] * 3, 25.0))
    flat = TriadModel(np.zeros(3), np.eye(3), curve([[0.0]] * 3, 25.0))
    for temperature, error in ((25.0, 0.0), (45.0, 2.0)):
        made = score(warm, fit_of(flat, temperature=temperature), flat, OFFSETS)
        np.testing.assert_allclose(made.errors, error)


def test_a_curve_of_more_terms_than_the_fit_has_cannot_be_compared():
    steep = TriadModel(np.zeros(3), np.eye(3), curve([[0.1, 0.2]] * 3, 25.0))
    flat = fit_of(TriadModel(np.zeros(3), np.eye(3), curve([[0.1]] * 3, 25.0)))
    with pytest.raises(InvalidInputError, match="the curve has more than 1 terms"):
        score(steep, flat, steep, OFFSETS)


def test_a_parameter_without_an_uncertainty_is_refused_by_name():
    covariance = np.eye(12)
    covariance[1, 1] = 0.0
    plain = TriadModel(np.zeros(3))
    with pytest.raises(InvalidInputError, match=r"the fit states no uncertainty for offset_y$"):
        score(plain, fit_of(plain, covariance), plain, OFFSETS)
    assert score(plain, fit_of(plain, covariance), plain, ("offset_x",)).chi2 == 0.0


def test_independent_fits_add_up_to_one_probability():
    one = RecoveryScore(("offset_x",), np.array([1.0]), np.eye(1))
    three = RecoveryScore(OFFSETS, np.array([2.0, 0.0, 0.0]), np.eye(3))
    total, freedom, p = joint_p_value((one, three))
    assert (total, freedom) == (pytest.approx(5.0), 4)
    assert p == pytest.approx(float(chi2.sf(5.0, 4)))
