from __future__ import annotations

import math

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.noise.coarse_means import means_together
from mavcal.calib.recording import Channel, Rounding, Sensor, Stage
from mavcal.calib.stats.quantisation import mean_of


def channel(values, quantum=1.0):
    t = np.arange(len(values)) / 100.0
    return Channel(Sensor.ACCEL, 0, t, values, "m/s2", Stage.RAW, "t", quantum=quantum, rounding=Rounding.NEAREST)


def read(rng, truths, count, sd):
    return [channel(np.rint(truth + sd * rng.normal(size=(count, 3)))) for truth in truths]


@pytest.mark.long
@pytest.mark.parametrize(("sd", "count"), [(0.15, 100), (0.2, 500), (0.3, 100), (0.3, 1000)])
def test_intervals_hold_and_the_noise_of_all_helps_each(sd, count):
    rng, held, errors, alone = np.random.default_rng(5), [], [], []
    for _ in range(25):
        truths = rng.uniform(-30.0, 30.0, (6, 3))
        parts = read(rng, truths, count, sd)
        for part, truth, mean in zip(parts, truths, means_together(parts), strict=True):
            held.append(np.abs(mean.mean - truth) <= 1.96 * np.sqrt(np.diag(mean.covariance)))
            errors.append(mean.mean - truth)
            alone.append(mean_of(part).mean - truth)
    assert np.mean(held) == pytest.approx(0.95, abs=3 * math.sqrt(0.95 * 0.05 / 450))
    assert np.std(errors) < 0.95 * np.std(alone)


def test_in_fine_bins_every_part_stands_for_itself():
    rng = np.random.default_rng(1)
    parts = read(rng, rng.uniform(-30.0, 30.0, (6, 3)), 200, 3.0)
    for part, mean in zip(parts, means_together(parts), strict=True):
        own = mean_of(part)
        np.testing.assert_array_equal(mean.mean, own.mean)
        np.testing.assert_array_equal(mean.covariance, own.covariance)
        assert mean.n == 200


def test_at_half_a_bin_both_ways_agree():
    rng = np.random.default_rng(2)
    parts = read(rng, rng.uniform(-30.0, 30.0, (6, 3)), 3000, 0.6)
    for part, mean in zip(parts, means_together(parts), strict=True):
        np.testing.assert_allclose(mean.mean, mean_of(part).mean, atol=0.003)
        np.testing.assert_allclose(mean.covariance.diagonal(), mean_of(part).covariance.diagonal(), rtol=0.25)


def test_one_number_again_and_again_lies_anywhere_in_its_bin():
    parts = [channel(np.full((50, 3), float(k))) for k in range(6)]
    for k, mean in enumerate(means_together(parts)):
        np.testing.assert_allclose(mean.mean, k, atol=1e-6)
        np.testing.assert_allclose(np.sqrt(mean.covariance.diagonal()), math.sqrt(1.0 / 12.0), rtol=0.25)


def test_samples_that_repeat_their_neighbours_count_less():
    rng = np.random.default_rng(3)
    parts = read(rng, rng.uniform(-30.0, 30.0, (6, 3)), 400, 0.3)
    slow = [channel(np.repeat(part.values, 5, axis=0)) for part in parts]
    white, repeated = means_together(parts), means_together(slow)
    ratio = np.mean([r.covariance.diagonal() / w.covariance.diagonal() for r, w in zip(repeated, white, strict=True)])
    assert 0.6 < ratio < 2.5


@pytest.mark.parametrize("scale", [1e-3, 9.80665e-3, 50.0])
def test_answers_scale_with_the_bins(scale):
    rng = np.random.default_rng(4)
    parts = read(rng, rng.uniform(-30.0, 30.0, (4, 3)), 200, 0.25)
    scaled = [channel(scale * part.values, scale) for part in parts]
    for one, other in zip(means_together(parts), means_together(scaled), strict=True):
        np.testing.assert_allclose(other.mean, scale * one.mean, rtol=1e-6)
        np.testing.assert_allclose(other.covariance, scale**2 * one.covariance, rtol=1e-4, atol=1e-12 * scale**2)


def test_nothing_and_too_little():
    assert means_together([]) == []
    with pytest.raises(InvalidInputError, match="two finite samples"):
        means_together([channel(np.zeros((1, 3)))])
