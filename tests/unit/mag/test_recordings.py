"""Real recordings of others, in counts; tolerances as their README states them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mavcal.calib.earth import EarthField
from mavcal.calib.firmware.in_force.undo import undo
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.logs.tlog import read_tlog
from mavcal.calib.mag.blur import rates_during
from mavcal.calib.mag.blur_fit import fit_ellipsoid_deblurred
from mavcal.calib.mag.ellipsoid import fit_ellipsoid
from mavcal.calib.recording import Sensor
from tests.fields import field_of

pytestmark = pytest.mark.shared


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("name", "reference", "published", "residual"),
    [
        ("filtered", (6194.2, 248.6, 3479.8), (6195.1, 252.1, 3477.5), 28.0),
        ("noisy", (6155.0, 257.1, 3444.8), (6158.6, 252.7, 3445.6), 58.0),
    ],
)
def test_qmc5883l(
    shared_data: Path,
    name: str,
    reference: tuple[float, float, float],
    published: tuple[float, float, float],
    residual: float,
) -> None:
    """Misfit, not noise, dominates: the stated uncertainty has grown to the size of the estimators' disagreement."""
    file = shared_data / "mag_cuyo_qmc5883l" / f"calibration_data__{name}_raw_data.csv"
    fit = fit_ellipsoid(np.genfromtxt(file, delimiter=",", skip_header=3), unit="counts")
    assert fit.status == FitStatus.OK
    np.testing.assert_allclose(fit.model.offset, reference, atol=8.0)
    np.testing.assert_allclose(fit.model.offset, published, atol=8.0)
    assert fit.residual_rms == pytest.approx(residual, rel=0.05)
    assert fit.quality["axis_ratio"] == pytest.approx(2.23, abs=0.03)
    assert fit.quality["variance_inflation"] > 10.0
    assert np.abs((fit.model.offset - np.array(published)) / fit.sd[:3]).max() < 4.5
    assert 1.0 < fit.sd[:3].max() < 8.0
    assert fit.quality["coverage"] == 1.0


def test_ellipsoid_fit_python(shared_data: Path) -> None:
    fit = fit_ellipsoid(np.loadtxt(shared_data / "mag_ellipsoid_fit_python" / "mag_out.txt"), unit="counts")
    assert fit.status == FitStatus.OK
    assert fit.n_samples == 347
    np.testing.assert_allclose(fit.model.offset, (-68.15, 82.77, -133.50), atol=0.3)
    assert np.mean(fit.native["radii"]) == pytest.approx(173.8, abs=0.5)
    assert fit.quality["axis_ratio"] == pytest.approx(1.150, abs=0.005)


SOFT_IRON = np.array([[1.06, 0.03, -0.02], [0.03, 0.95, 0.015], [-0.02, 0.015, 1.03]])
"""Injected into both captures: ArduPilot's is the correction, PX4's the sensor's own matrix."""


def fit_of_a_tumble(file: Path, window: float, field: EarthField) -> FitResult:
    recording = undo(read_tlog(file))
    mag, gyro = recording.channel(Sensor.MAG), recording.channel(Sensor.GYRO)
    fresh = np.r_[True, np.diff(gyro.t) > 0.0]
    rates = rates_during(mag.t, gyro.t[fresh], gyro.values[fresh], window)
    return fit_ellipsoid_deblurred(mag.values, rates, field=field, quantum=mag.quantum)


def test_tumbling_ardupilot(shared_data: Path) -> None:
    """A compass averaged over 100 ms, up to 26 rad/s: within 0.1 mG and 1e-3, inside the stated uncertainty."""
    field = field_of(58.0029, 1.14, norm_sd=0.0)
    fit = fit_of_a_tumble(shared_data / "sitl_captures" / "tumble.tlog", 0.1, field)
    truth = np.concatenate([[-9.0, 5.5, -3.5], SOFT_IRON.ravel()])
    assert fit.status == FitStatus.OK
    assert np.abs(fit.values - truth)[:3].max() < 0.01
    assert np.abs(fit.values - truth)[3:].max() < 1e-3
    assert np.abs((fit.values - truth) / fit.sd).max() < 4.5


@pytest.mark.long
def test_tumbling_px4(shared_data: Path) -> None:
    """Raw samples of 2 mG noise; the field strength is the one that the bench holds."""
    field = field_of(48.236, 1.1, norm_sd=0.02)
    fit = fit_of_a_tumble(shared_data / "px4_captures" / "bench_tumble.tlog", 0.0, field)
    truth = np.concatenate([[9.0, -5.5, 3.5], np.linalg.inv(SOFT_IRON).ravel()])
    assert fit.status == FitStatus.OK
    assert fit.residual_rms == pytest.approx(0.2, rel=0.05)
    assert fit.quality["heading_sd_deg"] < 0.05
    assert np.abs((fit.values - truth) / fit.sd).max() < 4.5
