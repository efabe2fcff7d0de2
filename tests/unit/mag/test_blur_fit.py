"""The uncertainty of a compass that is limited by how well its averaging is known, not by its noise."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.fit import FitStatus
from mavcal.calib.mag.blur import axes_of_gyro, rates_during
from mavcal.calib.mag.blur_fit import fit_ellipsoid_deblurred
from mavcal.calib.mag.samples import not_repeated
from mavcal.calib.recording import Sensor
from mavcal.service.simvehicle.rotation import mounting_matrix
from tests.unit.mag.turned import deviations, turned

SEEDS = range(100, 112)


def fits(seed: int, rate: float, noise: float, seconds: float = 25.0):
    """Fits of the three compasses of a simulated vehicle, and their truth."""
    made = turned(seed, rate, noise, seconds)
    (gyro,) = made.recording.find(Sensor.GYRO)
    found = []
    for k, truth in enumerate(made.truth):
        mag = made.recording.channel(Sensor.MAG, k)
        rates = rates_during(mag.t, gyro.t, gyro.values, 0.1)
        found.append((fit_ellipsoid_deblurred(mag.values, rates, quantum=mag.quantum, field=made.field), truth))
    return found


@pytest.fixture(scope="module")
def nearly_noiseless():
    return [[deviations(fit, truth) for fit, truth in fits(seed, 55.0, 0.0002, 12.0)] for seed in SEEDS]


@pytest.mark.long
def test_the_stated_uncertainty_of_a_nearly_noise_free_compass_is_true(nearly_noiseless) -> None:
    """With the noise alone the rms of error over sd is 2.1, the largest 10, and 72 % of the intervals hold."""
    found = np.array(nearly_noiseless)[:, 0]
    assert 0.5 < np.sqrt(np.mean(found**2)) < 1.15
    assert np.mean(np.abs(found) < 1.96) > 0.93
    assert np.abs(found).max() < 4.0


@pytest.mark.long
def test_the_stated_uncertainty_of_a_compass_in_whole_milligauss_is_true_and_no_larger(nearly_noiseless) -> None:
    found = np.array(nearly_noiseless)[:, 1:]
    assert 0.8 < np.sqrt(np.mean(found**2)) < 1.2
    assert 0.91 < np.mean(np.abs(found) < 1.96) < 0.99


@pytest.mark.long
def test_the_stated_uncertainty_of_a_noisy_compass_is_true() -> None:
    """Noise of 5 mG at 55 deg/s, where nothing but that noise counts."""
    found = np.array([deviations(fit, truth) for seed in SEEDS for fit, truth in fits(seed, 55.0, 0.5, 30.0)])
    assert 0.85 < np.sqrt(np.mean(found**2)) < 1.15
    assert 0.91 < np.mean(np.abs(found) < 1.96) < 0.985


def test_a_compass_without_noise_is_not_taken_for_one_full_of_outliers() -> None:
    """Before the blur is computed back, a third of its samples are many of its standard deviations off."""
    (fit, truth), *_ = fits(111, 70.0, 0.0002)
    assert fit.status == FitStatus.OK
    assert np.abs(deviations(fit, truth)).max() < 4.0


def test_noise_that_is_larger_than_any_blur_is_the_whole_uncertainty() -> None:
    """The sd is that of the same samples without any turning to doubt, within two per cent."""
    made = turned(7, 55.0, 0.5, 25.0)
    (gyro,) = made.recording.find(Sensor.GYRO)
    mag = made.recording.channel(Sensor.MAG, 0)
    rates = rates_during(mag.t, gyro.t, gyro.values, 0.1)
    rows = rates.sharp()
    doubted = fit_ellipsoid_deblurred(mag.values[rows], rates.take(rows))
    plain = fit_ellipsoid_deblurred(mag.values[rows], rates_during(mag.t[rows], gyro.t, gyro.values, 0.0))
    np.testing.assert_allclose(doubted.sd, plain.sd, rtol=0.02)


def test_a_reading_that_repeats_the_last_one_counts_once() -> None:
    samples = np.array([[1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [1.0, 2.0, 3.1], [1.0, 2.0, 3.0]])
    assert not_repeated(samples).tolist() == [True, False, True, True]


def test_the_axes_of_the_gyro_are_found_from_the_turning_itself() -> None:
    made = turned(3, 55.0, 0.2, 25.0)
    (gyro,) = made.recording.find(Sensor.GYRO)
    mag = made.recording.channel(Sensor.MAG, 0)
    rates = rates_during(mag.t, gyro.t, gyro.values, 0.1)
    (fit, _), *_ = fits(3, 55.0, 0.2)
    directions = fit.model.apply(mag.values) / made.field.norm
    keep = rates.known
    np.testing.assert_array_equal(axes_of_gyro(directions[keep], rates.take(keep)), np.eye(3))
    turned_by = mounting_matrix(6)  # yaw 270
    found = axes_of_gyro(directions[keep] @ turned_by.T, rates.take(keep))
    assert np.degrees(np.arccos(0.5 * (np.trace(found @ turned_by.T) - 1.0))) < 2.0


def test_a_compass_mounted_otherwise_than_stated_is_deblurred_in_its_own_axes() -> None:
    made = turned(5, 70.0, 0.002, 25.0)
    (gyro,) = made.recording.find(Sensor.GYRO)
    mag = made.recording.channel(Sensor.MAG, 0)
    rates = rates_during(mag.t, gyro.t, gyro.values, 0.1)
    quarter = mounting_matrix(6)
    as_stated = fit_ellipsoid_deblurred(mag.values, rates)
    otherwise = fit_ellipsoid_deblurred(mag.values @ quarter.T, rates)
    np.testing.assert_allclose(otherwise.model.offset, quarter @ as_stated.model.offset, atol=2e-3)
    assert otherwise.sd[:3].max() < 1.5 * as_stated.sd[:3].max()
