"""The catalogue: each effect of airframe, actuators and air, and what it does to the parameters of a flight.

An effect has amplitudes; it multiplies, divides or shifts parameters of :class:`calib.airframe.physics.Layout`. What
the simulator's flight shows too is not a gap: amplitudes are those of the real flight relative to the simulated one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.airframe.answer import Domain
from mavcal.calib.airframe.density import ID as DENSITY
from mavcal.calib.airframe.density import Densities
from mavcal.calib.airframe.nameless import GROUPS, PREFIX, SIZES
from mavcal.calib.airframe.physics import AXES, PRODUCTS, Kind, Layout

Array = NDArray[np.float64]


class Act(StrEnum):
    """How an amplitude changes a parameter."""

    TIMES = "times"  # multiplied by 1 + share * amplitude
    OVER = "over"  # divided by 1 + amplitude
    PLUS = "plus"  # amplitude * share is added


@dataclass(frozen=True)
class Change:
    """What one amplitude does to one parameter."""

    amplitude: int
    parameter: str
    act: Act
    share: float = 1.0


@dataclass(frozen=True)
class AirframeEffect:
    """One candidate block of effects.

    `id` is the effect's name in a report, `block` that of this form of it. `names` and `sd` are the amplitudes and
    their prior standard deviations; `base` the parameters whose ratios or differences are reported. `odds` are the
    prior odds that it is present.
    """

    id: str
    block: str
    names: tuple[str, ...]
    sd: tuple[float, ...]
    changes: tuple[Change, ...]
    base: tuple[str, ...]
    domain: Domain = Domain.AIRFRAME
    odds: float = 0.05
    exclusive: str = ""
    nameless: bool = False
    slew: bool = False
    motor: int | None = None
    torque: bool = False
    """Whether only torque shows it."""
    mean: float = 0.0
    """Prior mean of every amplitude, where the logs state one."""
    axes: frozenset[str] = frozenset()
    """Axes about all of which the vehicle must turn for the effect to show."""
    sides: tuple[float, float] | None = None
    """The parameter in the real and in the simulated flight, where the logs state it."""


FORMS: Final[Mapping[str, str]] = {"thrust_scale": "thrust", "thrust_by_lift": "lift", "thrust_by_mass": "mass"}
"""Block to cause, for an effect whose causes a report distinguishes."""
ODDS: Final = 0.05
"""Prior odds of each effect. Source: mixtures of one to four of twenty effects (AIRFRAME 6) have a mean of about
one."""


BODY_DRAG: Final[tuple[str, ...]] = ("c2_x", "c2_y")
STEPS: Final = 50.0
"""Number of times at which a load drop is tried in a flight of two minutes. Source: one in two seconds."""
IDS: Final = frozenset(
    {
        "thrust_scale", "thrust_expo", "rotor_drag", "body_drag", "inflow", "translational_lift", "inertia",
        "cg_offset", "motor_weak", "torque_bias", "yaw_coefficient", "angular_damping", "battery_sag", "motor_lag",
        "actuator_delay",
        "payload_step", "wind", "air_density",
    }
)  # fmt: skip
"""Every effect id of the catalogue."""


def catalogue(layout: Layout, kind: Kind, hover_gain: Sequence[float]) -> tuple[AirframeEffect, ...]:
    """Every effect for a vehicle of that many motors.

    Parameters
    ----------
    layout, kind
        Parameters and family of the vehicle. In PX4's SIH, whose drag does not grow with the rotors' speed, lift and
        yaw torque are separate settings.
    hover_gain
        Angular acceleration at a full differential command (3,), rad/s2: the scale of trims.
    """
    return tuple(_made(layout, kind, hover_gain))


def _made(layout: Layout, kind: Kind, gain: Sequence[float]) -> Iterator[AirframeEffect]:
    relative, plus = Act.TIMES, Act.PLUS
    # the effect of the rotors' inertia does not change with their thrust or torque
    reaction = Change(0, "spin_up", Act.OVER)
    gains = (*(Change(0, f"gain_{a}", relative) for a in AXES), reaction)
    yield _one("thrust_scale", "s", 0.2, (Change(0, "k", relative), *gains), "k", exclusive="thrust")
    if not kind.drag_by_rotor:  # SIH_T_MAX
        lift = tuple(Change(0, n, relative) for n in ("k", "gain_x", "gain_y"))
        yield AirframeEffect(
            "thrust_scale", "thrust_by_lift", ("s",), (0.2,), lift, ("k",), odds=ODDS / 2.0, exclusive="thrust",
            torque=True,
        )  # fmt: skip
    # the mass scales every force; terms in the rotors' speed scale with its root; other torques stay
    linear = 0.5 if kind.drag_by_rotor else 1.0
    whole, turned = ((n, 1.0) for n in (*BODY_DRAG, "ch")), (("flap_x", -0.5), ("flap_y", -0.5))
    shares = (("c1", linear), ("cz", linear), *whole, *turned)
    forces = (Change(0, n, relative, share) for n, share in shares)
    yield AirframeEffect(
        "thrust_scale", "thrust_by_mass", ("s",), (0.2,), (Change(0, "k", relative), *forces), ("k",),
        odds=ODDS / 2.0, exclusive="thrust",
    )  # fmt: skip
    yield _one("thrust_expo", "expo", 0.2, (Change(0, "expo", plus),), "expo")
    drag = [Change(0, "c1", relative), Change(0, "cz", relative)]
    if kind.rotors_damp:
        drag += [Change(0, f"damping_{a}", relative) for a in AXES]
        drag += [Change(0, f"flap_{a}", relative) for a in "xy"]
    yield _one("rotor_drag", "c1", 0.6, tuple(drag), "c1", exclusive="rotor_drag", odds=ODDS / 2.0)
    # the in-plane drag of the blades differs, and their inflow, which damps roll and pitch, does not
    flap = tuple(Change(1, f"flap_{a}", relative) for a in "xy")
    across = (Change(0, "c1", relative), *flap, Change(2, "damping_z", relative))
    yield AirframeEffect(
        "rotor_drag", "rotor_drag_across", ("c1", "flap", "damping_z"), (0.6,) * 3, across,
        ("c1", "flap_x", "damping_z"), odds=ODDS / 2.0, exclusive="rotor_drag",
    )  # fmt: skip
    yield _one("body_drag", "c2", 0.6, tuple(Change(0, n, relative) for n in BODY_DRAG), "c2_x")
    yield _one("inflow", "cz", 0.3, (Change(0, "cz", plus),), "cz", exclusive="inflow", odds=ODDS / 2.0)
    # a rotor loses thrust where it rises, whether the vehicle climbs or turns (AIRFRAME 2)
    turning = (Change(0, "cz", plus), Change(1, "damping_x", plus), Change(2, "damping_y", plus))
    yield AirframeEffect(
        "inflow", "inflow_of_turns", ("cz", "damping_x", "damping_y"), (0.3, 0.6, 0.6), turning,
        ("cz", "damping_x", "damping_y"), odds=ODDS / 2.0, exclusive="inflow", torque=True,
    )  # fmt: skip
    yield _one("translational_lift", "ch", 0.01, (Change(0, "ch", plus),), "ch")
    for axes in ("xy", "x", "y", "z"):
        yield _inertia(axes)
    for pair in PRODUCTS:
        product, block = (Change(0, f"product_{pair}", plus),), f"product_{pair}"
        yield AirframeEffect(
            "inertia", block, (pair,), (0.1,), product, (block,), odds=ODDS / 6.0, torque=True, axes=frozenset(pair),
        )  # fmt: skip
    cg = (Change(0, "cg_x", plus), Change(1, "cg_y", plus))
    yield AirframeEffect("cg_offset", "cg_offset", ("x", "y"), (0.05, 0.05), cg, ("cg_x", "cg_y"), torque=True)
    for i in range(1, layout.motors + 1):
        for form in ("weak", "pulse"):
            yield AirframeEffect(
                "motor_weak", f"motor_{form}_{i}", ("s",), (0.1,), (Change(0, f"{form}_{i}", plus),), (f"{form}_{i}",),
                odds=ODDS / (2 * layout.motors), exclusive=f"motor_{i}", motor=i, torque=True,
            )  # fmt: skip
    trims = tuple(Change(k, f"torque_{a}", plus) for k, a in enumerate(AXES))
    trim_sd = tuple(0.02 * abs(g) for g in gain)
    yield AirframeEffect(
        "torque_bias", "torque_bias", AXES, trim_sd, trims, tuple(f"torque_{a}" for a in AXES), torque=True
    )
    yield _one("yaw_coefficient", "s", 0.3, (Change(0, "gain_z", relative), reaction), "gain_z", torque=True)
    damping = tuple(Change(k, f"damping_{a}", relative) for k, a in enumerate(AXES))
    base = tuple(f"damping_{a}" for a in AXES)
    yield AirframeEffect("angular_damping", "angular_damping", AXES, (0.6,) * 3, damping, base, torque=True)
    yield _one("battery_sag", "exponent", 1.5, (Change(0, "sag", plus),), "sag")
    yield _one("motor_lag", "tau_up", 0.03, (Change(0, "tau", plus),), "tau", torque=True, exclusive="motor_lag")
    apart = (Change(0, "tau", plus), Change(0, "fall", plus, -1.0), Change(1, "fall", plus))
    yield AirframeEffect(
        "motor_lag", "motor_lag_apart", ("tau_up", "tau_down"), (0.03, 0.03), apart, ("tau", "fall"), odds=ODDS / 2.0,
        exclusive="motor_lag", torque=True,
    )  # fmt: skip
    yield AirframeEffect(
        "motor_lag", "motor_slew", (), (), (), (), odds=ODDS, exclusive="motor_lag", slew=True, torque=True
    )
    wind = (Change(0, "wind_north", plus), Change(1, "wind_east", plus))
    yield AirframeEffect(
        "wind", "wind", ("north", "east"), (4.0, 4.0), wind, ("wind_north", "wind_east"), Domain.ENVIRONMENT, odds=1.0
    )
    load = (Change(0, "load", plus),)
    yield AirframeEffect("payload_step", "payload_step", ("s",), (0.2,), load, ("load",), odds=ODDS / STEPS)
    yield _one("actuator_delay", "delay", 0.01, (Change(0, "delay", plus),), "delay", torque=True)


def of_density(both: Densities, *, rotors_damp: bool) -> AirframeEffect:
    """Effect of a different air density: it scales all aerodynamic forces, and the rotors' drag by its square root.

    In denser air, rotors carry the same weight at a speed lower by the square root of the density.
    """
    whole = ("k", *(f"gain_{a}" for a in AXES), *BODY_DRAG, "ch", "climb")
    damped = (*(f"damping_{a}" for a in AXES), "flap_x", "flap_y") if rotors_damp else ()
    changes = (
        *(Change(0, n, Act.TIMES) for n in whole),
        *(Change(0, n, Act.TIMES, 0.5) for n in ("c1", "cz", *damped)),
        Change(0, "spin_up", Act.OVER),
    )
    return AirframeEffect(
        DENSITY, DENSITY, ("s",), (both.sd,), changes, ("k",), Domain.ENVIRONMENT, odds=1.0,
        mean=both.excess, sides=(both.real.value, both.sim.value),
    )  # fmt: skip


def nameless(layout: Layout) -> tuple[AirframeEffect, ...]:
    """The groups of :mod:`calib.airframe.nameless` that the layout has columns of."""
    made = []
    for group in GROUPS:
        own = [n for n in layout.free if n.startswith(f"{PREFIX}{group.id}:")]
        if own:
            sd = SIZES["torque" if "torque" in group.id else "force"]
            changes = tuple(Change(k, name, Act.PLUS) for k, name in enumerate(own))
            domain = Domain.ENVIRONMENT if group.of_air else Domain.AIRFRAME
            torque = "torque" in group.id
            sds = (sd,) * len(own)
            one = AirframeEffect(group.id, group.id, tuple(own), sds, changes, (), domain, nameless=True, torque=torque)
            made.append(one)
    return tuple(made)


def _one(
    id_: str,
    name: str,
    sd: float,
    changes: tuple[Change, ...],
    base: str,
    *,
    torque: bool = False,
    exclusive: str = "",
    odds: float = ODDS,
) -> AirframeEffect:
    return AirframeEffect(id_, id_, (name,), (sd,), changes, (base,), odds=odds, torque=torque, exclusive=exclusive)


def _inertia(axes: str) -> AirframeEffect:
    """The moment of inertia of one axis, or of roll and pitch together: it divides all torques about it."""
    changes = tuple(
        Change(0, f"{what}_{a}", Act.OVER) for a in axes for what in ("gain", "damping", "torque", "flap")
        if not (what == "flap" and a == "z")
    )  # fmt: skip
    return AirframeEffect(
        "inertia", f"inertia_{axes}", ("ratio",), (0.3,), changes, tuple(f"gain_{a}" for a in axes),
        odds=ODDS / 2.0, torque=True, axes=frozenset(axes),
    )  # fmt: skip


def applied(layout: Layout, theta: Array, effects: Sequence[AirframeEffect], amplitudes: Array) -> tuple[Array, Array]:
    """Parameters of the real flight (P,) from those of the simulated one, and their derivative (P, P + K).

    The derivative is by `theta` first, then by the amplitudes of `effects` in their order.
    """
    count = len(theta)
    factor, shift = np.ones(count), np.zeros(count)
    by_amplitude = np.zeros((count, len(amplitudes)))
    place = 0
    for effect in effects:
        for change in effect.changes:
            at, value = place + change.amplitude, float(amplitudes[place + change.amplitude])
            row = layout.place[change.parameter]
            if change.act is Act.PLUS:
                shift[row] += change.share * value
                by_amplitude[row, at] += change.share
            elif change.act is Act.TIMES:
                own = 1.0 + change.share * value
                factor[row] *= own
                by_amplitude[row, at] += np.nan_to_num(change.share / own)
            else:
                own = max(1.0 + value, 0.05)
                factor[row] /= own
                by_amplitude[row, at] += -1.0 / own
        place += len(effect.names)
    scaled = theta * factor
    plus = np.zeros_like(by_amplitude)
    place = 0
    for effect in effects:
        for change in effect.changes:
            if change.act is Act.PLUS:
                plus[layout.place[change.parameter], place + change.amplitude] += change.share
        place += len(effect.names)
    derivative = (by_amplitude - plus) * scaled[:, None] + plus
    return scaled + shift, np.hstack([np.diag(factor), derivative])
