"""Reports with stated effects, as a diagnosis would give them."""

from __future__ import annotations

from collections.abc import Mapping

from mavcal.calib.airframe.answer import Domain, Geometry, Motor
from mavcal.calib.gap.effects import by_id, parameter_table
from mavcal.calib.gap.schema import EffectEstimate, EffectEvidence, GapReport, GapVerdict, Inputs, ParameterEstimate


def effect(id_: str, instances: tuple[int, ...] = (1,), **groups: object) -> EffectEstimate:
    """``bias=(1, 2, 3)`` fills bias.x bias.y bias.z; other parameters of the catalogue's effect are 0."""
    given: dict[str, float] = {}
    for name, value in groups.items():
        if isinstance(value, Mapping):
            given |= {f"{name}.{key}": float(v) for key, v in value.items()}
        elif isinstance(value, tuple):
            given |= {f"{name}.{axis}": float(v) for axis, v in zip("xyz", value, strict=True)}
        else:
            given[name] = float(str(value))
    table = parameter_table()[id_]
    assert set(given) <= {p.name for p in table}, "the catalogue names the parameters"
    params = tuple(_estimate(p.name, given.get(p.name, 0.0), p.unit) for p in table)
    evidence = EffectEvidence(100.0, len(params), 1e-9, 0.99, 0.5)
    return EffectEstimate(id_, by_id()[id_].sensor, instances, params, evidence)


def _estimate(name: str, value: float, unit: str) -> ParameterEstimate:
    se = 0.01 * abs(value) + 1e-6
    return ParameterEstimate(name, value, se, (value - 1.96 * se, value + 1.96 * se), unit)


def report(*effects: EffectEstimate) -> GapReport:
    inputs = Inputs("ab" * 32, None, 200.0, 70.0, "sim", 0.0, "ref_* columns", {}, "cd" * 32)
    return GapReport(inputs, GapVerdict.EXPLAINED if effects else GapVerdict.NO_GAP, effects=effects)


_ABSOLUTE = {
    "thrust_expo": {"expo": "1"},
    "motor_lag": {"tau_up": "s", "tau_down": "s", "slew": "1/s"},
    "actuator_delay": {"delay": "s"},
    "inertia": {"xy": "1", "xz": "1", "yz": "1"},
    "inflow": {"cz": "1/s"},
    "translational_lift": {"ch": "1/m"},
    "cg_offset": {"x": "1", "y": "1"},
    "torque_bias": {"x": "rad/s2", "y": "rad/s2", "z": "rad/s2"},
    "battery_sag": {"exponent": "1"},
    "ground_effect": {"a": "1"},
    "payload_step": {"t": "s"},
    "wind": {"north": "m/s", "east": "m/s"},
}
"""Parameters that are differences, by effect; all others of the airframe are ratios less 1."""
PLUS = Geometry(
    "quad", "plus", (Motor(0.0, 1.0, 1), Motor(0.0, -1.0, 1), Motor(1.0, 0.0, -1), Motor(-1.0, 0.0, -1)), "parameters"
)
AIR = frozenset({"air_density", "ground_effect", "wind", "turbulence", "gust", "gps_glitch", "ekf_reset"})


def airframe(id_: str, *, motor: int | None = None, sim: float | None = None, **given: float) -> EffectEstimate:
    """An effect of airframe or air: ratios of real to simulated (``s=0.9``), or differences where there is no ratio.

    `sim` is the simulated value of every parameter, from which the real one follows.
    """
    params = tuple(_airframe_estimate(id_, name, value, sim) for name, value in given.items())
    if motor is not None:
        params = (*params, ParameterEstimate("motor", float(motor), 0.0, (motor, motor), "1"))
    evidence = EffectEvidence(100.0, len(params), 1e-9, 0.99, 0.5)
    domain = Domain.ENVIRONMENT if id_ in AIR else Domain.AIRFRAME
    return EffectEstimate(id_, None, () if motor is None else (motor,), params, evidence, domain=domain)


def _airframe_estimate(id_: str, name: str, given: float, sim: float | None) -> ParameterEstimate:
    unit = _ABSOLUTE.get(id_, {}).get(name)
    value = given if unit is not None else given - 1.0
    se = 0.01 * abs(value) + 1e-6
    ci95 = (value - 1.96 * se, value + 1.96 * se)
    if unit is not None:
        real = None if sim is None else sim + value
        return ParameterEstimate(name, value, se, ci95, unit, real, sim)
    real = None if sim is None else sim * given
    return ParameterEstimate(name, value, se, ci95, "1", real, sim, given, (given - 1.96 * se, given + 1.96 * se))
