from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.logs import read
from mavcal.calib.recording import Channel, Sensor, Stage
from mavcal.calib.thermal.drift import DriftBlocks
from mavcal.calib.thermal.fit import fit_polynomial
from mavcal.calib.thermal.sweeps import cross_validated, hysteresis, judge_drift, sweeps

N = 4000
COEFFICIENTS = np.array([[7e-3, 6e-5, 1e-6], [-4e-3, -3e-5, 0.0], [9e-3, 4e-5, -2e-6]])
UP_AND_DOWN = 40.0 - 20.0 * np.cos(2 * np.pi * np.arange(N) / N)
TWICE = 40.0 - 20.0 * np.cos(4 * np.pi * np.arange(N) / N)


def gyro(values, rate=50.0):
    return Channel(Sensor.GYRO, 0, np.arange(len(values)) / rate, values, "rad/s", Stage.RAW, "test")


def drift(T):
    d = (T - 35.0)[:, None]
    return sum(COEFFICIENTS[:, j] * d ** (j + 1) for j in range(3))


def behind(T, seconds, rate=50.0):
    """`T` through a lag of first order."""
    decay = np.exp(-1.0 / rate / seconds)
    return lfilter([0.5 * (1 - decay)] * 2, [1.0, -decay], T - T[0]) + T[0]


@pytest.mark.parametrize(("tau", "said"), [(4.0, "sensor lags"), (-3.0, "thermometer lags")])
def test_the_lag_of_the_die_is_estimated_and_undone(tau, said):
    lagged = behind(UP_AND_DOWN, abs(tau))
    die, thermometer = (lagged, UP_AND_DOWN) if tau > 0 else (UP_AND_DOWN, lagged)
    rng = np.random.default_rng(1)
    nees = []
    for _ in range(8):
        fit = fit_polynomial(gyro(drift(die) + 0.002 * rng.normal(size=(N, 3))), thermometer)
        assert abs(fit.quality["lag_s"] - tau) < 4.0 * fit.quality["lag_sd_s"] + 0.02
        assert any(said in w for w in fit.warnings)
        error = fit.model.polynomial.coefficients - COEFFICIENTS
        for axis in range(3):
            rows = range(12 + 3 * axis, 15 + 3 * axis)
            nees.append(error[axis] @ np.linalg.solve(fit.covariance[np.ix_(rows, rows)], error[axis]) / 3)
    assert np.mean(nees) < 1.6
    ignored = fit_polynomial(gyro(drift(die)), thermometer, lag=False)
    assert ignored.quality["lag_s"] is None


def test_without_a_lag_none_is_found():
    rng = np.random.default_rng(2)
    for _ in range(5):
        assert (
            fit_polynomial(gyro(drift(UP_AND_DOWN) + 0.002 * rng.normal(size=(N, 3))), UP_AND_DOWN).quality["lag_s"]
            is None
        )


def test_one_way_tells_neither_lag_nor_hysteresis():
    T = 60.0 - 40.0 * np.exp(-np.arange(N) / 1500)
    fit = fit_polynomial(gyro(drift(behind(T, 4.0)) + 0.002 * np.random.default_rng(3).normal(size=(N, 3))), T)
    assert fit.quality["lag_s"] is None
    assert fit.quality["hysteresis"] is None
    assert fit.quality["cross_validation"] is None


def test_hysteresis_is_measured_and_one_loop_does_not_tell_it_from_a_wander():
    rng = np.random.default_rng(4)
    for T, told in ((np.tile(TWICE, 2), True), (UP_AND_DOWN, False)):
        loop = np.where(np.gradient(T) > 0, 0.5, -0.5)[:, None] * [0.06, 0.0, -0.04]
        fit = fit_polynomial(gyro(drift(T) + loop + 0.002 * rng.normal(size=(len(T), 3))), T, lag=False)
        assert fit.quality["hysteresis"] == pytest.approx([0.06, 0.0, -0.04], abs=0.004)
        assert any("differ in x by 0.06" in w for w in fit.warnings) == told


def blocks(T, values, degree=3):
    return DriftBlocks.of((T - 40.0) / 20.0, np.arange(len(T)) / 50.0, values, degree=degree)


def test_passages_of_the_temperature_are_sweeps():
    y = np.zeros((N, 3))
    assert len(sweeps(blocks(UP_AND_DOWN, y))) == 2
    assert len(sweeps(blocks(TWICE, y))) == 4
    assert len(sweeps(blocks(60.0 - 40.0 * np.exp(-np.arange(N) / 1500), y))) == 1


def test_a_drift_that_repeats_predicts_the_other_sweeps_and_one_that_does_not_is_declined():
    rng = np.random.default_rng(5)
    y = drift(TWICE) + 0.002 * rng.normal(size=(N, 3))
    fit = fit_polynomial(gyro(y), TWICE)
    assert fit.quality["cross_validation"]["sweeps"] == 4
    assert min(fit.quality["cross_validation"]["explained"]) > 0.99
    assert fit.status == FitStatus.OK
    sides = np.sign(np.sin(2 * np.pi * np.arange(N) / N))  # the second half runs the other way
    y[:, 0] = sides * (TWICE - 40.0) * 0.005 + 0.002 * rng.normal(size=N)
    other = fit_polynomial(gyro(y), TWICE)
    assert other.quality["cross_validation"]["explained"][0] < 0.0
    assert {"poly1_x", "poly2_x", "poly3_x"} <= set(other.undetermined)
    assert "sweeps disagree" in other.movements["poly1_x"]
    assert "poly1_y" not in other.undetermined


def test_noise_without_drift_is_not_declined():
    rng = np.random.default_rng(6)
    declined = [len(fit_polynomial(gyro(rng.normal(size=(N, 3))), TWICE).undetermined) for _ in range(10)]
    assert sum(declined) == 0


def test_one_sweep_only_is_not_judged():
    T = np.linspace(20.0, 60.0, N)
    assert cross_validated(blocks(T, drift(T))) is None
    assert hysteresis(blocks(T, drift(T)), 40.0, 20.0) is None


def test_a_fit_is_judged_on_another_record():
    rng = np.random.default_rng(7)
    fit = fit_polynomial(gyro(drift(UP_AND_DOWN) + 0.002 * rng.normal(size=(N, 3))), UP_AND_DOWN)
    same = judge_drift(fit, gyro(5.0 + drift(UP_AND_DOWN)), UP_AND_DOWN)
    assert same.explained == pytest.approx([1.0] * 3, abs=1e-3)
    opposite = judge_drift(fit, gyro(-drift(UP_AND_DOWN)), UP_AND_DOWN)
    assert (opposite.explained < -1.0).all()
    with pytest.raises(InvalidInputError, match="0 samples lie within"):
        judge_drift(fit, gyro(drift(UP_AND_DOWN)), UP_AND_DOWN + 80.0)
    with pytest.raises(InvalidInputError, match="no drift to judge"):
        judge_drift(dataclasses.replace(fit, status=FitStatus.REFUSED), gyro(drift(UP_AND_DOWN)), UP_AND_DOWN)


@pytest.mark.shared
def test_one_sweep_of_a_real_sensor_predicts_the_other(shared_data):
    names = {f"accel_{a}": f"acc_mps2_{k}" for k, a in enumerate("xyz")}
    names |= {f"gyro_{a}": f"gyro_mradps_{k}" for k, a in enumerate("xyz")}
    found = {}
    pair = [
        read(
            shared_data / "temp_cats_imu" / f"{file}.npz",
            mapping={**names, "t": "t_s", "temperature": "temp_C"},
            unit_gyro="mrad/s",
        )
        for file in ("dev_P0_z", "dev_P1_x")
    ]
    for sensor in (Sensor.ACCEL, Sensor.GYRO):
        (fitted, judge) = pair
        T = [r.channel(Sensor.TEMPERATURE).values[:, 0] for r in pair]
        fit = fit_polynomial(fitted.channel(sensor), T[0], degree=1, t_ref=10.0)
        found[sensor] = judge_drift(fit, judge.channel(sensor), T[1]).explained
        assert ("poly1_x" in fit.undetermined) == (sensor == Sensor.GYRO)
    assert (found[Sensor.ACCEL][1:] > 0.95).all()
    assert found[Sensor.GYRO][1] > 0.95
    assert found[Sensor.GYRO][0] == 0.0  # declined
