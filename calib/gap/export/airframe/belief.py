"""Parameters of the firmware's airframe model, set to the values that the flight shows (AIRFRAME 4.1)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.firmware.plan import Change, ParameterKind, Value
from mavcal.calib.gap.export.airframe.patch import airframe_effects
from mavcal.calib.gap.export.sensor_errors import doubt_text, named
from mavcal.calib.gap.schema import EffectEstimate, ParameterEstimate

SEA_LEVEL = 1.225
"""Density, kg/m3, at which the estimators state their drag. Source: ArduPilot's and PX4's EKF, standard atmosphere."""
WHILE_DISARMED = "set the thrust curve and the hover thrust while disarmed only"


@dataclass(frozen=True)
class _Belief:
    """Parameters that hold an airframe value: `of` converts the real value, within `limits`.

    One of the parameters `used` must not be 0, else the firmware ignores them.
    """

    effect: str
    parameter: str
    names: tuple[str, ...]
    of: Callable[[float], float]
    limits: tuple[float, float]
    unit: str
    used: tuple[str, ...] = ()


_EK3 = ("EK3_DRAG_BCOEF_X", "EK3_DRAG_BCOEF_Y", "EK3_DRAG_MCOEF")
_BELIEFS: Mapping[str, tuple[_Belief, ...]] = {
    "ardupilot": (
        _Belief("thrust_expo", "expo", ("MOT_THST_EXPO",), lambda e: e, (-1.0, 1.0), ""),
        _Belief("thrust_scale", "s", ("MOT_THST_HOVER",), lambda k: STANDARD_GRAVITY / k, (0.125, 0.6875), ""),
        _Belief("rotor_drag", "c1", ("EK3_DRAG_MCOEF",), lambda c: c, (0.0, 1.0), "1/s", _EK3),
        _Belief("body_drag", "c2", _EK3[:2], lambda c: 0.5 * SEA_LEVEL / c, (0.0, 1000.0), "kg/m2", _EK3),
    ),
    "px4": (
        _Belief("thrust_expo", "expo", ("THR_MDL_FAC",), lambda e: e, (0.0, 1.0), ""),
        _Belief("thrust_scale", "s", ("MPC_THR_HOVER",), lambda k: STANDARD_GRAVITY / k, (0.1, 0.8), ""),
        _Belief("rotor_drag", "c1", ("EKF2_MCOEF",), lambda c: c, (0.0, 1.0), "1/s", ("EKF2_DRAG_CTRL",)),
        _Belief(
            "body_drag",
            "c2",
            ("EKF2_BCOEF_X", "EKF2_BCOEF_Y"),
            lambda c: 0.5 * SEA_LEVEL / c,
            (0.0, 200.0),
            "kg/m2",
            ("EKF2_DRAG_CTRL",),
        ),
    ),
}
"""By autopilot. Source: AIRFRAME 4.1; limits are those of ArduPilot's and PX4's parameter documentation."""


def belief_changes(
    effects: Iterable[EffectEstimate], autopilot: str, parameters: Mapping[str, Value]
) -> tuple[tuple[Change, ...], tuple[str, ...]]:
    """Changes to `parameters` of the vehicle, and notes on what stays unchanged.

    A value within its standard deviation of the firmware's is not changed.
    """
    changes: list[Change] = []
    left: list[str] = []
    for effect in airframe_effects(effects):
        beliefs = [b for b in _BELIEFS.get(autopilot, ()) if b.effect == effect.id]
        if not beliefs:
            left.append(f"{named(effect)}: the firmware has no parameter that believes it")
        elif effect.evidence.doubtful:
            left.append(doubt_text(effect))
        else:
            for belief in beliefs:
                _believe(changes, left, effect, belief, parameters)
    return tuple(changes), tuple(left)


def _believe(
    changes: list[Change], left: list[str], effect: EffectEstimate, belief: _Belief, parameters: Mapping[str, Value]
) -> None:
    found = next((p for p in effect.params if p.name == belief.parameter), None)
    real = None if found is None else found.value_real
    missing = [name for name in belief.names if name not in parameters]
    if found is None or real is None or not real > 0.0:
        left.append(f"{named(effect)}: its real value is not known by itself")
    elif missing:
        left.append(f"{named(effect)}: the log has no {', '.join(missing)}")
    elif belief.used and not any(parameters.get(name, 0) for name in belief.used):
        left.append(f"{named(effect)}: the estimator uses no drag ({', '.join(belief.used)} 0)")
    else:
        low, high = belief.limits
        new = float(np.float32(min(max(belief.of(real), low), high)))
        sd = abs(belief.of(real + _deviation(found)) - belief.of(real))
        changes += _changes(effect, belief, parameters, new, sd, left)


def _changes(
    effect: EffectEstimate, belief: _Belief, parameters: Mapping[str, Value], new: float, sd: float, left: list[str]
) -> Sequence[Change]:
    made = []
    for name in belief.names:
        old = parameters[name]
        if abs(new - old) <= sd:
            left.append(f"{named(effect)}: {name} is {old:.4g} already")
            continue
        why = f"{effect.id} of the flight"
        made.append(Change(name, float(old), new, ParameterKind.REAL32, why, sd, belief.unit))
    return made


def _deviation(parameter: ParameterEstimate) -> float:
    """Standard deviation of the real value; a relative one counts in parts of the simulated value."""
    scale = 1.0 if parameter.ratio is None or parameter.value_sim is None else abs(parameter.value_sim)
    return parameter.se * scale
