"""Reading a diagnosis of the airframe: only what the report's schema promises, and what counts as right."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mavcal.calib.blind.answers import CaseAnswer

SENSOR, AIRFRAME, ENVIRONMENT = "sensor", "airframe", "environment"

HONEST: Mapping[str, frozenset[str]] = {
    "thrust_scale": frozenset({"air_density"}),
    "air_density": frozenset({"thrust_scale"}),
    "thrust_expo": frozenset({"thrust_scale", "battery_sag"}),
    "motor_lag": frozenset({"actuator_delay"}),
    "actuator_delay": frozenset({"motor_lag"}),
    "motor_weak": frozenset({"cg_offset", "torque_bias"}),
    "rotor_drag": frozenset({"body_drag"}),
    "body_drag": frozenset({"rotor_drag"}),
    "inflow": frozenset({"angular_damping"}),
    "inertia": frozenset({"yaw_coefficient"}),
    "yaw_coefficient": frozenset({"inertia"}),
    "cg_offset": frozenset({"torque_bias", "motor_weak"}),
    "torque_bias": frozenset({"cg_offset", "motor_weak"}),
    "battery_sag": frozenset({"thrust_scale", "thrust_expo"}),
    "payload_step": frozenset({"thrust_scale"}),
}
"""Names that are an honest answer where the true one is not in the catalogue. Source: the column "confused with" of
AIRFRAME 2."""


@dataclass(frozen=True)
class AirAnswer(CaseAnswer):
    """One case's label and what was said of it. The day's air is no false name where it differs between the flights."""

    @classmethod
    def of(cls, answer: CaseAnswer) -> AirAnswer:
        """The same, judged as an airframe's."""
        return cls(answer.label, answer.report, answer.failed, answer.seconds)

    @property
    def beside(self) -> set[str]:
        """Ids that are there as well: the day's air, and what the true changes are in another number."""
        entries = (*self.label["effects"], *self.label["unknown"])
        return set(self.label["differs"]) | {name for entry in entries for name in entry["also"]}

    @property
    def told(self) -> list[Mapping[str, Any]]:
        """Reported effects, the strongest first, without the day's air where it is not what was put in."""
        air = set(self.label["differs"]) - self.true
        return [effect for effect in self.effects if str(effect["id"]) not in air]

    @property
    def first(self) -> str | None:
        """The strongest name; None: none was said."""
        return str(self.told[0]["id"]) if self.told else None

    @property
    def set_of(self) -> set[str]:
        """Names and their rivals, without the day's air where it is not what was put in."""
        rivals = {str(r["id"]) for effect in self.told for r in effect.get("confusable_with") or []}
        return rivals | {str(effect["id"]) for effect in self.told}

    @property
    def detected(self) -> bool:
        """Whether anything but the day's air was reported."""
        return bool(self.told) or self.unknown

    @property
    def surplus(self) -> set[str]:
        """Named, and neither put in nor there as well."""
        return set(self.named) - self.true - self.beside

    @property
    def false_names(self) -> set[str]:
        """Of the surplus, what blames the vehicle or its sensors."""
        return {str(e["id"]) for e in self.effects if str(e["id"]) in self.surplus and domain_of(e) != ENVIRONMENT}

    @property
    def misplaced(self) -> bool:
        """Whether a sensor is blamed where none is wrong, or an airframe that is right."""
        there = {str(entry["domain"]) for entry in (*self.label["effects"], *self.label["unknown"])}
        blamed = {domain_of(e) for e in self.effects if str(e["id"]) in self.surplus}
        return bool(({SENSOR, AIRFRAME} & blamed) - there)

    @property
    def excused(self) -> bool:
        """Whether the report says that the recordings cannot show what was put in."""
        untested = {str(one["id"]) for one in self.report.get("not_testable") or []}
        return self.verdict == "not_testable" or (bool(self.true) and self.true <= untested)

    def entry(self, name: str) -> Mapping[str, Any] | None:
        """The label's entry of that id."""
        return next((entry for entry in self.label["effects"] if entry["id"] == name), None)

    def closed(self, horizon_s: float) -> float | None:
        """Share of the error of the predicted velocity that the effects close; None where the report has none."""
        for one in (self.report.get("airframe") or {}).get("rollout") or []:
            if one["quantity"] == "velocity" and one["part"] == "blocks" and abs(one["h_s"] - horizon_s) < 1e-6:
                return None if one["closed"] is None else float(one["closed"])
        return None


def domain_of(effect: Mapping[str, Any]) -> str:
    """Of a reported effect."""
    return str(effect.get("domain") or SENSOR)


def honest(true: str, named: str) -> bool:
    """Whether `named` may be said where `true` is not in the catalogue."""
    return named in HONEST.get(true, frozenset())


@dataclass(frozen=True)
class Told:
    """A true parameter beside the reported one. `low` to `high` is the 95 % interval, None where it has an open end."""

    effect: str
    name: str
    truth: float
    value: float
    low: float | None
    high: float | None
    exact: bool

    @property
    def error(self) -> float:
        """Reported less true."""
        return self.value - self.truth

    def size_error(self, *, relative: bool) -> float:
        """Its size; of a ratio less one, relative to the true ratio."""
        return abs(self.error) / (1.0 + self.truth) if relative else abs(self.error)

    @property
    def held(self) -> bool | None:
        """Whether the interval holds the truth; None where there is none to hold it against."""
        if not self.exact or self.low is None or self.high is None:
            return None
        return self.low <= self.truth <= self.high


def told_of(answer: AirAnswer) -> list[Told]:
    """Every true parameter of an effect that was named; ratios less one where both have a ratio."""
    found = []
    for effect in answer.effects:
        entry = answer.entry(str(effect["id"]))
        if entry is None or (entry["id"] == "motor_weak" and list(effect["instances"]) != entry["instances"]):
            continue
        for said in effect.get("params") or []:
            name = str(said["name"])
            if name in entry["params"] and said.get("value") is not None:
                found.append(_told(entry, name, said))
    return found


RELATIVE = frozenset({"s", "c1", "c2"})
"""Parameters that are real over simulated less one, and those of the effects in :data:`RELATIVE_EFFECTS`."""
RELATIVE_EFFECTS = frozenset({"inertia", "angular_damping"})


def _told(entry: Mapping[str, Any], name: str, said: Mapping[str, Any]) -> Told:
    value, interval = float(said["value"]), said.get("ci95")
    if (name in RELATIVE or entry["id"] in RELATIVE_EFFECTS) and said.get("ratio") is not None:
        value, interval = float(said["ratio"]) - 1.0, said.get("ratio_ci95")
        interval = None if interval is None else [None if x is None else float(x) - 1.0 for x in interval]
    low, high = interval or (None, None)
    return Told(
        effect=str(entry["id"]),
        name=name,
        truth=float(entry["params"][name]),
        value=value,
        low=None if low is None else float(low),
        high=None if high is None else float(high),
        exact=name in entry["exact"],
    )
