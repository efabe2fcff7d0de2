"""Which effect imitates which on a mission: `scripts/effects` writes the table of the page from it."""

from __future__ import annotations

import numpy as np

from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.effects.base import MeanEffect
from mavcal.calib.recording import Sensor

from .conftest import make

LEAST = 0.02
"""Share of the energy below which an imitator is none: which one is the best is chance."""
NONE, NOT_TESTABLE = "none", "not testable"
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
