"""The real airframe as a MATLAB struct, for a model of one's own (``idnlgrey``, the Multirotor block): AIRFRAME 4.4."""

from __future__ import annotations

from collections.abc import Sequence

from mavcal.calib.gap.export.airframe.patch import airframe_effects
from mavcal.calib.gap.export.airframe.wanted import ratio_of
from mavcal.calib.gap.export.state import named
from mavcal.calib.gap.schema import EffectEstimate, ParameterEstimate

_FIELDS: tuple[tuple[str, str, tuple[str, ...], str], ...] = (
    ("I", "inertia", ("x", "y", "z"), "kg m2, which a flight alone does not tell"),
    ("I_p", "inertia", ("xy", "xz", "yz"), "1, products of inertia over the moment of the second axis"),
    ("k", "thrust_scale", ("s",), "m/s2, thrust at full command over mass"),
    ("e", "thrust_expo", ("expo",), "thrust (1-e) c + e c^2 of the command c"),
    ("tau", "motor_lag", ("tau_up", "tau_down"), "s, up and down"),
    ("delay", "actuator_delay", ("delay",), "s"),
    ("c1", "rotor_drag", ("c1",), "1/s, at hover"),
    ("c2", "body_drag", ("c2",), "1/m"),
    ("kappa", "yaw_coefficient", ("s",), "m, yaw torque over thrust, which a flight alone does not tell"),
    ("r_cg", "cg_offset", ("x", "y"), "arms, forward and right"),
)
"""Name of the field, effect, parameters, unit."""
_RATIO_ONLY = frozenset({"inertia", "yaw_coefficient"})
"""Effects whose values in the flights are accelerations: only their ratio is that of the field."""
_HELD = frozenset(effect_id for _, effect_id, _, _ in _FIELDS)


def airframe_struct(effects: Sequence[EffectEstimate], *, mass: float | None = None) -> tuple[list[str], list[str]]:
    """Lines that make the struct ``airframe``, and in words what it cannot hold.

    A field holds the real vehicle's value, empty where the report has none; ``airframe.ratio`` and
    ``airframe.difference`` hold what the report says against the simulator.
    """
    flying = airframe_effects(effects)
    chosen = {e.id: e for e in flying}
    if not chosen:
        return [], []
    lines = [
        "% The real airframe; [] where it is the simulator's or not known. Ratios are real by simulated.",
        f"airframe = struct('m', {'[]' if mass is None else f'{mass:.9g}'}); % kg",
    ]
    for name, effect_id, wanted, unit in _FIELDS:
        effect = chosen.get(effect_id)
        params = [] if effect is None else [_parameter(effect, w) for w in wanted]
        real = [None if p is None or effect_id in _RATIO_ONLY else p.value_real for p in params]
        lines.append(f"airframe.{name} = {_values(real)}; % {unit}")
        if any(p is not None and p.ratio is not None for p in params):
            ratios = _values([1.0 if p is None else ratio_of(p) for p in params])
            lines.append(f"airframe.ratio.{name} = {ratios};")
        elif any(p is not None for p in params):
            lines.append(f"airframe.difference.{name} = {_values([0.0 if p is None else p.value for p in params])};")
    lost = [f"{named(e)}: the struct has no field for it" for e in flying if e.id not in _HELD]
    return lines, lost


def _parameter(effect: EffectEstimate, name: str) -> ParameterEstimate | None:
    """The parameter of that name; a lag that is told one way only is that of both."""
    either = [p for p in effect.params if p.name.startswith("tau")]
    return next((p for p in effect.params if p.name == name), either[0] if name.startswith("tau") and either else None)


def _values(values: Sequence[float | None]) -> str:
    known = [v for v in values if v is not None]
    return f"[{' '.join(f'{v:.9g}' for v in known)}]" if values and len(known) == len(values) else "[]"
