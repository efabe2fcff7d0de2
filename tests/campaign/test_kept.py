"""A campaign made in parts: what has ended is not made again, and a line cut short by a kill is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from bench.campaign.crossed.kept import Kept, commit_of, keep, kept_runs
from bench.campaign.crossed.report import CrossReport
from bench.campaign.judge import Ending

RUN = CrossReport(3, 1, "clean", "nothing", "arms", "px4", "gyro", Ending.VERIFIED, ("none",), {"network": True})
STORE = "sqlite"


def test_runs_of_one_seed_and_store_come_back_by_number(tmp_path: Path) -> None:
    path = tmp_path / "kept.jsonl"
    assert kept_runs(path, 1, STORE) == ()
    first, second = Kept("abc", STORE, RUN), Kept("abd+", STORE, replace(RUN, index=1, doubts=2))
    for one in (first, second, Kept("abc", STORE, replace(RUN, seed=2)), Kept("abc", "other", replace(RUN, index=9))):
        keep(path, one)
    assert kept_runs(path, 1, STORE) == (second, first)


def test_a_line_that_was_cut_short_counts_as_not_made(tmp_path: Path) -> None:
    path = tmp_path / "kept.jsonl"
    keep(path, Kept("abc", STORE, RUN))
    keep(path, Kept("abc", STORE, replace(RUN, index=4)))
    path.write_text(path.read_text()[:-20])
    assert [kept.report.index for kept in kept_runs(path, 1, STORE)] == [3]
    keep(path, Kept("abc", STORE, replace(RUN, index=4)))
    assert [kept.report.index for kept in kept_runs(path, 1, STORE)] == [3, 4]


def test_outside_of_git_there_is_no_commit(tmp_path: Path) -> None:
    assert commit_of(tmp_path) == ""
