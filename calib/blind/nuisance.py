"""What is wrong with a log without being an error of a sensor, and what nobody declared."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.blind.effects.place import reference_tilt
from mavcal.calib.blind.effects.thermal import lagged
from mavcal.calib.blind.missions import Rng, World
from mavcal.calib.blind.sensors import SENSORS, Effect, Order, Quality

Array = NDArray[np.float64]
Columns = dict[str, Array]


@dataclass(frozen=True, eq=False)
class HeavyTails(Effect):
    """Noise of the same variance with Student's t of three degrees of freedom."""

    def noise(self, world: World, sensor: str, noise: Array, quality: Quality, rng: Rng) -> Array:
        """Instead of the Gaussian one."""
        return np.asarray(quality.sd / np.sqrt(3.0) * rng.standard_t(3.0, noise.shape))


@dataclass(frozen=True, eq=False)
class Jitter(Effect):
    """Samples are taken up to a millisecond beside their stamps; all sensors together."""

    offsets: Array  # s, on the fine grid, constant over a log interval

    def mean(self, world: World, sensor: str, x: Array) -> Array:
        """The value at the true instant."""
        at = world.t + self.offsets
        return np.stack([np.interp(at, world.t, column) for column in x.T], axis=1)


def _heavy(rng: Rng, world: World) -> Effect:
    return HeavyTails("nuisance_heavy_tails", SENSORS)


def _jitter(rng: Rng, world: World) -> Effect:
    offsets = np.repeat(rng.normal(0.0, 0.5e-3, len(world.t) // 8), 8)
    return Jitter("nuisance_jitter", SENSORS, offsets, order=Order.TIME)


def _tilt(degrees: float) -> Callable[[Rng, World], Effect]:
    return lambda rng, world: reference_tilt(rng, world, np.radians(degrees))


EFFECTS: Mapping[str, Callable[[Rng, World], Effect]] = {
    "heavy_tails": _heavy,
    "jitter": _jitter,
    "reference_0.05_deg": _tilt(0.05),
    "reference_0.3_deg": _tilt(0.3),
}
"""Those that act on the signals."""


def _other_thermometer(real: Columns, sim: Columns, world: World, rng: Rng) -> tuple[Columns, Columns]:
    """The board's thermometer sits elsewhere: 4 degC off and 8 s late."""
    late = lagged(world.temperature, world.dt, 8.0)[::8] + 4.0
    read = np.where(np.isnan(real["temperature"]), np.nan, np.round(late, 2))
    return real | {"temperature": read}, sim | {"temperature": read}


def _lost_rows(real: Columns, sim: Columns, world: World, rng: Rng) -> tuple[Columns, Columns]:
    """Three seconds of the real log are lost."""
    t = real["t"]
    start = t[0] + rng.uniform(5.0, float(t[-1] - t[0]) - 8.0)
    keep = (t < start) | (t > start + 3.0)
    return {name: column[keep] for name, column in real.items()}, sim


def _no_rotors(real: Columns, sim: Columns, world: World, rng: Rng) -> tuple[Columns, Columns]:
    """No motor tells its speed."""

    def without(columns: Columns) -> Columns:
        return {name: column for name, column in columns.items() if not name.startswith("rotor")}

    return without(real), without(sim)


def _short_sim(real: Columns, sim: Columns, world: World, rng: Rng) -> tuple[Columns, Columns]:
    """The simulation ends early."""
    rows = int(0.7 * len(sim["t"]))
    return real, {name: column[:rows] for name, column in sim.items()}


LOGS: Mapping[str, Callable[[Columns, Columns, World, Rng], tuple[Columns, Columns]]] = {
    "other_thermometer": _other_thermometer,
    "lost_rows": _lost_rows,
    "no_rotors": _no_rotors,
    "short_sim": _short_sim,
}
"""Those that act on the files."""

NUISANCES = (*EFFECTS, *LOGS)
EXPECTED = {
    "heavy_tails": {f"{s}_noise" for s in SENSORS},  # of infinite kurtosis: what a record has is not what was drawn
    "jitter": {f"{s}_{kind}" for s in SENSORS for kind in ("noise", "rotor_noise", "flicker")} | {"clock_jitter"},
    "reference_0.05_deg": {"reference_attitude"},
    "reference_0.3_deg": {"reference_attitude"},
}
"""Names that are right, or an honest near-synonym, for each; the others leave nothing to name."""
