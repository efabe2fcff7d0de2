"""Changes that the airframe effects of a report require of any simulator: ratios and differences.

A ratio is real over simulated. A simulator's setting is its present one times the ratio, so that neither its quirks nor
a bias that both flights share matter (AIRFRAME 5.11).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from mavcal.calib.gap.export.sensor_errors import named
from mavcal.calib.gap.schema import EffectEstimate, ParameterEstimate

Triple = tuple[float, float, float]

_READ = frozenset(
    {
        *("thrust_scale", "thrust_expo", "motor_lag", "motor_weak", "rotor_drag", "body_drag", "inertia", "cg_offset"),
        *("torque_bias", "yaw_coefficient", "angular_damping", "battery_sag"),
    }
)
"""Effects that :class:`Wanted` has a place for."""
_EVEN = 0.5
"""Source: even odds."""


@dataclass(frozen=True)
class Wanted:
    """Required ratios (1: no change) and differences (0: no change).

    Each is the effect's own part, without what follows from the others. Weaker thrust, for example, also turns the
    vehicle less, and rotor drag and inertia change the damping. `light` is the acceleration ratio of a lighter vehicle,
    at the simulator's mass. `rotor_drag` contains its root, since rotors that carry less turn more slowly. `lag` are
    differences of the time constants up and down, s; `slew` is the rate limit of the command itself, 1/s. `weak` has
    the thrust ratio at the hover command by motor (from 1), `cg` is forward and right in arms, `torque` in rad/s2.
    `damping` is the ratio of an axis' damping, None: no change. `sag` is the ratio of the voltage sag; `sags` tells
    whether the battery changes. `products` of inertia (xy, xz, yz) over the moment of the second axis are to be added.
    `refused` says what cannot be used.
    """

    thrust: float = 1.0
    expo: float = 0.0
    lag: tuple[float, float] | None = None
    slew: float | None = None
    weak: Mapping[int, float] = field(default_factory=dict)
    rotor_drag: float = 1.0
    body_drag: float = 1.0
    light: float = 1.0
    inertia: Triple = (1.0, 1.0, 1.0)
    products: Triple = (0.0, 0.0, 0.0)
    cg: tuple[float, float] = (0.0, 0.0)
    torque: Triple = (0.0, 0.0, 0.0)
    yaw: float = 1.0
    damping: tuple[float | None, float | None, float | None] = (None, None, None)
    sag: float | None = None
    sags: bool = False
    refused: tuple[str, ...] = ()


def wanted_of(effects: Iterable[EffectEstimate]) -> Wanted:
    """Changes that the airframe effects among `effects` require."""
    reader = _Reader(tuple(effects))
    thrust = reader.ratio("thrust_scale", "s")
    # a lighter vehicle at its own mass: all accelerations by it, the rotors' drag by its root, and turns as before
    light = thrust if reader.by_mass else 1.0
    x, y, z = (light * reader.ratio("inertia", axis) for axis in "xyz")
    return Wanted(
        thrust=thrust,
        expo=reader.added("thrust_expo", "expo"),
        lag=reader.lag(),
        slew=reader.real("motor_lag", "slew"),
        weak=reader.weak(),
        rotor_drag=math.sqrt(light) * reader.ratio("rotor_drag", "c1"),
        light=light,
        body_drag=light * reader.ratio("body_drag", "c2"),
        inertia=(x, y, z),
        products=(reader.added("inertia", "xy"), reader.added("inertia", "xz"), reader.added("inertia", "yz")),
        cg=(reader.added("cg_offset", "x"), reader.added("cg_offset", "y")),
        torque=(
            reader.added("torque_bias", "x"),
            reader.added("torque_bias", "y"),
            reader.added("torque_bias", "z"),
        ),
        # a lift by itself leaves the torque about z as it was
        yaw=reader.ratio("yaw_coefficient", "s") / (thrust if reader.likeliest("thrust_scale") == "lift" else 1.0),
        damping=(reader.damping("x"), reader.damping("y"), reader.damping("z")),
        sag=reader.ratio("battery_sag", "s") if reader.has("battery_sag", "s") else None,
        sags=reader.effect("battery_sag") is not None,
        refused=tuple(dict.fromkeys(reader.refused)),
    )


def missing(effects: Iterable[EffectEstimate], reasons: Mapping[str, str]) -> tuple[str, ...]:
    """Notes on those of `effects` that a simulator cannot represent; `reasons` by effect id."""
    found = []
    for effect in effects:
        if effect.id in reasons or effect.id not in _READ:
            found.append(f"{named(effect)}: {reasons.get(effect.id, 'the simulator has no setting for it')}")
    return tuple(found)


def ratio_of(parameter: ParameterEstimate) -> float | None:
    """Ratio real over simulated; None unless positive."""
    found = parameter.ratio if parameter.ratio is not None else 1.0 + parameter.value
    return found if math.isfinite(found) and found > 0.0 else None


class _Reader:
    """Parameters of effects by name; keeps in words what could not be used."""

    def __init__(self, effects: tuple[EffectEstimate, ...]) -> None:
        self._effects = effects
        self.refused: list[str] = []

    def effect(self, effect_id: str) -> EffectEstimate | None:
        return next((e for e in self._effects if e.id == effect_id), None)

    def has(self, effect_id: str, name: str) -> bool:
        return self._parameter(effect_id, name) is not None

    def ratio(self, effect_id: str, name: str) -> float:
        found = self._parameter(effect_id, name)
        return 1.0 if found is None else self._usable(effect_id, found)

    def damping(self, axis: str) -> float | None:
        return self.ratio("angular_damping", axis) if self.has("angular_damping", axis) else None

    def likeliest(self, effect_id: str) -> str:
        """The likeliest cause of an effect; empty without the effect, or for one with a single cause."""
        effect = self.effect(effect_id)
        return "" if effect is None or not effect.forms else max(effect.forms, key=lambda cause: effect.forms[cause])

    @property
    def by_mass(self) -> bool:
        """Whether another mass is the likelier cause of the thrust scale."""
        effect = self.effect("thrust_scale")
        return effect is not None and effect.forms.get("mass", 0.0) > _EVEN

    def added(self, effect_id: str, name: str) -> float:
        found = self._parameter(effect_id, name)
        return 0.0 if found is None else found.value

    def lag(self) -> tuple[float, float] | None:
        """Lags up and down; equal if not estimated separately."""
        told = [name for name in ("tau_up", "tau_down") if self.has("motor_lag", name)]
        return (self.added("motor_lag", told[0]), self.added("motor_lag", told[-1])) if told else None

    def real(self, effect_id: str, name: str) -> float | None:
        """The real value; the simulator's own may be unobservable in its flight, such as a limit never reached."""
        found = self._parameter(effect_id, name)
        if found is None:
            return None
        return found.value if found.value_real is None else found.value_real

    def weak(self) -> dict[int, float]:
        found: dict[int, float] = {}
        for effect in self._effects:
            if effect.id != "motor_weak":
                continue
            size = next((p for p in effect.params if p.name == "s"), None)
            if size is not None:
                ratio = self._usable(named(effect), size)
                found |= {motor: found.get(motor, 1.0) * ratio for motor in effect.instances}
        return found

    def _parameter(self, effect_id: str, name: str) -> ParameterEstimate | None:
        effect = self.effect(effect_id)
        found = None if effect is None else next((p for p in effect.params if p.name == name), None)
        if found is not None and not math.isfinite(found.value):
            self.refused.append(f"{effect_id}: {name} is not finite")
            return None
        return found

    def _usable(self, who: str, parameter: ParameterEstimate) -> float:
        found = ratio_of(parameter)
        if found is None:
            said = parameter.ratio if parameter.ratio is not None else 1.0 + parameter.value
            self.refused.append(f"{who}: {parameter.name} would be multiplied by {said:.3g}, which is not above 0")
            return 1.0
        return found
