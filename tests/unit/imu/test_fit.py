from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.imu import fit_imu
from mavcal.calib.recording import Sensor

G = 9.80665
SYMMETRIC = [0, 1, 2, 3, 7, 11, 4, 5, 8]


def errors(fits, unit):
    accel, gyro = fits
    return (
        np.concatenate([accel.model.offset - unit.accel_offset, (accel.model.matrix - unit.accel_matrix).ravel()]),
        np.concatenate([gyro.model.offset - unit.gyro_offset, (gyro.model.matrix - unit.gyro_matrix).ravel()]),
    )


def test_both_sensors_within_their_stated_uncertainty(recorded, true_unit):
    accel, gyro = fit_imu(*recorded(np.random.default_rng(1)))
    assert (accel.status, gyro.status) == (FitStatus.OK, FitStatus.OK)
    assert (accel.sensor, gyro.sensor) == (Sensor.ACCEL, Sensor.GYRO)
    for fit, error in zip((accel, gyro), errors((accel, gyro), true_unit), strict=True):
        assert np.abs(error / fit.sd).max() < 4.0
        assert fit.quality["poses"] == 16
        assert fit.quality["p_value"] > 1e-3
        assert fit.quality["white"]
        assert fit.warnings == ()
    assert accel.sd[3:].max() < 6e-4
    assert accel.quality["attitude_sd_deg"] < 0.05
    assert gyro.quality["attitude_sd_deg_per_min"] < 0.5


@pytest.mark.long
def test_the_stated_uncertainty_holds(recorded, true_unit):
    squares = []
    for seed in range(8):
        fits = fit_imu(*recorded(np.random.default_rng([2, seed]), poses=14))
        for fit, error in zip(fits, errors(fits, true_unit), strict=True):
            on = np.array(SYMMETRIC) if fit.sensor == Sensor.ACCEL else np.arange(12)
            covariance = fit.covariance[np.ix_(on, on)]
            squares.append(error[on] @ np.linalg.solve(covariance, error[on]) / len(on))
    assert 0.75 < np.mean(squares) < 1.3  # 168 degrees of freedom: 0.11


def test_a_general_minimiser_finds_the_same(recorded):
    """The same likelihood by another route: scipy, rotations by its own class, directions as plain vectors."""
    accel, gyro = recorded(np.random.default_rng(3), poses=10, hold=1.5, move=0.5)
    fits = fit_imu(accel, gyro)
    spans = np.array(fits[0].quality["spans"])
    noise, rate_noise = fits[0].quality["noise_sd"], np.array(fits[1].quality["noise_sd"])
    means = np.array([accel.between(*s).values.mean(axis=0) for s in spans])
    counts = np.array([len(accel.between(*s)) for s in spans])
    rests = np.vstack([gyro.between(*s).values for s in spans])
    half = 0.005

    def residuals(p):
        b, C, M, bg = p[:3], p[3:9][[0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(3, 3), p[9:18].reshape(3, 3), p[18:21]
        u = p[21:].reshape(-1, 3)
        found = [((means - b) - u @ np.linalg.inv(C)) * np.sqrt(counts)[:, None] / noise]
        found.append(1e6 * (np.linalg.norm(u, axis=1)[:, None] / G - 1.0))
        found.append(((rests.mean(axis=0) - bg) * np.sqrt(len(rests)) / rate_noise)[None])
        for k in range(len(spans) - 1):
            start, end = spans[k, 1], spans[k + 1, 0]
            inside = (gyro.t > start - half) & (gyro.t < end + half)
            step = np.minimum(gyro.t[inside] + half, end) - np.maximum(gyro.t[inside] - half, start)
            steps = Rotation.from_rotvec((gyro.values[inside] - bg) @ M.T * step[:, None]).as_matrix()
            body = functools.reduce(np.matmul, steps)
            sd = rate_noise.mean() * np.sqrt((end - start) * 0.01) * G
            found.append((u[k + 1] - body.T @ u[k])[None] / sd)
        return np.concatenate([part.ravel() for part in found])

    first = (means - fits[0].model.offset) @ fits[0].model.matrix
    start = np.concatenate([np.zeros(3), np.ones(3), np.zeros(3), np.eye(3).ravel(), np.zeros(3), first.ravel()])
    start[:9] += 0.001
    other = least_squares(residuals, start, method="trf", x_scale="jac", max_nfev=12).x
    sd = np.concatenate([fits[0].sd[SYMMETRIC], fits[1].sd[3:], fits[1].sd[:3]])
    ours = np.concatenate(
        [fits[0].values[SYMMETRIC], fits[1].model.matrix.ravel(), fits[1].model.offset],
    )
    # the three axes' noise is pooled there and told apart here, and so are the poses'
    assert np.abs((ours - other[:21]) / sd).max() < 0.5


def test_counts_give_the_scale_of_a_count(recorded, true_unit):
    accel, gyro = recorded(np.random.default_rng(4), poses=18)
    accel_counts = dataclasses.replace(accel, values=np.round(accel.values * 415.0) + 33000, unit="counts", quantum=1.0)
    gyro_counts = dataclasses.replace(gyro, values=np.round(gyro.values * -4770.0) + 32500, unit="counts", quantum=1.0)
    fits = fit_imu(accel_counts, gyro_counts)
    assert {fit.unit for fit in fits} == {"counts"}
    assert (
        np.abs((fits[0].model.matrix * 415.0 - true_unit.accel_matrix) / fits[0].sd[3:].reshape(3, 3)).max() < 4 * 415
    )
    gyro_sd = fits[1].sd[3:].reshape(3, 3)
    assert np.abs((fits[1].model.matrix * -4770.0 - true_unit.gyro_matrix) / gyro_sd).max() < 4 * 4770
    assert fits[0].native["units_per_si"][0] == pytest.approx(415.0 / 1.01, rel=2e-3)


@pytest.mark.long
@settings(max_examples=5)
@given(seed=st.integers(0, 2**31), scale=st.floats(0.75, 1.35), shift=st.floats(-1e5, 1e5))
def test_turning_scaling_and_shifting_the_data_moves_the_answer_accordingly(recorded_once, seed, scale, shift):
    accel, gyro, fits = recorded_once
    Q = Rotation.random(random_state=seed).as_matrix()
    turned = fit_imu(
        dataclasses.replace(accel, values=accel.values @ Q.T, t=accel.t + shift),
        dataclasses.replace(gyro, values=scale * gyro.values @ Q.T, t=gyro.t + shift),
    )
    assert turned[0].model.offset == pytest.approx(Q @ fits[0].model.offset, abs=2e-4)
    assert turned[0].model.matrix == pytest.approx(Q @ fits[0].model.matrix @ Q.T, abs=2e-5)
    assert turned[1].model.matrix == pytest.approx(Q @ fits[1].model.matrix @ Q.T / scale, abs=1e-4)
    assert turned[1].model.offset == pytest.approx(scale * Q @ fits[1].model.offset, abs=1e-5)


@pytest.fixture(scope="module")
def recorded_once():
    from tests.unit.imu.conftest import _recorded

    accel, gyro = _recorded(np.random.default_rng(5), poses=14)
    return accel, gyro, fit_imu(accel, gyro)


def test_the_upper_form_keeps_the_norm_and_turns_the_gyroscope_along(recorded):
    channels = recorded(np.random.default_rng(6))
    symmetric, upper = (fit_imu(*channels, form=form) for form in ("symmetric", "upper"))
    assert np.tril(upper[0].model.matrix, -1) == pytest.approx(np.zeros((3, 3)), abs=1e-12)
    Q = upper[0].model.matrix @ np.linalg.inv(symmetric[0].model.matrix)
    assert pytest.approx(np.eye(3), abs=1e-9) == Q @ Q.T
    assert upper[1].model.matrix == pytest.approx(Q @ symmetric[1].model.matrix, abs=1e-9)
    tk = upper[0].native["imu_tk"]
    assert np.array(tk["misalignment"]) @ np.diag(tk["scale"]) == pytest.approx(upper[0].model.matrix)


def test_without_a_turn_about_an_axis_its_column_is_open(recorded):
    axes = Rotation.from_rotvec([[a, 0, 0] for a in np.radians(np.arange(0, 720, 40))])
    accel, gyro = fit_imu(*recorded(np.random.default_rng(7), attitudes=axes))
    assert accel.status == FitStatus.REFUSED
    assert "offset_x" in accel.message
    assert "each side down" in accel.movements["offset_x"]
    assert gyro.status == FitStatus.PARTIAL
    open_ones = {f"matrix_{row}{column}" for row in "xyz" for column in "yz"}
    assert open_ones <= set(gyro.undetermined)
    assert "about y" in gyro.movements["matrix_yy"]
    assert set(gyro.movements) == set(gyro.undetermined)


def test_a_pose_that_was_bumped_is_left_out(recorded, true_unit):
    accel, gyro = recorded(np.random.default_rng(8), poses=22)
    values = accel.values.copy()
    start = 10 * 300
    values[start : start + 200] += [0.0, 0.6, 0.3]
    accel = dataclasses.replace(accel, values=values)
    fits = fit_imu(accel, gyro)
    assert fits[0].quality["poses_left_out"] == 1
    assert any("30." in text and "left out" in text for text in fits[0].warnings)
    for fit, error in zip(fits, errors(fits, true_unit), strict=True):
        assert np.abs(error / fit.sd).max() < 5.0


def test_movements_with_holes_and_clipped_ones_are_not_integrated(recorded, true_unit):
    accel, gyro = recorded(np.random.default_rng(9), poses=20)
    values = np.clip(gyro.values, -3.0, 3.0)
    clipped = int((np.abs(np.diff(np.abs(values) >= 3.0, axis=0)).sum(axis=1) > 0).sum())
    assert clipped > 0
    keep = np.ones(len(gyro), dtype=bool)
    keep[250:270] = False
    gyro = dataclasses.replace(gyro, values=values).take(keep)
    fits = fit_imu(accel, gyro)
    assert fits[1].quality["moves_left_out"] >= 2
    for fit, error in zip(fits, errors(fits, true_unit), strict=True):
        assert np.abs(error / fit.sd).max() < 4.5


def test_only_what_is_true_of_bad_input(recorded):
    accel, gyro = recorded(np.random.default_rng(10), poses=10, hold=1.5)

    def refused(a, g, **options):
        fits = fit_imu(a, g, **options)
        assert {fit.status for fit in fits} == {FitStatus.REFUSED}
        assert fits[0].undetermined
        assert fits[0].movements
        return fits[0].message

    nan = dataclasses.replace(accel, values=np.full_like(accel.values, np.nan))
    assert "0 finite samples" in refused(nan, gyro)
    assert "not gravity" in refused(dataclasses.replace(accel, values=accel.values / G), gyro)
    assert "constant" in refused(accel, dataclasses.replace(gyro, values=gyro.values * [1, 1, 0]))
    assert "still poses" in refused(accel.between(0.0, 6.0), gyro.between(0.0, 6.0))
    assert "together for 0.0 s" in refused(accel, dataclasses.replace(gyro, t=gyro.t + 1000.0))
    with pytest.raises(InvalidInputError, match="goes back"):
        fit_imu(dataclasses.replace(accel, t=accel.t[::-1]), gyro)
    with pytest.raises(InvalidInputError, match="gravity"):
        fit_imu(accel, gyro, gravity=-1.0)
    same = recorded(np.random.default_rng(11), attitudes=Rotation.from_rotvec(np.zeros((8, 3))))
    assert refused(*same)


def test_some_missing_samples_do_not_matter(recorded, true_unit):
    rng = np.random.default_rng(12)
    accel, gyro = recorded(rng, poses=14)
    values = accel.values.copy()
    values[rng.integers(0, len(values), 100), 1] = np.nan
    fits = fit_imu(dataclasses.replace(accel, values=values), gyro)
    assert np.abs(errors(fits, true_unit)[0] / fits[0].sd).max() < 4.0
