"""``mavcal campaign``: a folder of logs on several executors, and vehicles."""

from __future__ import annotations

import csv
import json
import os
from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from mavcal.service.cli import cli
from mavcal.service.simvehicle import SimulatedVehicle

from .gap_tables import write_table
from .jobs_bench import SPEED, stored, zero_gyro_offsets


def logs(folder: Path, count: int = 5) -> Path:
    """Tables of a gyroscope at rest, and one file that is none."""
    (folder / "deep").mkdir(parents=True)
    for n in range(count):
        rows = "".join(f"{k / 50},0.01,0.02,0.0{k % (n + 5)}\n" for k in range(400))
        (folder / ("deep" if n % 2 else ".") / f"rest{n}.csv").write_text(f"t,gyro_x,gyro_y,gyro_z\n{rows}")
    (folder / "notes.csv").write_bytes(b"nothing\0\1")
    return folder


def run(*words: str | Path) -> tuple[int, Any, str]:
    done = CliRunner().invoke(cli, ["campaign", *map(str, words)], standalone_mode=False)
    if done.exception is not None:
        raise done.exception
    out = json.loads(done.stdout) if "--json" in words else done.stdout
    return int(done.return_value), out, done.stderr


def of_the_test() -> Executor:
    return ThreadPoolExecutor(2)


def check(folder: Path, data: Path, executor: str) -> dict[str, Any]:
    table = folder.parent / "outcome.csv"
    code, told, _ = run(
        *("fit", "gyro-rest", folder, "--executor", executor, "--data-dir", data, "--csv", table, "--json")
    )
    assert code == 1  # one of them is no log
    assert told["counts"] == {"done": 5, "failed": 1}
    by_subject = {item["subject"]: item for item in told["items"]}
    assert list(by_subject) == ["deep/rest1.csv", "deep/rest3.csv", "notes.csv", "rest0.csv", "rest2.csv", "rest4.csv"]
    assert by_subject["notes.csv"]["code"] == "invalid-input"
    assert str(folder) not in by_subject["notes.csv"]["text"]
    with table.open(newline="") as file:
        assert [row["outcome"] for row in csv.DictReader(file)] == [item["outcome"] for item in told["items"]]
    return dict(told)


@pytest.mark.long
@pytest.mark.parametrize("executor", ["threads:2", "processes:2", f"{__name__}:of_the_test"])
def test_a_folder_is_fitted_on_any_executor_with_the_same_digits(tmp_path: Path, executor: str) -> None:
    folder, data = logs(tmp_path / "logs"), tmp_path / "data"
    told = check(folder, data, executor)
    code, found, _ = run("items", told["id"], "--data-dir", data, "--json")
    assert code == 0
    alone = CliRunner().invoke(cli, ["fit", "gyro-rest", str(folder / "rest0.csv"), "--json"], standalone_mode=False)
    (item,) = (i for i in found["items"] if i["subject"] == "rest0.csv")
    assert item["result"]["fits"] == [json.loads(alone.stdout)]
    assert len(item["result"]["sha256"]) == 64
    code, text, _ = run("items", told["id"], "--data-dir", data, "--outcome", "failed")
    assert "notes.csv" in text
    assert "rest0.csv" not in text


@pytest.mark.long
def test_a_folder_is_fitted_by_dask(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="dask.distributed is not installed (mavcal[dask])")
    os.environ.setdefault("DASK_DISTRIBUTED__ADMIN__TICK__LIMIT", "1h")  # it warns of every busy machine
    options = {"n_workers": 2, "threads_per_worker": 1, "host": "127.0.0.1", "dashboard_address": None}
    with distributed.LocalCluster(**options) as cluster:
        check(logs(tmp_path / "logs"), tmp_path / "data", f"dask:{cluster.scheduler_address}")


@pytest.mark.long
def test_gaps_of_a_folder(tmp_path: Path) -> None:
    folder, data = tmp_path / "logs", tmp_path / "data"
    folder.mkdir()
    write_table(folder / "real.csv", seconds=20.0)
    code, told, _ = run("gap", folder, "--executor", "threads:1", "--data-dir", data, "--json")
    assert code == (0 if told["items"][0]["outcome"] == "done" else 1)
    assert told["items"][0]["code"]
    code, found, _ = run("items", told["id"], "--data-dir", data, "--json")
    assert found["items"][0]["result"]["documents"] == ["item-1-report.json", "item-1-report.html"]


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("fit", "gyro-rest", "none"), "there is no folder none"),
        (("fit", "none", "."), "there is no method 'none'"),
        (("fit", "gyro-rest", ".", "--glob", "*.none"), "there is no file like"),
        (("fit", "gyro-rest", ".", "--executor", "none"), "names no executor"),
        (("items", "none"), "there is no"),
        (("resume", "none"), "there is no"),
        (("calibrate", "gyro", "--connect", "udpin:127.0.0.1:0", "--reboot"), "--apply"),
    ],
)
def test_what_makes_no_sense_is_refused_in_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], why: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.csv").write_text("t\n0\n")
    with pytest.raises(Exception, match=why):
        run(*words, "--data-dir", tmp_path / "data")


@pytest.mark.long
def test_vehicles_on_several_endpoints(tmp_path: Path) -> None:
    data = tmp_path / "data"
    one = SimulatedVehicle("ardupilot", speed=SPEED, seed=61, config={"thermal": False})
    two = SimulatedVehicle("ardupilot", speed=SPEED, seed=62, config={"thermal": False})
    with one, two:
        connect = ("--connect", one.url, "--connect", two.url, "--data-dir", data, "--json")
        code, told, _ = run("preflight", *connect)
        assert sum(told["counts"].values()) == 2
        assert code == (0 if set(told["counts"]) == {"done"} else 3 if set(told["counts"]) <= {"done", "warned"} else 1)
        for sim in (one, two):
            zero_gyro_offsets(sim)
        before = stored(one), stored(two)
        options = ("--option", "uncertainty=0.02")
        code, told, _ = run("calibrate", "gyro", *options, *connect)
        assert (code, told["counts"]) == (0, {"review": 2})
        assert (stored(one), stored(two)) == before
        silent = ("--connect", "udpin:127.0.0.1:0", "--wait", "6")
        code, told, said = run("calibrate", "gyro", *options, *connect, *silent, "--apply")
        assert (code, told["counts"]) == (1, {"done": 2, "skipped": 1})
        assert "no vehicle was heard on udpin:127.0.0.1:0" in said
        assert stored(one) != before[0]
        assert stored(two) != before[1]
