"""``python -m bench.campaign [faults|kills|cli|crossed|starved|all]``: run, print the tables.

Exit code 1: a criterion is not met.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from pathlib import Path
from typing import TypeVar

from bench.campaign import criteria, tables
from bench.campaign.cli_run import cli_kills, run_cli_kill
from bench.campaign.criteria import Criterion
from bench.campaign.crossed.kept import Kept, commit_of, keep, kept_runs
from bench.campaign.crossed.plan import cross, crosses
from bench.campaign.crossed.report import CrossReport
from bench.campaign.crossed.run import run_cross
from bench.campaign.crossed.stores import SQLITE, StoreKind
from bench.campaign.crossed.tables import LEAST_RUNS, cross_tables, of_crosses
from bench.campaign.document import write_crossed, write_document
from bench.campaign.fault_run import run_fault
from bench.campaign.judge import Ending
from bench.campaign.kill_run import run_kill
from bench.campaign.kill_scene import REPEATS, kill_of, kills, repetition
from bench.campaign.report import FaultReport, KillReport
from bench.campaign.scenario import scenarios
from bench.campaign.starved import StarvedReport, of_starved, run_starved, starved_table

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "fault-campaign.md"
RUNS = 280
STARVED_RUNS = 4
PARTS = ("faults", "kills", "cli", "crossed", "starved", "all")
MOST_REPETITIONS = 8
"""A kill that comes a step too late is tried again, so often at most."""

Job = TypeVar("Job")
AnyReport = FaultReport | KillReport | CrossReport
Report = TypeVar("Report", FaultReport, KillReport, CrossReport)


def main(argv: Sequence[str] | None = None) -> int:
    """Run what is asked for. Exit code 1: a criterion is not met, or the single run asked for has failed."""
    parser = argparse.ArgumentParser(prog="scripts/campaign", description=__doc__)
    parser.add_argument("part", nargs="?", choices=PARTS, default="all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--runs", type=int, default=RUNS, help="number of fault runs")
    parser.add_argument("--crosses", type=int, default=LEAST_RUNS, help="number of crossed runs")
    parser.add_argument("--first", type=int, default=0, help="the first of them; a campaign can be made in parts")
    parser.add_argument("--store", default=SQLITE, help="of crossed runs: sqlite, or MODULE:CLASS made of --store-url")
    parser.add_argument("--store-url", default="", help="where that store is; {run} in it names the run")
    parser.add_argument("--keep", type=Path, help="file of finished crossed runs; those in it are not made again")
    parser.add_argument("--starved", type=int, default=STARVED_RUNS, help="number of starved runs")
    parser.add_argument("--postgresql", action="store_true", help="crossed runs on a PostgreSQL of their own")
    parser.add_argument("--run", type=int, default=None, help="only this run, with all it has to say")
    parser.add_argument("--workers", type=int, default=4, help="runs at the same time")
    args = parser.parse_args(argv)
    if not args.postgresql:
        return _campaign(args, StoreKind(args.store, args.store_url))
    from bench.campaign.crossed.postgresql import served

    with served() as kind:
        return _campaign(args, kind)


def _campaign(args: argparse.Namespace, kind: StoreKind) -> int:
    if args.run is not None:
        return _single(args, kind)
    began = time.monotonic()
    faults: list[FaultReport] = []
    killed: list[KillReport] = []
    commands: list[KillReport] = []
    crossed: list[CrossReport] = []
    starved: list[StarvedReport] = []
    found: list[Criterion] = []
    texts: list[str] = []
    with ProcessPoolExecutor(args.workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        if args.part in ("faults", "all"):
            faults = _all(pool, run_fault, scenarios(args.runs, args.seed))
            texts.append(tables.fault_tables(faults))
            found += criteria.of_faults(faults)
        if args.part in ("kills", "all"):
            killed = _kills(pool, args.seed)
            texts.append(tables.kill_table(killed))
            found += criteria.of_kills(killed)
        if args.part in ("cli", "all"):
            commands = _all(pool, run_cli_kill, cli_kills(args.seed))
            texts.append(tables.cli_table(commands))
            found += criteria.of_cli_kills(commands)
        if args.part in ("crossed", "all"):
            crossed = _crossed(pool, args, kind)
            texts.append(cross_tables(crossed))
            found += of_crosses(crossed)
    if args.part in ("starved", "all"):  # one after the other, once nothing else wants the processor
        starved = _starved(args.seed, args.starved)
        texts.append(starved_table(starved))
        found += of_starved(starved)
    print("\n\n".join(["", *texts, tables.criteria_table(found)]))
    _show_failures([*faults, *killed, *commands, *crossed])
    print(
        f"\nseed {args.seed}, {len(faults)} fault runs, {len(killed)} SIGKILL runs of the service, {len(commands)} "
        f"of the command line, {len(crossed)} crossed runs on {_named(kind)} and {len(starved)} starved ones, "
        f"{_minutes(began)}"
    )
    if args.part == "all":
        write_document(DOCUMENT, args.seed, faults, killed, commands, crossed, starved, found)
    if args.part == "crossed" and len(crossed) >= LEAST_RUNS:
        write_crossed(
            DOCUMENT.with_name(f"crossed-campaign-{_named(kind)}.md"), args.seed, _named(kind), crossed, found
        )
    return 0 if all(criterion.met for criterion in found) else 1


def _named(kind: StoreKind) -> str:
    return kind.name.partition(":")[0].rpartition(".")[2]


def _single(args: argparse.Namespace, kind: StoreKind) -> int:
    report: AnyReport
    if args.part == "cli":
        report = run_cli_kill(cli_kills(args.seed)[args.run])
    elif args.part == "kills":
        report = run_kill(kill_of(args.seed, args.run))
    elif args.part == "crossed":
        print(cross(args.run, args.seed))
        report = run_cross(cross(args.run, args.seed), kind)
    else:
        scenario = scenarios(max(args.runs, args.run + 1), args.seed)[args.run]
        print(scenario)
        report = run_fault(scenario)
    print(report)
    return int(report.ending == Ending.FAILURE)


def _all(pool: ProcessPoolExecutor, run: Callable[[Job], Report], jobs: Iterable[Job]) -> list[Report]:
    reports = []
    for report in pool.map(run, jobs):
        reports.append(report)
        _progress(report)
    return reports


def _crossed(pool: ProcessPoolExecutor, args: argparse.Namespace, kind: StoreKind) -> list[CrossReport]:
    """The runs asked for, without those that the file of kept ones has; each is kept as soon as it has ended."""
    wanted = crosses(args.crosses, args.seed, args.first)
    if args.keep is None:
        return _all(pool, partial(run_cross, kind=kind), wanted)
    commit, known = commit_of(DOCUMENT.parent), kept_runs(args.keep, args.seed, kind.name)
    reports = {kept.report.index: kept.report for kept in known}
    waiting = [pool.submit(run_cross, one, kind=kind) for one in wanted if one.index not in reports]
    for done in as_completed(waiting):
        report = done.result()
        _progress(report)
        keep(args.keep, Kept(commit, kind.name, report))
        reports[report.index] = report
    print(f"kept runs of commits {', '.join(sorted({kept.commit for kept in known} | {commit}))}")
    return [reports[index] for index in sorted(reports)]


def _starved(seed: int, count: int) -> list[StarvedReport]:
    reports = []
    for index in range(count):
        report = run_starved(index, seed, told=_say)
        _say(f"starved {index} {report.autopilot} -> {report.ending} ({report.seconds:.0f} s)")
        reports.append(report)
    return reports


def _kills(pool: ProcessPoolExecutor, seed: int) -> list[KillReport]:
    """Every planned kill; those whose step was left behind before the signal came are repeated."""
    planned = list(kills(seed))
    reports = _all(pool, run_kill, planned)
    by_step = {kill.step: kill for kill in reversed(planned)}
    number = 0
    for _ in range(MOST_REPETITIONS):
        struck = criteria.struck_steps(reports)
        missing = [kill for step, kill in by_step.items() for _ in range(REPEATS - struck[step.value])]
        if not missing:
            break
        more = [repetition(kill, number + i) for i, kill in enumerate(missing, start=1)]
        number += len(more)
        reports += _all(pool, run_kill, more)
    return reports


def _progress(report: AnyReport) -> None:
    if isinstance(report, CrossReport):
        cell = f"{report.network}, {report.process}, {report.vehicle}"
        what = f"cross {report.index:4} {report.autopilot} {report.job}: {cell}"
    elif isinstance(report, KillReport):
        what = (
            f"kill {report.index:3} {report.scene}: aimed at {report.aimed}, struck {', '.join(report.struck) or '-'}"
        )
    else:
        struck = ", ".join(kind for kind, count in report.strikes.items() if count)
        what = f"run {report.index:3} {report.autopilot} {report.job}: {struck}"
    print(f"{what} -> {report.ending} ({report.seconds:.0f} s)", file=sys.stderr, flush=True)
    for complaint in report.complaints:
        print(f"    {complaint}\n    {report.reproduce}", file=sys.stderr, flush=True)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _show_failures(reports: Iterable[AnyReport]) -> None:
    for report in reports:
        if report.ending == Ending.FAILURE:
            print(f"\nFAILURE: {report.reproduce}")
            print("\n".join(f"    {complaint}" for complaint in report.complaints))
            print(f"    the job says: {report.says}")


def _minutes(began: float) -> str:
    return f"{(time.monotonic() - began) / 60:.0f} min"


if __name__ == "__main__":
    sys.exit(main())
