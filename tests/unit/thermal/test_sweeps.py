from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import lfilter

from mavcal.calib.fit import FitStatus
from mavcal.calib.logs import read
from mavcal.calib.recording import Channel, Sensor, Stage
from mavcal.calib.thermal.drift import DriftBlocks, DriftData
from mavcal.calib.thermal.fit import fit_polynomial
from mavcal.calib.thermal.sweeps import (
    Die,
    DriftPrediction,
    both_ways,
    cross_validated,
    hysteresis,
    rates,
    sweeps,
    thermal_lag,
)
from tests.unit.thermal.judged import judge_drift

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


def blocks_of(T, y=None):
    """One block a row: the temperature in degC about 40, scaled by 20, over a second a row."""
    x = (np.asarray(T) - 40.0) / 20.0
    series = np.zeros((len(x), 3)) if y is None else y
    design = np.column_stack([np.ones(len(x)), x])
    return DriftBlocks(
        design, series, np.ones(len(x)), np.arange(len(x)) * 1.0, design.T @ design, np.zeros((2, 3)), np.zeros(3), 9
    )


def ramps(*turns, step=1.0):
    """A temperature that goes from one turn to the next in steps."""
    pieces = [np.arange(a, b, step if b > a else -step) for a, b in pairwise(turns)]
    return np.concatenate([*pieces, turns[-1:]])


def die_over(T, seconds):
    time = np.linspace(0.0, seconds, len(T))
    return Die(time, T, np.gradient(T, time))


def test_a_die_without_lag_has_the_temperature_of_its_thermometer():
    die = die_over(30.0 + np.sin(np.linspace(0.0, 6.0, 500)), 100.0)
    at = np.array([0.0, 33.3, 100.0])
    assert die.at(at, 0.0) == pytest.approx(np.interp(at, die.time, die.temperature))


@pytest.mark.parametrize("lag", [0.5, 5.0, 40.0])
def test_a_die_behind_a_steady_rise_is_lag_times_rate_colder(lag):
    die = die_over(20.0 + 0.3 * np.linspace(0.0, 100.0, 500), 100.0)
    at = np.array([0.0, 10.0, 99.0])
    assert die.at(at, lag) == pytest.approx(20.0 + 0.3 * (at - lag))
    assert die.at(at, -lag) == pytest.approx(20.0 + 0.3 * (at + lag))


def test_a_die_obeys_its_equation_of_first_order():
    """``T = T_die + tau dT_die/dt``, for a temperature that is no straight line."""
    time = np.linspace(0.0, 200.0, 4096)
    die = die_over(40.0 + 10.0 * np.sin(0.05 * time), 200.0)
    for lag in (3.0, 20.0):
        behind_it = die.at(time, lag)
        again = behind_it + lag * np.gradient(behind_it, time)
        assert again[5:-5] == pytest.approx(die.temperature[5:-5], abs=1e-3)


def test_the_rate_is_degrees_a_second_and_none_where_time_stands():
    blocks = blocks_of([20.0, 22.0, 26.0, 30.0])
    assert rates(blocks, 40.0, 20.0).tolist() == pytest.approx([2.0, 3.0, 4.0, 4.0])
    stands = dataclasses.replace(blocks, time=np.array([0.0, 1.0, 1.0, 2.0]))
    assert not rates(stands, 40.0, 20.0).any()
    assert rates(blocks_of([20.0, 30.0]), 40.0, 20.0).tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("up", "down", "slow", "told"),
    [
        (22, 3, 0, True),  # twelve in a hundred of the moving time
        (23, 2, 0, False),
        (3, 22, 0, True),
        (20, 3, 0, False),  # too few blocks to say
        (23, 2, 40, False),  # what hardly moves is neither
        (22, 3, 40, True),
    ],
)
def test_a_tenth_of_the_moving_time_goes_the_other_way(up, down, slow, told):
    rate = np.concatenate([np.full(up, 1.0), np.full(down, -0.5), np.full(slow, -0.05)])
    assert both_ways(rate) is told


def test_a_temperature_that_stands_goes_neither_way():
    assert not both_ways(np.zeros(100))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_warming_less_cooling_is_the_hysteresis(sign):
    T = ramps(20.0, 60.0, 20.0)
    warms = np.gradient(T) > 0.0
    rng = np.random.default_rng(5)
    y = np.outer(T, [0.1, 0.0, 0.0]) + np.outer(np.where(warms, 0.5, -0.5), [0.0, sign, 0.0])
    difference, sd = hysteresis(blocks_of(T, y + 0.01 * rng.normal(size=(len(T), 3))), 40.0, 20.0)
    assert difference == pytest.approx([0.0, sign, 0.0], abs=0.03)
    assert (sd > 0.0).all()
    assert (sd < 0.05).all()


@pytest.mark.parametrize(
    ("turns", "lengths"),
    [
        ((20.0, 60.0), [41]),
        ((60.0, 20.0), [41]),
        ((20.0, 60.0, 20.0), [41, 41]),
        ((20.0, 60.0, 20.0, 60.0), [41, 41, 41]),
        ((20.0, 60.0, 55.0, 60.0), [51]),  # a small dip is no turn
        ((20.0, 60.0, 50.0, 60.0, 20.0), [41, 41]),  # one that turns and covers less than two fifths is no sweep
        ((20.0, 60.0, 42.0), [41, 19]),
    ],
)
def test_a_sweep_is_a_passage_through_two_fifths_of_the_span(turns, lengths):
    assert [len(part) for part in sweeps(blocks_of(ramps(*turns)))] == lengths


def test_sweeps_that_disagree_are_judged_by_each_other_alone():
    """A drift that changes sign between two sweeps: each is predicted with twice its own scatter."""
    T = ramps(20.0, 60.0, 20.0)
    first = np.arange(len(T)) <= 40
    y = np.outer(np.where(first, T - 40.0, 40.0 - T), [1.0, 0.0, 0.0])
    found = cross_validated(blocks_of(T, y))
    assert found.after[0] == pytest.approx(2.0 * found.before[0], rel=0.1)  # the turn itself is in both
    assert found.explained[0] == pytest.approx(-3.0, abs=0.6)


def test_sweeps_that_agree_explain_all_of_each_other():
    T = ramps(20.0, 60.0, 20.0)
    found = cross_validated(blocks_of(T, np.outer(T, [1.0, -2.0, 0.5])))
    assert found.explained == pytest.approx(np.ones(3))
    assert found.before == pytest.approx(np.std(ramps(20.0, 60.0)) * np.array([1.0, 2.0, 0.5]), rel=0.02)


def test_sweeps_of_few_blocks_are_not_judged():
    assert cross_validated(blocks_of(ramps(20.0, 60.0, 20.0, step=20.0))) is None
    assert cross_validated(blocks_of(ramps(20.0, 60.0, 20.0, step=10.0))) is not None


def test_what_a_correction_takes_away_is_a_share_of_the_variance():
    found = DriftPrediction(np.array([2.0, 1.0, 0.0]), np.array([1.0, 2.0, 0.0]))
    assert found.explained.tolist() == [0.75, -3.0, 1.0]


def test_no_axis_shows_no_lag():
    T = UP_AND_DOWN
    data = DriftData.of(gyro(drift(behind(T, 4.0)) + 1e-4 * np.random.default_rng(6).normal(size=(N, 3))), T)
    blocks = data.blocks((T - 40.0) / 20.0, 3)
    die = Die.of(data.time, T, blocks, rates(blocks, 40.0, 20.0))
    assert thermal_lag(blocks, die, 40.0, 20.0, np.ones(3, dtype=bool)).seconds == pytest.approx(4.0, abs=0.3)
    assert thermal_lag(blocks, die, 40.0, 20.0, np.zeros(3, dtype=bool)) is None


def test_a_record_is_judged_within_the_range_of_its_fit():
    rng = np.random.default_rng(7)
    fit = fit_polynomial(gyro(drift(UP_AND_DOWN) + 1e-4 * rng.normal(size=(N, 3))), UP_AND_DOWN)
    T = np.linspace(0.0, 60.0, 384)
    record = gyro(drift(T) + np.where(T < 20.0, 50.0, 0.0)[:, None])  # what lies outside is nonsense
    assert (judge_drift(fit, record, T).explained > 0.99).all()
    holed = record.values.copy()
    holed[200:300] = np.nan
    assert (judge_drift(fit, dataclasses.replace(record, values=holed), T).explained > 0.99).all()
