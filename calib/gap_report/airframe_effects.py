"""The effects of airframe and air in words: a phrase for each id, its parameters as ratios or differences."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from mavcal.calib.airframe.ground import TOLD_AT_M
from mavcal.calib.gap.schema import EffectEstimate, ParameterEstimate, Rival
from mavcal.calib.gap_report.intervals import after_number, bracketed, more_or_less, range_of, ratio_of, rounded, times

_AXES = {"x": "roll", "y": "pitch", "z": "yaw"}
_PAIRS = ("xy", "xz", "yz")
_PER_CENT, _MS = 100.0, 1000.0
_FAST = 10.0
"""Speed, m/s, at which the lift of forward flight is stated. Chosen, not measured: a brisk flight of a small
multicopter."""
_DECIDED = 0.9
"""Probability above which only one cause is stated. Source: the limit for naming an effect."""
_Params = Mapping[str, ParameterEstimate]


@dataclass(frozen=True)
class Claim:
    """One parameter for display: real against simulated, its 95 % interval, and both values where known."""

    label: str
    difference: str
    interval: str
    sides: str


@dataclass(frozen=True)
class _Kind:
    """`plain` names the effect, `finding` states the result; `sides` has label and unit of both values by parameter."""

    plain: str
    finding: Callable[[_Params, EffectEstimate], str]
    sides: Mapping[str, tuple[str, str]]


def known(effect_id: str) -> bool:
    """Whether this is an effect of airframe or air that has words here."""
    return effect_id in _KINDS


def plain_name(effect_id: str) -> str:
    """``a shifted centre of gravity``; the id in words where it is of a sensor, or of another version."""
    return _KINDS[effect_id].plain if effect_id in _KINDS else effect_id.replace("_", " ")


def phrase(effect: EffectEstimate) -> str:
    """The finding as part of a sentence: ``motor 3 is 7.9 % weak (7.4 to 8.4)``."""
    kind = _KINDS.get(effect.id)
    if kind is None or not effect.params:
        part = "motor" if effect.sensor is None else "unit"
        where = f", {part} {', '.join(map(str, effect.instances))}" if effect.instances else ""
        return f"{plain_name(effect.id)}{where}"
    try:
        return kind.finding({p.name: p for p in effect.params}, effect)
    except KeyError:  # of a report that another version wrote
        return kind.plain


def labels(effect_id: str) -> Mapping[str, tuple[str, str]]:
    """Label of each parameter, and the unit of both values; empty where only their ratio is meaningful."""
    return _KINDS[effect_id].sides if effect_id in _KINDS else {}


def claims(effect: EffectEstimate) -> tuple[Claim, ...]:
    """The parameters, except the number of a motor, which is part of its name."""
    known_ones = labels(effect.id)
    return tuple(_claim(p, *known_ones.get(p.name, (p.name, p.unit))) for p in effect.params if p.name != "motor")


def rival_phrase(rival: Rival) -> str:
    """``a shifted centre of gravity, 86 % alike; what decides: hover at two thrusts``."""
    alike = f", {_PER_CENT * min(max(rival.kappa, 0.0), 1.0):.0f} % alike" if math.isfinite(rival.kappa) else ""
    return f"{plain_name(rival.id)}{alike}; what decides: {rival.fix}"


def wind_from(north: float, east: float) -> tuple[float, float]:
    """Wind speed, m/s, and the direction that it comes from, degrees from north, from the velocity of the air."""
    return math.hypot(north, east), math.degrees(math.atan2(-east, -north)) % 360.0


def _claim(p: ParameterEstimate, label: str, unit: str) -> Claim:
    sides = _both(p, unit)
    if p.unit == "1" and p.ratio is not None:
        value, low, high = ratio_of(p)
        return Claim(label, f"{rounded(value, low, high, least=2)} times", range_of(low, high, least=2), sides)
    sign = "+" if p.value > 0.0 and p.value_sim is not None else ""
    return Claim(label, f"{sign}{rounded(p.value, *p.ci95)}{after_number(p.unit)}", range_of(*p.ci95), sides)


def _both(p: ParameterEstimate, unit: str) -> str:
    """``real 0.392, simulated 0.245 1/s``; empty if unknown, or if only their ratio is meaningful."""
    real, sim = p.value_real, p.value_sim
    if not unit or real is None or sim is None or not (math.isfinite(real) and math.isfinite(sim)):
        return ""
    return f"real {real:.3g}, simulated {sim:.3g}{after_number(unit)}"


def _joined(parts: Iterable[str]) -> str:
    """The parts as ``a, b and c``. Raises KeyError if there is none."""
    *most, last = list(parts) or [""]
    if not last:
        raise KeyError("no parameter")
    return f"{', '.join(most)} and {last}" if most else last


def _has(name: str, what: str) -> Callable[[_Params, EffectEstimate], str]:
    return lambda p, _: f"the real vehicle has {times(p[name], what)}"


def _has_by_axis(what: str) -> Callable[[_Params, EffectEstimate], str]:
    def finding(p: _Params, _: EffectEstimate) -> str:
        shown = [axis for axis in _AXES if axis in p]
        first = [times(p[axis], f"the {what} in {_AXES[axis]}") for axis in shown[:1]]
        return f"the real vehicle has {_joined(first + [times(p[a], f'that in {_AXES[a]}') for a in shown[1:]])}"

    return finding


def _inertia(p: _Params, effect: EffectEstimate) -> str:
    """Moments as ratios, products of inertia as differences."""
    found = [] if not any(a in p for a in _AXES) else [_has_by_axis("inertia")(p, effect)]
    for pair in (pair for pair in _PAIRS if pair in p):
        one, other = (_AXES[axis] for axis in pair)
        amount = more_or_less(p[pair], 1.0, "", "larger", "smaller")
        found.append(f"the product of inertia of {one} and {other} is {amount}")
    return _joined(found)


def _thrust(p: _Params, effect: EffectEstimate) -> str:
    """The ratio, and whether thrust or mass differs; both below the probability :data:`_DECIDED`."""
    said = f"the real vehicle has {times(p['s'], 'the thrust for its mass')}"
    if not effect.forms:
        return said
    mass, lift = (effect.forms.get(cause, 0.0) for cause in ("mass", "lift"))
    if 1.0 - _DECIDED < mass < _DECIDED:
        return f"{said}; the flight does not tell thrust from mass ({_PER_CENT * mass:.0f} % mass)"
    heavier = f"its mass differs, it is {1.0 / ratio_of(p['s'])[0]:.2f} times as heavy"
    which = heavier if mass >= _DECIDED else "its thrust differs"
    told = f"{said}; of the two, {which} ({_PER_CENT * max(mass, 1.0 - mass):.0f} %)"
    return f"{told}, and the yaw torque of its rotors does not" if lift >= _DECIDED else told


def _expo(p: _Params, _: EffectEstimate) -> str:
    amount = more_or_less(p["expo"], 1.0, "", "higher", "lower")
    return f"the thrust curve of the real vehicle has an expo that is {amount}"


def _lag(p: _Params, _: EffectEstimate) -> str:
    if (slew := p.get("slew")) is not None:
        if slew.value_real is None:
            return f"the thrust of the real motors changes {more_or_less(slew, 1.0, '1/s', 'faster', 'slower')}"
        most = rounded(slew.value_real, *slew.ci95)
        return f"the thrust of the real motors changes by at most {most} of the full command a second"
    ways = {"tau_up": "speed up", "tau_down": "slow down"}
    parts = [f"{more_or_less(p[n], _MS, 'ms', 'longer', 'less')} to {way}" for n, way in ways.items() if n in p]
    return f"the real motors take {_joined(parts)}"


def _delay(p: _Params, _: EffectEstimate) -> str:
    return f"commands reach the real motors {more_or_less(p['delay'], _MS, 'ms', 'later', 'earlier')}"


def _weak(p: _Params, effect: EffectEstimate) -> str:
    value, low, high = ratio_of(p["s"])
    sign = -1.0 if value < 1.0 else 1.0
    low, high = sorted(_PER_CENT * sign * (edge - 1.0) for edge in (low, high))
    amount = rounded(_PER_CENT * abs(value - 1.0), low, high)
    which = effect.instances[0] if effect.instances else round(p["motor"].value)
    return f"motor {which} is {amount} % {'weak' if value < 1.0 else 'strong'}{bracketed(low, high)}"


def _inflow(p: _Params, _: EffectEstimate) -> str:
    return f"each m/s of climb costs the real vehicle {more_or_less(p['cz'], 1.0, 'm/s2', 'more', 'less')}"


def _lift(p: _Params, _: EffectEstimate) -> str:
    amount = more_or_less(p["ch"], _FAST**2, "m/s2", "more", "less")
    return f"level flight at {_FAST:g} m/s lifts the real vehicle by {amount}"


def _centre(p: _Params, _: EffectEstimate) -> str:
    words = {"x": ("further forward", "further back"), "y": ("further right", "further left")}
    moved = {n: p[n] for n in words if n in p}
    sure = {n: one for n, one in moved.items() if one.ci95[0] * one.ci95[1] > 0.0} or moved
    parts = [more_or_less(one, _PER_CENT, "% of an arm", *words[n]) for n, one in sure.items()]
    return f"the centre of gravity of the real vehicle is {_joined(parts)}"


def _torque(p: _Params, _: EffectEstimate) -> str:
    parts = [f"{rounded(p[a].value, *p[a].ci95)} rad/s2 in {_AXES[a]}{bracketed(*p[a].ci95)}" for a in _AXES if a in p]
    return f"a steady torque turns the real vehicle: {_joined(parts)}"


def _sag(p: _Params, _: EffectEstimate) -> str:
    if (exponent := p.get("exponent")) is not None:
        amount = more_or_less(exponent, 1.0, "", "more", "less")
        return f"thrust follows the voltage of the real battery with an exponent of {amount}"
    return f"its sagging battery leaves the real vehicle {times(p['s'], 'the thrust')}"


def _ground(p: _Params, _: EffectEstimate) -> str:
    amount = more_or_less(p["a"], _PER_CENT, "% of thrust", "more", "less")
    return f"with its rotors {TOLD_AT_M} m above the ground the real vehicle has {amount}"


def _payload(p: _Params, _: EffectEstimate) -> str:
    value, low, high = ratio_of(p["s"])
    said = f"{rounded(value, low, high, least=2)} times as heavy{bracketed(low, high, least=2)}"
    return f"at {p['t'].value:.1f} s the real vehicle became {said}"


def _density(p: _Params, _: EffectEstimate) -> str:
    value, low, high = ratio_of(p["s"])
    said = f"the air was {rounded(value, low, high, least=2)} times as dense{bracketed(low, high, least=2)}"
    return f"{said}, as at {p['altitude'].value:.0f} m in the standard atmosphere" if "altitude" in p else said


def _wind(p: _Params, _: EffectEstimate) -> str:
    north, east = (one.value if one.value_real is None else one.value_real for one in (p["north"], p["east"]))
    speed, direction = wind_from(north, east)
    return f"wind of {speed:.1f} m/s from {direction:.0f} deg"


def _rough(p: _Params, _: EffectEstimate) -> str:
    return f"the air was {'rougher' if p['sigma'].value >= 0.0 else 'calmer'} by {_size(p['sigma'])} m/s2 rms"


def _event(what: str, unit: str) -> Callable[[_Params, EffectEstimate], str]:
    return lambda p, _: f"{what} of {_size(p['size'])} {unit} at {p['t'].value:.1f} s"


def _size(p: ParameterEstimate) -> str:
    return rounded(abs(p.value), *p.ci95)


def _sides(*rows: tuple[str, str, str]) -> Mapping[str, tuple[str, str]]:
    """Label and unit of the two sides of each parameter."""
    return {name: (label, unit) for name, label, unit in rows}


def _axes(what: str, unit: str) -> Mapping[str, tuple[str, str]]:
    return {name: (f"{what} in {axis}", unit) for name, axis in _AXES.items()}


_KINDS: Mapping[str, _Kind] = {
    "thrust_scale": _Kind(
        "another thrust for its mass",
        _thrust,
        _sides(("s", "thrust over mass at full command", "m/s2")),
    ),
    "thrust_expo": _Kind("another thrust curve", _expo, _sides(("expo", "expo of the thrust curve", "1"))),
    "motor_lag": _Kind(
        "slower motors",
        _lag,
        _sides(
            ("tau_up", "time constant, speeding up", "s"),
            ("tau_down", "time constant, slowing down", "s"),
            ("slew", "limit of the command's rate", "1/s"),
        ),
    ),
    "actuator_delay": _Kind("a delay of the commands", _delay, _sides(("delay", "delay", "s"))),
    "motor_weak": _Kind("a weak motor", _weak, _sides(("s", "thrust of the motor in hover", ""))),
    "rotor_drag": _Kind(
        "another rotor drag",
        _has("c1", "the rotor drag"),
        _sides(
            ("c1", "rotor drag in hover", "1/s"),
            ("flap", "torque by air velocity", ""),
            ("damping_z", "damping of yaw", ""),
        ),
    ),
    "body_drag": _Kind("another body drag", _has("c2", "the body drag"), _sides(("c2", "body drag", "1/m"))),
    "inflow": _Kind(
        "another loss of thrust in climbs",
        _inflow,
        _sides(
            ("cz", "loss by climb", "1/s"),
            ("damping_x", "damping of roll", "1/s"),
            ("damping_y", "damping of pitch", "1/s"),
        ),
    ),
    "translational_lift": _Kind(
        "another lift of forward flight", _lift, _sides(("ch", "lift by speed squared", "1/m"))
    ),
    "inertia": _Kind(
        "another inertia",
        _inertia,
        {
            **_axes("inertia", ""),
            **_sides(*((pair, f"product of inertia {pair}, over the moment of {pair[1]}", "1") for pair in _PAIRS)),
        },
    ),
    "cg_offset": _Kind(
        "a shifted centre of gravity", _centre, _sides(("x", "forward, in arms", "1"), ("y", "right, in arms", "1"))
    ),
    "torque_bias": _Kind("a steady torque", _torque, _axes("steady torque", "rad/s2")),
    "yaw_coefficient": _Kind("another yaw torque", _has("s", "the yaw torque"), _sides(("s", "yaw torque", ""))),
    "angular_damping": _Kind("another damping of turns", _has_by_axis("damping of turns"), _axes("damping", "1/s")),
    "battery_sag": _Kind(
        "a sagging battery",
        _sag,
        _sides(("exponent", "exponent of the voltage", "1"), ("s", "thrust under the sag", "")),
    ),
    "air_density": _Kind(
        "another air density",
        _density,
        _sides(("s", "air density", "kg/m3"), ("altitude", "altitude for the simulator", "m")),
    ),
    "ground_effect": _Kind("ground effect", _ground, _sides(("a", "thrust gained at the ground", "1"))),
    "payload_step": _Kind("a change of payload", _payload, _sides(("s", "mass", ""), ("t", "time", "s"))),
    "wind": _Kind("wind", _wind, _sides(("north", "air moves north", "m/s"), ("east", "air moves east", "m/s"))),
    "turbulence": _Kind("turbulence", _rough, _sides(("sigma", "turbulence, rms", "m/s2"))),
    "gust": _Kind("a gust", _event("a gust", "m/s2"), _sides(("size", "size", "m/s2"), ("t", "time", "s"))),
    "gps_glitch": _Kind(
        "a jump of the GPS place",
        _event("a jump of the GPS place", "m"),
        _sides(("size", "size", "m"), ("t", "time", "s")),
    ),
    "ekf_reset": _Kind(
        "a reset of the estimator",
        _event("a reset of the estimator's velocity", "m/s"),
        _sides(("size", "size", "m/s"), ("t", "time", "s")),
    ),
}
"""Every effect of airframe and air. An empty unit: only the ratio is meaningful."""
