from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.earth import EarthField
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.mag.fixed_yaw import (
    KEPT_SD,
    NEVER_FITTED_SD,
    TILT_SD,
    KnownAttitude,
    declination_sd,
    fit_fixed_yaw,
)
from mavcal.calib.triad import TriadModel
from tests.fields import field_of

FIELD = EarthField([20.5, 1.2, 44.0], norm_sd=0.15)
TURNED = Rotation.from_euler("ZYX", [90.0, 0.0, 180.0], degrees=True).as_matrix()
FITTED = np.array([[1.04, 0.02, -0.01], [0.02, 0.97, 0.015], [-0.01, 0.015, 1.01]])
STANDING = KnownAttitude(math.radians(4.0), math.radians(-3.0), math.radians(211.0), math.radians(1.5))


def reading(offset, matrix, standing=STANDING, field=FIELD):
    """What a compass of that offset, and that matrix from raw to body, reads."""
    return offset + np.linalg.solve(matrix, standing.body_from_ned() @ field.north_east_down)


@pytest.mark.parametrize("mounting", [np.eye(3), TURNED])
def test_the_offset_is_found_exactly_and_the_matrix_is_kept(mounting):
    offset = np.array([31.0, -12.0, 7.0])
    before = TriadModel(offset=np.array([5.0, 0.0, 0.0]), matrix=mounting @ FITTED)
    fit = fit_fixed_yaw(
        reading(offset, before.matrix), np.zeros((3, 3)), 50, before, STANDING, field=FIELD, body_from_sensor=mounting
    )
    np.testing.assert_allclose(fit.model.offset, offset, atol=1e-9)
    np.testing.assert_allclose(fit.model.matrix, FITTED, atol=1e-12)
    assert fit.status == FitStatus.PARTIAL
    assert all(name.startswith("matrix") for name in fit.undetermined)
    assert fit.quality["soft_iron_kept"]
    assert fit.quality["offset_moved"] == pytest.approx(float(np.linalg.norm(offset - before.offset)))


@pytest.mark.sampled
@pytest.mark.parametrize("fitted", [True, False])
def test_its_interval_holds_the_truth_where_everything_errs_as_stated(fitted):
    """1000 vehicles whose heading, tilt, field and soft iron err as the model of the uncertainty has them."""
    rng = np.random.default_rng(3)
    assumed = FITTED if fitted else np.eye(3)
    held = np.zeros(3)
    for _ in range(1000):
        true = assumed + (KEPT_SD if fitted else NEVER_FITTED_SD) * rng.normal(size=(3, 3))
        turned = STANDING.heading + math.hypot(STANDING.heading_sd, declination_sd(FIELD.horizontal)) * rng.normal()
        tilt = TILT_SD * rng.normal(size=2)
        at = KnownAttitude(STANDING.roll + tilt[0], STANDING.pitch + tilt[1], turned, 0.0)
        dip = FIELD.inclination + math.radians(0.2) * rng.normal()
        norm = FIELD.norm + FIELD.norm_sd * rng.normal()
        field = field_of(norm, dip, FIELD.declination)
        offset = rng.normal(0.0, 20.0, 3)
        read = reading(offset, true, at, field) + 0.05 * rng.normal(size=3)
        fit = fit_fixed_yaw(read, 0.0025 * np.eye(3), 50, TriadModel(matrix=assumed), STANDING, field=FIELD)
        held += np.abs(fit.model.offset - offset) < 1.96 * np.sqrt(np.diag(fit.covariance)[:3])
    assert (np.abs(held / 1000.0 - 0.95) < 0.025).all(), held


def test_a_compass_that_was_never_calibrated_says_how_little_one_heading_tells_of_the_others():
    fitted, never = (
        fit_fixed_yaw(reading(np.zeros(3), m), np.zeros((3, 3)), 50, TriadModel(matrix=m), STANDING, field=FIELD)
        for m in (FITTED, 1.1 * np.eye(3))
    )
    assert fitted.quality["heading_here_sd_deg"] == never.quality["heading_here_sd_deg"] < 1.6
    assert fitted.quality["heading_sd_deg"] < 0.7 * never.quality["heading_sd_deg"]
    assert any("soft iron was never calibrated" in text for text in never.warnings)
    assert not any("soft iron was never calibrated" in text for text in fitted.warnings)


def test_a_heading_that_is_hardly_known_or_a_field_that_is_hardly_level_is_refused():
    steep = field_of(60.0, math.radians(86.0), norm_sd=0.15)
    fit = fit_fixed_yaw(
        reading(np.zeros(3), FITTED, field=steep),
        np.zeros((3, 3)),
        50,
        TriadModel(matrix=FITTED),
        STANDING,
        field=steep,
    )
    assert fit.status == FitStatus.REFUSED
    assert "the horizontal field is 4 uT here" in fit.message


def test_without_the_field_or_with_numbers_that_are_none_it_is_refused():
    with pytest.raises(InvalidInputError, match="position"):
        fit_fixed_yaw(np.zeros(3), np.eye(3), 1, TriadModel(), STANDING)
    with pytest.raises(InvalidInputError, match="finite"):
        fit_fixed_yaw(np.full(3, np.nan), np.eye(3), 1, TriadModel(), STANDING, field=FIELD)
