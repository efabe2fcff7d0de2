"""``python -m bench.campaign [faults|kills|cli|all]``: run, print the tables.

``--seed 1 --run 17`` repeats a single run. Exit code 1: a criterion is not met, or that run has failed.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

from bench.campaign import report as told
from bench.campaign.cli_run import cli_kills, run_cli_kill
from bench.campaign.fault_run import run_fault
from bench.campaign.judge import Ending
from bench.campaign.kill_run import kill_of, kills, repetition, run_kill
from bench.campaign.report import REPEATS, FaultReport, KillReport
from bench.campaign.scenario import scenarios
from bench.rows import Row, table

RUNS = 280
MOST_REPETITIONS = 8
"""A kill that comes a step too late is tried again, so often at most."""

Job = TypeVar("Job")
Report = TypeVar("Report", FaultReport, KillReport)


def main(argv: Sequence[str] | None = None) -> int:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(prog="scripts/campaign", description=__doc__)
    parser.add_argument("part", nargs="?", choices=("faults", "kills", "cli", "all"), default="all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--runs", type=int, default=RUNS, help="number of fault runs")
    parser.add_argument("--run", type=int, default=None, help="only this run, with all it has to say")
    parser.add_argument("--workers", type=int, default=4, help="runs at the same time")
    args = parser.parse_args(argv)
    if args.run is not None:
        return _single(args.part, args.seed, args.run, args.runs)
    began = time.monotonic()
    found: list[Row] = []
    with ProcessPoolExecutor(args.workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        if args.part in ("faults", "all"):
            faults = _all(pool, run_fault, scenarios(args.runs, args.seed))
            print("\n" + told.fault_table(faults))
            found += told.of_faults(faults)
        if args.part in ("kills", "all"):
            killed = _kills(pool, args.seed)
            print("\n" + told.kill_table(killed))
            found += told.of_kills(killed)
        if args.part in ("cli", "all"):
            commands = _all(pool, run_cli_kill, cli_kills(args.seed))
            print("\n" + told.cli_table(commands))
            found += told.of_cli_kills(commands)
    print("\n" + table(found))
    print(f"\nseed {args.seed}, {(time.monotonic() - began) / 60:.0f} min")
    return 0 if all(criterion.met for criterion in found) else 1


def _single(part: str, seed: int, run: int, runs: int) -> int:
    report: FaultReport | KillReport
    if part == "cli":
        report = run_cli_kill(cli_kills(seed)[run])
    elif part == "kills":
        report = run_kill(kill_of(seed, run))
    else:
        scenario = scenarios(max(runs, run + 1), seed)[run]
        print(scenario)
        report = run_fault(scenario)
    print(report)
    return int(report.ending == Ending.FAILURE)


def _all(pool: ProcessPoolExecutor, run: Callable[[Job], Report], jobs: Iterable[Job]) -> list[Report]:
    reports = []
    for report in pool.map(run, jobs):
        reports.append(report)
        print(f"{report.reproduce} -> {report.ending} ({report.seconds:.0f} s)", file=sys.stderr, flush=True)
        for complaint in report.complaints:
            print(f"    {complaint}\n    the job says: {report.says}", file=sys.stderr, flush=True)
    return reports


def _kills(pool: ProcessPoolExecutor, seed: int) -> list[KillReport]:
    """Every planned kill; those whose step was left behind before the signal came are repeated."""
    planned = list(kills(seed))
    reports = _all(pool, run_kill, planned)
    by_step = {kill.step: kill for kill in reversed(planned)}
    number = 0
    for _ in range(MOST_REPETITIONS):
        struck = told.struck_steps(reports)
        missing = [kill for step, kill in by_step.items() for _ in range(REPEATS - struck[step.value])]
        if not missing:
            break
        more = [repetition(kill, number + i) for i, kill in enumerate(missing, start=1)]
        number += len(more)
        reports += _all(pool, run_kill, more)
    return reports


if __name__ == "__main__":
    sys.exit(main())
