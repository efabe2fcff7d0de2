"""Tallies as tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from bench.accuracy.campaign import Tally
from bench.rows import Row, Section, grid, table


@dataclass(frozen=True)
class Part:
    """One table with its sentences, and the promises that it judges."""

    title: str
    body: str
    checks: tuple[Row, ...] = ()

    @classmethod
    def of_section(cls, section: Section) -> Part:
        """A part that is nothing but targets."""
        checks = tuple(
            Row(f"{section.title}: {row.what}", row.target, row.measured, row.met)
            for row in section.rows
            if row.met is not None
        )
        return cls(section.title, "\n\n".join((table(section.rows), *section.notes)), checks)


def accuracy_part(title: str, tallies: Sequence[Tally], missing: Sequence[str] = (), notes: Sequence[str] = ()) -> Part:
    """Error over bound of all contenders, and of the promised ones everything."""
    cases = list(dict.fromkeys(t.case for t in tallies))
    names = list(dict.fromkeys(t.contender.name for t in tallies))
    found = {(t.contender.name, t.case): t for t in tallies}
    lines = ["error / bound (one standard error) · median time of a run"]
    head = ["", *(f"N = {case.size}" for case in cases)]
    lines.append(grid(head, [[name, *(_cell(found.get((name, case))) for case in cases)] for name in names]))
    own = [t for t in tallies if t.contender.ours]
    lines.append("With uncertainty:")
    head = ["", "N", "runs", "error / bound", "95 % intervals hold", "time", "refused"]
    lines.append(grid(head, [_detail(t) for t in own]))
    lines += [f"Not measured: {reason}." for reason in missing]
    lines += list(notes)
    seeds = ", ".join(f"{case.seed} (N = {case.size}, {case.runs} runs)" for case in cases)
    lines.append(f"Seeds: {seeds}.")
    return Part(title, "\n\n".join(lines), tuple(_check(title, t) for t in tallies if t.met is not None))


def _cell(tally: Tally | None) -> str:
    if tally is None or not tally.runs:
        return ""
    if not tally.squares:
        return f"none of {tally.runs} runs"
    text = f"{_number(tally.ratio)} ({_number(tally.ratio_sd)})"
    text += f" · {_time(tally.milliseconds)}"
    if tally.failed or tally.refused:
        text += f", {tally.failed + tally.refused} of {tally.runs} none"
    if tally.runs < tally.case.runs:
        text += f", {tally.runs} runs"
    return text


def _detail(tally: Tally) -> list[str]:
    coverage = "" if tally.coverage is None else f"{tally.coverage:.4f} (sd {tally.coverage_sd:.4f})"
    return [
        tally.contender.name,
        str(tally.case.size),
        str(tally.runs),
        f"{tally.ratio:.3f} ({tally.ratio_sd:.3f})",
        coverage,
        _time(tally.milliseconds),
        str(tally.refused + tally.failed),
    ]


def _check(title: str, tally: Tally) -> Row:
    promised, measured = [], [f"{tally.ratio:.3f} ({tally.ratio_sd:.3f})"]
    if tally.contender.target is not None:
        promised.append(f"<= {tally.contender.target:.2f} + {tally.allowance:.3f}")
    if tally.coverage is not None:
        promised.append("intervals hold 95 %" if tally.contender.exact else "intervals hold >= 95 %")
        measured.append(f"{100.0 * tally.coverage:.2f} % (2 sd: {200.0 * tally.coverage_sd:.2f})")
    if tally.failed or tally.refused:
        measured.append(f"{tally.failed + tally.refused} runs without an answer")
    return Row(f"{title}, N = {tally.case.size}", ", ".join(promised), ", ".join(measured), tally.met)


def _number(value: float) -> str:
    if not math.isfinite(value):
        return "-"
    return f"{value:.2f}" if value < 10 else f"{value:.0f}" if value < 1e5 else f"{value:.0e}"


def _time(milliseconds: float) -> str:
    return f"{milliseconds:.2g} ms" if milliseconds < 10 else f"{milliseconds:.0f} ms"
