"""What is kept of every round, so that a loop that was interrupted goes on where it was.

``progress.json`` in the work folder says whose loop it is and how far it is; ``round-N/flown.json`` that its flight is
whole, ``round-N/round.json`` what its diagnosis measured.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from mavcal.calib.airframe.answer import Domain, Quantity
from mavcal.calib.gap.schema import EffectEstimate, GapReport, GapVerdict, NotTestable
from mavcal.calib.gap_report.airframe_effects import phrase
from mavcal.calib.report import to_json
from mavcal.service.closing.errors import OtherClosing
from mavcal.service.closing.logs import Flown
from mavcal.service.closing.mission import MissionKind
from mavcal.service.closing.settings import SimSettings

Json = dict[str, Any]

SCHEMA = "closing/1"
PROGRESS, FLOWN, ROUND, DIAGNOSIS = "progress.json", "flown.json", "round.json", "diagnosis.json"
_UNSAID = {"mission": MissionKind.STANDARD.value}
"""What folders of earlier versions do not say of their loop."""
_AIRFRAME = "airframe"
"""Id under which a report says that no airframe could be compared."""
PREDICTED_S = 1.0
"""Length of the predicted flights whose error sums a round up."""


@dataclass(frozen=True)
class RoundResult:
    """One round as measured: the real flight against the simulator with `settings`.

    `closed` is the part of the held-out gap that the effects found now would close, None where it is not known;
    `rollout` as in the report; `velocity_error` that after one predicted second with the simulator as it was, m/s.
    """

    number: int
    verdict: str
    tested: bool
    effects: tuple[Json, ...]
    closed: float | None
    rollout: tuple[Json, ...]
    velocity_error: float | None
    settings: SimSettings
    to_set: SimSettings
    """With the remedy of these effects: what the next round flies with."""
    not_set: tuple[str, ...]
    """Keys of the remedy that this simulator's command cannot take."""
    log: str
    not_tested: tuple[str, ...] = ()
    """Why the airframe, or anything at all, could not be compared."""
    notes: tuple[str, ...] = ()
    """What its log lacked, and how it was flown again."""

    @property
    def left(self) -> tuple[str, ...]:
        """Ids of the effects that still tell the flights apart."""
        return tuple(effect["id"] for effect in self.effects if effect["material"])

    def as_json(self) -> Json:
        """Everything, as data."""
        return {
            "round": self.number,
            "verdict": self.verdict,
            "tested": self.tested,
            "effects": list(self.effects),
            "left": list(self.left),
            "closed": self.closed,
            "rollout": list(self.rollout),
            "velocity_error": self.velocity_error,
            "settings": _settings_json(self.settings),
            "to_set": _settings_json(self.to_set),
            "not_set": list(self.not_set),
            "log": self.log,
            "not_tested": list(self.not_tested),
            "notes": list(self.notes),
        }


class Outcome(StrEnum):
    """Why the loop ended."""

    CLOSED = "closed"  # nothing material is left
    NOTHING_TO_SET = "nothing_to_set"  # what is left has no name, or cannot be set in this simulator
    WITHOUT_EFFECT = "without_effect"  # what was set is there as before
    ROUNDS_USED = "rounds_used"  # something is left after the last round
    NOT_TESTABLE = "not_testable"  # the flights do not allow an answer


_NO_MORE = (GapVerdict.NO_GAP, GapVerdict.EXPLAINED)
_UNMOVED = 0.1
"""Part of a value by which it must have changed to count as moved. Chosen, not measured: a remedy takes off more."""


def outcome_of(results: Sequence[RoundResult], rounds: int) -> Outcome | None:
    """Why there is no round after `results`; None: there is one. `rounds` may be flown with a remedy."""
    last = results[-1]
    if not last.left:
        if not last.tested or last.not_tested or last.verdict == GapVerdict.NOT_TESTABLE:
            return Outcome.NOT_TESTABLE
        return Outcome.CLOSED if last.verdict in _NO_MORE else Outcome.NOTHING_TO_SET
    if last.to_set == last.settings:
        return Outcome.NOTHING_TO_SET
    if len(results) > 1 and _values(last) and _unmoved(_values(results[-2]), _values(last)):
        return Outcome.WITHOUT_EFFECT
    return Outcome.ROUNDS_USED if len(results) > rounds else None


def _values(result: RoundResult) -> dict[tuple[str, ...], float]:
    return {
        (effect["id"], *map(str, effect["instances"]), name): parameter["value"]
        for effect in result.effects
        if effect["material"]
        for name, parameter in effect["params"].items()
    }


def _unmoved(before: Mapping[tuple[str, ...], float], now: Mapping[tuple[str, ...], float]) -> bool:
    """Whether every value is there as before; what is small beside the others does not count."""
    least = _UNMOVED * max(map(abs, now.values()))
    return before.keys() == now.keys() and all(
        abs(value - before[key]) <= _UNMOVED * abs(value) or max(abs(value), abs(before[key])) < least
        for key, value in now.items()
    )


def measured(
    number: int,
    report: GapReport,
    settings: SimSettings,
    log: str,
    *,
    with_frame: bool,
    notes: tuple[str, ...] = (),
) -> RoundResult:
    """The round's result from its diagnosis; without a frame file only parameters can be set."""
    wanted = settings.patched(effect for effect in report.effects if is_material(effect))
    to_set = wanted if with_frame else SimSettings(wanted.parameters, settings.frame)
    not_set = tuple(wanted.changed_from(to_set))
    rollout = () if report.airframe is None else report.airframe.rollout
    errors = [
        r.before for r in rollout if r.quantity is Quantity.VELOCITY and r.h_s == PREDICTED_S and r.part == "blocks"
    ]
    return RoundResult(
        number,
        report.verdict.value,
        report.tested,
        tuple(_effect_json(effect) for effect in report.effects),
        None if report.shrink is None else report.shrink.known,
        tuple(
            {"h_s": r.h_s, "quantity": r.quantity.value, "unit": r.unit, "part": r.part, "before": r.before,
             "after": r.after, "floor": r.floor, "closed": r.closed}
            for r in rollout
        ),
        errors[0] if errors else None,
        settings,
        to_set,
        not_set,
        log,
        tuple(f"{n.id}: {n.reason}; needed: {n.need}" for n in report.not_testable if _matters(n, report)),
        notes,
    )  # fmt: skip


def _matters(untested: NotTestable, report: GapReport) -> bool:
    """Whether it says that flights, not single effects, could not be compared."""
    return untested.id == _AIRFRAME or not report.tested


def is_material(effect: EffectEstimate) -> bool:
    """Whether an effect is worth another flight: all but the day's weather.

    A doubtful name is set too, as in an export: the next flight measures whether it was right.
    """
    return effect.domain is not Domain.ENVIRONMENT


def _effect_json(effect: EffectEstimate) -> Json:
    return {
        "id": effect.id,
        "said": phrase(effect),
        "domain": effect.domain.value,
        "instances": list(effect.instances),
        "probability": effect.evidence.probability,
        "material": is_material(effect),
        "params": {p.name: {"value": p.value, "unit": p.unit, "ci95": list(p.ci95)} for p in effect.params},
        "sim_patch": dict(effect.sim_patch),
    }


def _settings_json(settings: SimSettings) -> Json:
    return {"parameters": dict(settings.parameters), "frame": dict(settings.frame)}


class WorkFolder:
    """The folder of one loop. Raises OtherClosing if it is that of another one.

    `identity` is what must be the same for its rounds to hold: flight, command, mission, settings at the start.
    """

    def __init__(self, path: Path, identity: Mapping[str, Any]) -> None:
        self.path = path
        self._identity = to_json(dict(identity))
        path.mkdir(parents=True, exist_ok=True)
        kept = read_json(path / PROGRESS)
        before, now = {**_UNSAID, **(kept or {}).get("of", {})}, {**_UNSAID, **self._identity}
        if kept is not None and before != now:
            other = [name for name, value in now.items() if before.get(name) != value]
            raise OtherClosing(
                f"{path} holds the rounds of another loop ({', '.join(other)} differ): choose another folder by "
                "--work, or remove this one"
            )

    def round_folder(self, number: int) -> Path:
        """Where a round's files are."""
        return self.path / f"round-{number}"

    def result(self, number: int, settings: SimSettings) -> RoundResult | None:
        """What a round measured, if it is done and flew with `settings`."""
        kept = read_json(self.round_folder(number) / ROUND)
        if kept is None or kept.get("settings") != to_json(_settings_json(settings)):
            return None
        return RoundResult(
            number=kept["round"],
            verdict=kept["verdict"],
            tested=kept["tested"],
            effects=tuple(kept["effects"]),
            closed=kept["closed"],
            rollout=tuple(kept["rollout"]),
            velocity_error=kept["velocity_error"],
            settings=SimSettings(**kept["settings"]),
            to_set=SimSettings(**kept["to_set"]),
            not_set=tuple(kept["not_set"]),
            log=kept["log"],
            not_tested=tuple(kept.get("not_tested", ())),
            notes=tuple(kept.get("notes", ())),
        )

    def flown(self, number: int, settings: SimSettings) -> Flown | None:
        """The flight of a round, if it is whole and had `settings`."""
        folder = self.round_folder(number)
        kept = read_json(folder / FLOWN)
        if kept is None or kept["settings"] != to_json(_settings_json(settings)):
            return None
        log = folder / str(kept["log"])
        return Flown(log, tuple(kept.get("notes", ()))) if log.is_file() else None

    def begin_round(self, number: int) -> Path:
        """An empty folder for a round: nothing of an earlier flight may be taken for this one's."""
        folder = self.round_folder(number)
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        return folder

    def keep_flown(self, number: int, settings: SimSettings, flown: Flown) -> None:
        """The flight of a round is whole."""
        folder = self.round_folder(number)
        log = str(flown.log.relative_to(folder))
        kept = {"log": log, "settings": _settings_json(settings), "notes": list(flown.notes)}
        write_json(folder / FLOWN, kept)

    def keep(self, result: RoundResult, diagnosis: Json) -> None:
        """Write the diagnosis of a round and what came of it."""
        folder = self.round_folder(result.number)
        write_json(folder / DIAGNOSIS, diagnosis)
        write_json(folder / ROUND, result.as_json())

    def keep_progress(self, number: int, doing: str, share: float, left_s: float | None) -> None:
        """Write how far the loop is."""
        standing = {"round": number, "doing": doing, "share": share, "left_s": left_s}
        write_json(self.path / PROGRESS, {"schema": SCHEMA, "of": self._identity, "standing": standing})


def read_json(file: Path) -> Json | None:
    """The object in `file`; None if it is not there or not whole."""
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None


def write_json(file: Path, document: Mapping[str, Any]) -> None:
    """Write an object so that the file is always whole."""
    beside = file.with_name(f".{file.name}")
    beside.write_text(json.dumps(to_json(document), indent=1, allow_nan=False) + "\n", encoding="utf-8")
    os.replace(beside, file)
