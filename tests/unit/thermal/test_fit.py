from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.recording import Channel, Sensor, Stage
from mavcal.calib.thermal.drift import DriftBlocks
from mavcal.calib.thermal.fit import fit_linear, fit_polynomial
from tests.examples import examples

T_S2 = np.array([25.0, 35.0, 45.0, 55.0, 65.0, 55.0, 45.0])
Y_S2 = np.array([400.0, 411.0, 419.0, 431.0, 440.0, 429.0, 420.0])
COEFFICIENTS = np.array([[7e-3, 6e-5, 1e-6], [-4e-3, -3e-5, 0.0], [9e-3, 4e-5, -2e-6]])


def channel(values, sensor=Sensor.GYRO, unit="rad/s", rate=50.0):
    values = np.asarray(values, dtype=float)
    values = np.column_stack([values] * 3) if values.ndim == 1 else values
    return Channel(sensor, 0, np.arange(len(values)) / rate, values, unit, Stage.RAW, "test")


def warm_up(n=4000):
    return 60.0 - 40.0 * np.exp(-np.arange(n) / (0.4 * n))


def up_and_down(n=4000):
    return 40.0 - 20.0 * np.cos(2 * np.pi * np.arange(n) / n)


def drift(T, coefficients=COEFFICIENTS, offset=(0.1, -0.2, 0.05)):
    d = (T - 35.0)[:, None]
    return offset + d * coefficients[:, 0] + d**2 * coefficients[:, 1] + d**3 * coefficients[:, 2]


def walk(rng, n, size):
    return size * np.cumsum(rng.normal(size=(n, 3)), axis=0) / np.sqrt(n)


def test_the_slope_of_the_specification():
    fit = fit_linear(channel(Y_S2, unit="counts"), T_S2, t_ref=25.0)
    assert fit.model.polynomial is not None
    assert fit.model.polynomial.coefficients[:, 0] == pytest.approx(0.990789473684, abs=1e-12)
    assert fit.native["intercepts"] == pytest.approx([400.197368421] * 3, abs=1e-9)
    assert fit.native["residual_sd"] == pytest.approx([0.884070] * 3, abs=1e-6)
    assert fit.sd[12:] == pytest.approx(0.026830, abs=1e-6)
    assert fit.model.apply([437.0] * 3, 53.0) == pytest.approx([409.257894737] * 3, abs=1e-9)


def test_the_slope_through_a_point_is_another_estimator():
    fit = fit_linear(channel(Y_S2), T_S2, t_ref=25.0, through=np.full(3, 400.0))
    assert fit.native["slopes"] == pytest.approx([0.997674] * 3, abs=1e-6)
    assert fit.native["form"] == "through_point"


def test_the_published_form_corrects_nothing_at_zero():
    zero, other = (fit_linear(channel(Y_S2), T_S2, t_ref=t) for t in (0.0, 25.0))
    assert zero.native["slopes"] == pytest.approx(other.native["slopes"], abs=1e-12)
    assert zero.native["intercepts"][0] == pytest.approx(400.197368421 - 25 * 0.990789473684, abs=1e-8)


def test_the_slopes_of_numpy():
    rng = np.random.default_rng(1)
    T = rng.uniform(10.0, 60.0, 500)
    y = rng.normal(size=(500, 3)) + np.outer(T, [1.0, -2.0, 0.3])
    fit = fit_linear(channel(y), T)
    assert fit.native["slopes"] == pytest.approx(np.polyfit(T, y, 1)[0], rel=1e-9)


def test_offsets_are_no_part_of_the_linear_method():
    fit = fit_linear(channel(Y_S2), T_S2)
    assert fit.status == FitStatus.OK
    assert fit.undetermined == ("offset_x", "offset_y", "offset_z")
    assert (fit.model.offset == 0.0).all()


def test_a_constant_axis_is_named_and_not_estimated():
    values = np.column_stack([Y_S2, Y_S2, np.zeros(7)])
    fit = fit_linear(channel(values), T_S2)
    assert fit.status == FitStatus.PARTIAL
    assert "poly1_z" in fit.undetermined
    assert fit.native["slopes"][2] is None
    assert fit.model.polynomial is not None
    assert fit.model.polynomial.coefficients[2, 0] == 0.0
    assert any("z reads one constant value" in w for w in fit.warnings)


def test_rows_pasted_again_count_as_weights_and_not_as_information():
    rng = np.random.default_rng(2)
    T = np.round(np.linspace(53.0, 41.0, 25))
    y = np.round(7.0 * T[:, None] + 5.0 * rng.normal(size=(25, 3)))
    once = fit_linear(channel(y), T)
    T2, y2 = np.concatenate([T, T[1:]]), np.concatenate([y, y[1:]])
    twice = fit_linear(channel(y2), T2)
    assert twice.quality["repeated_rows"] == 24
    assert any("24 of 49 rows repeat" in w for w in twice.warnings)
    assert twice.native["slopes"] == pytest.approx(np.polyfit(T2, y2, 1)[0], rel=1e-9)
    assert twice.sd[12:] == pytest.approx(once.sd[12:], rel=1e-9)
    assert once.quality["repeated_rows"] == 0


@settings(max_examples=examples(25), deadline=None)
@given(seed=st.integers(0, 1000), scale=st.floats(1e-3, 1e3), shift=st.floats(-100.0, 100.0), degree=st.integers(1, 4))
def test_another_unit_and_another_offset(seed, scale, shift, degree):
    rng = np.random.default_rng(seed)
    T = up_and_down(400)
    y = drift(T) + 0.01 * rng.normal(size=(400, 3))
    one = fit_polynomial(channel(y), T, degree=degree)
    other = fit_polynomial(channel(scale * (y + shift)), T, degree=degree)
    assert one.model.polynomial is not None
    assert other.model.polynomial is not None
    size = np.abs(one.model.polynomial.coefficients).max()
    assert other.model.polynomial.coefficients / scale == pytest.approx(
        one.model.polynomial.coefficients, rel=1e-5, abs=1e-7 * size
    )
    assert other.model.offset / scale - shift == pytest.approx(one.model.offset, abs=1e-7)


@pytest.mark.parametrize("degree", [1, 2, 3, 5])
def test_exact_data_give_the_exact_polynomial(degree):
    T = warm_up(600)
    truth = np.zeros((3, degree))
    truth[:, : min(3, degree)] = COEFFICIENTS[:, : min(3, degree)]
    d = (T - 35.0)[:, None, None] ** np.arange(1, degree + 1)
    fit = fit_polynomial(channel((d * truth).sum(axis=2) + np.array([0.1, 0.2, 0.3])), T, degree=degree)
    assert fit.model.polynomial is not None
    span = 40.0 ** np.arange(1, degree + 1)
    assert fit.model.polynomial.coefficients * span == pytest.approx(truth * span, abs=1e-8)
    assert fit.model.offset == pytest.approx([0.1, 0.2, 0.3], abs=1e-8)


@pytest.mark.sampled
@pytest.mark.parametrize("temperature", [warm_up, up_and_down])
@pytest.mark.parametrize("wander", [0.0, 0.05])
def test_errors_stay_within_their_sd_under_white_noise_and_under_a_walk(temperature, wander):
    rng = np.random.default_rng(3)
    n = 2000
    T = temperature(n)
    nees, inside = [], []
    for _ in range(60):
        fit = fit_polynomial(channel(drift(T) + 0.02 * rng.normal(size=(n, 3)) + walk(rng, n, wander)), T)
        assert fit.model.polynomial is not None
        for axis in range(3):
            rows = range(12 + 3 * axis, 15 + 3 * axis)
            if f"poly1_{'xyz'[axis]}" in fit.undetermined:
                continue
            error = fit.model.polynomial.coefficients[axis] - COEFFICIENTS[axis]
            nees.append(error @ np.linalg.solve(fit.covariance[np.ix_(rows, rows)], error) / 3.0)
            inside.append(np.abs(error) < 1.96 * fit.sd[list(rows)])
    assert len(nees) > 90
    assert np.mean(nees) < 1.4
    assert np.mean(inside) > 0.93


@pytest.mark.long
def test_white_noise_attains_the_bound():
    rng = np.random.default_rng(4)
    n = 2000
    T = up_and_down(n)
    X = (T - 35.0)[:, None] ** np.arange(4)
    information = X.T @ X / 0.02**2
    squares = []
    for _ in range(60):
        fit = fit_polynomial(channel(drift(T) + 0.02 * rng.normal(size=(n, 3))), T)
        assert fit.model.polynomial is not None
        error = np.column_stack(
            [fit.model.offset - (0.1, -0.2, 0.05), fit.model.polynomial.coefficients - COEFFICIENTS]
        )
        squares += [e @ information @ e / 4.0 for e in error]
    assert np.sqrt(np.mean(squares)) <= 1.03 + 2.0 / np.sqrt(2 * 180 * 4)


def test_a_walk_is_reported_against_what_white_noise_would_say():
    rng = np.random.default_rng(5)
    T = up_and_down(2000)
    calm = fit_polynomial(channel(drift(T) + 0.02 * rng.normal(size=(2000, 3))), T)
    wild = fit_polynomial(channel(drift(T) + 0.02 * rng.normal(size=(2000, 3)) + walk(rng, 2000, 0.1)), T)
    assert min(calm.quality["probability_of_white_noise"]) > 0.2
    assert max(p for p in wild.quality["probability_of_white_noise"] if p is not None) < 1e-3
    assert np.nanmean(wild.sd[12:]) > 5.0 * np.mean(calm.sd[12:])


def test_an_axis_that_only_wanders_is_declined_by_name():
    rng = np.random.default_rng(6)
    T = warm_up(3000)
    y = drift(T) + 0.002 * rng.normal(size=(3000, 3))
    y[:, 0] = 0.1 + 0.002 * rng.normal(size=3000) + walk(rng, 3000, 0.3)[:, 0]
    fit = fit_polynomial(channel(y), T)
    assert fit.status == FitStatus.PARTIAL
    assert {"poly1_x", "poly2_x", "poly3_x", "offset_x"} == set(fit.undetermined)
    assert any("x wanders" in w and "not repeatable" in w for w in fit.warnings)
    assert fit.model.polynomial is not None
    assert (fit.model.polynomial.coefficients[0] == 0.0).all()


def test_the_offset_of_an_accelerometer_in_one_pose_is_unknown_and_of_a_gyroscope_known():
    T = warm_up(1000)
    y = drift(T) + 0.01 * np.random.default_rng(7).normal(size=(1000, 3))
    accel = fit_polynomial(channel(y, Sensor.ACCEL, "m/s2"), T)
    assert accel.status == FitStatus.OK
    assert accel.undetermined == ("offset_x", "offset_y", "offset_z")
    assert (accel.model.offset == 0.0).all()
    assert not accel.covariance[:3].any()
    gyro = fit_polynomial(channel(y), T)
    assert gyro.undetermined == ()
    assert np.abs((gyro.model.offset - (0.1, -0.2, 0.05)) / gyro.sd[:3]).max() < 4.0


def test_a_narrow_span_is_refused_by_name():
    T = np.linspace(30.0, 36.0, 500)
    fit = fit_polynomial(channel(drift(T)), T)
    assert fit.status == FitStatus.REFUSED
    assert "6.0 degC (30.0 to 36.0)" in fit.message
    assert "cold board" in fit.message
    assert fit_polynomial(channel(drift(T)), T, min_span=5.0).status == FitStatus.OK


def test_a_thermal_lag_is_noticed():
    n = 4000
    time = np.arange(n) / 50.0
    T = up_and_down(n)
    die = np.interp(time - 4.0, time, T)
    noise = 0.002 * np.random.default_rng(8).normal(size=(n, 3))
    lagging = fit_polynomial(channel(drift(die) + noise), T)
    assert lagging.quality["lag_s"] == pytest.approx(4.0, rel=0.3)
    assert any("lags its thermometer" in w for w in lagging.warnings)
    assert fit_polynomial(channel(drift(T) + noise), T).quality["lag_s"] is None


@pytest.mark.parametrize("noise", [0.5, 0.2, 0.05])
def test_coarse_bins_are_resolved_through_the_drift(raw_channel, noise):
    rng = np.random.default_rng(9)
    n, q = 3000, 0.01
    T = up_and_down(n)
    z = []
    for _ in range(6):
        values = drift(T, offset=(0.001, -0.2, 0.05)) + noise * q * rng.normal(size=(n, 3))
        fit = fit_polynomial(raw_channel(Sensor.GYRO, np.arange(n) / 50.0, values, "rad/s", quantum=q), T)
        assert fit.model.polynomial is not None
        error = fit.model.polynomial.coefficients - COEFFICIENTS
        z.append((error.ravel() / fit.sd[12:])[~np.isnan(fit.sd[12:])])
    z = np.concatenate(z)
    assert len(z) > 30
    assert np.abs(z).max() < 4.5
    assert np.mean(np.square(z)) < 1.6


def test_an_axis_in_one_bin_has_no_drift_to_see(raw_channel):
    T = warm_up(800)
    values = np.column_stack([drift(T)[:, 0], np.full(800, 0.0002), np.full(800, -0.0003)])
    fit = fit_polynomial(raw_channel(Sensor.GYRO, np.arange(800) / 50.0, values, "rad/s", quantum=1e-3), T)
    assert fit.status == FitStatus.PARTIAL
    assert any("below one bin" in w for w in fit.warnings)
    quiet = raw_channel(Sensor.GYRO, np.arange(800) / 50.0, np.zeros((800, 3)), "rad/s", quantum=1e-3)
    whole = fit_polynomial(quiet, T)
    assert whole.status == FitStatus.PARTIAL
    assert len(whole.undetermined) == 12


def test_an_axis_on_too_few_levels_cannot_be_resolved(raw_channel):
    T = warm_up(800)
    values = np.column_stack([drift(T)[:, 0], 0.0005 + 1e-5 * (T - 20.0) + 0.0003, drift(T)[:, 2]])
    fit = fit_polynomial(raw_channel(Sensor.GYRO, np.arange(800) / 50.0, values, "rad/s", quantum=1e-3), T)
    assert "poly1_y" in fit.undetermined
    assert any("too few levels" in w for w in fit.warnings)


def test_a_dead_sensor_is_refused():
    fit = fit_polynomial(channel(np.zeros((500, 3))), warm_up(500))
    assert fit.status == FitStatus.REFUSED
    assert "stuck" in fit.message


def test_rows_without_numbers_are_left_out_and_counted():
    T = warm_up(900)
    y = drift(T)
    y[::10, 1] = np.nan
    fit = fit_polynomial(channel(y), np.where(np.arange(900) % 10 == 5, np.nan, T))
    assert (fit.n_samples, fit.n_used) == (900, 720)
    assert any("180 rows" in w for w in fit.warnings)


@pytest.mark.parametrize("n", [0, 1, 4])
def test_too_few_rows(n):
    assert fit_linear(channel(np.zeros((n, 3))), np.linspace(20.0, 60.0, n)).status == FitStatus.REFUSED


def test_two_temperatures_do_not_make_a_cubic():
    T = np.repeat([20.0, 60.0], 50)
    assert "different temperatures" in fit_polynomial(channel(drift(T)), T).message


def test_impossible_input_is_an_error():
    y = channel(drift(warm_up(100)))
    with pytest.raises(InvalidInputError, match="degree"):
        fit_polynomial(y, warm_up(100), degree=9)
    with pytest.raises(InvalidInputError, match="one temperature a row"):
        fit_polynomial(y, warm_up(99))
    with pytest.raises(InvalidInputError, match="three axes"):
        fit_linear(dataclasses.replace(y, values=y.values[:, :2]), warm_up(100))


def test_counting_equal_samples_gives_the_same_answer_as_listing_them(raw_channel, monkeypatch):
    rng = np.random.default_rng(10)
    T = np.round(warm_up(3000), 2)
    values = drift(T, offset=(0.01, 0.0, -0.003)) + 3e-4 * rng.normal(size=(3000, 3))
    coarse = raw_channel(Sensor.GYRO, np.arange(3000) / 50.0, values, "rad/s", quantum=1e-3)
    listed = fit_polynomial(coarse, T)
    monkeypatch.setattr("mavcal.calib.thermal.fit._MANY", 100)
    counted = fit_polynomial(coarse, T)
    assert np.abs((counted.values - listed.values) / np.where(listed.sd > 0, listed.sd, 1.0)).max() < 1e-4


def test_every_open_parameter_has_its_remedy_and_every_fit_its_residuals():
    T = warm_up(1000)
    y = drift(T) + 0.01 * np.random.default_rng(11).normal(size=(1000, 3))
    accel = fit_polynomial(channel(y, Sensor.ACCEL, "m/s2"), T)
    line = fit_linear(channel(np.column_stack([y[:, :2], np.zeros(1000)])), T)
    assert set(accel.movements) == set(accel.undetermined)
    assert "accel-thermal" in accel.movements["offset_x"]
    assert "gyro-rest" in line.movements["offset_x"]
    assert "finer resolution" in line.movements["poly1_z"]
    assert accel.quality["p_value"] > 1e-3
    assert accel.quality["white"]
    assert accel.quality["attitude_sd_deg"] == pytest.approx(np.degrees(max(accel.quality["drift_sd"]) / 9.80665))
    gyro = fit_polynomial(channel(y), T)
    assert gyro.quality["attitude_sd_deg_per_min"] > 0.0
    refusal = fit_polynomial(channel(y), np.linspace(30.0, 31.0, 1000))
    assert "cold board" in refusal.movements["poly1_x" if "poly1_x" in refusal.movements else "offset_x"]


def test_a_walk_shows_in_the_residuals():
    rng = np.random.default_rng(12)
    T = up_and_down(2000)
    wild = fit_polynomial(channel(drift(T) + 0.02 * rng.normal(size=(2000, 3)) + walk(rng, 2000, 0.1)), T)
    assert wild.quality["p_value"] < 1e-3
    assert not wild.quality["white"]


def test_rows_out_of_order_are_sorted():
    rng = np.random.default_rng(13)
    T = warm_up(1000)
    straight = channel(drift(T) + 0.01 * rng.normal(size=(1000, 3)))
    order = rng.permutation(1000)
    shuffled = fit_polynomial(
        dataclasses.replace(straight, t=straight.t[order], values=straight.values[order]), T[order]
    )
    assert shuffled.values == pytest.approx(fit_polynomial(straight, T).values, abs=1e-12)
    assert any("ran backwards" in w for w in shuffled.warnings)


def test_spikes_are_left_out_and_counted():
    rng = np.random.default_rng(14)
    T = warm_up(1000)
    y = drift(T) + 0.01 * rng.normal(size=(1000, 3))
    calm = fit_polynomial(channel(y), T)
    y[[100, 700], [0, 2]] = [500.0, -800.0]
    spiked = fit_polynomial(channel(y), T)
    assert any("2 rows lie far" in w for w in spiked.warnings)
    known = calm.sd > 0
    assert np.abs((spiked.values - calm.values)[known] / calm.sd[known]).max() < 0.5


@pytest.mark.parametrize("t", [np.linspace(430.0, 612.0, 500), np.linspace(2000.0, 6000.0, 500)])
def test_raw_temperatures_are_refused(t):
    fit = fit_polynomial(channel(drift(warm_up(500))), t)
    assert fit.status == FitStatus.REFUSED
    assert "no degrees Celsius" in fit.message


def test_six_channels_of_a_far_offset_lose_no_digits():
    rng = np.random.default_rng(15)
    x = np.linspace(-1.0, 1.0, 3000)
    y = np.outer(x, np.arange(1.0, 7.0)) + 1e-3 * rng.normal(size=(3000, 6))
    near, far = (DriftBlocks.of(x, x + 1.0, y + shift, degree=3) for shift in (0.0, 1e7))
    assert far.ordinary[1:] == pytest.approx(near.ordinary[1:], abs=1e-7)
    assert far.residual_sd() == pytest.approx(near.residual_sd(), rel=1e-4)
    forced = DriftBlocks.of(x, x + 1.0, y + 5.0, degree=2, origin=np.full(6, 5.0))
    assert forced.ordinary == pytest.approx(np.linalg.lstsq(x[:, None] ** [1, 2], y, rcond=None)[0], abs=1e-9)
