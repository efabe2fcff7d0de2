"""Table recordings of a tumbling flight, as files: the ideal reading beside what an accelerometer with errors read."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.unit.gap.synthetic import flight

BIAS = (0.3, -0.2, 0.15)


def write_table(path: Path, bias: tuple[float, float, float] = BIAS, *, seed: int = 4, seconds: float = 20.0) -> Path:
    """A CSV with t, accel_*, ref_accel_*: 50 Hz, white noise of 0.05 m/s2."""
    rng = np.random.default_rng(seed)
    truth = flight(rng, seconds)
    ideal = truth["force"]
    measured = ideal + np.array(bias) + 0.05 * rng.normal(size=ideal.shape)
    header = "t,accel_x,accel_y,accel_z,ref_accel_x,ref_accel_y,ref_accel_z"
    np.savetxt(path, np.column_stack([truth["t"], measured, ideal]), delimiter=",", header=header, comments="")
    return path
