"""Many vehicles of each fault: which checks fail, and whether the right one does so alone."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from bench.preflight.faults import FAULTS, Fault
from bench.preflight.vehicle import BenchVehicle, healthy
from mavcal.calib.preflight.check import Report, Verdict
from mavcal.calib.preflight.run import preflight

RIGHT_SHARE = 0.99
FALSE_SHARE = 1.0 / 200.0


@dataclass(frozen=True)
class Row:
    """One fault on one autopilot over many seeds; `fault` None: healthy vehicles."""

    fault: Fault | None
    autopilot: str
    runs: int
    right: int
    """Runs in which exactly one check failed, and it was a right one; of healthy vehicles: every check passed."""
    failed: Counter[str]
    """By the checks that failed together (of healthy vehicles: that did not pass), how often."""
    blamed: Counter[str]
    """``it alone``, ``it or another``, ``another``, ``none``: how often, of the runs that were right."""
    advised: Counter[str]
    """Remedies of the check that failed."""
    wrong: tuple[int, ...]
    """Seeds of the other runs."""

    @property
    def met(self) -> bool:
        """Whether the target is reached."""
        if self.fault is None:
            return self.runs - self.right <= FALSE_SHARE * self.runs
        return self.right >= RIGHT_SHARE * self.runs and self.blamed["another"] == 0


AUTOPILOTS = ("ardupilot", "px4")


def looked_at(fault: Fault | None, seed: int) -> tuple[BenchVehicle, Report]:
    """One vehicle, and its preflight."""
    vehicle = healthy(seed, redundant=fault is not None)
    if fault is not None:
        fault.do(vehicle)
    return vehicle, preflight(vehicle.snapshot())


def report_of(fault: Fault | None, seed: int) -> Report:
    """The preflight of one vehicle."""
    return looked_at(fault, seed)[1]


def run(fault: Fault | None, autopilot: str, first: int, runs: int) -> Row:
    """One row of the table: so many vehicles of this autopilot, from the seed `first` on."""
    failed: Counter[str] = Counter()
    blamed: Counter[str] = Counter()
    advised: Counter[str] = Counter()
    wrong = []
    start = first + (first % 2 != AUTOPILOTS.index(autopilot))
    for seed in range(start, start + 2 * runs, 2):
        vehicle, report = looked_at(fault, seed)
        counted = (Verdict.FAIL,) if fault is not None else (Verdict.FAIL, Verdict.WARN, Verdict.UNKNOWN)
        found = [check for check in report.checks if check.verdict in counted]
        failed[", ".join(check.id for check in found) or "none"] += 1
        good = not found if fault is None else len(found) == 1 and found[0].id in fault.right
        if not good:
            wrong.append(seed)
        elif fault is not None:
            blamed[whom(vehicle.culprit, found[0].suspects)] += 1
            advised[found[0].remedy] += 1
    return Row(fault, autopilot, runs, runs - len(wrong), failed, blamed, advised, tuple(wrong))


def whom(culprit: str, suspects: tuple[str, ...]) -> str:
    """How well the blame fits."""
    if not suspects or not culprit:
        return "none"
    if culprit not in suspects:
        return "another"
    return "it alone" if len(suspects) == 1 else "it or another"


def rows(runs: int, healthy_runs: int, first: int = 1) -> list[Row]:
    """The whole table; `runs` of each fault on each autopilot."""
    found = [run(None, autopilot, first, healthy_runs) for autopilot in AUTOPILOTS]
    return found + [run(fault, autopilot, first, runs) for fault in FAULTS for autopilot in AUTOPILOTS]
