"""PX4's simulation in hardware as a vehicle of this generator, and its settings as effects (AIRFRAME 4.2).

Thrust is linear in a lagged output, drag linear in the velocity along all axes, damping one for all axes, and there is
neither wind nor a battery that matters. Its sensors are loud. Read in PX4's ``sih.cpp`` of February 2025.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mavcal.calib.blind.airframe.air import Weather
from mavcal.calib.blind.airframe.changes import blades, both, driven, factor, hulled, relative, signed
from mavcal.calib.blind.airframe.draw import log_uniform
from mavcal.calib.blind.airframe.effects import inertia, mass, payload_step, yaw_coefficient
from mavcal.calib.blind.airframe.logs import Unit
from mavcal.calib.blind.airframe.sides import Entry, Kind, Pair, Rng
from mavcal.calib.blind.airframe.vehicle import FRAMES, Battery, Drive, Hull, Propeller, Vehicle

CALM = Weather(0.0, 0.0, 0.0)
SPREAD = 1.2
"""Owners set the simulator to their vehicle: each setting up to so many times its default. Chosen, not measured."""
SOFT = 0.3
"""Factor on the usual yaw gains, because the yaw torque is weak and late and the gyroscope is loud. Measured: it brings
the time with an output at its limit from 17 % of a flight to less than 1 %."""
NO_LAG_S = 1e-6
TOP = 1000.0
"""rad/s, of rotors that SIH does not have: only thrust, torque and lag are felt."""


def draw_sih(rng: Rng) -> Vehicle:
    """With settings about its defaults: 1 kg, 5 N and 0.1 N m a motor, 50 ms, 1 N s/m, 0.025 N m s, 0.2 m."""

    def about(default: float) -> float:
        return default * log_uniform(rng, 1.0 / SPREAD, SPREAD)

    thrust, frame = about(5.0), FRAMES["quad-x"]
    damping = about(0.025)
    return Vehicle(
        frame=frame.name,
        rotors=frame.rotors(math.sqrt(2.0) * about(0.2), 0.0),
        propeller=Propeller(thrust / TOP**2, about(0.1) / thrust, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1),
        drive=Drive(TOP, 0.0, NO_LAG_S, NO_LAG_S, about(0.05), 0.0, exponent=0.0),
        battery=Battery(16.2, 0.0, 1e9, 0.0),
        hull=Hull(
            mass=about(1.0),
            inertia=(about(0.025), about(0.025), about(0.03)),
            products=(0.0, 0.0, 0.0),
            centre=(0.0, 0.0, 0.0),
            area=(0.0, 0.0, 0.0),
            damping=(damping, damping, damping),
            pull=about(1.0),
        ),
    )


def draw_sih_units(rng: Rng) -> tuple[Unit, Unit]:
    """Two units alike, as loud as the simulator's own."""
    place = (rng.uniform(-0.01, 0.01), rng.uniform(-0.01, 0.01), 0.0)
    one = Unit(place, 0.1, (0.14, 0.07, 0.03), (0.5, 1.7, 1.4), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    return one, one


def t_max(rng: Rng, pair: Pair) -> Pair:
    """``SIH_T_MAX``: the torque about z is a setting of its own and stays."""
    old, ratio = pair.real.vehicle, factor(rng, 1.02, 1.3)
    blade = old.propeller
    new = blades(old, thrust=blade.thrust * ratio, torque_arm=blade.torque_arm / ratio)
    params, ratios = relative({"s": lambda x: x.thrust}, *both(old, new))
    return pair.flown(new).said(Entry("thrust_scale", "airframe", params, ratios, ("s",), size=ratio))


def t_tau(rng: Rng, pair: Pair) -> Pair:
    """``SIH_T_TAU``: one lag up and down, 10 to 150 ms."""
    old = pair.real.vehicle
    before = old.drive.filter
    after = float(np.clip(before * factor(rng, 1.25, 3.0), 0.01, 0.15))
    params = {"tau_up": after - before, "tau_down": after - before}
    ratios = dict.fromkeys(params, after / before)
    entry = Entry("motor_lag", "airframe", params, ratios, tuple(params), size=after / before)
    return pair.flown(driven(old, filter=after)).said(entry)


def kdv(rng: Rng, pair: Pair) -> Pair:
    """``SIH_KDV``: drag along all axes."""
    old, ratio = pair.real.vehicle, factor(rng, 1.1, 3.0)
    new = hulled(old, replace(old.hull, pull=old.hull.pull * ratio))
    params, ratios = relative({"c1": lambda x: x.rotor_drag}, *both(old, new))
    return pair.flown(new).said(Entry("rotor_drag", "airframe", params, ratios, ("c1",), size=ratio))


def kdw(rng: Rng, pair: Pair) -> Pair:
    """``SIH_KDW``: damping of all axes."""
    old, ratio = pair.real.vehicle, factor(rng, 1.4, 4.0)
    x, y, z = (d * ratio for d in old.hull.damping)
    new = hulled(old, replace(old.hull, damping=(x, y, z)))
    ratios = dict.fromkeys("xyz", ratio)
    params = dict.fromkeys("xyz", ratio - 1.0)
    return pair.flown(new).said(Entry("angular_damping", "airframe", params, ratios, ("x", "y", "z"), size=ratio))


def product(rng: Rng, pair: Pair) -> Pair:
    """``SIH_IXY``, ``SIH_IXZ`` or ``SIH_IYZ``, over the moment of the second axis."""
    old, share = pair.real.vehicle, signed(rng, 0.05, 0.3)
    which = int(rng.integers(3))
    one, other = ((0, 1), (0, 2), (1, 2))[which]
    size = share * old.hull.inertia[other]
    products = [size if k == which else 0.0 for k in range(3)]
    new = hulled(old, replace(old.hull, products=(products[0], products[1], products[2])))
    name = "xyz"[one] + "xyz"[other]
    return pair.flown(new).said(Entry("inertia", "airframe", {name: share}, {}, (name,), size=abs(share)))


def arm(rng: Rng, pair: Pair) -> Pair:
    """``SIH_L_ROLL`` or ``SIH_L_PITCH``: seen as another inertia of that axis, whose damping stays."""
    old, ratio = pair.real.vehicle, factor(rng, 1.04, 1.3)
    roll = bool(rng.random() < 0.5)
    rotors = tuple(replace(r, y=r.y * ratio) if roll else replace(r, x=r.x * ratio) for r in old.rotors)
    axis = "x" if roll else "y"
    entry = Entry("inertia", "airframe", {axis: 1.0 / ratio - 1.0}, {axis: 1.0 / ratio}, size=ratio)
    return pair.flown(replace(old, rotors=rotors)).said(entry)


SIH_KINDS: tuple[Kind, ...] = (
    Kind("thrust_scale", t_max, "thrust"),
    Kind("thrust_scale", mass, "thrust"),
    Kind("motor_lag", t_tau, "time"),
    Kind("rotor_drag", kdv, "drag"),
    Kind("angular_damping", kdw, "damping"),
    Kind("inertia", inertia, "inertia"),
    Kind("inertia", product, "inertia"),
    Kind("inertia", arm, "inertia"),
    Kind("yaw_coefficient", yaw_coefficient, "inertia"),
    Kind("payload_step", payload_step, "thrust"),
)
"""The settings that AIRFRAME 6 names for its tier A2."""
