"""Magnetometers in counts."""

from __future__ import annotations

import numpy as np

from bench.realdata import recordings
from bench.realdata.finding import Finding, compared
from mavcal.calib.fit import FitResult
from mavcal.calib.methods import METHODS

_CENTRES = {  # published; found by orthogonal distance
    "filtered": ((6195.1, 252.1, 3477.5), (6194.2, 248.6, 3479.8)),
    "noisy": ((6158.6, 252.7, 3445.6), (6155.0, 257.1, 3444.8)),
}
_COUNTS = "8 counts are 0.7 % of the field"


def findings() -> list[Finding]:
    """All of them."""
    found = []
    for kind, (published, distance) in _CENTRES.items():
        name = f"mag_cuyo_qmc5883l {kind}"
        fit = _fit(recordings.cuyo_magnetometer(kind))
        offset, sd = fit.model.offset, fit.sd[:3]
        found += [
            compared(
                name, "mag-ellipsoid", "centre, counts, as published", published, offset, sd, within=8, because=_COUNTS
            ),
            compared(
                name,
                "mag-ellipsoid",
                "centre, counts, by orthogonal distance",
                distance,
                offset,
                sd,
                within=8,
                because=_COUNTS,
            ),
            compared(name, "mag-ellipsoid", "ratio of the axes", 2.23, _ratio(fit), 0.0, within=0.02, because="1 %"),
            compared(
                name,
                "mag-ellipsoid",
                "residual rms, counts",
                {"filtered": 28, "noisy": 58}[kind],
                fit.residual_rms,
                0.0,
                within=1,
                because="a misfit of the model, not noise",
            ),
        ]
    name, fit = "mag_ellipsoid_fit_python", _fit(recordings.ellipsoid_fit())
    return [
        *found,
        compared(
            name,
            "mag-ellipsoid",
            "centre, counts",
            (-68.15, 82.77, -133.50),
            fit.model.offset,
            fit.sd[:3],
            within=0.01,
            because="our own sd alone",
        ),
        compared(
            name,
            "mag-ellipsoid",
            "mean radius, counts",
            173.8,
            fit.native["expmfs"],
            0.0,
            within=0.2,
            because="geometric or arithmetic mean",
        ),
        compared(name, "mag-ellipsoid", "ratio of the axes", 1.150, _ratio(fit), 0.0, within=0.003, because="its sd"),
    ]


def _fit(recording: recordings.Recording) -> FitResult:
    (fit,) = METHODS["mag-ellipsoid"].run(recording, {})
    return fit


def _ratio(fit: FitResult) -> float:
    axes = np.linalg.eigvalsh(fit.model.matrix)
    return float(axes[-1] / axes[0])
