"""Physical changes of a vehicle, sizes that are drawn, and what is seen of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from mavcal.calib.blind.airframe.draw import log_uniform
from mavcal.calib.blind.airframe.seen import Seen, hover_command, hover_ratio, see
from mavcal.calib.blind.airframe.sides import Rng
from mavcal.calib.blind.airframe.vehicle import Hull, Vehicle


def signed(rng: Rng, low: float, high: float) -> float:
    """Log-uniform in size, either sign."""
    return log_uniform(rng, low, high) * float(rng.choice([-1.0, 1.0]))


def factor(rng: Rng, low: float, high: float) -> float:
    """A ratio whose logarithm is log-uniform in size from those of `low` to `high`, up or down."""
    return math.exp(signed(rng, math.log(low), math.log(high)))


def blades(vehicle: Vehicle, **changes: float) -> Vehicle:
    """With other blades."""
    return replace(vehicle, propeller=replace(vehicle.propeller, **changes))


def driven(vehicle: Vehicle, **changes: float) -> Vehicle:
    """With another drive."""
    return replace(vehicle, drive=replace(vehicle.drive, **changes))


def hulled(vehicle: Vehicle, hull: Hull) -> Vehicle:
    """With another hull."""
    return replace(vehicle, hull=hull)


def both(old: Vehicle, new: Vehicle) -> tuple[Seen, Seen]:
    """What is seen of them at the hover voltage of the old one."""
    ratio = hover_ratio(old)
    return see(old, ratio), see(new, ratio)


def relative(
    names: dict[str, Callable[[Seen], float]], before: Seen, after: Seen
) -> tuple[dict[str, float], dict[str, float]]:
    """Values and ratios of relative parameters."""
    ratios = {name: get(after) / get(before) for name, get in names.items()}
    return {name: ratio - 1.0 for name, ratio in ratios.items()}, ratios


def hovers(vehicle: Vehicle) -> float:
    """Hover command, for a check that a change leaves it room."""
    return hover_command(vehicle, hover_ratio(vehicle))
