"""A slice of the campaign: every kind of fault once, and a kill in the middle of taking a write back."""

from __future__ import annotations

import multiprocessing
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass

import pytest

from bench.campaign.cli_run import cli_kills, run_cli_kill
from bench.campaign.fault_run import run_fault
from bench.campaign.judge import Ending
from bench.campaign.kill_run import kill_of, run_kill
from bench.campaign.report import CLEAR_SD, FaultReport, KillReport
from bench.campaign.scenario import KINDS, scenarios

pytestmark = [pytest.mark.campaign, pytest.mark.long, pytest.mark.timeout(300)]

SEED = 1
RUNS = (1, 5, 6, 10, 36, 42, 53, 70, 72, 73, 79, 139, 224, 225, 226)
"""Short ones that have every kind of fault among them."""
KILLS = (16,)
"""While an old value is on its way back."""
CLI_KILLS = (9, 30)
"""The command line dies between an echo and its journal row, then ``recover``; and before a parameter leaves, then the
next calibration."""
WORKERS = 4


@dataclass(frozen=True)
class Slice:
    """The reports, as they come in."""

    faults: dict[int, Future[FaultReport]]
    kills: dict[int, Future[KillReport]]
    commands: dict[int, Future[KillReport]]


@pytest.fixture(scope="module")
def runs() -> Iterator[Slice]:
    chosen = scenarios(max(RUNS) + 1, SEED)
    with ProcessPoolExecutor(WORKERS, mp_context=multiprocessing.get_context("spawn")) as pool:
        kills = {index: pool.submit(run_kill, kill_of(SEED, index)) for index in KILLS}
        commands = {index: pool.submit(run_cli_kill, cli_kills(SEED)[index]) for index in CLI_KILLS}
        yield Slice({index: pool.submit(run_fault, chosen[index]) for index in RUNS}, kills, commands)


def test_every_run_ends_as_it_may(runs: Slice) -> None:
    wrong = [future.result() for future in runs.faults.values() if future.result().ending == Ending.FAILURE]
    assert not wrong, "\n".join(f"{report.reproduce}: {report.complaints}" for report in wrong)


def test_every_fault_strikes_behind_the_first_parameter(runs: Slice) -> None:
    strikes: Counter[str] = Counter()
    for future in runs.faults.values():
        strikes.update(future.result().strikes)
    assert not [kind for kind in KINDS if not strikes[kind]]


def test_what_was_not_applied_is_named(runs: Slice) -> None:
    reports = [future.result() for future in runs.faults.values()]
    clear = [(pin, report) for report in reports for pin in report.pinned if pin.effect > CLEAR_SD]
    assert clear
    unnamed = [f"{r.reproduce}: {pin}; {r.says}" for pin, r in clear if pin.missed or not pin.named]
    assert not unnamed, "\n".join(unnamed)


def test_a_killed_service_takes_up_its_write(runs: Slice) -> None:
    for future in runs.kills.values():
        report = future.result()
        assert report.ending != Ending.FAILURE, f"{report.reproduce}: {report.complaints}"
        assert report.struck, f"{report.reproduce}: not killed, {report.journal}"


def test_a_killed_command_line_is_put_right_by_the_next_run(runs: Slice) -> None:
    for future in runs.commands.values():
        report = future.result()
        assert report.ending != Ending.FAILURE, f"{report.reproduce}: {report.complaints}; {report.says}"
