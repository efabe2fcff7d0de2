from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.blind.airframe.thinned import THINNINGS

T = 30.0 + np.arange(20_000) / 200.0


def columns() -> dict[str, np.ndarray]:
    names = ("accel_x", "gyro_x", "motor_1", "vel_n", "voltage", "current")
    return {"t": T, **{name: np.arange(len(T), dtype=float) for name in names}}


def thinned(name: str) -> dict[str, np.ndarray]:
    return THINNINGS[name].thin(columns(), np.random.default_rng(1))


@pytest.mark.parametrize(
    ("name", "column", "other", "hz"),
    [
        ("commands_10_hz", "motor_1", "gyro_x", 10.0),
        ("imu_25_hz", "gyro_x", "motor_1", 25.0),
    ],
)
def test_a_slow_message_has_fewer_samples(name, column, other, hz):
    found = thinned(name)
    assert 1.0 / np.diff(T[np.isfinite(found[column])]) == pytest.approx(hz, rel=0.1)
    assert np.isfinite(found[other]).all()


def test_gaps_leave_no_long_piece():
    t = thinned("gaps")["t"]
    breaks = np.flatnonzero(np.diff(t) > 0.1)
    pieces = np.diff(t[np.concatenate([[0], breaks + 1])])
    assert len(breaks) > 50
    assert max(np.diff(breaks)) / 200.0 <= 0.31
    assert pieces.min() >= 0.35


def test_a_missing_message_is_missing():
    assert "voltage" not in thinned("no_battery")
    assert "vel_n" not in thinned("no_velocity")
    assert "voltage" in thinned("no_velocity")
