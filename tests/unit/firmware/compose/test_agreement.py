"""A change that is smaller than its uncertainty is no plan, least of all one with a restart."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.firmware.compose.plan import ComposeOptions, compose
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import ThermalPolynomial

CURVE = ThermalPolynomial(25.0, 10.0, 60.0, [[7e-3, 6e-5, 1e-7], [-4e-3, -3e-5, 2e-7], [9e-3, 4e-5, 0.0]])


def written(plan, parameters):
    return {**parameters, **{change.name: change.new for change in plan.changes}}


def moved(fit, deviations):
    """The same fit a degree warmer, with offsets that lie so many standard deviations away."""
    offset = fit.model.offset + np.array(deviations) * fit.sd[:3]
    model = dataclasses.replace(fit.model, offset=offset)
    return dataclasses.replace(fit, model=model, temperature=fit.temperature + 1.0)


@pytest.fixture(params=["ardupilot", "px4"])
def vehicle(request):
    """Parameters and fingerprint of either autopilot."""
    return request.getfixturevalue(f"{request.param}_parameters"), request.getfixturevalue(
        f"{request.param}_fingerprint"
    )


def fit_of(make_fit, sensor):
    known = {"offset": [0.31, -0.22, 0.17], "matrix": np.diag([1.05, 0.93, 1.06])}
    if sensor == Sensor.GYRO:
        return make_fit(Sensor.GYRO, offset=[0.031, -0.022, 0.017], offset_sd=1e-4)
    if sensor == Sensor.ACCEL:
        return make_fit(Sensor.ACCEL, **known, offset_sd=2e-3, matrix_sd=2e-4)
    return make_fit(Sensor.MAG, offset=[13.0, -22.0, 31.0], matrix=known["matrix"], offset_sd=0.05, matrix_sd=1e-3)


@pytest.mark.parametrize("sensor", [Sensor.GYRO, Sensor.ACCEL, Sensor.MAG])
def test_a_repeated_calibration_writes_nothing_and_says_by_how_much_it_differs(vehicle, make_fit, sensor):
    parameters, fingerprint = vehicle
    fit = fit_of(make_fit, sensor)
    first = compose([fit], parameters, fingerprint)
    assert first.changes
    assert not first.agreements
    now = written(first, parameters)

    again = compose([moved(fit, [0.5, -0.4, 0.3])], now, fingerprint)
    assert again.changes == ()
    assert again.blockers == ()
    assert again.nothing_to_write
    assert not again.needs_reboot
    (agrees,) = again.agreements
    parts = {Sensor.GYRO: 3, Sensor.ACCEL: 6, Sensor.MAG: 9}[sensor]
    assert agrees.deviation == pytest.approx(np.sqrt(0.25 / parts), rel=1e-2)
    assert f"{sensor} 1 agrees with what is in force: differs by {agrees.deviation:.1f} sd" in again.warnings[0]

    off = compose([moved(fit, [7.0, 0.0, 0.0])], now, fingerprint)
    assert {c.sensor for c in off.changes if not c.session} == {sensor}
    assert not off.agreements


@pytest.mark.parametrize(
    ("deviations", "agrees"),
    [([2.27] * 3, True), ([2.29] * 3, False), ([3.94, 0, 0], True), ([3.96, 0, 0], False)],
)
def test_the_whole_change_is_judged_against_the_95_percent_region(
    ardupilot_parameters, ardupilot_fingerprint, make_fit, deviations, agrees
):
    """7.815 is the 95 % quantile of chi-squared with three degrees of freedom: twice that is 3 x 2.283^2, 3.953^2."""
    fit = fit_of(make_fit, Sensor.GYRO)
    now = written(compose([fit], ardupilot_parameters, ardupilot_fingerprint), ardupilot_parameters)
    plan = compose([moved(fit, deviations)], now, ardupilot_fingerprint)
    assert bool(plan.agreements) == agrees


def test_the_covariance_decides_and_not_the_single_deviations(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    fit = fit_of(make_fit, Sensor.GYRO)
    now = written(compose([fit], ardupilot_parameters, ardupilot_fingerprint), ardupilot_parameters)
    tied = fit.covariance.copy()
    tied[0, 1] = tied[1, 0] = 0.99 * tied[0, 0]
    along, across = ([2.5, 2.5, 0.0], [2.5, -2.5, 0.0])
    plans = [
        compose([dataclasses.replace(moved(fit, d), covariance=tied)], now, ardupilot_fingerprint)
        for d in (along, across)
    ]
    assert [bool(plan.agreements) for plan in plans] == [True, False]


def test_one_gyro_that_moved_is_written_without_the_one_that_agrees(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    fits = [make_fit(Sensor.GYRO, i, offset=[0.01, 0.02, 0.03]) for i in (0, 1)]
    now = written(compose(fits, ardupilot_parameters, ardupilot_fingerprint), ardupilot_parameters)
    plan = compose([moved(fits[0], [9, 0, 0]), fits[1]], now, ardupilot_fingerprint)
    assert {c.instance for c in plan.changes} == {0}
    assert [a.instance for a in plan.agreements] == [1]
    assert not plan.blockers


def test_keeping_the_gyro_offsets_at_boot_is_planned_although_they_agree(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    fit = fit_of(make_fit, Sensor.GYRO)
    now = written(compose([fit], ardupilot_parameters, ardupilot_fingerprint), ardupilot_parameters)
    plan = compose([moved(fit, [0, 0, 0])], now, ardupilot_fingerprint, options=ComposeOptions(keep_gyro_at_boot=True))
    assert [(c.name, c.new) for c in plan.changes] == [("INS_GYR_CAL", 0)]
    assert not any("next boot" in text for text in plan.warnings)


def test_a_first_calibration_is_written_however_small_it_is(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    """An offset of exactly zero means "never calibrated" to the firmware, which then refuses to arm."""
    fit = make_fit(Sensor.ACCEL, offset=[1e-4, 0, 0], offset_sd=2e-3, matrix_sd=2e-4)
    plan = compose([fit], ardupilot_parameters, ardupilot_fingerprint)
    assert any(c.name == "INS_ACCOFFS_X" for c in plan.changes)


def test_a_temperature_that_becomes_known_is_written(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    """Otherwise the thermal job would ask for this one again and again."""
    fit = fit_of(make_fit, Sensor.ACCEL)
    now = written(compose([fit], ardupilot_parameters, ardupilot_fingerprint), ardupilot_parameters)
    plan = compose([moved(fit, [0.1, 0, 0])], now | {"INS_ACC1_CALTEMP": -300.0}, ardupilot_fingerprint)
    assert {c.name: c.new for c in plan.changes}["INS_ACC1_CALTEMP"] == 33.0


def test_a_drift_is_judged_as_a_whole_and_by_its_range(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    fit = make_fit(Sensor.GYRO, offset=[0.01, 0.02, 0.03], polynomial=CURVE, polynomial_sd=1e-4)
    now = written(compose([fit], ardupilot_parameters, ardupilot_fingerprint), ardupilot_parameters)
    plan = compose([moved(fit, [0.3, -0.2, 0.1])], now, ardupilot_fingerprint)
    assert plan.nothing_to_write
    assert plan.agreements[0].deviation < 1.0

    other = dataclasses.replace(CURVE, coefficients=1.5 * CURVE.coefficients)
    steeper = make_fit(Sensor.GYRO, offset=[0.01, 0.02, 0.03], polynomial=other, polynomial_sd=1e-4)
    assert any("TCAL1_GYR1" in c.name for c in compose([steeper], now, ardupilot_fingerprint).changes)

    wider = make_fit(
        Sensor.GYRO,
        offset=[0.01, 0.02, 0.03],
        polynomial=dataclasses.replace(CURVE, t_max=70.0),
        polynomial_sd=1e-4,
    )
    assert not compose([wider], now, ardupilot_fingerprint).agreements


def test_what_px4_cannot_hold_is_not_said_to_agree(px4_parameters, px4_fingerprint, make_fit):
    """A scale of 1.004 never reaches its memory: the row stays neutral, and the loss stays announced."""
    fit = make_fit(Sensor.MAG, offset=[0.3, 0.2, 0.1], matrix=1.004 * np.eye(3), offset_sd=0.01, matrix_sd=1e-4)
    plan = compose([fit], px4_parameters, px4_fingerprint)
    assert plan.nothing_to_write
    assert plan.agreements[0].text.startswith("what can be stored of mag 1 agrees")
    assert {loss.what for loss in plan.losses} == {"scale", "offset"}


def test_px4_does_not_restart_for_the_noise_of_a_scale_beside_an_offset(px4_parameters, px4_fingerprint, make_fit):
    scales = np.array([1.05, 0.93, 1.06])
    known = {"offset_sd": 2e-3, "matrix_sd": 2e-4}
    first = make_fit(Sensor.ACCEL, offset=[0.31, -0.22, 0.17], matrix=np.diag(scales), **known)
    now = written(compose([first], px4_parameters, px4_fingerprint), px4_parameters)
    noisy = make_fit(Sensor.ACCEL, offset=[0.51, -0.22, 0.17], matrix=np.diag(scales + 1e-4), **known)
    plan = compose([noisy], now, px4_fingerprint)
    assert {c.name for c in plan.changes if not c.session} == {"CAL_ACC0_XOFF"}
    assert not plan.needs_reboot
    changed = make_fit(Sensor.ACCEL, offset=[0.51, -0.22, 0.17], matrix=np.diag(scales + 2e-3), **known)
    assert compose([changed], now, px4_fingerprint).needs_reboot
