"""What is kept of rounds, when there is another one, and how a loop is told."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

import pytest

from mavcal.calib.airframe.answer import AirframePart, Domain, Quantity, Rollout
from mavcal.calib.gap.schema import (
    EffectEstimate,
    EffectEvidence,
    GapReport,
    GapVerdict,
    Inputs,
    MultipleTesting,
    NotTestable,
    ParameterEstimate,
    Shrink,
)
from mavcal.service.closing.errors import LogUnusable, OtherClosing, WorkFolderUnusable
from mavcal.service.closing.logs import Flown, find_log
from mavcal.service.closing.loop import ClosingResult
from mavcal.service.closing.report import page, round_lines, sentence
from mavcal.service.closing.rounds import Outcome, RoundResult, measured, outcome_of
from mavcal.service.closing.settings import SimSettings
from mavcal.service.closing.work import WorkFolder, read_json

START = SimSettings({"A": 1.0}, {"mass": 3.0})


def effect(
    name: str, value: float, patch: dict[str, Any], domain: Domain = Domain.AIRFRAME, p: float = 0.97
) -> EffectEstimate:
    evidence = EffectEvidence(80.0, 1, 1e-6, p, 1.0)
    parameter = ParameterEstimate("s", value, 0.01, (value - 0.02, value + 0.02), "1")
    return EffectEstimate(name, None, (), (parameter,), evidence, sim_patch=patch, domain=domain)


def report(*effects: EffectEstimate, verdict: GapVerdict = GapVerdict.EXPLAINED, error: float = 0.58) -> GapReport:
    rollout = (
        Rollout(0.2, Quantity.BODY_RATE, "rad/s", 2.0, 0.1, 0.05, 0.97, (0.9, 1.0)),
        Rollout(1.0, Quantity.VELOCITY, "m/s", error, 0.02, 0.01, 0.98, (0.95, 1.0)),
        Rollout(1.0, Quantity.VELOCITY, "m/s", 9.0, 0.02, 0.01, 0.98, None, part="doublets"),
    )
    inputs = Inputs(None, None, 400.0, 120.0, "none", 0.0, "", {}, "")
    shrink = Shrink(1.0, 0.03, 0.0, "noise", 0.97, (0.9, 1.0), nested=True)
    return GapReport(
        inputs, verdict, effects=effects, shrink=shrink, multiple_testing=MultipleTesting(9, 0.005),
        airframe=AirframePart(rollout=rollout),
    )  # fmt: skip


def one(number: int, *effects: EffectEstimate, settings: SimSettings = START, **other: Any) -> RoundResult:
    return measured(number, report(*effects, **other), settings, "log.bin", with_frame=True)


SCALE = effect("thrust_scale", -0.09, {"frame_json": {"hoverThrOut": 0.43}})
WIND = effect("wind", 3.0, {"SIM_WIND_SPD": 3.0}, Domain.ENVIRONMENT)


def test_a_round_holds_what_was_measured() -> None:
    result = one(0, SCALE, WIND)
    assert (result.velocity_error, result.closed, result.left) == (0.58, 0.97, ("thrust_scale",))
    assert result.to_set == SimSettings({"A": 1.0}, {"mass": 3.0, "hoverThrOut": 0.43})
    assert len(result.rollout) == 3


def test_without_a_frame_file_only_parameters_are_set() -> None:
    both = effect("motor_weak", 0.1, {"SIM_ENGINE_MUL": 0.96, "frame_json": {"hoverThrOut": 0.4}})
    result = measured(0, report(both), START, "log.bin", with_frame=False)
    assert result.to_set == SimSettings({"A": 1.0, "SIM_ENGINE_MUL": 0.96}, {"mass": 3.0})
    assert result.not_set == ("hoverThrOut",)


def rounds(*values: float) -> list[RoundResult]:
    return [one(k, effect("thrust_scale", v, {"frame_json": {"k": float(k)}})) for k, v in enumerate(values)]


@pytest.mark.parametrize(
    ("results", "expected"),
    [
        ([one(0, SCALE)], None),
        ([one(0)], Outcome.CLOSED),
        ([one(0, verdict=GapVerdict.NO_GAP)], Outcome.CLOSED),
        ([one(0, WIND)], Outcome.CLOSED),
        ([one(0, verdict=GapVerdict.UNKNOWN)], Outcome.NOTHING_TO_SET),
        ([one(0, verdict=GapVerdict.NOT_TESTABLE)], Outcome.NOT_TESTABLE),
        ([one(0, effect("inflow", 0.3, {}))], Outcome.NOTHING_TO_SET),
        (rounds(-0.2, -0.05), None),
        (rounds(-0.2, -0.19), Outcome.WITHOUT_EFFECT),
        (rounds(-0.2, -0.05, -0.01), Outcome.ROUNDS_USED),
    ],
)
def test_the_loop_ends_when_another_round_would_not_help(results: list[RoundResult], expected: Outcome | None) -> None:
    assert outcome_of(results, rounds=2) == expected


def test_a_folder_that_names_no_mission_flew_the_standard_one(tmp_path: Path) -> None:
    WorkFolder(tmp_path / "w", {"real": "a"}).keep_progress(0, "flying", 0.5, None)
    WorkFolder(tmp_path / "w", {"real": "a", "mission": "standard"})
    with pytest.raises(OtherClosing, match=r"\(mission differ\)"):
        WorkFolder(tmp_path / "w", {"real": "a", "mission": "log"})


def test_a_round_is_kept_and_found_again_with_its_settings_only(tmp_path: Path) -> None:
    folder = WorkFolder(tmp_path / "w", {"real": "a"})
    made = folder.begin_round(0)
    assert folder.flown(0, START) is None
    log = made / "logs" / "1.BIN"
    log.parent.mkdir()
    log.write_bytes(b"\xa3\x95")
    flown = Flown(log, ("at 4 times real time its log lacked 5 % of its samples",))
    folder.keep_flown(0, START, flown)
    result = measured(0, report(SCALE), START, "logs/1.BIN", with_frame=True)
    folder.keep(result, {"verdict": "explained"})

    again = WorkFolder(tmp_path / "w", {"real": "a"})
    assert again.flown(0, START) == flown
    assert again.result(0, START) == result
    other = SimSettings({"A": 2.0})
    assert again.flown(0, other) is None
    assert again.result(0, other) is None
    assert list(again.begin_round(0).iterdir()) == []


def test_a_file_that_was_cut_counts_as_none(tmp_path: Path) -> None:
    (tmp_path / "x.json").write_text('{"a": ')
    assert read_json(tmp_path / "x.json") is None
    assert read_json(tmp_path / "y.json") is None


@pytest.mark.parametrize("inside", ["", "deeper/still"])
def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path, inside: str) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(WorkFolderUnusable, match=r"file.* cannot be written: .*--work"):
        WorkFolder(tmp_path / "file" / inside if inside else tmp_path / "file", {"real": "a"})


def test_what_cannot_be_written_while_it_runs_is_said(tmp_path: Path) -> None:
    folder = WorkFolder(tmp_path / "w", {"real": "a"})
    (tmp_path / "w" / ".progress.json").symlink_to("/dev/full")
    with pytest.raises(WorkFolderUnusable, match=r"cannot be written: No space left on device.*--work"), folder.owned():
        folder.keep_progress(0, "flying", 0.5, None)


def test_two_loops_do_not_run_in_one_folder(tmp_path: Path) -> None:
    first, second = (WorkFolder(tmp_path / "w", {"real": "a"}) for _ in range(2))
    with first.owned(), pytest.raises(OtherClosing, match=r"another loop runs in .*w now.*--work"), second.owned():
        pass
    with second.owned():
        second.keep_progress(0, "flying", 0.5, None)


def test_another_flight_does_not_go_on_with_these_rounds(tmp_path: Path) -> None:
    folder = WorkFolder(tmp_path, {"real": "a", "command": "c"})
    folder.keep_progress(1, "flying (hover)", 0.5, 12.0)
    assert read_json(tmp_path / "progress.json") == {
        "schema": "closing/1",
        "of": {"real": "a", "command": "c"},
        "standing": {"round": 1, "doing": "flying (hover)", "share": 0.5, "left_s": 12.0},
    }
    WorkFolder(tmp_path, {"real": "a", "command": "c"})
    with pytest.raises(OtherClosing, match=r"real differ.*--work"):
        WorkFolder(tmp_path, {"real": "b", "command": "c"})


def test_the_newest_log_counts_and_an_eeprom_is_none(tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "eeprom.bin").write_bytes(b"\0" * 9)
    with pytest.raises(LogUnusable, match=r"there is eeprom\.bin"):
        find_log(tmp_path)
    for k, name in enumerate(("logs/00000001.BIN", "logs/00000002.BIN", "old.ulg")):
        (tmp_path / name).write_bytes(b"ULog" if name.endswith("ulg") else b"\xa3\x95\x80")
        os.utime(tmp_path / name, (100 * (k % 2), 100 * (k % 2)))
    assert find_log(tmp_path).name == "00000002.BIN"
    (tmp_path / "log.bin").write_bytes(b"\xa3\x95\x80")
    os.utime(tmp_path / "log.bin", (1, 1))
    assert find_log(tmp_path).name == "log.bin"


def test_a_loop_is_told_round_by_round() -> None:
    first, last = one(0, SCALE, WIND), one(1, verdict=GapVerdict.NO_GAP, error=0.012)
    result = ClosingResult(Outcome.CLOSED, (first, last))
    assert round_lines(first) == [
        "round 0: explained, error after 1 s 0.58 m/s, its effects close 97 % of the held-out gap",
        "  the real vehicle has 0.91 times the thrust for its mass (0.89 to 0.93), probability 97 %",
        "  wind, probability 97 %, of the day: not set",
        "  set hoverThrOut 0.43",
    ]
    assert sentence(result) == (
        "After 1 round nothing material is left. The error of the predicted velocity after 1 s went from 0.58 to "
        "0.012 m/s."
    )
    made = page(result, "The loop of <x>")
    assert "The loop of &lt;x&gt;" in made
    assert "hoverThrOut 0.43" in made
    assert "<td>body rate after " in made


def test_a_round_that_tested_nothing_says_why() -> None:
    why = NotTestable("airframe", "the flights have 4 and 6 motors", "two flights of one frame")
    found = dataclasses.replace(report(verdict=GapVerdict.NOT_TESTABLE), not_testable=(why,))
    result = measured(0, found, START, "log.bin", with_frame=True)
    assert round_lines(result)[1:] == [
        "  not tested: airframe: the flights have 4 and 6 motors; needed: two flights of one frame"
    ]
    assert result.as_json()["not_tested"] == list(result.not_tested)


def test_sensors_that_agree_close_nothing_where_the_airframe_was_not_compared() -> None:
    """A simulator with another frame: its sensors are alike, and nobody knows how it flies."""
    why = NotTestable("airframe", "the flights have 4 and 6 motors", "two flights of one frame")
    alike = dataclasses.replace(report(verdict=GapVerdict.NO_GAP), not_testable=(why,))
    result = measured(0, alike, START, "log.bin", with_frame=True)
    assert outcome_of([result], rounds=2) is Outcome.NOT_TESTABLE


def test_a_diagnosis_that_was_cut_short_closes_nothing() -> None:
    warnings = ("the limit of 20 s ended the diagnosis: allow more time",)
    cut = dataclasses.replace(report(verdict=GapVerdict.NOT_TESTABLE), left_out=("airframe",), warnings=warnings)
    result = measured(0, cut, START, "log.bin", with_frame=True)
    assert outcome_of([result], rounds=2) is Outcome.NOT_TESTABLE
    assert round_lines(result)[1:] == [f"  not tested: {warnings[0]}"]


def test_what_is_too_little_to_be_named_is_told_where_nothing_is() -> None:
    """A loop that ends with nothing left, and an error of the predicted flight that is none of the simulator's."""
    warnings = ("thrust_scale has a probability of 84 %, too little to name it",)
    alike = dataclasses.replace(report(verdict=GapVerdict.NO_GAP), warnings=warnings)
    assert round_lines(measured(0, alike, START, "log.bin", with_frame=True))[1:] == [f"  note: {warnings[0]}"]
    named = dataclasses.replace(report(SCALE), warnings=warnings)
    assert measured(0, named, START, "log.bin", with_frame=True).notes == ()


def test_a_loop_that_did_not_fly_again_says_what_is_left() -> None:
    result = ClosingResult(Outcome.NOTHING_TO_SET, (one(0, effect("inflow", 0.3, {})),))
    assert sentence(result) == "After 0 rounds what is left has no name, or cannot be set in this simulator (inflow)."
