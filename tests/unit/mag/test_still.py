"""A compass in whole steps that is held still: how many readings a stretch is worth, and whether the fit knows it."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.mag.blur import Rates
from mavcal.calib.mag.blur_fit import fit_ellipsoid_deblurred
from mavcal.calib.mag.still import counted_as, still_stretches
from tests.unit.mag.turned import deviations

STEP = 0.1


def rounded(values):
    return (np.floor(values / STEP) + 0.5) * STEP


def worth(noise, lengths=20, stretches=400):
    """Mean of what stretches of `lengths` readings at random fields are stated to be worth, and what they are."""
    rng = np.random.default_rng(11)
    truth = rng.uniform(-40.0, 40.0, (stretches, 1, 3))
    readings = rounded(truth + noise * rng.normal(size=(stretches, lengths, 3)))
    stated = np.concatenate([counted_as(r, np.array([0]), STEP) for r in readings])
    single = np.mean((readings[:, 0] - truth[:, 0]) ** 2)
    return float(np.mean(1.0 / stated)), float(np.mean((readings.mean(axis=1) - truth[:, 0]) ** 2) / single)


@pytest.mark.parametrize("noise", [0.0001, 0.003, 0.01, 0.02, 0.03, 0.05])
def test_the_mean_of_a_stretch_is_worth_what_its_error_says(noise) -> None:
    """One reading without noise, all twenty at half a step; in between the variance is up to three times too large."""
    stated, true = worth(noise)
    assert 0.8 * true < stated < (1.3 if noise in (0.0001, 0.003, 0.05) else 3.0) * true


def test_a_reading_that_moved_on_is_a_stretch_of_its_own() -> None:
    samples = np.array([0.0, 0.1, 0.0, 0.1, 5.0, 9.0, 9.1, 9.0])[:, None] * [1.0, 0.0, 0.0]
    starts = still_stretches(samples, STEP)
    assert starts.tolist() == [0, 4, 5]
    assert counted_as(samples, starts, STEP)[1] == 1.0
    assert (counted_as(samples, starts, STEP) < 1.5).all()  # two axes never left their step


def held(seed):
    """Deviations of a fit to forty attitudes held for two seconds, next to one step's edge in one of the axes."""
    rng = np.random.default_rng([seed, 3])
    directions = rng.normal(size=(40, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    offset = rng.uniform(-20.0, 20.0, 3)
    field = 50.0 * directions + offset
    field[np.arange(40), rng.integers(0, 3, 40)] = np.nan
    field = np.where(np.isnan(field), np.round((50.0 * directions + offset) / STEP) * STEP, field)
    samples = rounded(np.repeat(field, 20, axis=0) + 0.003 * rng.normal(size=(800, 3)))
    still = Rates(np.arange(800) / 10.0, *np.zeros((1, 800, 3)), *np.zeros((2, 800, 3, 3)), np.ones(800, bool), 0.0)
    fit = fit_ellipsoid_deblurred(samples, still, quantum=STEP)
    assert fit.n_samples == 40
    return deviations(fit, np.concatenate([offset, [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]]))


def test_the_uncertainty_of_a_compass_that_was_held_still_is_that_of_its_attitudes() -> None:
    """With every jump between two steps for a reading of its own, the rms is 2.3 and 56 % of the intervals hold."""
    found = np.array([held(seed) for seed in range(25)])
    assert 0.8 < np.sqrt(np.mean(found**2)) < 1.2
    assert 0.91 < np.mean(np.abs(found) < 1.96) < 0.99
