"""PX4's simulation in hardware with the wanted effects: SIH_* parameters (AIRFRAME 4.2)."""

from __future__ import annotations

import math
from collections.abc import Mapping

from mavcal.calib.gap.export.airframe.sitl import Settings
from mavcal.calib.gap.export.airframe.wanted import Wanted

DEFAULTS: Mapping[str, float] = {
    "SIH_MASS": 1.0,
    "SIH_T_MAX": 5.0,
    "SIH_Q_MAX": 0.1,
    "SIH_T_TAU": 0.05,
    "SIH_KDV": 1.0,
    "SIH_KDW": 0.025,
    "SIH_IXX": 0.025,
    "SIH_IYY": 0.025,
    "SIH_IZZ": 0.03,
    "SIH_IXY": 0.0,
    "SIH_IXZ": 0.0,
    "SIH_IYZ": 0.0,
}
"""What a fresh simulator has. Source: PX4's sih_params."""
REASONS: Mapping[str, str] = {
    "thrust_expo": "SIH's thrust is linear in the output; a THR_MDL_FAC would only make the firmware misjudge it",
    "actuator_delay": "SIH has no delay between an output and its thrust",
    "motor_weak": "SIH's motors are all alike",
    "body_drag": "SIH's drag is linear in velocity",
    "inflow": "SIH has no drag of its own along z: SIH_KDV acts along all axes",
    "translational_lift": "SIH has no translational lift",
    "cg_offset": "SIH's motors are symmetric about the centre of mass",
    "torque_bias": "SIH has no constant torque",
    "battery_sag": "SIH's battery does not touch the thrust",
    "payload_step": "SIH_MASS can be set in flight; a file cannot say when",
}
"""Why the simulator cannot represent an effect. Source: AIRFRAME 4.2."""
_INERTIA = ("SIH_IXX", "SIH_IYY", "SIH_IZZ")
_CROSS = (("SIH_IXY", "SIH_IYY"), ("SIH_IXZ", "SIH_IZZ"), ("SIH_IYZ", "SIH_IZZ"))
"""Each product of inertia and the moment of its second axis."""
_ALIKE = 0.02
"""Relative difference of damping up to which axes count as equal. Chosen, not measured: below the resolution of flights
(AIRFRAME 6)."""
_SAME = 1e-9
"""Relative difference up to which a setting equals the simulator's. Source: rounding of double numbers."""
_LAG_ALIKE = 0.001
"""Difference, s, up to which two time constants are equal. Chosen, not measured: a third of the resolution of flights
(AIRFRAME 6)."""


def sih_settings(wanted: Wanted, simulator: Mapping[str, float], *, mass: float | None = None) -> Settings:
    """Every SIH_* that differs from the simulator's, solved together; arguments as of ``sitl_settings``."""
    made = Settings(lost=list(wanted.refused))
    before = {name: float(simulator.get(name, default)) for name, default in DEFAULTS.items()}
    after = dict(before)
    grow = 1.0 if mass is None else mass / before["SIH_MASS"]
    after["SIH_MASS"] *= grow
    after["SIH_T_MAX"] *= wanted.thrust * grow
    after["SIH_Q_MAX"] *= wanted.thrust * wanted.yaw * grow
    after["SIH_KDV"] *= wanted.rotor_drag * math.sqrt(wanted.light) * grow  # its drag does not follow the rotors
    for name, ratio in zip(_INERTIA, wanted.inertia, strict=True):
        after[name] *= ratio * grow
    for (name, moment), added in zip(_CROSS, wanted.products, strict=True):
        after[name] = (before[name] / before[moment] + added) * after[moment]
    after["SIH_KDW"] = before["SIH_KDW"] * wanted.light * grow * _damper(wanted, made)
    after["SIH_T_TAU"] = _lag(before, wanted, made)
    if wanted.rotor_drag != 1.0:
        made.notes.append("SIH_KDV acts along the world's three axes alike")
    made.parameters |= {name: v for name, v in after.items() if abs(v - before[name]) > _SAME * abs(before[name])}
    return made


def _damper(wanted: Wanted, made: Settings) -> float:
    """Damping ratio for all axes: the mean of the wanted ones."""
    needed = {axis: ratio for axis, ratio in zip("xyz", wanted.damping, strict=True) if ratio is not None}
    if not needed:
        return 1.0
    found = sum(needed.values()) / len(needed)
    if any(abs(v - found) > _ALIKE * found for v in needed.values()):
        listed = ", ".join(f"{axis} {v:.3g}" for axis, v in needed.items())
        made.lost.append(f"angular_damping: SIH_KDW is one for all axes; wanted are its multiples {listed}")
    if len(needed) < len(_INERTIA):
        made.lost.append(f"angular_damping: SIH_KDW also acts about {', '.join(sorted(set('xyz') - set(needed)))}")
    return found


def _lag(before: Mapping[str, float], wanted: Wanted, made: Settings) -> float:
    """Time constant for both directions; a rate limit cannot be represented."""
    if wanted.slew is not None:
        made.lost.append("motor_lag: SIH has a time constant and no limit of the rate")
    if wanted.lag is None:
        return before["SIH_T_TAU"]
    up, down = wanted.lag
    if abs(up - down) > _LAG_ALIKE:
        made.lost.append(
            f"motor_lag: SIH_T_TAU is one for both directions; {up:+.3g} s up and {down:+.3g} s down wanted"
        )
    found = before["SIH_T_TAU"] + 0.5 * (up + down)
    if found < 0.0:
        made.lost.append(f"motor_lag: SIH_T_TAU would be {found:.3g} s; it stays at 0 or more")
    return max(0.0, found)
