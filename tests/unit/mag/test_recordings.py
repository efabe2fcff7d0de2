"""Real recordings of others, in counts; tolerances as their README states them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.fit import FitStatus
from calib.mag.ellipsoid import fit_ellipsoid

pytestmark = pytest.mark.shared


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
