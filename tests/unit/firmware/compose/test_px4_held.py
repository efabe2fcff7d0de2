"""A drift whose terms PX4 would not save: what is written instead, and what it costs."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.firmware.compose.draft import Subject
from mavcal.calib.firmware.compose.plan import compose
from mavcal.calib.firmware.compose.px4_held import held_drift
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.firmware.values import FLT_EPSILON, retained
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import ThermalPolynomial

LOW, HIGH, REFERENCE = 12.0, 58.0, 35.0
EPSILON = np.float32(FLT_EPSILON)


def curve(*rows):
    return ThermalPolynomial(REFERENCE, LOW, HIGH, list(rows))


def drift(make_fit, polynomial, sensor=Sensor.GYRO):
    return make_fit(sensor, offset=[0.01, 0.02, 0.03], polynomial=polynomial, polynomial_sd=1e-9)


SMALL = curve([1.6e-4, -8.6e-7, -6.1e-9], [-3.7e-4, 7.4e-7, 9e-8], [3.4e-4, 5e-8, 1e-7])


def test_a_plan_holds_nothing_that_the_restart_would_take_away(px4_parameters, px4_fingerprint, make_fit):
    plan = compose([drift(make_fit, SMALL)], px4_parameters, px4_fingerprint)
    for change in plan.changes:
        if change.kind == "real32":
            assert retained(change.name, float(change.new)) == change.new, change.name
    (loss,) = [one for one in plan.losses if one.what == "terms of the drift"]
    assert "x: cubic" in loss.text
    assert "rad/s stay between 12 and 58 degC" in loss.text
    after = px4_parameters | {c.name: c.new for c in plan.changes}
    held = px4.calibration_in_force(after, Sensor.GYRO, 0)
    t = np.linspace(LOW, HIGH, 50)
    wanted = np.array([0.01, 0.02, 0.03]) + SMALL(t)
    missed = np.linalg.norm(held.offset + held.polynomial(t) - wanted, axis=1).max()
    assert missed <= loss.cost * 1.001
    assert loss.cost < 5e-4  # leaving all of them out as they are would cost 0.0017 rad/s


def test_what_can_be_held_is_written_as_it_was_measured(px4_parameters, px4_fingerprint, make_fit):
    fit = drift(make_fit, curve([1.6e-4, -8.6e-7, 4e-7], [0.0, 0.0, 0.0], [3.4e-4, 5e-7, 0.0]))
    held = held_drift(fit)
    assert (held.cost, held.fixed) == (0.0, ())
    np.testing.assert_array_equal(held.fit.covariance, fit.covariance)


@pytest.mark.parametrize("seed", range(20))
def test_no_other_choice_that_can_be_held_is_nearer(make_fit, seed):
    """Against a search of its own: fixed terms at zero or at the edge, the others by the normal equations."""
    random = np.random.default_rng(seed)
    rows = random.normal(size=(3, 3)) * [1e-4, random.choice([1e-6, 1e-7]), 1e-7]
    fit = drift(make_fit, curve(*rows))
    held = held_drift(fit)
    found = held.fit.model.polynomial.coefficients
    single = np.abs(found.astype(np.float32))
    assert ((single == 0.0) | (single > EPSILON)).all()
    d = np.linspace(LOW, HIGH, 201) - REFERENCE
    powers = np.stack([d, d**2, d**3], axis=1)
    for axis in range(3):
        mine = np.mean((powers @ (found[axis] - rows[axis])) ** 2)
        for third in (0.0, 1.1920931e-07, -1.1920931e-07):
            rest = powers @ rows[axis] - third * powers[:, 2]
            other = np.append(np.linalg.solve(powers[:, :2].T @ powers[:, :2], powers[:, :2].T @ rest), third)
            if (np.abs(other[:2]) > FLT_EPSILON).all():
                assert mine <= np.mean((powers @ (other - rows[axis])) ** 2) * (1.0 + 1e-6)


@pytest.mark.long
def test_the_stated_sd_is_that_of_the_fit_with_the_term_fixed(make_fit):
    """Monte Carlo: measured coefficients scatter by their covariance; so do the held ones by theirs."""
    random = np.random.default_rng(7)
    sd = np.array([2e-6, 1e-7, 5e-9])
    truth = np.array([1.6e-4, -8.6e-6, 1e-8])
    mean = drift(make_fit, curve(truth, truth, truth))
    covariance = mean.covariance.copy()
    covariance[12:, 12:] = np.kron(np.eye(3), np.diag(sd**2))
    stated = np.sqrt(np.diag(held_drift(dataclasses.replace(mean, covariance=covariance)).fit.covariance)[12:15])
    drawn = []
    for _ in range(400):
        row = truth + sd * random.normal(size=3)
        drawn.append(held_drift(drift(make_fit, curve(row, truth, truth))).fit.model.polynomial.coefficients[0])
    scatter = np.std(drawn, axis=0, ddof=1)
    assert stated[2] == scatter[2] == 0.0
    np.testing.assert_allclose(stated[:2], scatter[:2], rtol=0.12)


def test_the_sentence_names_axes_orders_and_cost(make_fit):
    held = held_drift(drift(make_fit, SMALL))
    text = held.text(Subject(Sensor.GYRO, 0))
    assert text.startswith("gyro 1")
    assert "1.2e-07" in text
    assert {axis for axis, _ in held.fixed} == {axis for axis in "xyz" if f"{axis}: " in text}
    assert all(order in text for _, orders in held.fixed for order in orders)
    assert f"{held.cost:.2g}" in text


def test_changes_that_ask_for_no_save_come_first(px4_parameters, px4_fingerprint, make_fit):
    in_force = {"TC_G_ENABLE": 1, "TC_G0_ID": 1310988, "TC_G0_TMIN": LOW, "TC_G0_TMAX": HIGH, "TC_G0_TREF": REFERENCE}
    in_force |= {f"TC_G0_X3_{axis}": 4e-7 for axis in range(3)}
    rows = [[1.6e-4, 8e-6, 4.5e-7]] * 3
    plan = compose([drift(make_fit, curve(*rows))], px4_parameters | in_force, px4_fingerprint)
    names = [c.name for c in plan.changes if c.name.startswith(("TC_G0_X1", "TC_G0_X2", "TC_G0_X3"))]
    assert names[:3] == ["TC_G0_X3_0", "TC_G0_X3_1", "TC_G0_X3_2"]
