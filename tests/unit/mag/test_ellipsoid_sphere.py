"""An ellipsoid that does not converge is answered by the sphere, with what that may cost."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import UndeterminedError
from mavcal.calib.fit import FitStatus
from mavcal.calib.mag.ellipsoid import ellipsoid_shape, fit_ellipsoid
from mavcal.calib.mag.result import MagContext
from mavcal.calib.mag.shape import MagModel
from mavcal.calib.mag.shape_fit import Asked

FIELD = 49.0 * np.array([np.cos(1.15), 0.0, np.sin(1.15)])
OFFSET = np.array([8.0, -5.0, 12.0])
SOFT_IRON = np.eye(3) + 0.04 * np.array([[1.0, 0.5, 0.0], [0.5, -1.0, 0.3], [0.0, 0.3, 0.0]])


def hardly_tilted(seed, *, tilt, noise, change=0.0):
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 1.0, 600)
    attitude = Rotation.from_euler("ZYX", np.column_stack([12.0 * t, tilt * np.sin(40.0 * t), tilt * np.sin(31.0 * t)]))
    values = attitude.inv().apply(FIELD) @ SOFT_IRON.T + OFFSET + noise * rng.normal(size=(600, 3))
    values[t > 0.6] += change
    return values


@pytest.mark.parametrize("model", ["symmetric", "auto"])
def test_the_sphere_takes_its_place_with_an_honest_sd(model):
    samples = hardly_tilted(7, tilt=0.5, noise=5.0)
    with pytest.raises(UndeterminedError, match="settle on no ellipsoid"):
        ellipsoid_shape(samples, MagModel.SYMMETRIC, Asked(MagContext()), fall_back=False)
    fit = fit_ellipsoid(samples, model=model)
    if model == "auto" and fit.status == FitStatus.OK:
        return  # its prior made it converge
    assert fit.status == FitStatus.PARTIAL
    assert "matrix_xx" in fit.undetermined
    known = fit.sd[:3] > 0.0
    assert known.any()
    assert (np.abs(fit.model.offset - OFFSET)[known] < 3.0 * fit.sd[:3][known]).all()
    assert (
        fit.sd[:3][known] > fit_ellipsoid(samples, model="offset").sd[:3][known]
    ).all()  # that one believes in no soft iron
    assert "the ellipsoid did not converge: " in fit.warnings[0]
    assert "soft iron of 5 %" in fit.warnings[1]
    assert "the matrix stay open: turn the vehicle" in fit.message


def test_a_refusal_says_why_the_ellipsoid_did_not_converge():
    fit = fit_ellipsoid(hardly_tilted(0, tilt=0.15, noise=1.0, change=8.0))
    assert fit.status == FitStatus.REFUSED
    assert fit.message.startswith("the ellipsoid did not converge: the samples show ")
    assert "the field changed while turning" in fit.message


def test_the_ball_of_noise_of_a_compass_that_was_not_turned_is_no_sphere():
    rng = np.random.default_rng(3)
    samples = np.array([20.0, 5.0, 40.0]) + np.array([0.6, 0.5, 0.4]) * rng.normal(size=(500, 3))
    for model in ("symmetric", "auto"):
        assert fit_ellipsoid(samples, model=model).status == FitStatus.REFUSED
