"""Reports of a loop: a line for each round, a final sentence, and a page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mavcal.calib import pages
from mavcal.calib.gap_report.words import chance, number
from mavcal.service.closing.loop import ClosingResult
from mavcal.service.closing.rounds import Outcome, RoundResult

_ENDS = {
    Outcome.CLOSED: "nothing material is left",
    Outcome.NOTHING_TO_SET: "what is left has no name, or cannot be set in this simulator",
    Outcome.WITHOUT_EFFECT: "what was set is there as before, so setting it does not help",
    Outcome.ROUNDS_USED: "the rounds are used up, and something is left",
    Outcome.NOT_TESTABLE: "these flights do not allow an answer",
}

_MOST_UNTESTED = 3


def sentence(result: ClosingResult) -> str:
    """How the loop ended, with the error before and after."""
    first, last = result.rounds[0], result.rounds[-1]
    flown = len(result.rounds) - 1
    rounds = "1 round" if flown == 1 else f"{flown} rounds"
    text = f"After {rounds} {_ENDS[result.outcome]}"
    left = f" ({', '.join(last.left)})" if last.left else ""
    if first.velocity_error is None or last.velocity_error is None or not flown:
        return f"{text}{left}."
    return (
        f"{text}{left}. The error of the predicted velocity after 1 s went from {number(first.velocity_error)} to "
        f"{number(last.velocity_error)} m/s."
    )


def round_lines(result: RoundResult) -> list[str]:
    """Lines on a round: what it measured, and what the next one sets."""
    error = "" if result.velocity_error is None else f", error after 1 s {number(result.velocity_error)} m/s"
    lines = [f"round {result.number}: {result.verdict}{error}{_closes(result)}"]
    lines += [f"  {one}" for one in (*result.notes, *_effects(result))]
    lines += [f"  set {one}" for one in _changes(result)]
    lines += [f"  not tested: {one}" for one in result.not_tested[:_MOST_UNTESTED]]
    return lines + [f"  cannot be set by this command: {one}" for one in result.not_set]


def _closes(result: RoundResult) -> str:
    return "" if result.closed is None else f", its effects close {100.0 * result.closed:.0f} % of the held-out gap"


def _effects(result: RoundResult) -> list[str]:
    found = []
    for effect in result.effects:
        aside = "" if effect["material"] else ", of the day: not set"
        said = effect.get("said", effect["id"])  # rounds of an earlier version have no words
        found.append(f"{said}, probability {chance(effect['probability'])}{aside}")
    return found


def _changes(result: RoundResult) -> list[str]:
    return [
        f"{name} {_value(now)}" if before is None else f"{name} {_value(before)} -> {_value(now)}"
        for name, (before, now) in result.to_set.changed_from(result.settings).items()
    ]


def _value(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def page(result: ClosingResult, title: str) -> str:
    """The loop as a page of its own."""
    return pages.page(
        "mavcal.service.closing",
        "rounds.html",
        title=title,
        sentence=sentence(result),
        rows=_rows(result.rounds),
        rollout=_predicted(result.rounds),
        numbers=[r.number for r in result.rounds],
    )


def _predicted(rounds: Sequence[RoundResult]) -> list[dict[str, Any]]:
    """A row a horizon: the error of each round's simulator, and the floor of the last one."""
    found: dict[tuple[str, float, str], dict[str, Any]] = {}
    for one in rounds:
        for r in one.rollout:
            what = f"{r['quantity'].replace('_', ' ')} after {r['h_s']:g} s, {r['unit']}"
            beside = "" if r["part"] == "blocks" else f"; {r['part']} held out"
            row = found.setdefault(
                (r["quantity"], r["h_s"], r["part"]), {"what": f"{what}{beside}", "errors": {}, "floor": ""}
            )
            row["errors"][one.number] = f"{r['before']:.3g}"
            row["floor"] = f"{r['floor']:.3g}"
    return list(found.values())


def _rows(rounds: Sequence[RoundResult]) -> list[dict[str, Any]]:
    return [
        {
            "number": r.number,
            "error": "not known" if r.velocity_error is None else f"{r.velocity_error:.3g} m/s",
            "closed": "not known" if r.closed is None else f"{100.0 * r.closed:.0f} %",
            "effects": _effects(r),
            "changes": _changes(r),
            "not_set": r.not_set,
            "notes": r.notes,
        }
        for r in rounds
    ]
