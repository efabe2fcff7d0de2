"""ArduPilot's simulated multicopter with the wanted effects: keys of its frame, and SIM_* parameters (AIRFRAME 4.1)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mavcal.calib.gap.export.airframe.frame import OWN_DAMPING, PARAMETERS, PULSE_ZERO, Frame, FrameMotor
from mavcal.calib.gap.export.airframe.wanted import Wanted

REASONS: Mapping[str, str] = {
    "actuator_delay": "SITL has no delay between a command and its thrust",
    "inflow": "SITL has no drag of its own along z: mdrag_coef acts along all axes",
    "translational_lift": "SITL has no translational lift",
    "payload_step": "SITL's frame keeps its mass in flight; SIM_SLUP_* is a load on a line",
}
"""Why the simulator cannot represent an effect. Source: AIRFRAME 4.1."""
_MASK_BITS = 32
"""Outputs that SIM_ENGINE_FAIL can name. Source: ArduPilot's SITL_State.cpp, a 32-bit mask."""
_LASTING = 3_600_000.0
"""Duration, ms, of a permanent torque. Chosen, not measured: longer than a flight."""
_ALIKE = 0.02
"""Relative difference of damping up to which axes count as equal. Chosen, not measured: below the resolution of flights
(AIRFRAME 6).
"""
_SAME = 1e-9
"""Relative difference up to which a setting equals the simulator's. Source: rounding of double numbers."""


@dataclass
class Settings:
    """Settings so far: keys of the frame, parameters, notes on what they cannot represent, and advice."""

    frame: dict[str, Any] = field(default_factory=dict)
    parameters: dict[str, float] = field(default_factory=dict)
    lost: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def sitl_settings(
    wanted: Wanted,
    frame: Frame,
    simulator: Mapping[str, float],
    *,
    mass: float | None = None,
    capacity: float | None = None,
) -> Settings:
    """Everything that differs from the simulator as it is, solved together.

    Parameters
    ----------
    wanted
        The effects.
    frame, simulator
        The simulator as it was flown: its frame, and the parameters of its log.
    mass
        Of the real vehicle, kg; None: the simulator keeps its own, and only ratios to the mass are what they should be.
    capacity
        Of the real vehicle's battery, Ah; None: not known.
    """
    made = Settings(lost=list(wanted.refused))
    target = _scaled(frame, mass)
    target = _thrust(target, wanted, made)
    target = _drag(target, frame, wanted, simulator, made)
    target = _inertia(target, frame, wanted, made)
    target = _battery(target, wanted, capacity, made)
    target = _motors(target, wanted, made)
    target = _damping(target, frame, wanted, made)
    _weak(target, frame, wanted, simulator, made)
    _torque(wanted, simulator, made)
    _lag(wanted, made)
    _write(made, target, frame, simulator)
    return made


def _scaled(frame: Frame, mass: float | None) -> Frame:
    """The same accelerations with another mass: forces, torques and currents grow with it."""
    if mass is None:
        return frame
    grow = mass / frame["mass"]
    keys = dict(frame.keys) | {"mass": mass, "refCurrent": frame["refCurrent"] * grow}
    if frame["battCapacityAh"] > 0.0:
        keys |= {"battCapacityAh": frame["battCapacityAh"] * grow, "refBatRes": frame["refBatRes"] / grow}
    x, y, z = frame.inertia
    return replace(frame, keys=keys, inertia=(x * grow, y * grow, z * grow))


def _thrust(target: Frame, wanted: Wanted, made: Settings) -> Frame:
    hover = target["hoverThrOut"] / wanted.thrust
    if hover >= 1.0:
        made.lost.append(f"thrust_scale: hoverThrOut would be {hover:.3g}: the simulated vehicle could not hover")
    expo = target["propExpo"] + wanted.expo
    if not 0.0 <= expo <= 1.0:
        made.lost.append(f"thrust_expo: propExpo would be {expo:.3g}; it stays within 0 to 1")
    slew = target["slew_max"] if wanted.slew is None else wanted.slew
    return _with(target, hoverThrOut=hover, propExpo=min(max(expo, 0.0), 1.0), slew_max=slew)


def _drag(target: Frame, frame: Frame, wanted: Wanted, simulator: Mapping[str, float], made: Settings) -> Frame:
    """Rotor drag c_1 and body drag c_2 of the target, through ``mdrag_coef`` and ``refSpd``.

    With u the reference speed, q the rotors' drag over u and F the drag of the tilt, the body has S = b (F - q u)/u^2.
    A wanted S gives S u^2 + b q u = b F. Where the log has SIM_FRM_BBDRAG (b), that is solved for and u stays.
    """
    grow = target["mass"] / frame["mass"]
    if wanted.rotor_drag != 1.0 and frame.rotor_drag == 0.0:
        made.lost.append("rotor_drag: the simulated rotors have none, so there is nothing to multiply")
    if wanted.body_drag != 1.0 and frame.body == 0.0:
        made.lost.append("body_drag: the simulated body has none, so there is nothing to multiply")
    if wanted.rotor_drag == wanted.body_drag == grow == 1.0:
        return target
    target = _with(target, mdrag_coef=frame.mdrag * wanted.rotor_drag * math.sqrt(grow))
    if wanted.rotor_drag != 1.0:
        made.notes.append("mdrag_coef acts along z as well, and the rotors moving with their arms damp in proportion")
    body = frame.body * wanted.body_drag * grow
    speed, pull, drag = target["refSpd"], target.momentum, target.reference_drag
    if PARAMETERS["bbdrag_coef"] in simulator and drag > pull * speed:
        return _with(target, bbdrag_coef=body * speed**2 / (drag - pull * speed))
    scale = target["bbdrag_coef"]
    if scale == 0.0:  # no body drag at any speed; a higher one would cut that of the rotors
        return target if pull * speed <= drag else _with(target, refSpd=drag / pull)
    root = math.sqrt((scale * pull) ** 2 + 4.0 * body * scale * drag)
    return _with(target, refSpd=2.0 * scale * drag / (scale * pull + root))


def _inertia(target: Frame, frame: Frame, wanted: Wanted, made: Settings) -> Frame:
    if any(wanted.products):
        made.lost.append("inertia: moment_inertia has no products of inertia")
    grow = target["mass"] / frame["mass"]
    x, y, z = (i * r * grow for i, r in zip(frame.inertia, wanted.inertia, strict=True))
    return replace(target, inertia=(x, y, z))


def _battery(target: Frame, wanted: Wanted, capacity: float | None, made: Settings) -> Frame:
    """A battery with more voltage sag: less charge and more resistance; one without sag gets the vehicle's capacity."""
    if not wanted.sags:
        return target
    present = target["battCapacityAh"]
    if present <= 0.0 and capacity is None:
        made.lost.append(
            "battery_sag: the simulator's battery does not fall and the vehicle's is not known; set battCapacityAh "
            "and refBatRes to what it has (BATT_CAPACITY, BAT.Res)"
        )
        return target
    if present <= 0.0 and capacity is not None:
        made.lost.append(f"battery_sag: refBatRes is {target['refBatRes']:g} ohm; set it to the flight's BAT.Res")
        return _with(target, battCapacityAh=capacity)
    if wanted.sag is None:
        made.lost.append("battery_sag: SITL's thrust goes with the square of the voltage")
        return target
    made.notes.append("battery_sag: charge and resistance together, to first order")
    return _with(target, battCapacityAh=present / wanted.sag, refBatRes=target["refBatRes"] * wanted.sag)


def _motors(target: Frame, wanted: Wanted, made: Settings) -> Frame:
    """Motors moved against the centre of mass, and their yaw factors."""
    if wanted.cg == (0.0, 0.0) and wanted.yaw == 1.0:
        return target
    asked = [name for name, some in (("cg_offset", any(wanted.cg)), ("yaw_coefficient", wanted.yaw != 1.0)) if some]
    known = bool(target.motors) and (wanted.yaw == 1.0 or all(m.yaw for m in target.motors))
    if not known:
        made.lost += [f"{name}: where the motors are and how they turn is not known; state the frame" for name in asked]
        return target
    if wanted.yaw != 1.0:
        made.notes.append("SITL's yaw torque goes with command times thrust")
    ahead, right = (c * target.arm for c in wanted.cg)
    return replace(target, motors=tuple(_moved(m, ahead, right, wanted.yaw) for m in target.motors))


def _moved(motor: FrameMotor, ahead: float, right: float, yaw: float) -> FrameMotor:
    x, y, z = motor.position
    return FrameMotor((x - ahead, y - right, z), motor.yaw * yaw)


def _damping(target: Frame, frame: Frame, wanted: Wanted, made: Settings) -> Frame:
    """Damping beyond that of the rotors, by ``refRotRate``, one number for all axes."""
    if all(ratio is None for ratio in wanted.damping):
        return target
    rotors = target.rotor_damping
    axes = [i for i, ratio in enumerate(wanted.damping) if ratio is not None]
    total = np.array([(rotors[i] + frame.own_damping) * (wanted.damping[i] or 1.0) for i in axes])
    own = float(np.mean(total - rotors[axes]))
    if own <= 0.0:
        made.lost.append(
            f"angular_damping: {np.mean(total):.3g} 1/s is wanted, the rotors moving with their arms alone make "
            f"{np.mean(rotors[axes]):.3g}"
        )
        own = 0.0
    elif np.any(np.abs(rotors[axes] + own - total) > _ALIKE * total):
        listed = ", ".join(f"{'xyz'[i]} {w:.3g}" for i, w in zip(axes, total, strict=True))
        made.lost.append(f"angular_damping: refRotRate is one for all axes; wanted are {listed} 1/s")
    if len(axes) < len(wanted.damping) and abs(own - frame.own_damping) > _ALIKE * float(rotors.min()):
        rest = ", ".join("xyz"[i] for i in range(len(wanted.damping)) if i not in axes)
        made.lost.append(f"angular_damping: refRotRate also acts about {rest}")
    return _with(target, refRotRate=OWN_DAMPING / own if own > 0.0 else 0.0)


def _weak(target: Frame, frame: Frame, wanted: Wanted, simulator: Mapping[str, float], made: Settings) -> None:
    """One factor of the pulse for all weak motors, so that the thrust is right at the hover command."""
    if not wanted.weak:
        return
    present, mask = simulator.get("SIM_ENGINE_MUL", 1.0), int(simulator.get("SIM_ENGINE_FAIL", 0.0))
    was = _thrust_ratio(frame, present, _voltage(frame, simulator))
    motors = {n + 1: was for n in range(_MASK_BITS) if mask & (1 << n)} if present != 1.0 else {}
    motors |= {n: motors.get(n, 1.0) * ratio for n, ratio in wanted.weak.items()}
    common = float(np.mean(list(motors.values())))
    made.lost += [
        f"motor_weak of motor {n}: SIM_ENGINE_MUL multiplies the pulse; the thrust is right at the hover command only"
        for n in sorted(wanted.weak)
    ]
    if max(motors.values()) - min(motors.values()) > _SAME:
        listed = ", ".join(f"{n}: {motors[n]:.3g}" for n in sorted(motors))
        made.lost.append(f"motor_weak: one factor for all motors of SIM_ENGINE_FAIL, {common:.3g}; wanted are {listed}")
    voltage = _voltage(target, simulator)
    hover = target.hover_thrust(voltage)
    if common * hover > 1.0:
        made.lost.append(f"motor_weak: {common:.3g} times the hover thrust is more than full command gives")
    pulse = _pulse(target, _command(target, min(1.0, common * hover)))
    made.parameters["SIM_ENGINE_FAIL"] = float(sum(1 << (n - 1) for n in motors))
    made.parameters["SIM_ENGINE_MUL"] = (pulse - PULSE_ZERO) / (_pulse(target, _command(target, hover)) - PULSE_ZERO)
    made.notes.append(
        "SIM_ENGINE_FAIL is a mask of motors, the first is 1, from ArduPilot 4.7 on; before, the number of one output "
        "from 0"
    )


def _thrust_ratio(frame: Frame, factor: float, voltage: float) -> float:
    """Thrust at the hover command with the pulse multiplied, over that without."""
    hover, expo = frame.hover_thrust(voltage), frame["propExpo"]
    low, high = _pulse(frame, 0.0), _pulse(frame, 1.0)
    pulse = PULSE_ZERO + factor * (_pulse(frame, _command(frame, hover)) - PULSE_ZERO)
    command = min(1.0, max(0.0, (pulse - low) / (high - low)))
    return ((1.0 - expo) * command + expo * command**2) / hover


def _command(frame: Frame, thrust: float) -> float:
    """The command, 0 to 1, at which the curve (1-e) c + e c^2 gives `thrust` of full."""
    e, most = frame["propExpo"], min(1.0, max(0.0, thrust))
    return 2.0 * most / ((1.0 - e) + math.sqrt((1.0 - e) ** 2 + 4.0 * e * most)) if most > 0.0 else 0.0


def _pulse(frame: Frame, command: float) -> float:
    width = frame["pwmMax"] - frame["pwmMin"]
    return frame["pwmMin"] + width * (frame["spin_min"] + command * (frame["spin_max"] - frame["spin_min"]))


def _voltage(frame: Frame, simulator: Mapping[str, float]) -> float:
    """Voltage of a constant battery, V; one with sag is taken as full."""
    stated = simulator.get("SIM_BATT_VOLTAGE", 0.0)
    return stated if stated > 0.0 and frame["battCapacityAh"] <= 0.0 else frame["maxVoltage"]


def _torque(wanted: Wanted, simulator: Mapping[str, float], made: Settings) -> None:
    if not any(wanted.torque):
        return
    lasts = simulator.get("SIM_TWIST_TIME", 0.0) > 0.0
    for axis, size in zip("XYZ", wanted.torque, strict=True):
        present = simulator.get(f"SIM_TWIST_{axis}", 0.0) if lasts else 0.0
        made.parameters[f"SIM_TWIST_{axis}"] = present + size
    made.parameters["SIM_TWIST_TIME"] = _LASTING
    made.notes.append("SIM_TWIST_TIME ends the torque after an hour and is then 0: set it before each flight")


def _lag(wanted: Wanted, made: Settings) -> None:
    if wanted.lag is None:
        return
    made.lost.append("motor_lag: SITL's motors have no first-order lag, only a limit of their rate (slew_max)")


def _write(made: Settings, target: Frame, frame: Frame, simulator: Mapping[str, float]) -> None:
    """Add the differences from the present simulator; keys with a parameter in its log become that parameter."""
    for key, value in target.keys.items():
        if abs(value - frame[key]) <= _SAME * abs(frame[key]):
            continue
        if PARAMETERS.get(key) in simulator:
            made.parameters[PARAMETERS[key]] = value
        else:
            made.frame[key] = _rounded(value)
    if not np.allclose(target.inertia, frame.inertia, rtol=_SAME, atol=0.0):
        made.frame["moment_inertia"] = _listed(target.inertia)
    unread = sorted(name for name in simulator if name.startswith("SIM_FRM_") and name not in PARAMETERS.values())
    if made.frame and unread:
        made.notes.append(f"SIM_FRM_* go before the frame's file: mind {', '.join(unread)}")
    for n, (motor, before) in enumerate(zip(target.motors, frame.motors, strict=True), start=1):
        if motor.position != before.position:
            made.frame[f"motor{n}_position"] = _listed(motor.position)
        if motor.yaw != before.yaw:
            made.frame[f"motor{n}_yaw"] = _rounded(motor.yaw)


def _rounded(value: float) -> float:
    """`value` rounded to the digits of the simulator's float32."""
    return float(f"{value:.8g}")


def _listed(values: Sequence[float]) -> list[float]:
    return [_rounded(v) for v in values]


def _with(frame: Frame, **changed: float) -> Frame:
    return replace(frame, keys={**frame.keys, **changed})
