"""Many vehicles of each fault: which checks fail, and whether the right one does so alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from bench.preflight.faults import FAULTS, Fault
from bench.preflight.vehicle import healthy
from mavcal.calib.preflight.check import Report, Verdict
from mavcal.calib.preflight.run import preflight

RIGHT_SHARE = 0.99
FALSE_SHARE = 1.0 / 200.0


@dataclass(frozen=True)
class Row:
    """One fault over many seeds; `fault` None: healthy vehicles."""

    fault: Fault | None
    runs: int
    right: int
    """Runs in which exactly one check failed, and it was a right one; of healthy vehicles: every check passed."""
    failed: Counter[str]
    """By the checks that failed together (of healthy vehicles: that did not pass), how often."""
    wrong: tuple[int, ...]
    """Seeds of the other runs."""

    @property
    def met(self) -> bool:
        """Whether the target is reached."""
        if self.fault is None:
            return self.runs - self.right <= FALSE_SHARE * self.runs
        return self.right >= RIGHT_SHARE * self.runs


def report_of(fault: Fault | None, seed: int) -> Report:
    """The preflight of one vehicle."""
    vehicle = healthy(seed, redundant=fault is not None)
    if fault is not None:
        fault.do(vehicle)
    return preflight(vehicle.snapshot())


def run(fault: Fault | None, seeds: Iterable[int]) -> Row:
    """One row of the table."""
    failed: Counter[str] = Counter()
    wrong, runs = [], 0
    for seed in seeds:
        runs += 1
        report = report_of(fault, seed)
        counted = (Verdict.FAIL,) if fault is not None else (Verdict.FAIL, Verdict.WARN, Verdict.UNKNOWN)
        found = [check.id for check in report.checks if check.verdict in counted]
        failed[", ".join(found) or "none"] += 1
        good = not found if fault is None else len(found) == 1 and found[0] in fault.right
        if not good:
            wrong.append(seed)
    return Row(fault, runs, runs - len(wrong), failed, tuple(wrong))


def rows(runs: int, healthy_runs: int, first: int = 1) -> list[Row]:
    """The whole table."""
    found = [run(None, range(first, first + healthy_runs))]
    return found + [run(fault, range(first, first + runs)) for fault in FAULTS]
