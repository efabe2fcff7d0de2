"""Reports with stated effects, as a diagnosis would give them."""

from __future__ import annotations

from collections.abc import Mapping

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
