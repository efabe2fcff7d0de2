"""The verdict on a run: compares what the vehicle holds with what the job says. Complaints are sentences; none is
good."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from bench.campaign.truth import Holding, Residual, equal

Json = Mapping[str, Any]


class Ending(StrEnum):
    """How a run ended."""

    VERIFIED = "verified"
    AS_BEFORE = "as before"
    IN_DOUBT = "in doubt, list true"
    FAILURE = "FAILURE"


ENDINGS = {
    "succeeded": Ending.VERIFIED,
    "reverted": Ending.AS_BEFORE,
    "review": Ending.AS_BEFORE,
    "interrupted": Ending.AS_BEFORE,
    "cancelled": Ending.AS_BEFORE,
}
"""What a job in this state claims of its vehicle."""

SET_BY_COMMAND = ("INS_ACC_ID", "INS_ACC2_ID", "INS_ACC3_ID", "COMPASS_DEV_ID", "COMPASS_DEV_ID2")
"""The command at the end of a plan has ArduPilot store these by itself."""


@dataclass(frozen=True)
class OwnWrite:
    """A parameter value that the vehicle stored unasked."""

    value: float
    after_end: bool
    """The job had ended before."""


@dataclass(frozen=True)
class Evidence:
    """What a run has seen. `job` is the job as the service tells it, as JSON; holdings are the vehicle's own."""

    job: Json
    before: Holding
    now: Holding
    foreign: Mapping[str, float]
    """Values written by a third party, by name."""
    own: Mapping[str, OwnWrite] = field(default_factory=dict)
    """The last value that the vehicle stored by itself, by name."""

    @property
    def changes(self) -> Sequence[Json]:
        """The plan's changes; none before there is a plan."""
        plan = self.job["plan"]
        changes: Sequence[Json] = [] if plan is None else plan["changes"]
        return changes


@dataclass(frozen=True)
class Stop:
    """A stopping fault that struck while the job wrote; times are the vehicle's."""

    kind: str
    struck: float
    visible: float
    """From here on the service has to know of it."""
    states: Sequence[tuple[float, str]]
    """When the job was seen to enter which state, oldest first."""

    @property
    def doubted(self) -> float | None:
        """When the job was first seen in doubt after the stroke; None: never."""
        return next((t for t, state in self.states if state == "in_doubt" and t >= self.struck), None)

    @property
    def demanded(self) -> bool:
        """Whether the job had to stop: it wrote, had not ended when the fault was visible, and awaited no restart."""
        if self.doubted is not None:
            return True
        before = [state for t, state in self.states if t <= self.struck]
        passed = {*before[-1:], *(state for t, state in self.states if self.struck < t <= self.visible)}
        return bool(passed) and not passed & {*ENDINGS, "waiting_for_reboot", "in_doubt"}


def stop_complaints(stops: Iterable[Stop], sets: Sequence[tuple[float, str, float]]) -> tuple[str, ...]:
    """What is wrong after stopping faults: a PARAM_SET between its being visible and the doubt, or no doubt at all."""
    complaints = []
    for stop in stops:
        if not stop.demanded:
            continue
        doubted = stop.doubted
        if doubted is None:
            complaints.append(f"{stop.kind} at {stop.struck:.1f} s in mid-write, and the job was never in doubt")
        late = [name for t, name, _ in sets if stop.visible < t and (doubted is None or t < doubted)]
        if late:
            complaints.append(f"{len(late)} PARAM_SETs arrived long after {stop.kind}: {', '.join(late[:3])}")
    return tuple(complaints)


def judge(
    evidence: Evidence, residuals: Iterable[Residual], endings: Mapping[str, Ending] = ENDINGS
) -> tuple[Ending, tuple[str, ...]]:
    """The ending that the vehicle bears out, with what is wrong if none is; `endings` are what states claim."""
    state = evidence.job["state"]
    claimed = endings.get(state)
    if claimed is None:
        return Ending.FAILURE, (f"the job is {state}: {evidence.job['outcome']}",)
    complaints = _verified(evidence, residuals) if claimed == Ending.VERIFIED else _as_before(evidence)
    return (Ending.FAILURE if complaints else claimed), tuple(complaints)


def _verified(e: Evidence, residuals: Iterable[Residual]) -> list[str]:
    complaints = []
    wanted = {c["name"]: c["old"] if c["session"] else c["new"] for c in e.changes}
    for name, value in wanted.items():
        held = e.now.stored[name]
        if value is not None and not equal(held, value):
            complaints.append(f"succeeded, but {name} holds {held:.9g} instead of {value:.9g}")
    complaints += _beside(e, wanted)
    complaints += [
        f"succeeded, but {r.sensor} {r.instance} is off by {r.worst:.3g}, more than {r.bound:.3g}"
        for r in residuals
        if not r.good
    ]
    return complaints


def _as_before(e: Evidence) -> list[str]:
    """Every value is the old one. One of the vehicle's own or of a third party stays; the job names it.

    A value that the vehicle stored after the job's end need not be named.
    """
    complaints = _beside(e, [c["name"] for c in e.changes])
    named = {s["name"] for s in e.job["standing"]}
    untouched = e.job["state"] == "review" and not (e.job["last_write"] or {}).get("sent")
    for change in e.changes:
        name, held = change["name"], e.now.stored[change["name"]]
        if equal(held, e.before.stored[name]) or (untouched and by_itself(e, name)):
            continue
        own = e.own.get(name)
        if own is not None and by_itself(e, name) and equal(held, own.value):
            if not (own.after_end or name in named):
                complaints.append(f"the vehicle rewrote {name} by itself, and the job does not name it")
        elif name not in e.foreign or not equal(held, e.foreign[name]):
            complaints.append(f"{e.job['state']}, but {name} holds {held:.9g} instead of {e.before.stored[name]:.9g}")
        elif name not in named:
            complaints.append(f"{name} was left to a third party, and the job does not name it")
    return complaints


def _beside(e: Evidence, planned: Iterable[str]) -> list[str]:
    """What changed although it was in nobody's plan."""
    excused = {*planned, *e.foreign, *SET_BY_COMMAND}
    return [
        f"{name} changed from {old:.9g} to {new:.9g}, which was not in the plan"
        for name, (old, new) in e.before.differing(e.now).items()
        if name not in excused and not by_itself(e, name)
    ]


def by_itself(e: Evidence, name: str) -> bool:
    """Whether the vehicle may have rewritten this gyro offset: PX4 at rest, ArduPilot when it starts."""
    stored = e.now.stored
    px4 = stored.get("IMU_GYRO_CAL_EN") == 1 and name.startswith("CAL_GYRO") and name.endswith("OFF")
    ardupilot = stored.get("INS_GYR_CAL") == 1 and name.startswith("INS_GYR") and ("OFFS_" in name or "CALTEMP" in name)
    return px4 or ardupilot


def doubt_complaints(e: Evidence) -> tuple[str, ...]:
    """What is wrong with the list of a job in doubt: certain values are the vehicle's, the others old, new or as heard.

    A vehicle that calibrates its gyros by itself may have changed what is not certain since.
    """
    complaints = []
    listed = {s["name"]: s for s in e.job["standing"]}
    for name, s in listed.items():
        held = e.now.stored[name]
        if name in e.foreign and equal(held, e.foreign[name]):
            continue
        if s["certain"] and not equal(held, s["value"]):
            complaints.append(f"in doubt, but {name} is certainly {s['value']:.9g}, and the vehicle holds {held:.9g}")
        heard = s["value"] is not None and equal(held, s["value"])
        if not (s["certain"] or by_itself(e, name) or heard or equal(held, s["old"]) or equal(held, s["new"])):
            complaints.append(f"in doubt: {name} is neither old nor new, the vehicle holds {held:.9g}")
    return (*complaints, *_beside(e, listed))


def held_back(state: Json, faults: Iterable[Json]) -> list[str]:
    """Parameters whose first PARAM_SET met a fault "accepted but not applied": a repeated one changes nothing.

    They are told by the count of PARAM_SETs: a busy machine can bring two of them at one time of the vehicle's clock.
    """
    names = [name for _, name, _ in state["param_set_list"]]
    earlier = state["param_sets"] - len(names)
    met = {fault["nth_set"] - 1 - earlier for fault in faults if fault["kind"] == "not_applied" and fault["struck"]}
    return [name for k, name in enumerate(names) if k in met and name not in names[:k]]
