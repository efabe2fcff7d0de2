"""One side of a case before it is flown: vehicle, weather, and what happens on the way."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.blind.airframe.air import Weather
from mavcal.calib.blind.airframe.flight import LOOP_HZ, Events
from mavcal.calib.blind.airframe.logs import Unit
from mavcal.calib.blind.airframe.vehicle import Vehicle

Array = NDArray[np.float64]
Rng = np.random.Generator
Happening = Callable[[Events, Array, Rng], Events]
"""``happening(events, t, rng)``: the events with its own, t (N,) s."""


@dataclass(frozen=True)
class Slip:
    """An error of the estimated velocity: from `t` on it grows to `size` m/s (north, east) and goes away.

    A glitch leads the estimate away within a second and lets it return in `length` s; a reset takes away at once
    what had grown over `length` s.
    """

    t: float
    length: float
    size: tuple[float, float]
    reset: bool

    def error(self, t: Array) -> Array:
        """North east down, (N, 3), m/s."""
        since = t - self.t
        if self.reset:
            shape = np.where((since > -self.length) & (since < 0.0), 1.0 + since / self.length, 0.0)
        else:
            shape = np.where(since > 0.0, (1.0 - np.exp(-since / 0.3)) * np.exp(-since / self.length), 0.0)
        error: Array = shape[:, None] * np.array([*self.size, 0.0])
        return error


@dataclass(frozen=True)
class Side:
    """The real or the simulated flight."""

    vehicle: Vehicle
    weather: Weather
    units: tuple[Unit, Unit]
    slips: tuple[Slip, ...] = ()
    happenings: tuple[Happening, ...] = ()
    low: bool = False
    """Whether it hovers near the ground before it lands."""

    def events(self, count: int, rng: Rng) -> Events:
        """What happens over `count` loops."""
        t = np.arange(count) / LOOP_HZ
        events = Events()
        for happening in self.happenings:
            events = happening(events, t, rng)
        return events


@dataclass(frozen=True)
class Entry:
    """What was put in, as the scorer keeps it.

    Parameters
    ----------
    id, domain
        As the report has them; of what no catalogue has, ``unknown_<name>``.
    params
        The report's values: real over simulated less one of what is relative, real less simulated of the rest.
    ratios
        Real over simulated, of those that have both.
    exact
        Names of the parameters whose truth is one number whatever model is fitted: intervals are held against them.
    also
        Ids that the same change has in another number as well: they are no false names.
    instances
        Motors or units, from 1.
    """

    id: str
    domain: str
    params: Mapping[str, float]
    ratios: Mapping[str, float] = field(default_factory=dict)
    exact: tuple[str, ...] = ()
    also: tuple[str, ...] = ()
    instances: tuple[int, ...] = ()
    size: float = 0.0

    def as_json(self) -> dict[str, Any]:
        """For the label."""
        return {
            "id": self.id,
            "domain": self.domain,
            "instances": list(self.instances),
            "params": {k: round(float(v), 9) for k, v in self.params.items()},
            "ratios": {k: round(float(v), 9) for k, v in self.ratios.items()},
            "exact": list(self.exact),
            "also": list(self.also),
            "size": round(float(self.size), 9),
        }


@dataclass(frozen=True)
class Pair:
    """Both sides and what is in them."""

    real: Side
    sim: Side
    entries: tuple[Entry, ...] = ()

    def flown(self, vehicle: Vehicle) -> Pair:
        """With another real vehicle."""
        return replace(self, real=replace(self.real, vehicle=vehicle))

    def said(self, entry: Entry) -> Pair:
        """With one more entry."""
        return replace(self, entries=(*self.entries, entry))


Put = Callable[[Rng, Pair], Pair]


@dataclass(frozen=True)
class Kind:
    """A kind of effect: `put` draws its size and puts it into a pair. Two of one `group` are not put into one case."""

    id: str
    put: Put
    group: str
    domain: str = "airframe"
