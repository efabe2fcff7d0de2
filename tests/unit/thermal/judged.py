"""How well the drift of a fit predicts another record of the same sensor, in any pose: only the shape counts."""

from __future__ import annotations

import numpy as np

from mavcal.calib.fit import FitResult
from mavcal.calib.recording import Array, Channel
from mavcal.calib.stats.windows import finite_rows
from mavcal.calib.thermal.sweeps import DriftPrediction

BLOCKS = 64


def judge_drift(fit: FitResult, channel: Channel, temperature: Array) -> DriftPrediction:
    """Rms of block means about their own mean before and after the correction; samples outside its range are out."""
    drift = fit.model.polynomial
    assert drift is not None
    t = np.asarray(temperature, dtype=np.float64)
    inside = finite_rows(channel.values) & (t >= drift.t_min) & (t <= drift.t_max)
    values = channel.values[inside]
    spreads = []
    for series in (values, values - drift(t[inside])):
        blocks = np.array_split(series, BLOCKS)
        means, counts = np.array([b.mean(axis=0) for b in blocks]), np.array([float(len(b)) for b in blocks])
        about = means - counts @ means / counts.sum()
        spreads.append(np.sqrt(counts @ about**2 / counts.sum()))
    return DriftPrediction(*spreads)
