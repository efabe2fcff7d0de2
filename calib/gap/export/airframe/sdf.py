"""The airframe's effects as Gazebo's motor model and inertia (AIRFRAME 4.3).

A flight does not say what the model's own values are. The values are those that the plugin has by default; a comment
beside each says what to do with another model's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mavcal.calib.gap.export.airframe.patch import airframe_effects
from mavcal.calib.gap.export.airframe.wanted import Wanted, missing, wanted_of
from mavcal.calib.gap.schema import EffectEstimate

DEFAULTS: Mapping[str, float] = {
    "motorConstant": 8.54858e-06,
    "momentConstant": 0.016,
    "rotorDragCoefficient": 1e-4,
    "timeConstantUp": 0.0125,
    "timeConstantDown": 0.025,
}
"""Motor model. Source: gz-sim's MulticopterMotorModel.cc."""
REASONS: Mapping[str, str] = {
    "thrust_expo": "Gazebo's thrust goes with the square of the speed, and the bridge makes the speed of the command",
    "actuator_delay": "Gazebo has no delay between a command and its thrust",
    "body_drag": "Gazebo's motor model has no drag of the body",
    "inflow": "Gazebo's motor model has no inflow",
    "translational_lift": "Gazebo's motor model has no translational lift",
    "angular_damping": "Gazebo's damping is that of the rotors moving with their arms: it follows their drag",
    "torque_bias": "Gazebo has no constant torque",
    "battery_sag": "Gazebo's battery does not touch the thrust",
    "payload_step": "Gazebo's links keep their mass",
}
"""What the simulator has nothing for. Source: AIRFRAME 4.3."""
_PLUGIN = '<plugin filename="gz-sim-multicopter-motor-model-system" name="gz::sim::systems::MulticopterMotorModel">'


@dataclass(frozen=True)
class AirframeSdf:
    """Elements of a model, and in words what they cannot hold."""

    text: str
    lost: tuple[str, ...]


def airframe_sdf(effects: Sequence[EffectEstimate], *, mass: float | None = None) -> AirframeSdf:
    """Motor model and inertial elements with the airframe's effects; `mass` is the real vehicle's, kg, if known."""
    chosen = airframe_effects(effects)
    wanted = wanted_of(chosen)
    lost = [*missing(chosen, REASONS), *wanted.refused]
    if wanted.slew is not None:
        lost.append("motor_lag: Gazebo's motors have time constants and no limit of the rate")
    lines = _motor_model(wanted, lost)
    blocks = [_block(lines, None)] if lines else []
    blocks += [_block([_times("motorConstant", wanted.thrust * r)], n) for n, r in sorted(wanted.weak.items())]
    inertial = _inertial(wanted, mass)
    if inertial:
        blocks.append("\n".join(["<inertial>", *(f"  {line}" for line in inertial), "</inertial>"]))
    head = "<!-- mavcal: airframe; values are the plugin's defaults with the effects, axes forward-left-up -->"
    notes = [f"<!-- not held: {text.replace('--', '- -')} -->" for text in lost]
    return AirframeSdf("\n".join([head, *notes, *blocks]) + "\n", tuple(lost))


def _motor_model(wanted: Wanted, lost: list[str]) -> list[str]:
    """The speed at hover falls with the root of a rising constant, and the rotors' drag with that speed."""
    lines = []
    if wanted.thrust != 1.0:
        lines.append(_times("motorConstant", wanted.thrust))
    if wanted.yaw != 1.0:
        lines.append(_times("momentConstant", wanted.yaw))
    drag = wanted.rotor_drag * math.sqrt(wanted.thrust)
    if drag != 1.0:
        lines.append(_times("rotorDragCoefficient", drag))
    for name, added in zip(("timeConstantUp", "timeConstantDown"), wanted.lag or (), strict=False):
        value = DEFAULTS[name] + added
        if value < 0.0:
            lost.append(f"motor_lag: {name} would be {value:.3g} s; it stays at 0 or more")
        lines.append(f"{_element(name, max(0.0, value))} <!-- {added:+.4g} s to the model's own -->")
    return lines


def _inertial(wanted: Wanted, mass: float | None) -> list[str]:
    lines = []
    if mass is not None:
        lines.append(_element("mass", mass))
        lines.append(
            f"<!-- motorConstant, rotorDragCoefficient and inertia times {mass:.6g} over the model's own mass -->"
        )
    if wanted.inertia != (1.0, 1.0, 1.0):
        said = ", ".join(f"{n} times {r:.5g}" for n, r in zip(("ixx", "iyy", "izz"), wanted.inertia, strict=True))
        lines.append(f"<!-- inertia: {said} -->")
    signed = (-wanted.products[0], -wanted.products[1], wanted.products[2])  # forward-left-up
    for name, moment, added in zip(("ixy", "ixz", "iyz"), ("iyy", "izz", "izz"), signed, strict=True):
        if added:
            lines.append(f"<!-- inertia: {name} {added:+.5g} times {moment} to the model's own -->")
    if any(wanted.cg):
        ahead, right = wanted.cg
        lines.append(f"<!-- pose: x {ahead:+.5g}, y {-right:+.5g} times the longest arm to the model's own -->")
    return lines


def _times(name: str, ratio: float) -> str:
    return f"{_element(name, DEFAULTS[name] * ratio)} <!-- the model's own times {ratio:.5g} -->"


def _element(name: str, value: float) -> str:
    return f"<{name}>{value:.6g}</{name}>"


def _block(lines: Sequence[str], motor: int | None) -> str:
    about = [] if motor is None else [f"{_element('motorNumber', motor - 1)} <!-- motor {motor} -->"]
    return "\n".join([_PLUGIN, *(f"  {line}" for line in (*about, *lines)), "</plugin>"])
