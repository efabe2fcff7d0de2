"""Error over standard deviation of every written number, and whether what was said of it is true."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.firmware.jobs import Done
from bench.rows import grid
from mavcal.client.enums import JobState

WITHIN = 1.959964
"""Standard deviations of a 95 % interval."""
WRONG = 5.0
"""Standard deviations: a number farther off was not estimated honestly."""
HELD = 2e-6
"""Relative: what a float32 loses on the way."""


@dataclass(frozen=True)
class Row:
    """One step of a round."""

    autopilot: str
    round: str
    step: str
    state: str
    proof: str
    errors: tuple[float, ...]
    """Error over stated sd of each number whose truth is known."""
    farthest: str
    seconds: float
    untrue: tuple[str, ...]
    """Sentences that the vehicle or the truth contradicts."""
    said: str
    right: bool = True
    """Whether the step ended as it should."""

    @property
    def within(self) -> int:
        """How many 95 % intervals hold the truth."""
        return sum(abs(z) <= WITHIN for z in self.errors)

    @property
    def good(self) -> bool:
        """It ended as it should, and nothing that it said is untrue."""
        return self.right and not self.untrue


def scored(
    autopilot: str, round_: str, done: Done, truth: Mapping[str, float], read: Callable[[str], float | None]
) -> Row:
    """A job beside the truth and beside what the vehicle holds now."""
    job = done.job
    errors = _errors(done, truth)
    untrue = [*_about_the_vehicle(done, read), *_about_the_numbers(job.state, errors)]
    proof = "" if job.outcome is None else str(job.outcome.proof)
    worst = max(errors, key=lambda name: abs(errors[name]), default="")
    return Row(
        autopilot,
        round_,
        job.kind,
        str(job.state),
        proof,
        tuple(errors.values()),
        f"{worst} {errors[worst]:+.1f}" if worst else "",
        done.seconds,
        tuple(untrue),
        done.said,
        right=job.state is JobState.SUCCEEDED,
    )


def _errors(done: Done, truth: Mapping[str, float]) -> dict[str, float]:
    """By parameter. A compass's matrix is compared without the factor that it shares with the assumed field."""
    if done.job.plan is None:
        return {}
    changes = {c.name: c for c in done.job.plan.changes if c.sd and c.name in truth}
    common = _common_factors({name: float(c.new) for name, c in changes.items()}, truth)
    return {
        name: (float(c.new) * common.get(_stem(name), 1.0) - truth[name]) / float(c.sd or math.nan)
        for name, c in changes.items()
    }


MATRICES = ("COMPASS_DIA", "COMPASS_ODI", "SCALE", "ODIAG")


def _stem(name: str) -> str:
    """Which compass's matrix a name belongs to; empty: none."""
    if name.startswith(("COMPASS_DIA", "COMPASS_ODI")):
        return name[11:-1]
    if name.startswith("CAL_MAG") and ("SCALE" in name or "ODIAG" in name):
        return name[:8]
    return ""


def _common_factors(new: Mapping[str, float], truth: Mapping[str, float]) -> dict[str, float]:
    """True over written mean diagonal of each compass's matrix."""
    factors: dict[str, float] = {}
    diagonal = [n for n in new if "DIA_" in n or "DIA2_" in n or "DIA3_" in n or ("CAL_MAG" in n and "SCALE" in n)]
    for stem in {_stem(name) for name in diagonal if _stem(name) or name.startswith("COMPASS_DIA")}:
        own = [n for n in diagonal if _stem(n) == stem]
        factors[stem] = float(np.mean([truth[n] for n in own]) / np.mean([new[n] for n in own]))
    return factors


def _about_the_vehicle(done: Done, read: Callable[[str], float | None]) -> list[str]:
    """A success holds every new value, a rollback every old one."""
    if done.job.plan is None or done.job.state not in {JobState.SUCCEEDED, JobState.REVERTED}:
        return []
    untrue = []
    for change in done.job.plan.changes:
        wanted = change.new if done.job.state is JobState.SUCCEEDED and not change.session else change.old
        holds = read(change.name)
        if wanted is None or holds is None:
            continue
        if abs(holds - float(wanted)) > HELD * max(1.0, abs(float(wanted))):
            untrue.append(f"{done.job.state}, but {change.name} holds {holds:g} and not {float(wanted):g}")
    return untrue


def _about_the_numbers(state: JobState, errors: Mapping[str, float]) -> list[str]:
    far = [f"{name} {z:+.1f} sd" for name, z in errors.items() if abs(z) > WRONG]
    if state is JobState.SUCCEEDED and far:
        return [f"succeeded, but off: {', '.join(far)}"]
    if state is JobState.REVERTED and errors and not far:
        return ["taken back, although every number is right"]
    return []


def table(rows: Sequence[Row]) -> str:
    """The rows in Markdown, and what all of them together say of the intervals."""
    cells = []
    for row in rows:
        rms = f"{math.sqrt(sum(z * z for z in row.errors) / len(row.errors)):.2f}" if row.errors else ""
        within = f"{row.within} of {len(row.errors)}" if row.errors else ""
        ended = row.state if row.right else f"**{row.state}**: {row.said}"
        numbers = (row.proof, rms, within, row.farthest, f"{row.seconds:.0f}")
        cells.append((row.autopilot, row.round, row.step, ended, *numbers, "; ".join(row.untrue)))
    count, held = (sum(numbers) for numbers in zip(*((len(row.errors), row.within) for row in rows), strict=True))
    bad = sum(not row.good for row in rows)
    head = ("autopilot", "round", "step", "ended", "proof", "error/sd: rms", "in 95 %", "farthest", "s", "untrue")
    said = f"{held} of {count} intervals hold the truth; {bad} of {len(rows)} steps not as they should be."
    return f"{grid(head, cells)}\n\n{said}"
