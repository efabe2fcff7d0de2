from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from bench.same import Tolerance, answers_in, compared, differences, main

REPORT = {
    "verdict": "explained",
    "effects": [{"id": "accel_bias", "params": [{"value": 0.25, "se": 1e-3}]}, {"id": "gyro_bias", "params": []}],
    "shrink": None,
}


def changed(**values: Any) -> dict[str, Any]:
    return {**json.loads(json.dumps(REPORT)), **values}


def written(folder: Path, **answers: Any) -> Path:
    folder.mkdir(exist_ok=True)
    for name, answer in answers.items():
        (folder / f"{name}.json").write_text(json.dumps(answer), encoding="utf-8")
    return folder


def places(before: Any, after: Any) -> list[str]:
    return [found.place for found in differences(before, after)]


def test_nothing_differs_in_what_is_equal() -> None:
    assert places(REPORT, changed()) == []


def test_every_kind_of_difference_has_its_place() -> None:
    other = changed(verdict="unknown")
    other["effects"][0]["params"][0]["value"] = 0.5
    assert places(REPORT, other) == ["verdict", "effects[0].params[0].value"]
    assert places(REPORT, changed(shrink={"closed": 1.0})) == ["shrink"]
    assert places({"a": 1}, {"a": 1, "b": 2}) == ["b"]
    assert places({"a": 1, "b": 2}, {"a": 1}) == ["b"]
    assert places([1, 2], [1, 2, 3]) == [""]
    assert places({"a": 1}, {"a": True}) == ["a"]
    assert places({"a": 1}, {"a": "1"}) == ["a"]


def test_an_entry_that_is_missing_hides_no_other_difference() -> None:
    assert places({"a": [1.0, 2.0]}, {"a": [1.5]}) == ["a", "a[0]"]


def test_one_and_one_point_zero_are_the_same_number() -> None:
    assert places({"a": 1}, {"a": 1.0}) == []


def test_what_is_no_number_is_equal_to_itself_only() -> None:
    assert places([math.nan, math.inf], [math.nan, math.inf]) == []
    assert places([math.nan, math.inf, 1.0], [1.0, -math.inf, math.inf]) == ["[0]", "[1]", "[2]"]
    one = compared("a", [1.0], [math.nan], Tolerance(relative=1.0, absolute=1e9))
    assert not one.same


def test_times_and_versions_are_no_difference() -> None:
    assert places({"seconds": 1.0, "in": {"diagnoser_sha256": "a"}}, {"seconds": 2.0, "in": {}}) == []


@pytest.mark.parametrize(
    ("tolerance", "same"),
    [
        (Tolerance(), False),
        (Tolerance(relative=1e-10), False),
        (Tolerance(relative=1e-8), True),
        (Tolerance(absolute=1e-7), True),
        (Tolerance(absolute=1e-9), False),
    ],
)
def test_the_tolerance_is_relative_or_absolute(tolerance: Tolerance, same: bool) -> None:
    assert compared("a", {"x": 10.0}, {"x": 10.0 + 5e-8}, tolerance).same is same


def test_of_what_is_within_the_tolerance_the_largest_is_kept() -> None:
    one = compared("a", [1.0, 1.0, 5.0], [1.0 + 1e-9, 1.0 + 3e-9, 5.0], Tolerance(relative=1e-6))
    assert one.within is not None
    assert one.within.place == "[1]"


def test_answers_are_those_of_the_folder_and_below_it(tmp_path: Path) -> None:
    written(tmp_path, a={"x": 1})
    written(tmp_path / "deep", b={"x": 2})
    (tmp_path / "rows.jsonl").write_text('{"x": 3}\n{"x": 4}\n', encoding="utf-8")
    (tmp_path / "profile.txt").write_text("no answer", encoding="utf-8")
    assert {name: answer["x"] for name, answer in answers_in(tmp_path).items()} == {
        "a.json": 1,
        "deep/b.json": 2,
        "rows.jsonl:1": 3,
        "rows.jsonl:2": 4,
    }


def test_equal_folders_exit_with_zero(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before, after = written(tmp_path / "before", a=REPORT, b={}), written(tmp_path / "after", a=REPORT, b={})
    assert main([str(before), str(after)]) == 0
    assert "2 of 2 answers are the same" in capsys.readouterr().out


def test_a_difference_is_printed_with_its_place_and_exits_with_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before, after = written(tmp_path / "before", a=REPORT), written(tmp_path / "after", a=changed(verdict="no_gap"))
    assert main([str(before), str(after)]) == 1
    out = capsys.readouterr().out
    assert 'verdict: "explained" -> "no_gap"' in out
    assert "0 of 1 answers are the same" in out


def test_an_answer_that_one_folder_lacks_is_a_difference(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before, after = written(tmp_path / "before", a=REPORT, b={}), written(tmp_path / "after", a=REPORT)
    assert main([str(before), str(after)]) == 1
    assert "b.json: only in" in capsys.readouterr().out


def test_a_folder_without_an_answer_and_a_damaged_answer_are_wrong_use(tmp_path: Path) -> None:
    good, empty = written(tmp_path / "good", a={}), written(tmp_path / "empty")
    with pytest.raises(SystemExit, match="2"):
        main([str(good), str(empty)])
    (empty / "a.json").write_text("{", encoding="utf-8")
    with pytest.raises(SystemExit, match="2"):
        main([str(good), str(empty)])
