"""Effects that two flights can show, and what the others would need (AIRFRAME 5.8)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.airframe.fit import FlightLikelihood
from mavcal.calib.airframe.flown import LOG_BITS, PROFILE_BITS
from mavcal.calib.airframe.physics import AXES

Array = NDArray[np.float64]

TORQUE_HZ: Final = 90.0
"""Least rate, Hz, of commands and gyroscope to judge torque. Source: AIRFRAME 5.7, torque needs 100 Hz; a log at loop
rate may lack one row in ten."""
COMMAND_HZ: Final = 40.0
"""Least rate, Hz, of commands to judge the shape of thrust. Source: AIRFRAME 5.7, 50 Hz resolved curve and lag."""
_RUN: Final = 3.0
_FAST: Final = 7.5
_CLIMB: Final = 1.0
_LIFT_SPAN: Final = 0.15
_SAG_SPAN: Final = 0.06
_LEAST_TURNS: Final = 0.03
_MOST_LIMITED: Final = 0.2
"""Requirements of AIRFRAME 5.8: speed both ways, m/s; airspeed for a square law (8 m/s in a fraction of a flight). Then
climbs; range of the collective command; of the voltage; fraction of a flight in commanded turns; fraction at a
limit."""
_LEAST_RATE: Final = 0.1
"""Rate, rad/s, that an axis exceeds for a hundredth of a flight with commanded turns. Chosen, not measured: a doublet
of 10 degrees reaches 0.5, a calm hover 0.03."""


@dataclass(frozen=True)
class Missing:
    """An effect that these flights could not have shown, why, and what would be needed.

    `latent`: it may still be present. It then competes, so that no other effect absorbs it, but is not named. `axes`:
    only these could not have shown it; empty: none could.
    """

    id: str
    reason: str
    need: str
    latent: bool = False
    axes: tuple[str, ...] = ()

    @property
    def wholly(self) -> bool:
        """Whether the effect is left out altogether and does not compete."""
        return not self.latent and not self.axes


TORQUE_IDS: Final = (
    "motor_weak", "inertia", "cg_offset", "torque_bias", "yaw_coefficient", "angular_damping", "motor_lag",
    "actuator_delay",
)  # fmt: skip


def missing(real: FlightLikelihood, sim: FlightLikelihood, winds: tuple[Array, Array]) -> tuple[Missing, ...]:
    """Everything that cannot be tested with both flights; `winds` (2,) blow to north and east in each, m/s."""
    return tuple(_missing(real, sim, winds))


def _missing(real: FlightLikelihood, sim: FlightLikelihood, winds: tuple[Array, Array]) -> Iterator[Missing]:
    pair = {"real": real, "simulated": sim}
    yield from _by_rates(pair)
    for (which, one), wind in zip(pair.items(), winds, strict=True):
        yield from _by_motion(which, one, wind)
    silent = [which for which, one in pair.items() if not one.airframe.flight.has_voltage]
    if silent:
        log = LOG_BITS if pair[silent[0]].airframe.flight.ardupilot else PROFILE_BITS
        yield Missing("battery_sag", f"the {silent[0]} recording has no voltage of the battery", log)
    elif real.airframe.voltage_span < _SAG_SPAN:
        span = 100.0 * real.airframe.voltage_span
        need = "a flight that empties the battery by 6 % in voltage"
        yield Missing("battery_sag", f"the voltage changes by {span:.1f} %", need)


def _by_rates(pair: Mapping[str, FlightLikelihood]) -> Iterator[Missing]:
    """Effects that need faster logs, or turns."""
    log = LOG_BITS if pair["real"].airframe.flight.ardupilot else PROFILE_BITS
    rates = {w: min(f.airframe.flight.command_hz, f.airframe.flight.inertial_hz) for w, f in pair.items()}
    slow = min(rates, key=lambda w: rates[w])
    if rates[slow] < COMMAND_HZ:
        yield Missing("thrust_expo", f"commands of the {slow} flight at {rates[slow]:.0f} Hz: a curve needs 40 Hz", log)
    if rates[slow] < TORQUE_HZ:
        reason = f"commands or gyroscope of the {slow} flight at {rates[slow]:.0f} Hz: torque needs 100 Hz"
        for id_ in TORQUE_IDS:
            yield Missing(id_, reason, f"{log}: commands and gyroscope at 100 Hz or more")
        return
    for which, one in pair.items():
        turning = float(one.turns.mean())
        if turning < _LEAST_TURNS:
            need = "sharp roll and pitch doublets and yaw steps, or a chirp of SID_AXIS 10 to 12"
            reason = f"the {which} vehicle is made to turn in {100 * turning:.0f} % of its flight only"
            for id_ in ("inertia", "yaw_coefficient", "angular_damping", "motor_lag", "actuator_delay"):
                yield Missing(id_, f"{reason}: commands answer gusts", need)
            return
        yield from _by_axis(which, one)


def _by_axis(which: str, one: FlightLikelihood) -> Iterator[Missing]:
    """Effects that need turns about an axis about which the flight hardly turns."""
    flight = one.airframe.flight
    rates = np.percentile(np.abs(flight.rate[flight.usable]), 99.0, axis=0)
    for axis, name, rate in zip(AXES, ("roll", "pitch", "yaw"), rates, strict=True):
        if rate < _LEAST_RATE:
            reason = f"the {which} vehicle turns in {name} at {rate:.2f} rad/s"
            need = "yaw steps of 60 degrees and more" if axis == "z" else f"sharp doublets in {name}"
            yield Missing("inertia", reason, need, axes=(axis,))
            if axis == "z":
                yield Missing("yaw_coefficient", reason, need)


def _by_motion(which: str, one: FlightLikelihood, wind: Array) -> Iterator[Missing]:
    """Effects that need a faster, less level or less steady flight."""
    flight = one.airframe.flight
    rows = flight.usable
    level = np.hypot(*flight.velocity[rows, :2].T)
    span = float(np.ptp(np.percentile(flight.c[rows].mean(axis=1), (5.0, 95.0))))
    through_air = np.hypot(*(flight.velocity[rows, :2] - wind).T)
    fast, usual = float(np.percentile(through_air, 98.0)), float(np.percentile(level, 90.0))
    climb = float(np.percentile(np.abs(flight.velocity[rows, 2]), 97.0))
    if span < _LIFT_SPAN and one.lifts.mean() < _LEAST_TURNS:
        why = f"the {which} flight's throttle spans {span:.2f}"
        yield Missing("thrust_expo", why, "throttle steps of 0.3", latent=True)
    if usual < _RUN:
        need = f"runs out and back at {_RUN:.0f} m/s and more, along x and y"
        yield Missing("rotor_drag", f"the {which} vehicle flies at {usual:.1f} m/s", need, latent=True)
    if fast < _FAST:
        need = "runs at two speeds, the faster one at 8 m/s or more"
        for id_ in ("body_drag", "translational_lift"):
            yield Missing(id_, f"the {which} vehicle reaches {fast:.1f} m/s through the air", need, latent=True)
    if climb < _CLIMB:
        need = "climbs and descents at 2 to 4 m/s"
        yield Missing("inflow", f"the {which} vehicle climbs at {climb:.1f} m/s", need, latent=True)


def unusable(one: FlightLikelihood) -> str | None:
    """Why a whole flight cannot be judged: too much of it is at a limit; None: it can."""
    limited = float(one.airframe.flight.limited.mean())
    if limited > _MOST_LIMITED:
        return f"a motor is at its limit in {100 * limited:.0f} % of the flight"
    return None
