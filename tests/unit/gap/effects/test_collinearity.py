"""Which effects imitate each other on which mission: the table of the page, measured again."""

from __future__ import annotations

import re

import numpy as np
import pytest

from mavcal.calib.gap.effects import by_id, catalogue
from mavcal.calib.gap.effects.base import MeanEffect
from mavcal.calib.recording import Sensor
from scripts.effects import PAGE

from .conftest import make

THETA = {
    "t_ref": 25.0,
    "lag_s": 8.0,
    "delay_s": 0.01,
    "cutoff_hz": 15.0,
    "drift_ppm": 300.0,
    "frequency_hz": 1.3,
    "time_s": 30.0,
    "rotor_order": 101.0,
}
OF_LARGEST = {"limit": 0.8, "half_width": 0.2}
MISSIONS = ("static", "hover", "tumble")


def _space(effect, trace):
    """Orthonormal columns of what an effect can do."""
    name = effect.shape.parameter.name if effect.shape is not None else ""
    largest = float(np.abs(trace.ideal).max())
    theta = OF_LARGEST[name] * largest if name in OF_LARGEST else THETA.get(name, np.nan)
    X = effect.columns(trace, theta).reshape(-1, trace.ideal.size).T
    size = np.linalg.norm(X, axis=0)
    U, s, _ = np.linalg.svd(X[:, size > 0.0] / size[size > 0.0], full_matrices=False)
    return U[:, s > 1e-6 * s.max(initial=1.0)]


def closest(sensor: Sensor, mission: str) -> dict[str, tuple[str, float]]:
    """Best imitator of every effect on the mean, and the mean squared canonical correlation (white noise)."""
    trace = make(sensor, mission, fs=25.0)
    effects = [e for e in catalogue() if isinstance(e, MeanEffect) and (e.sensor == sensor or e.shared)]
    spaces = {e.id: _space(e, trace) for e in effects if e.missing(trace) is None}
    spaces = {name: space for name, space in spaces.items() if space.shape[1]}
    table = {}
    for g, G in spaces.items():
        kappa = {h: float(((H.T @ G) ** 2).sum() / G.shape[1]) for h, H in spaces.items() if h != g}
        rival = max(kappa, key=lambda h: kappa[h])
        table[g] = (rival, kappa[rival])
    return table


@pytest.mark.parametrize("mission", MISSIONS)
def test_the_page_says_who_imitates_whom(mission):
    page = PAGE.read_text(encoding="utf-8")
    column = MISSIONS.index(mission)
    rows = {
        (sensor, effect_id): cells.split("|")[column].strip()
        for sensor, effect_id, cells in re.findall(r"^\| (accel|gyro|mag) \| (\w+) \| (.*) \|$", page, flags=re.M)
    }
    for sensor in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG):
        table = closest(sensor, mission)
        written = {effect_id: cell for (s, effect_id), cell in rows.items() if s == sensor and cell != "not testable"}
        assert set(written) == set(table)
        for effect_id, (rival, kappa) in table.items():
            name, number = written[effect_id].rsplit(" ", 1)
            assert float(number) == pytest.approx(kappa, abs=0.015), effect_id
            # Ties may fall either way.
            assert name == rival or kappa > 0.99 or kappa < 0.02, effect_id


def test_a_tumble_separates_what_rest_cannot():
    static, tumble = closest(Sensor.ACCEL, "static"), closest(Sensor.ACCEL, "tumble")
    assert static["reference_attitude"][1] > 0.99
    assert tumble["accel_scale"][1] < 0.5
    assert by_id()["accel_scale"].missing(make(Sensor.ACCEL, "static")) is not None
