"""Density of the air in both flights, from pressure and temperature, or from the altitude.

Thrust and drag are proportional to it (AIRFRAME 2). Where the densities differ beyond their errors, an effect of that
size is expected. Where they may be equal, density does not compete: it is listed as a rival of a thrust that it
explains.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from mavcal.calib.airframe.testable import Missing
from mavcal.calib.recording import Recording, Sensor

ID: Final = "air_density"
_GAS: Final = 287.05
_ZERO_C: Final = 273.15
_LAPSE, _SEA_LEVEL_K, _SEA_LEVEL_PA, _SEA_LEVEL, _POWER = 0.0065, 288.15, 101325.0, 1.225, 4.2559
"""Gas constant of air, J/(kg K), and the standard atmosphere of 1976: temperature lapse rate, K/m; temperature,
pressure and density at sea level; exponent of density in temperature."""
_WARMER: Final = (10.0, 6.0)
"""Excess temperature, K, of a barometer on its board over the air, and its standard deviation. Chosen, not measured."""
_BY_ALTITUDE: Final = 0.04
"""Relative error where only the altitude is known. Source: days 12 K from the standard atmosphere."""
_SIMULATED: Final = 0.003
"""The same for ArduPilot's simulator, which flies in the standard atmosphere. Source: AIRFRAME 4.1; GPS altitude."""
_APART: Final = 2.0
"""Standard errors by which two densities must differ for the effect to be expected. Source: 95 %."""
_ALIKE: Final = 0.015
_VAGUE: Final = 0.05
"""Relative difference below which two densities count as equal, and error above which their ratio is not known.
Source: 85 m of altitude make 1 % (AIRFRAME 2), and usual differences of thrust are 5 to 30 %."""
_NEED: Final = "BARO, vehicle_air_data or a GPS altitude in both logs"
_FURTHER: Final = "flights 500 m of altitude or 25 K apart"


@dataclass(frozen=True)
class Density:
    """Density, kg/m3, and its relative standard deviation."""

    value: float
    sd: float


@dataclass(frozen=True)
class Densities:
    """Densities of the air in the real and the simulated flight."""

    real: Density
    sim: Density

    @property
    def excess(self) -> float:
        """Ratio of the real to the simulated density, less one."""
        return self.real.value / self.sim.value - 1.0

    @property
    def sd(self) -> float:
        """Standard deviation of the excess."""
        return float(np.hypot(self.real.sd, self.sim.sd)) * (1.0 + self.excess)

    @property
    def alike(self) -> Missing | None:
        """Why no effect of the density is expected; None: the densities differ beyond their errors."""
        if abs(self.excess) > max(_APART * self.sd, _ALIKE):
            return None
        if self.sd > _VAGUE:
            return Missing(ID, f"the ratio of the densities is known to {100.0 * self.sd:.0f} % only", _NEED)
        within = abs(self.excess) + _APART * self.sd
        return Missing(ID, f"the densities in both flights agree to within {100.0 * within:.0f} %", _FURTHER)

    def explains(self, excess: float, sd: float) -> bool:
        """Whether the air alone explains a thrust with this relative excess and error."""
        return abs(excess - self.excess) < _APART * float(np.hypot(sd, self.sd))


def altitude_of(density: float) -> float:
    """Altitude at which the standard atmosphere has this density, m."""
    return float((1.0 - (density / _SEA_LEVEL) ** (1.0 / _POWER)) * _SEA_LEVEL_K / _LAPSE)


def _standard(altitude: float) -> float:
    return float(_SEA_LEVEL * (1.0 - _LAPSE * altitude / _SEA_LEVEL_K) ** _POWER)


def densities(real: Density | None, sim: Density | None, settings: Mapping[str, float]) -> Densities | Missing:
    """The densities in both flights, or why they are not known; `settings` are the simulator's parameters."""
    if any(name.startswith("SIH_") for name in settings):
        return Missing(ID, "the thrust of PX4's SIH does not depend on the air", "a simulator that has a density")
    if real is None or sim is None:
        which = "real" if real is None else "simulated"
        return Missing(ID, f"the {which} log has no pressure and no altitude", _NEED)
    return Densities(real, sim)


def density_of(recording: Recording, start: float, end: float) -> Density | None:
    """Density of the air from `start` to `end`, s; None: the log has neither pressure nor altitude."""
    standard = any(name.startswith("SIM_") for name in recording.parameters.final())
    air = next((c for c in recording.dynamics if c.sensor == Sensor.AIR and len(c)), None)
    if air is not None:
        inside = (air.t >= start) & (air.t <= end)
        pressure, warm = np.median(air.values[inside if inside.any() else slice(None)], axis=0).tolist()
        if pressure > 0.0:
            if standard:
                return Density(_SEA_LEVEL * (pressure / _SEA_LEVEL_PA) ** (_POWER / (1.0 + _POWER)), _SIMULATED)
            kelvin = warm + _ZERO_C - _WARMER[0]
            return Density(pressure / (_GAS * kelvin), _WARMER[1] / kelvin)
    places = recording.find(Sensor.POSITION)
    if not places:
        return None
    altitude = float(np.median(places[0].values[:, 2]))
    return Density(_standard(altitude), _SIMULATED if standard else _BY_ALTITUDE)
