"""A drift of a few quanta: a number that repeats within a bin is no measurement of the curve."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.recording import Array, Channel, Rounding, Sensor, Stage
from mavcal.calib.thermal.fit import fit_polynomial

QUANTUM, NOISE = 1e-3, 4.3e-5  # rad/s: SCALED_IMU2 of ArduPilot behind its low-pass filter of 20 Hz
MIDDLE = 35.0


def warmed(coefficients: Array, seed: int) -> tuple[Channel, Array]:
    """A gyro with that drift about 35 degC, (3, 3) by order and axis, truncated, in a warm-up to 58.7 degC."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, 300.0, 0.1)
    temperature = 11.3 + 47.4 * (1.0 - np.exp(-t / 55.0))
    value = ((temperature - MIDDLE)[:, None] ** np.arange(1, 4)) @ coefficients
    value += random.uniform(-5e-3, 5e-3, 3) + NOISE * random.normal(size=(len(t), 3))
    counts = np.trunc(value / QUANTUM)
    streamed = QUANTUM * (counts + 0.5 * np.sign(counts))
    channel = Channel(
        Sensor.GYRO, 1, t, streamed, "rad/s", Stage.RAW, "SCALED_IMU2", QUANTUM, Rounding.TOWARD_ZERO, counts == 0
    )
    return channel, temperature


def deviations(seed: int, share: float) -> tuple[Array, Array]:
    """Errors over stated sd of the coefficients of the axes that are estimated, and their sd."""
    random = np.random.default_rng(1000 + seed)
    truth = random.uniform(-1.0, 1.0, (3, 3)) * share * 1e-6 * np.array([[500.0], [3.5], [0.05]])
    fit = fit_polynomial(*warmed(truth, seed))
    sd = np.sqrt(np.diag(fit.covariance)[12:]).reshape(3, 3)
    known = np.array([fit.determined(*(f"poly{k}_{a}" for k in (1, 2, 3))) for a in "xyz"])
    assert fit.model.polynomial is not None
    return (fit.model.polynomial.coefficients - truth.T)[known] / sd[known], sd[known]


@pytest.mark.parametrize("share", [0.1, 0.3, 0.6])
def test_stated_errors_hold_however_few_levels_are_seen(share: float) -> None:
    """Monte Carlo over random drifts of 0.1 to 20 quanta."""
    found = [deviations(seed, share) for seed in range(8)]
    errors = np.concatenate([error.ravel() for error, _ in found])
    assert all((sd > 0.0).all() for _, sd in found)
    if share > 0.5:
        assert len(errors) > 9 * 3  # most axes of such a drift pass edges enough
    assert np.abs(errors).max(initial=0.0) < 4.5
    assert np.mean(np.abs(errors) > 1.96) < 0.15 if len(errors) else True


def test_an_axis_of_too_few_edges_is_named_with_what_would_help() -> None:
    truth = 1e-6 * np.array([[480.0, 40.0, 400.0], [3.0, 0.1, -2.0], [0.04, 0.0, 0.02]])
    fit = fit_polynomial(*warmed(truth, 3))
    assert {"poly1_y", "poly2_y", "poly3_y"} <= set(fit.undetermined)
    assert any("y shows too few levels of 0.001 rad/s" in text for text in fit.warnings)
    assert fit.quality["drift_sd"][1] is None
    assert "HIGHRES_IMU" in fit.movements["poly1_y"]
