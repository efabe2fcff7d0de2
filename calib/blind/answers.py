"""Reading a diagnosis: only what the report's schema promises, and what counts as right, fixed before any run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mavcal.calib.blind.cases import split

SYNONYMS: Mapping[str, frozenset[str]] = {
    "temp_linear": frozenset({"temp_poly", "thermal_lag"}),
    "temp_poly": frozenset({"temp_linear", "thermal_lag"}),
    "thermal_lag": frozenset({"temp_linear", "temp_poly"}),
    "low_pass": frozenset({"delay"}),
    "delay": frozenset({"low_pass"}),
    "step": frozenset({"random_walk"}),
    "random_walk": frozenset({"flicker", "step"}),
    "flicker": frozenset({"random_walk"}),
    "aliasing": frozenset({"vibration", "rotor_noise", "noise", "tone"}),
    "vibration": frozenset({"aliasing", "rotor_noise", "tone"}),
    "rotor_noise": frozenset({"noise", "vibration", "aliasing"}),
    "noise": frozenset({"rotor_noise"}),
    "tone": frozenset({"aliasing", "vibration"}),
    "quantisation": frozenset({"noise", "dead_band"}),
    "earth_field": frozenset({"field_gradient"}),
    "field_gradient": frozenset({"earth_field"}),
    "misalignment": frozenset({"rotation"}),
    "rotation": frozenset({"misalignment"}),
}
"""Kinds of the same sensor that are an honest answer where the true kind is not in the catalogue."""

BESIDE: Mapping[str, frozenset[str]] = {
    "temp_linear": frozenset({"bias", "hard_iron"}),
    "temp_poly": frozenset({"bias", "hard_iron"}),
    "thermal_lag": frozenset({"bias", "hard_iron"}),
    "temp_scale": frozenset({"scale"}),
    "misalignment": frozenset({"rotation"}),
    "field_gradient": frozenset({"earth_field"}),
}
"""Kinds that the same truth has in another convention: a thermal error at another reference temperature has an offset,
skewed axes in another frame are turned, a gradient about another origin has a constant field. Beside the true kind they
are no false alarm."""


@dataclass(frozen=True)
class CaseAnswer:
    """One case's label and what was said of it.

    `named` in the report's order, `reach` all of it with the rivals, `failed` the error where there is no report.
    """

    label: Mapping[str, Any]
    report: Mapping[str, Any]
    failed: str | None
    seconds: float

    @property
    def effects(self) -> list[Mapping[str, Any]]:
        """Reported effects, the strongest evidence first."""
        found = list(self.report.get("effects") or [])
        return sorted(found, key=lambda e: -float((e.get("evidence") or {}).get("two_delta_loglik") or 0.0))

    @property
    def named(self) -> list[str]:
        """Their ids."""
        return [str(e["id"]) for e in self.effects]

    @property
    def reach(self) -> set[str]:
        """Ids and their rivals."""
        rivals = {str(r["id"]) for e in self.effects for r in e.get("confusable_with") or []}
        return rivals | set(self.named)

    @property
    def verdict(self) -> str:
        """As reported."""
        return str(self.report.get("verdict", "failed"))

    @property
    def unknown(self) -> bool:
        """Whether something unknown was reported."""
        return bool((self.report.get("unknown") or {}).get("flag")) or self.verdict == "unknown"

    @property
    def detected(self) -> bool:
        """Whether anything was."""
        return bool(self.named) or self.unknown

    @property
    def true(self) -> set[str]:
        """Ids that were put in."""
        return {str(e["id"]) for e in self.label["effects"]}

    @property
    def severity(self) -> float:
        """Lambda of all that was put in."""
        return float(sum(e["lambda"] for e in (*self.label["effects"], *self.label["unknown"])))

    @property
    def surplus(self) -> set[str]:
        """Named, not put in, and not the same in another convention."""
        return {n for n in set(self.named) - self.true if not any(_beside(t, n) for t in self.true)}


def _beside(true: str, named: str) -> bool:
    (sensor, kind), (other, also) = split(true), split(named)
    return sensor == other and also in BESIDE.get(kind, frozenset())


def honest_without(true: str, named: str) -> bool:
    """Whether `named` may be said where `true` is not in the catalogue."""
    if true == "clock_drift":
        return named.endswith("_delay")
    if true == "reference_attitude":
        return named in {"accel_rotation", "mag_rotation", "mag_earth_field"}
    (sensor, kind), (other, also) = split(true), split(named)
    return sensor == other and also in SYNONYMS.get(kind, frozenset()) | BESIDE.get(kind, frozenset())


def covered(true: Mapping[str, Any], said: Mapping[str, Any]) -> list[bool]:
    """Which of the true parameters lie in the 95 % intervals of the parameters of the same name.

    A vector under another name is recognised by its three components. An interval without an end says nothing.
    """
    intervals = {str(p["name"]): p.get("ci95") for p in said.get("params") or []}
    by_axis: dict[str, list[Any]] = {}
    for name, interval in intervals.items():
        by_axis.setdefault(name.rpartition(".")[2], []).append(interval)
    found = []
    for name, value in true["params"].items():
        same_axis = by_axis.get(name.rpartition(".")[2], []) if "." in name else []
        interval = intervals.get(name) or (same_axis[0] if len(same_axis) == 1 else None)
        if interval is not None and None not in interval:
            found.append(float(interval[0]) <= float(value) <= float(interval[1]))
    return found
