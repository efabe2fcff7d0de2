"""Changes that no catalogue of effects names: what should be called unknown."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mavcal.calib.blind.airframe.changes import hulled
from mavcal.calib.blind.airframe.draw import log_uniform
from mavcal.calib.blind.airframe.flight import LOOP_HZ, Events
from mavcal.calib.blind.airframe.logs import coloured
from mavcal.calib.blind.airframe.sides import Array, Entry, Happening, Kind, Pair, Rng
from mavcal.calib.blind.airframe.surroundings import EARLIEST, LATEST
from mavcal.calib.blind.airframe.vehicle import SEA_LEVEL


def _happening(pair: Pair, happen: Happening) -> Pair:
    return replace(pair, real=replace(pair.real, happenings=(*pair.real.happenings, happen)))


def _unknown(name: str, honest: tuple[str, ...], size: float) -> Entry:
    """`honest` are names of the catalogue that describe a part of it."""
    return Entry(f"unknown_{name}", "airframe", {}, also=honest, size=size)


def esc_hysteresis(rng: Rng, pair: Pair) -> Pair:
    """The speed controller follows a command only once that has moved by a few per cent."""
    band = log_uniform(rng, 0.015, 0.05)

    def happen(events: Events, t: Array, _: Rng) -> Events:
        return replace(events, band=band)

    return _happening(pair, happen).said(_unknown("esc_hysteresis", ("actuator_delay", "motor_lag"), band))


def motor_tilt(rng: Rng, pair: Pair) -> Pair:
    """A motor's mount gives way in flight."""
    motor, size = int(rng.integers(len(pair.real.vehicle.rotors))), math.radians(log_uniform(rng, 3.0, 12.0))
    angle, at, takes = rng.uniform(-math.pi, math.pi), rng.uniform(EARLIEST, LATEST - 15.0), rng.uniform(0.5, 8.0)
    aim = np.array([math.cos(angle), math.sin(angle)]) * size

    def happen(events: Events, t: Array, _: Rng) -> Events:
        return replace(events, tilted=motor, tilt=np.clip((t - at) / takes, 0.0, 1.0)[:, None] * aim)

    return _happening(pair, happen).said(_unknown("motor_tilt", ("torque_bias", "cg_offset"), size))


def sail(rng: Rng, pair: Pair) -> Pair:
    """A plate askew to the nose: its drag has a side force."""
    vehicle = pair.real.vehicle
    square, angle = log_uniform(rng, 0.015, 0.06), math.radians(rng.uniform(25.0, 65.0)) * float(rng.choice([-1, 1]))
    area = 2.0 * square * vehicle.hull.mass / SEA_LEVEL
    new = hulled(vehicle, replace(vehicle.hull, plate=(angle, area)))
    return pair.flown(new).said(_unknown("sail", ("body_drag", "rotor_drag"), square))


def leak(rng: Rng, pair: Pair) -> Pair:
    """A sprayer empties through the whole flight."""
    lost = log_uniform(rng, 0.06, 0.3)

    def happen(events: Events, t: Array, _: Rng) -> Events:
        left = 1.0 - lost * np.clip((t - 15.0) / 75.0, 0.0, 1.0)
        return replace(events, mass=left if events.mass is None else left * events.mass)

    return _happening(pair, happen).said(_unknown("leak", ("payload_step",), lost))


def wake(rng: Rng, pair: Pair) -> Pair:
    """Thrust is lost, unsteadily, in descents through its own wake."""
    depth = log_uniform(rng, 0.08, 0.3)

    def happen(events: Events, t: Array, drawn: Rng) -> Events:
        unsteady = np.clip(1.0 + 0.6 * coloured(drawn, len(t), [1.0], 0.2)[:, 0], 0.0, 2.5)
        return replace(events, wake=depth * unsteady)

    return _happening(pair, happen).said(_unknown("wake", ("inflow", "turbulence"), depth))


def output_hold(rng: Rng, pair: Pair) -> Pair:
    """Outputs repeat for moments, at random."""
    a_second, length = log_uniform(rng, 1.0, 4.0), log_uniform(rng, 0.02, 0.08)

    def happen(events: Events, t: Array, drawn: Rng) -> Events:
        held = np.zeros(len(t), dtype=bool)
        for begin in np.flatnonzero(drawn.random(len(t)) < a_second / LOOP_HZ):
            held[begin : begin + max(1, round(length * drawn.uniform(0.5, 1.5) * LOOP_HZ))] = True
        return replace(events, held=held)

    return _happening(pair, happen).said(_unknown("output_hold", ("actuator_delay", "motor_lag"), a_second * length))


STRANGE: tuple[Kind, ...] = (
    Kind("unknown_esc_hysteresis", esc_hysteresis, "time"),
    Kind("unknown_motor_tilt", motor_tilt, "trim"),
    Kind("unknown_sail", sail, "drag"),
    Kind("unknown_leak", leak, "thrust"),
    Kind("unknown_wake", wake, "inflow"),
    Kind("unknown_output_hold", output_hold, "time"),
)
