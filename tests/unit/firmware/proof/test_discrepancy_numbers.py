"""The discrepancy agrees with finite differences, and its covariance with floors that are written out."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.firmware.proof.discrepancy import (
    BeforeAfter,
    Expected,
    covariance,
    discrepancy,
    expected_of,
    true_magnitude,
)
from mavcal.calib.firmware.proof.evidence import StillMean
from mavcal.calib.firmware.proof.known_drift import known_drift
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import ThermalPolynomial, TriadModel

STABILITY = {Sensor.ACCEL: 1e-3, Sensor.GYRO: 5e-5, Sensor.MAG: 0.05}
EARTH_RATE = 7.292115e-5
ATTITUDE = np.radians(0.05)
PER_DEGC = {Sensor.ACCEL: 5e-3, Sensor.GYRO: 5e-4, Sensor.MAG: 0.0}
SIZE = {Sensor.ACCEL: 9.8, Sensor.GYRO: 0.02, Sensor.MAG: 45.0}
CURVE = ThermalPolynomial(25.0, 10.0, 60.0, [[7e-3, 6e-5], [-4e-3, -3e-5], [9e-3, 4e-5]])
WHOLE = TriadModel([0.3, -0.2, 0.1], [[1.1, 0.03, 0.01], [0.02, 0.9, -0.04], [0.0, 0.05, 1.2]])
HEATS = (30.2, 33.9, 30.6, 41.0)
RESTS = (0, 0, 0, 1)


def spread(rng, scale, size=3):
    root = scale * rng.normal(size=(size, size))
    return root @ root.T


class Case:
    """A capture as a function of what was read and fitted."""

    def __init__(self, make_fit, sensor, *, before=True, drift=True, heats=HEATS, moving=0, magnitude=None, opened=()):
        rng = np.random.default_rng(3)
        self.sensor, self.heats = sensor, heats
        size = SIZE[sensor]
        self.means = size * rng.normal(size=(1 + len(heats) + moving, 3))
        self.spreads = [spread(rng, 1e-3 * size) for _ in self.means]
        self.moving = moving
        self.before = before
        self.magnitude = true_magnitude(sensor) if magnitude is None else magnitude
        self.at_rest = make_fit(sensor, offset=[0.2, 0.1, -0.3], matrix=np.eye(3) + 0.03 * rng.normal(size=(3, 3)))
        self.at_rest = dataclasses.replace(
            self.at_rest, covariance=spread(rng, 1e-3, 12), residual_rms=0.07, temperature=28.0
        )
        self.drift = make_fit(sensor, polynomial=CURVE, polynomial_sd=1e-4, undetermined=opened) if drift else None

    def __call__(self, move=0.0, *, means=None, fit=None, curve=None):
        """The capture with its means, the parameters of the fits or the coefficients of the curve moved."""
        means = self.means if means is None else means
        offset_matrix = np.zeros(12) if fit is None else fit[:12]
        model = dataclasses.replace(
            self.at_rest.model,
            offset=self.at_rest.model.offset + offset_matrix[:3],
            matrix=self.at_rest.model.matrix + offset_matrix[3:].reshape(3, 3),
        )
        moves, drift = known_drift(self.sensor, self.drift, None), self.drift
        if drift is not None:
            moves = self._curve(moves, np.zeros(6) if curve is None else curve)
        believed = moves if fit is None or drift is None else self._curve(moves, fit[12:])
        expected = expected_of(dataclasses.replace(self.at_rest, model=model), drift, believed, self.magnitude)
        after = tuple(
            StillMean(100.0 + 10.0 * k, means[1 + k], self.spreads[1 + k], heat, rest=rest, temperature_sd=0.1 * k)
            for k, (heat, rest) in enumerate(zip(self.heats, RESTS, strict=False))
        )
        first = 1 + len(after)
        moving = tuple(StillMean(200.0, means[k], self.spreads[k], 35.0) for k in range(first, first + self.moving))
        then = StillMean(90.0, means[0], self.spreads[0], 29.0, rest=0) if self.before else None
        raw = WHOLE.invert(means[0]) if self.before else None
        return BeforeAfter(self.sensor, then, raw, after, (*after, *moving), expected, moves, restarted=False)

    @staticmethod
    def _curve(moves, change):
        assert moves.polynomial is not None
        coefficients = moves.polynomial.coefficients + change.reshape(3, 2)
        return dataclasses.replace(moves, polynomial=dataclasses.replace(moves.polynomial, coefficients=coefficients))


def undo(readings):
    return WHOLE.invert(np.array([r.mean for r in readings]))


def derivative(vector, size, step):
    columns = [(vector(step * row) - vector(-step * row)) / (2 * step) for row in np.eye(size)]
    return np.array(columns).T


def propagated(case, *, equality):
    """How noise of readings and fits enters the discrepancy."""
    count = case.means.size
    readings = derivative(
        lambda z: discrepancy(case(means=case.means + z.reshape(-1, 3)), undo, equality=equality), count, 1e-5
    )
    noise = np.zeros((count, count))
    for k, block in enumerate(case.spreads):
        noise[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = block
    expected = case().expected
    fitted = derivative(lambda z: discrepancy(case(fit=z), undo, equality=equality), len(expected.covariance), 1e-6)
    found = readings @ noise @ readings.T + fitted @ expected.covariance @ fitted.T
    if case.drift is not None and equality:
        moved = derivative(lambda z: discrepancy(case(curve=z), undo, equality=True), 6, 1e-6)
        moved[3 * len(case().weights) :] = 0.0  # what the lengths owe to the curve is in the fits
        found += moved @ case.drift.covariance[12:, 12:] @ moved.T
    return found


def stale(case, weights):
    heats = np.array(case.heats)
    sds = 0.1 * np.arange(len(heats))
    return np.diag((weights @ (CURVE(heats + sds) - CURVE(heats))).ravel() ** 2)


WEIGHTS = np.array([[0.5, 0, 0.5, 0], [0, 1, 0, 0]])
"""30.2 and 30.6 degC are one temperature; the last reading is of another rest, in which only a gyroscope may be."""


@pytest.mark.parametrize("sensor", [Sensor.ACCEL, Sensor.MAG])
def test_vectors_before_and_after_and_lengths_have_the_covariance_of_their_causes(make_fit, sensor):
    case = Case(make_fit, sensor, moving=2 if sensor == Sensor.MAG else 0, magnitude=48.0)
    capture = case()
    np.testing.assert_array_equal(capture.weights, WEIGHTS)
    vector = WHOLE.invert(case.means[1:5]) - (CURVE(np.array(HEATS)) - CURVE(29.0))
    change = WEIGHTS @ vector - WHOLE.invert(case.means[0])
    heats = np.array([r.temperature for r in capture.invariant])
    offset = case.at_rest.model.offset + CURVE(heats) - CURVE(28.0)
    true = (undo(capture.invariant) - offset) @ case.at_rest.model.matrix.T
    lengths = np.sqrt((true**2).sum(axis=1)) - 48.0
    np.testing.assert_allclose(
        discrepancy(capture, undo, equality=True), np.r_[change.ravel(), lengths], rtol=1e-12, atol=1e-12
    )
    np.testing.assert_allclose(discrepancy(capture, undo, equality=False), lengths, rtol=1e-12)

    floor = np.zeros((6 + len(lengths),) * 2)
    first = np.linalg.inv(WHOLE.matrix) @ capture.after[0].mean
    turned = np.array([ATTITUDE * np.cross(axis, first) for axis in np.eye(3)])
    floor[:6, :6] = np.kron(np.ones((2, 2)), turned.T @ turned) + STABILITY[sensor] ** 2 * np.eye(6)
    floor[:6, :6] += stale(case, WEIGHTS)
    floor[6:, 6:] = (0.07**2 + STABILITY[sensor] ** 2) * np.eye(len(lengths))
    expected = propagated(case, equality=True) + floor
    found = covariance(capture, WHOLE, undo, equality=True)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-9 * expected.max())
    alone = covariance(capture, WHOLE, undo, equality=False)
    np.testing.assert_allclose(alone, expected[6:, 6:], rtol=1e-5, atol=1e-9 * expected.max())


def test_lengths_of_an_unknown_field_and_of_an_open_axis_may_be_off_alike(make_fit):
    case = Case(make_fit, Sensor.MAG)
    field = covariance(case(), WHOLE, undo, equality=False)
    np.testing.assert_allclose(
        field, propagated(case, equality=False) + (0.07**2 + 0.05**2) * np.eye(4) + 100.0**2, rtol=1e-5
    )
    case = Case(make_fit, Sensor.ACCEL, opened=("poly1_y", "poly2_y"))
    slope = derivative(lambda z: discrepancy(case(fit=z), undo, equality=False), 18, 1e-6)[:, 1]
    found = covariance(case(), WHOLE, undo, equality=False)
    far = (5e-3 * (41.0 - 28.0)) ** 2 * np.outer(slope, slope)
    np.testing.assert_allclose(
        found, propagated(case, equality=False) + (0.07**2 + 1e-3**2) * np.eye(4) + far, rtol=1e-5
    )


@pytest.mark.parametrize("drift", [True, False])
def test_a_gyro_at_rest_is_compared_in_every_rest_and_may_have_drifted(make_fit, drift):
    case = Case(make_fit, Sensor.GYRO, drift=drift)
    capture = case()
    weights = np.vstack([WEIGHTS, [0, 0, 0, 1]])
    np.testing.assert_array_equal(capture.weights, weights)
    found = covariance(capture, WHOLE, undo, equality=True)
    walk = 1.5e-5 * np.array([(10.0 + 30.0) / 2, 20.0, 40.0])
    own = EARTH_RATE**2 + STABILITY[Sensor.GYRO] ** 2
    expected = propagated(case, equality=True) + np.kron(np.outer(walk, walk) + own * np.eye(3), np.eye(3))
    if drift:
        expected += stale(case, weights)
    else:
        moved = 5e-4 * np.array([(1.2 + 1.6) / 2, 4.9, 12.0])
        expected += np.kron(np.outer(moved, moved), np.eye(3))
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-15)


@pytest.mark.parametrize("opened", [(), ("poly1_y", "poly2_y")])
def test_a_gyro_without_a_capture_before_is_held_against_zero(make_fit, opened):
    case = Case(make_fit, Sensor.GYRO, before=False, opened=opened)
    capture = case()
    assert capture.zero_rate
    heats = np.array(HEATS)
    mean = (
        (undo(capture.after) - case.at_rest.model.offset - CURVE(heats) + CURVE(28.0)) @ case.at_rest.model.matrix.T
    ).mean(axis=0)
    np.testing.assert_allclose(discrepancy(capture, undo, equality=True), mean, rtol=1e-12)
    far = 13.0 * 5e-4 * case.at_rest.model.matrix[:, 1] if opened else np.zeros(3)
    expected = propagated(case, equality=False) + (EARTH_RATE**2 + 5e-5**2) * np.eye(3) + np.outer(far, far)
    found = covariance(capture, WHOLE, undo, equality=False)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-12)


def test_what_no_capture_says_is_not_compared(make_fit):
    capture = Case(make_fit, Sensor.ACCEL)()
    blind = dataclasses.replace(capture, expected=None)
    assert discrepancy(blind, undo, equality=False).shape == (0,)
    assert len(discrepancy(blind, undo, equality=True)) == 6
    assert len(covariance(blind, WHOLE, undo, equality=True)) == 6
    assert (capture.equality, capture.lengths, capture.zero_rate) == (True, True, False)
    assert not dataclasses.replace(capture, after=()).equality
    assert not dataclasses.replace(capture, raw_before=None).equality
    assert not blind.lengths
    assert not dataclasses.replace(capture, invariant=()).lengths
    assert len(discrepancy(dataclasses.replace(capture, invariant=()), undo, equality=True)) == 6
    assert len(discrepancy(Case(make_fit, Sensor.ACCEL, before=False)(), undo, equality=True)) == 4


def test_readings_without_a_temperature_are_one_group_and_stand_where_the_fit_stands(make_fit):
    case = Case(make_fit, Sensor.ACCEL, heats=(30.0, None, 36.2, None))
    capture = case()
    np.testing.assert_array_equal(capture.weights, [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]])
    unmoved = np.array([30.0, 28.0, 36.2, 28.0])
    offset = case.at_rest.model.offset + CURVE(unmoved) - CURVE(28.0)
    true = (undo(capture.after) - offset) @ case.at_rest.model.matrix.T
    np.testing.assert_allclose(
        discrepancy(capture, undo, equality=False), np.linalg.norm(true, axis=1) - 9.80665, rtol=1e-12
    )


class TestExpected:
    def test_nothing_fitted_is_nothing_expected(self):
        assert expected_of(None, None, known_drift(Sensor.GYRO, None, None), 0.0) is None

    def test_an_undetermined_parameter_may_be_ten_units_off(self, make_fit):
        fit = make_fit(Sensor.ACCEL, undetermined=("offset_y", "matrix_xz"), offset_sd=0.5, matrix_sd=0.25)
        found = expected_of(fit, None, known_drift(Sensor.ACCEL, None, None), 9.8)
        assert isinstance(found, Expected)
        wanted = np.array([0.25, 100.0, 0.25] + [0.0625] * 2 + [100.0] + [0.0625] * 6)
        np.testing.assert_allclose(np.diag(found.covariance), wanted)
        assert (found.reference, found.misfit, found.magnitude) == (32.0, 0.0, 9.8)

    def test_a_drift_alone_stands_at_its_own_reference_with_its_own_correlations(self, make_fit):
        fit = make_fit(Sensor.ACCEL, offset=[0.3, 0.2, 0.1], polynomial=CURVE, residual_rms=np.nan)
        fit = dataclasses.replace(fit, covariance=spread(np.random.default_rng(1), 1e-3, 18))
        found = expected_of(None, fit, known_drift(Sensor.ACCEL, fit, None), 9.8)
        np.testing.assert_array_equal(found.covariance, fit.covariance)
        assert (found.reference, found.misfit) == (25.0, 0.0)
        assert found.model.polynomial is CURVE
        assert found.model.offset.tolist() == [0.3, 0.2, 0.1]

    def test_without_a_temperature_the_curve_cannot_be_used(self, make_fit):
        rest = make_fit(Sensor.ACCEL, offset=[0.3, 0.2, 0.1], temperature=None, residual_rms=0.02)
        drift = make_fit(Sensor.ACCEL, polynomial=CURVE)
        found = expected_of(rest, drift, known_drift(Sensor.ACCEL, drift, None), 9.8)
        assert found.model.polynomial is None
        assert found.reference is None
        assert found.misfit == 0.02
        assert found.model.offset.tolist() == [0.3, 0.2, 0.1]
        assert found.covariance.shape == (18, 18)
        assert not found.covariance[:12, 12:].any()
