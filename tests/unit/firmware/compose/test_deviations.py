"""Every planned number carries its own standard deviation, in its own unit."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.firmware.compose.ardupilot import ardupilot_coefficients
from mavcal.calib.firmware.compose.plan import compose
from mavcal.calib.fit import parameter_names
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import ThermalPolynomial

ELEMENTS = ("xx", "yy", "zz", "xy", "xz", "yz")
SDS = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]) * 1e-3


def scaled(make_fit, sensor, matrix):
    """A fit about the identity whose nine elements have nine standard deviations."""
    names = parameter_names()
    covariance = np.zeros((12, 12))
    for sd, axis in zip(SDS, "xyz", strict=False):
        covariance[names.index(f"offset_{axis}"), names.index(f"offset_{axis}")] = sd**2
    for sd, element in zip(SDS[3:], ELEMENTS, strict=True):
        both = [names.index(f"matrix_{element}"), names.index(f"matrix_{element[::-1]}")]
        covariance[np.ix_(both, both)] = sd**2
    return dataclasses.replace(make_fit(sensor, offset=[13.0, -22.0, 31.0], matrix=matrix), covariance=covariance)


MATRIX = np.array([[1.05, 0.02, 0.03], [0.02, 0.93, -0.02], [0.03, -0.02, 1.06]])


def test_a_compass_of_ardupilot_in_milligauss_and_pure_numbers(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    plan = compose([scaled(make_fit, Sensor.MAG, MATRIX)], ardupilot_parameters, ardupilot_fingerprint)
    planned = {c.name: c for c in plan.changes}
    for k, axis in enumerate("XYZ"):
        assert planned[f"COMPASS_OFS_{axis}"].new == pytest.approx(-10 * [13.0, -22.0, 31.0][k])
        assert planned[f"COMPASS_OFS_{axis}"].sd == pytest.approx(10 * SDS[k])
        assert planned[f"COMPASS_OFS_{axis}"].unit == "mGauss"
        # small cross terms mix the elements by some per cent
        assert planned[f"COMPASS_DIA_{axis}"].sd == pytest.approx(SDS[3 + k], rel=0.06)
        assert planned[f"COMPASS_ODI_{axis}"].sd == pytest.approx(SDS[6 + k], rel=0.06)


def test_a_compass_of_px4_in_gauss_and_pure_numbers(px4_parameters, px4_fingerprint, make_fit):
    plan = compose([scaled(make_fit, Sensor.MAG, MATRIX)], px4_parameters, px4_fingerprint)
    planned = {c.name: c for c in plan.changes}
    for k, axis in enumerate("XYZ"):
        assert planned[f"CAL_MAG0_{axis}OFF"].new == pytest.approx([0.13, -0.22, 0.31][k])
        assert planned[f"CAL_MAG0_{axis}OFF"].sd == pytest.approx(0.01 * SDS[k])
        assert planned[f"CAL_MAG0_{axis}OFF"].unit == "gauss"
        assert planned[f"CAL_MAG0_{axis}SCALE"].sd == pytest.approx(SDS[3 + k], rel=0.06)
        assert planned[f"CAL_MAG0_{axis}ODIAG"].sd == pytest.approx(SDS[6 + k], rel=0.06)


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_an_accelerometer_in_its_own_unit(request, make_fit, autopilot):
    fit = scaled(make_fit, Sensor.ACCEL, np.diag([1.05, 0.93, 1.06]))
    fit = dataclasses.replace(fit, model=dataclasses.replace(fit.model, offset=np.array([0.3, -0.2, 0.1])))
    known, whose = (request.getfixturevalue(f"{autopilot}_{what}") for what in ("parameters", "fingerprint"))
    planned = {c.name: c for c in compose([fit], known, whose).changes}
    offset, scale = (
        ("INS_ACCOFFS_{}", "INS_ACCSCAL_{}") if autopilot == "ardupilot" else ("CAL_ACC0_{}OFF", "CAL_ACC0_{}SCALE")
    )
    for k, axis in enumerate("XYZ"):
        assert planned[offset.format(axis)].sd == pytest.approx(SDS[k])
        assert planned[offset.format(axis)].unit == "m/s2"
        assert planned[scale.format(axis)].sd == pytest.approx(SDS[3 + k], rel=1e-6)


CURVE = ThermalPolynomial(25.0, 10.0, 60.0, [[7e-5, 6e-7, 4e-7], [-4e-5, -3e-7, 2e-7], [9e-5, 4e-7, 3e-7]])


@pytest.fixture
def drift(make_fit):
    fit = make_fit(Sensor.GYRO, offset=[0.01, 0.02, 0.03], polynomial=CURVE)
    root = np.random.default_rng(3).normal(size=(9, 9)) * np.tile([1e-6, 1e-8, 1e-10], 3)[:, None]
    covariance = fit.covariance.copy()
    covariance[12:, 12:] = root @ root.T
    return dataclasses.replace(fit, covariance=covariance)


def test_a_drift_on_ardupilot_is_that_of_the_curve_about_35_degrees(ardupilot_parameters, ardupilot_fingerprint, drift):
    planned = {c.name: c for c in compose([drift], ardupilot_parameters, ardupilot_fingerprint).changes}
    for axis, letter in enumerate("XYZ"):
        start = np.zeros((3, 3))

        def moved(step, axis=axis, start=start):
            change = start.copy()
            change[axis] = step
            return ardupilot_coefficients(dataclasses.replace(CURVE, coefficients=change))[axis]

        jacobian = np.array([moved(row) for row in np.eye(3)]).T
        rows = slice(12 + 3 * axis, 15 + 3 * axis)
        sd = np.sqrt(np.diag(jacobian @ drift.covariance[rows, rows] @ jacobian.T))
        for order in (1, 2, 3):
            change = planned[f"INS_TCAL1_GYR{order}_{letter}"]
            assert change.sd == pytest.approx(sd[order - 1], rel=1e-9)
            assert change.unit == f"1e-6 rad/s/degC^{order}"
            assert change.new == pytest.approx(ardupilot_coefficients(CURVE)[axis, order - 1], rel=1e-6)
    # a + 2 b d + 3 c d^2 with d = 10, in millionths
    assert planned["INS_TCAL1_GYR1_X"].new == pytest.approx(70.0 + 20 * 0.6 + 300 * 0.4, rel=1e-6)


def test_a_drift_on_px4_is_the_curve_as_it_is(px4_parameters, px4_fingerprint, drift):
    plan = compose([drift], px4_parameters, px4_fingerprint)
    planned = {c.name: c for c in plan.changes}
    sd = np.sqrt(np.diag(drift.covariance)[12:]).reshape(3, 3)
    for axis in range(3):
        for order in (1, 2, 3):
            change = planned[f"TC_G0_X{order}_{axis}"]
            assert change.new == pytest.approx(CURVE.coefficients[axis, order - 1], rel=1e-6)
            assert change.sd == pytest.approx(sd[axis, order - 1])
            assert change.unit == f"rad/s/degC^{order}"
    assert not any("is not determined" in text for text in plan.warnings)


@pytest.mark.parametrize("name", ["poly1_y", "poly3_y"])
@pytest.mark.parametrize(("autopilot", "stem"), [("ardupilot", "INS_TCAL1_GYR{}_Y"), ("px4", "TC_G0_X{}_1")])
def test_an_axis_of_which_any_power_is_open_is_not_compensated(request, drift, autopilot, stem, name):
    known, whose = (request.getfixturevalue(f"{autopilot}_{what}") for what in ("parameters", "fingerprint"))
    plan = compose([dataclasses.replace(drift, undetermined=(name,))], known, whose)
    planned = {c.name: c for c in plan.changes}
    assert "gyro 1: the drift of the y axis is not determined and is not compensated" in plan.warnings
    assert [(planned[stem.format(k)].new, planned[stem.format(k)].sd) for k in (1, 2, 3)] == [(0.0, None)] * 3
