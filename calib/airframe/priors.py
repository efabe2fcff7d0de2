"""Prior, limits, and derivative step of each parameter."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from mavcal.calib.airframe.nameless import PREFIX, SIZES
from mavcal.calib.airframe.physics import PRODUCTS

_PRIORS: Final[Mapping[str, tuple[float, float]]] = {
    "k": (25.0, 20.0), "expo": (0.5, 0.4), "sag": (0.0, 1.5), "c1": (0.3, 0.5), "cz": (0.3, 0.7), "c2": (0.02, 0.05),
    "ch": (0.0, 0.03), "climb": (0.0, 0.1), "wind_north": (0.0, 8.0), "wind_east": (0.0, 8.0), "bias": (0.0, 0.5),
    "lever": (0.0, 0.1), "gain_x": (200.0, 400.0), "gain_y": (200.0, 400.0), "gain_z": (8.0, 40.0),
    "damping": (1.0, 5.0), "torque": (0.0, 20.0), "cg": (0.0, 0.3), "spin_up": (0.0, 0.3), "flap": (0.0, 2.0),
    "cross": (0.0, 1.0), "tau": (0.02, 0.05), "fall": (0.0, 0.03), "delay": (0.005, 0.02), "weak": (0.0, 0.15),
    "pulse": (0.0, 0.15), "scale": (0.0, 0.003), "load": (0.0, 0.3), "bias_z": (0.0, 0.03),
    "rise": (0.0, 5e-4), "product": (0.0, 0.1),
}  # fmt: skip
"""Prior mean and standard deviation of each parameter, or of its family. Source: the sizes on real small drones in
AIRFRAME 2 and 2.1, doubled. `flap` is mostly the rotors' drag, which acts above the centre of mass: 0.5 1/s at 3 cm,
with mass over inertia of 100 to 400 1/m2. A flap of 2.3 with a prior of 0.3 made an inertia of -34 %. `rise` is 3e-4
for ArduPilot's simulated quad; without it, 7 m/s of wind damped turns by a quarter more."""
ENDS: Final[Mapping[str, tuple[float, float]]] = {
    "tau": (-0.02, 0.5), "delay": (-0.03, 0.2), "expo": (-0.5, 1.2), "k": (5.0, 200.0), "cg_x": (-0.5, 0.5),
    "cg_y": (-0.5, 0.5), "spin_up": (-0.1, 1.0), **{f"product_{pair}": (-0.3, 0.3) for pair in PRODUCTS},
}  # fmt: skip
"""Limits beyond which a vehicle does not fly, or the formula has no meaning. Source: AIRFRAME 2, sizes on real
drones."""
_STEPS: Final[Mapping[str, float]] = {"tau": 1e-3, "delay": 2e-3, "fall": 1e-3, "expo": 1e-3}


def prior_of(name: str) -> tuple[float, float]:
    """Mean and standard deviation of one parameter."""
    if name.startswith(PREFIX):
        return 0.0, SIZES["torque" if "torque" in name else "force"]
    return _PRIORS[name] if name in _PRIORS else _PRIORS[name.rsplit("_", 1)[0]]


def step_of(name: str) -> float:
    """Step of a numerical derivative."""
    return _STEPS.get(name, 1e-3 * max(prior_of(name)[1], 1e-3))
