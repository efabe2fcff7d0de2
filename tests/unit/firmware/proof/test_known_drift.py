from __future__ import annotations

import numpy as np

from mavcal.calib.firmware.proof.known_drift import DRIFT_PER_DEGC, UNKNOWN_TEMPERATURE, known_drift
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import ThermalPolynomial

CURVE = ThermalPolynomial(35.0, 10.0, 60.0, [[7e-4, 6e-6, 1e-8], [-4e-4, -3e-6, 2e-8], [9e-4, 4e-6, 0.0]])
ONE = np.ones((1, 1))


def test_the_shift_is_that_of_the_curve_and_clamps(make_fit):
    drift = known_drift(Sensor.GYRO, make_fit(Sensor.GYRO, polynomial=CURVE), None)
    np.testing.assert_allclose(drift.shift(20.0, [50.0, 80.0, None]), CURVE([50, 60, 20]) - CURVE(20.0), atol=1e-15)


def test_the_uncertainty_agrees_with_scattered_curves(make_fit):
    rng = np.random.default_rng(1)
    fit = make_fit(Sensor.GYRO, polynomial=CURVE, polynomial_sd=1e-5)
    drift = known_drift(Sensor.GYRO, fit, None)
    weights = np.array([[0.5, 0.5, 0.0], [0.0, 0.0, 1.0]])
    now = [40.0, 42.0, 55.0]
    sd = fit.sd[12:].reshape(3, 3)
    shifts = []
    for _ in range(4000):
        other = ThermalPolynomial(35.0, 10.0, 60.0, CURVE.coefficients + sd * rng.normal(size=(3, 3)))
        shifts.append((weights @ (other(np.array(now)) - other(20.0))).ravel())
    stated = drift.uncertainty(20.0, now, weights)
    np.testing.assert_allclose(stated, np.cov(np.transpose(shifts)), rtol=0.1, atol=0.05 * stated.max())


def test_an_axis_that_was_declined_may_have_moved(make_fit):
    declined = tuple(f"poly{k}_y" for k in (1, 2, 3))
    drift = known_drift(Sensor.GYRO, make_fit(Sensor.GYRO, polynomial=CURVE, undetermined=declined), None)
    assert drift.open_axes == (False, True, False)
    spread = drift.uncertainty(20.0, [30.0], ONE)
    np.testing.assert_allclose(np.sqrt(np.diag(spread)), [0.0, 10 * DRIFT_PER_DEGC[Sensor.GYRO], 0.0])


def test_without_a_curve_every_axis_may_have_moved_and_an_unknown_temperature_by_five_degrees():
    drift = known_drift(Sensor.ACCEL, None, None)
    assert not drift.shift(20.0, [30.0]).any()
    spread = drift.uncertainty(None, [30.0], ONE)
    np.testing.assert_allclose(np.sqrt(np.diag(spread)), [UNKNOWN_TEMPERATURE * DRIFT_PER_DEGC[Sensor.ACCEL]] * 3)
    in_force = known_drift(Sensor.ACCEL, None, CURVE)
    assert not in_force.uncertainty(20.0, [50.0], ONE).any()
