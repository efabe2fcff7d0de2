"""Effects of the airframe: a physical change of one side, and what a model of forces and torques sees of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mavcal.calib.blind.airframe.changes import blades, both, driven, factor, hulled, relative, signed
from mavcal.calib.blind.airframe.draw import log_uniform, without_battery
from mavcal.calib.blind.airframe.flight import LOOP_S, SUBSTEPS, Events
from mavcal.calib.blind.airframe.seen import Seen, see
from mavcal.calib.blind.airframe.sides import Array, Entry, Kind, Pair, Rng

GRID_S = LOOP_S / SUBSTEPS
"""Delays are whole steps of it."""
TOLD_AT_M = 0.25
"""Height of the rotors above the ground, m. Source: docs/gap-effects.md, ``ground_effect``."""


def thrust_scale(rng: Rng, pair: Pair) -> Pair:
    """Other propellers; what more thrust has more of drag and inflow keeps both as they were in hover."""
    old, ratio = pair.real.vehicle, factor(rng, 1.02, 1.3)
    blade, root = old.propeller, math.sqrt(ratio)
    new = blades(old, thrust=blade.thrust * ratio, drag=blade.drag * root, inflow=blade.inflow * root)
    params, ratios = relative({"s": lambda x: x.thrust}, *both(old, new))
    return pair.flown(new).said(Entry("thrust_scale", "airframe", params, ratios, ("s",), size=ratio))


def mass(rng: Rng, pair: Pair) -> Pair:
    """Another mass: thrust over mass is what is seen. It divides every force, so that all of them are seen changed."""
    old, ratio = pair.real.vehicle, factor(rng, 1.02, 1.3)
    new = hulled(old, replace(old.hull, mass=old.hull.mass / ratio))
    params, ratios = relative({"s": lambda x: x.thrust}, *both(old, new))
    also = ("rotor_drag", "body_drag", "inflow", "translational_lift", "inertia", "yaw_coefficient", "angular_damping")
    return pair.flown(new).said(Entry("thrust_scale", "airframe", params, ratios, ("s",), also, size=ratio))


def thrust_expo(rng: Rng, pair: Pair) -> Pair:
    """Another thrust curve with the same full thrust."""
    old = pair.real.vehicle
    step = signed(rng, 0.05, 0.3)
    if not 0.1 <= old.drive.expo + step <= 0.95:
        step = -step
    new = driven(old, expo=float(np.clip(old.drive.expo + step, 0.1, 0.95)))
    a, b = (seen.expo for seen in both(old, new))
    return pair.flown(new).said(
        Entry("thrust_expo", "airframe", {"expo": b - a}, {"expo": b / a}, ("expo",), size=abs(step))
    )


def motor_lag(rng: Rng, pair: Pair) -> Pair:
    """Slower or faster motors, up and down alike; or a limit of the command's rate, which the simulator has not."""
    old = pair.real.vehicle
    if rng.random() < 0.25:
        slew = log_uniform(rng, 0.6, 4.0)
        new = driven(old, slew=slew)
        return pair.flown(new).said(Entry("motor_lag", "airframe", {"slew": slew}, also=("actuator_delay",), size=slew))
    ratio = factor(rng, 1.25, 2.5)
    up, down = old.drive.up * ratio, old.drive.down * ratio
    new = driven(old, up=up, down=down)
    params = {"tau_up": up - old.drive.up, "tau_down": down - old.drive.down}
    entry = Entry(
        "motor_lag", "airframe", params, {"tau_up": ratio, "tau_down": ratio}, ("tau_up", "tau_down"), size=ratio
    )
    return pair.flown(new).said(entry)


def actuator_delay(rng: Rng, pair: Pair) -> Pair:
    """A later output, in whole steps of the generator."""
    old = pair.real.vehicle
    late = GRID_S * max(1, round(log_uniform(rng, 0.003, 0.03) / GRID_S))
    new = driven(old, delay=old.drive.delay + late)
    ratios = {"delay": new.drive.delay / old.drive.delay}
    return pair.flown(new).said(Entry("actuator_delay", "airframe", {"delay": late}, ratios, ("delay",), size=late))


def motor_weak(rng: Rng, pair: Pair) -> Pair:
    """One propeller has less thrust and torque."""
    old, lost = pair.real.vehicle, log_uniform(rng, 0.01, 0.12)
    motor = int(rng.integers(len(old.rotors)))
    rotors = list(old.rotors)
    rotors[motor] = replace(rotors[motor], factor=rotors[motor].factor * (1.0 - lost))
    params, ratios = {"s": -lost, "motor": motor + 1.0}, {"s": 1.0 - lost}
    entry = Entry("motor_weak", "airframe", params, ratios, ("s",), instances=(motor + 1,), size=lost)
    return pair.flown(replace(old, rotors=tuple(rotors))).said(entry)


def rotor_drag(rng: Rng, pair: Pair) -> Pair:
    """More or less H-force; where the hubs lie off the centre of mass it damps rotations as well."""
    old, ratio = pair.real.vehicle, factor(rng, 1.15, 3.0)
    new = blades(old, drag=old.propeller.drag * ratio)
    params, ratios = relative({"c1": lambda x: x.rotor_drag}, *both(old, new))
    entry = Entry("rotor_drag", "airframe", params, ratios, ("c1",), ("angular_damping",), size=ratio)
    return pair.flown(new).said(entry)


def body_drag(rng: Rng, pair: Pair) -> Pair:
    """Another hull around the same frame."""
    old, ratio = pair.real.vehicle, factor(rng, 1.3, 3.0)
    x, y, z = (area * ratio for area in old.hull.area)
    new = hulled(old, replace(old.hull, area=(x, y, z)))
    params, ratios = relative({"c2": lambda x: x.body_drag}, *both(old, new))
    return pair.flown(new).said(Entry("body_drag", "airframe", params, ratios, ("c2",), size=ratio))


def inflow(rng: Rng, pair: Pair) -> Pair:
    """Blades that lose more or less thrust in a climb, with the same gain in level flight."""
    old = pair.real.vehicle
    mean = see(old).inflow
    step = signed(rng, 0.05, 0.35)
    if mean + step < 0.05:
        step = -step
    ratio = (mean + step) / mean
    new = blades(old, inflow=old.propeller.inflow * ratio, lift=old.propeller.lift / ratio)
    a, b = (seen.inflow for seen in both(old, new))
    entry = Entry("inflow", "airframe", {"cz": b - a}, {"cz": b / a}, ("cz",), ("angular_damping",), size=abs(step))
    return pair.flown(new).said(entry)


def translational_lift(rng: Rng, pair: Pair) -> Pair:
    """The gain in level flight is another share of momentum theory's; in half of the cases the simulator has none."""
    old = pair.real.vehicle
    if rng.random() < 0.5:
        lean = blades(pair.sim.vehicle, lift=0.0)
        pair, new = replace(pair, sim=replace(pair.sim, vehicle=lean)), old
        before = blades(old, lift=0.0)
    else:
        before, new = old, blades(old, lift=old.propeller.lift * log_uniform(rng, 1.4, 2.5))
    a, b = (seen.lift for seen in both(before, new))
    step = b - a
    return pair.flown(new).said(Entry("translational_lift", "airframe", {"ch": step}, size=step))


def inertia(rng: Rng, pair: Pair) -> Pair:
    """Mass sits further out or in: of one axis or all. Damping in 1/s changes with it."""
    old = pair.real.vehicle
    axes = [(0,), (1,), (0, 1), (0, 1, 2)][int(rng.integers(4))]
    ratios = {"xyz"[axis]: factor(rng, 1.04, 1.5) for axis in axes[:1]}
    ratios |= {"xyz"[axis]: ratios["xyz"[axes[0]]] * rng.uniform(0.95, 1.05) for axis in axes[1:]}
    x, y, z = (value * ratios.get(axis, 1.0) for axis, value in zip("xyz", old.hull.inertia, strict=True))
    new = hulled(old, replace(old.hull, inertia=(x, y, z)))
    params = {axis: ratio - 1.0 for axis, ratio in ratios.items()}
    also = ("angular_damping", "yaw_coefficient") if "z" in ratios else ("angular_damping",)
    entry = Entry("inertia", "airframe", params, ratios, tuple(ratios), also, size=ratios["xyz"[axes[0]]])
    return pair.flown(new).said(entry)


def cg_offset(rng: Rng, pair: Pair) -> Pair:
    """A shifted battery: 2 to 20 mm at an arm of a quarter of a metre. The inertial unit's lever arm shifts as well."""
    old = pair.real.vehicle
    size, angle = log_uniform(rng, 0.008, 0.08), rng.uniform(-math.pi, math.pi)
    x, y = size * math.cos(angle), size * math.sin(angle)
    cx, cy, cz = old.hull.centre
    new = hulled(old, replace(old.hull, centre=(cx + x * old.arm, cy + y * old.arm, cz)))
    entry = Entry("cg_offset", "airframe", {"x": x, "y": y}, {}, ("x", "y"), ("accel_lever_arm",), size=size)
    return pair.flown(new).said(entry)


def torque_bias(rng: Rng, pair: Pair) -> Pair:
    """A constant moment, or arms twisted all one way, which turn the vehicle about its down axis."""
    old = pair.real.vehicle
    axis = int(rng.integers(3))
    if axis == 2 and rng.random() < 0.5:
        lean = math.radians(signed(rng, 0.2, 1.5))
        new = replace(old, rotors=tuple(replace(r, tilt=_twisted(r.x, r.y, lean)) for r in old.rotors))
    else:
        # 2 to 10 % of a motor's hover thrust at its arm; about the down axis of its torque.
        share = signed(rng, 0.02, 0.1) * old.weight / len(old.rotors)
        moment = share * (old.propeller.torque_arm * len(old.rotors) if axis == 2 else old.arm)
        torque = [moment if k == axis else 0.0 for k in range(3)]
        new = hulled(old, replace(old.hull, torque=(torque[0], torque[1], torque[2])))
    a, b = (seen.trim[axis] for seen in both(old, new))
    name = "xyz"[axis]
    return pair.flown(new).said(Entry("torque_bias", "airframe", {name: b - a}, {}, (name,), size=abs(b - a)))


def _twisted(x: float, y: float, lean: float) -> tuple[float, float]:
    """Tilt of a rotor on an arm that is twisted about itself: its thrust leans clockwise seen from above."""
    arm = math.hypot(x, y)
    return -lean * y / arm, lean * x / arm


def yaw_coefficient(rng: Rng, pair: Pair) -> Pair:
    """Blades with another torque for their thrust."""
    old, ratio = pair.real.vehicle, factor(rng, 1.05, 1.7)
    new = blades(old, torque_arm=old.propeller.torque_arm * ratio)
    params, ratios = relative({"s": lambda x: x.yaw}, *both(old, new))
    return pair.flown(new).said(Entry("yaw_coefficient", "airframe", params, ratios, ("s",), ("inertia",), size=ratio))


def angular_damping(rng: Rng, pair: Pair) -> Pair:
    """More drag of the hull against rotation, of all axes."""
    old = pair.real.vehicle
    extra = log_uniform(rng, 0.7, 4.0)  # 1/s
    x, y, z = (d + extra * i for d, i in zip(old.hull.damping, old.hull.inertia, strict=True))
    new = hulled(old, replace(old.hull, damping=(x, y, z)))
    names: dict[str, Callable[[Seen], float]] = {
        "x": lambda s: s.damping[0],
        "y": lambda s: s.damping[1],
        "z": lambda s: s.damping[2],
    }
    params, ratios = relative(names, *both(old, new))
    return pair.flown(new).said(Entry("angular_damping", "airframe", params, ratios, ("x", "y", "z"), size=extra))


def battery_sag(rng: Rng, pair: Pair) -> Pair:
    """The simulated thrust does not follow the voltage: it has no battery, or one that only tells its voltage."""
    old = pair.sim.vehicle
    steady = without_battery(old) if rng.random() < 0.5 else driven(old, exponent=0.0)
    exponent = rng.uniform(1.0, 2.0)
    battery = replace(old.battery, resistance=old.battery.resistance * rng.uniform(1.0, 2.0))
    battery = replace(battery, capacity=battery.capacity * rng.uniform(0.3, 0.6))
    new = replace(driven(pair.real.vehicle, exponent=exponent), battery=battery)
    pair = replace(pair, sim=replace(pair.sim, vehicle=steady))
    return pair.flown(new).said(Entry("battery_sag", "airframe", {"exponent": exponent}, size=exponent))


def air_density(rng: Rng, pair: Pair) -> Pair:
    """A higher or colder place: all air forces with it."""
    old, ratio = pair.real.vehicle, factor(rng, 1.02, 1.15)
    new = replace(old, density=old.density * ratio)
    entry = Entry("air_density", "environment", {"s": ratio - 1.0}, {"s": ratio}, ("s",), size=ratio)
    return pair.flown(new).said(entry)


def ground_effect(rng: Rng, pair: Pair) -> Pair:
    """Only the real air feels the ground; `a` is the gain at the height at which reports tell it. Both hover low."""
    strength = log_uniform(rng, 0.8, 3.0)
    flat = replace(pair.sim.vehicle, ground=0.0)
    pair = replace(pair, sim=replace(pair.sim, vehicle=flat, low=True), real=replace(pair.real, low=True))
    new = replace(pair.real.vehicle, ground=strength)
    gain = 1.0 / (1.0 - strength * (new.propeller.radius / (4.0 * TOLD_AT_M)) ** 2) - 1.0
    return pair.flown(new).said(Entry("ground_effect", "airframe", {"a": gain}, exact=("a",), size=gain))


def payload_step(rng: Rng, pair: Pair) -> Pair:
    """Something falls off in flight."""
    lost, at = log_uniform(rng, 0.03, 0.3), rng.uniform(30.0, 75.0)

    def happen(events: Events, t: Array, _: Rng) -> Events:
        left = np.where(t < at, 1.0, 1.0 - lost)
        return replace(events, mass=left if events.mass is None else left * events.mass)

    real = replace(pair.real, happenings=(*pair.real.happenings, happen))
    # The vehicle of the label's other numbers is the one that took off.
    entry = Entry("payload_step", "airframe", {"s": -lost, "t": at}, {"s": 1.0 - lost}, ("s",), size=lost)
    return replace(pair, real=real).said(entry)


KINDS: tuple[Kind, ...] = (
    Kind("thrust_scale", thrust_scale, "thrust"),
    Kind("thrust_expo", thrust_expo, "curve"),
    Kind("motor_lag", motor_lag, "time"),
    Kind("actuator_delay", actuator_delay, "time"),
    Kind("motor_weak", motor_weak, "trim"),
    Kind("rotor_drag", rotor_drag, "drag"),
    Kind("body_drag", body_drag, "drag"),
    Kind("inflow", inflow, "inflow"),
    Kind("translational_lift", translational_lift, "inflow"),
    Kind("inertia", inertia, "inertia"),
    Kind("cg_offset", cg_offset, "trim"),
    Kind("torque_bias", torque_bias, "trim"),
    Kind("yaw_coefficient", yaw_coefficient, "inertia"),
    Kind("angular_damping", angular_damping, "damping"),
    Kind("battery_sag", battery_sag, "voltage"),
    Kind("ground_effect", ground_effect, "ground"),
    Kind("payload_step", payload_step, "thrust"),
)
"""Of the airframe. Two of one group are not put into one case."""
MASS = Kind("thrust_scale", mass, "thrust")
"""Alone only: beside another effect the numbers of both would be one."""
MASSES = 0.25
"""Share of thrust scales that are another mass. Chosen, not measured."""
