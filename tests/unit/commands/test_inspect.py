from __future__ import annotations

import json
from dataclasses import replace

import click
import numpy as np
import pytest
from click.testing import CliRunner

from mavcal.calib.errors import UnreadableError
from mavcal.calib.health.report import health
from mavcal.calib.recording import Channel, Recording, Segment, Sensor, Stage
from mavcal.service.commands.inspect import command, inspection_lines

T = np.arange(500) / 50.0
ACCEL = Channel(Sensor.ACCEL, 0, T, np.tile([0.0, 0.0, -9.8], (500, 1)), "m/s2", Stage.RAW, "IMU")
FLIGHT = Recording((ACCEL,), source="a.bin")
BENCH = replace(FLIGHT, segments=(Segment("x-up", 0.0, 1.0),))


@pytest.fixture
def inspected(tmp_path, monkeypatch):
    """Runs the command on recordings by name of their file; an error stands for one that cannot be read."""

    def run(recordings, *arguments):
        def read(file, **_):
            found = recordings[file.name]
            if isinstance(found, Exception):
                raise found
            return found

        monkeypatch.setattr("mavcal.calib.logs.read", read)
        for name in recordings:
            (tmp_path / name).touch()
        monkeypatch.chdir(tmp_path)
        result = CliRunner().invoke(command, arguments, standalone_mode=False)
        if result.exception is not None:
            raise result.exception
        return result.stdout.splitlines()

    return run


def test_a_table_has_a_line_a_log_and_one_that_cannot_be_read_is_a_line_too(inspected):
    logs = {"flight.bin": FLIGHT, "b.csv": BENCH, "broken.ulg": UnreadableError("it has no header")}
    lines = inspected(logs, "--table", *logs, "gone.bin")
    heads = [line.split() for line in lines]
    assert [head[0] for head in heads] == [*logs, "gone.bin"]
    assert [head[1] for head in heads[1:]] == ["bench", "unreadable", "unreadable"]
    assert lines[2].endswith("it has no header")
    assert lines[3].endswith("there is no file gone.bin")
    assert heads[0][1:] == f"{health(FLIGHT).verdict.value} {health(FLIGHT).summary}".replace("_", " ").split()
    [line] = inspected(logs, "--table", "--json", "flight.bin", "broken.ulg")
    told = json.loads(line)["logs"]
    assert [row["verdict"] for row in told] == [health(FLIGHT).verdict.value, "unreadable"]


def test_several_logs_are_a_table_or_a_mistake(inspected):
    with pytest.raises(click.UsageError, match="one FILE at a time"):
        inspected({"a.bin": FLIGHT, "b.bin": FLIGHT}, "a.bin", "b.bin")


def test_a_page_is_written_of_a_flight_and_not_of_a_bench(inspected, tmp_path):
    inspected({"a.bin": FLIGHT}, "a.bin", "--report", "out.html")
    assert "Sensor health of a.bin" in (tmp_path / "out.html").read_text()
    with pytest.raises(click.UsageError, match="--report is for flights"):
        inspected({"b.csv": BENCH}, "b.csv", "--report", "bench.html")
    assert not (tmp_path / "bench.html").exists()


def test_a_channel_is_told_with_rate_mean_and_length(inspected):
    lines = inspected({"b.csv": BENCH}, "b.csv", "--all")
    [channel] = [line.split() for line in lines if line.startswith("  accel[0]")]
    assert channel[1:4] == ["IMU", "raw", "500"]
    assert " ".join(channel[4:]) == "50.00 Hz mean 0 0 -9.8, length 9.8 m/s2"
    assert "  0 parameters, 0 changes, 0 events" in lines


def test_a_flight_is_told_with_its_health_and_a_bench_without(inspected):
    flight, bench = (inspected({"a.bin": one}, "a.bin") for one in (FLIGHT, BENCH))
    assert flight[1] == health(FLIGHT).summary
    assert health(FLIGHT).summary not in bench


def test_a_recording_of_a_bench_has_no_health(inspected):
    assert json.loads(inspected({"b.csv": BENCH}, "b.csv", "--json")[0])["health"] is None
    assert json.loads(inspected({"a.bin": FLIGHT}, "a.bin", "--json")[0])["health"] is not None


def finding(verdict, text):
    return {"verdict": verdict, "text": text}


BARE = {
    "source": "a.bin",
    "duration": 20.0,
    "identity": {"autopilot": "px4", "uid": ""},
    "health": None,
    "channels": [],
    "armed": [],
    "parameters": {"count": 0, "changes": []},
    "events": [],
    "warnings": [],
    "flight": None,
    "next": [],
}


def health_of(*sensors, action="", lacks=()):
    return {"summary": "All in all.", "action": action, "sensors": sensors, "lacks": lacks}


GOOD = {"verdict": "ok", "name": "gyro 1", "findings": [finding("ok", "It is quiet."), finding("ok", "It moves.")]}


def test_a_sensor_is_told_with_what_speaks_against_it_or_the_first_thing_found():
    bad = {
        "verdict": "cannot_say",
        "name": "accel 2",
        "findings": [finding("ok", "fine"), finding("suspicious", "It clips."), finding("faulty", "Dead.")],
    }
    document = {**BARE, "health": health_of(GOOD, bad, lacks=["a compass"])}
    lines = [" ".join(line.split()) for line in inspection_lines(document, whole=True)]
    summary, good, first, second, lacks, end = lines[1:7]
    assert summary == document["health"]["summary"]
    assert good.startswith("ok gyro")
    assert good.endswith(GOOD["findings"][0]["text"])
    assert "accel 2" in first
    assert first.endswith("It clips.")
    assert second == "Dead."
    assert lacks.endswith("a compass")
    assert end == ""
    short = [" ".join(line.split()) for line in inspection_lines(document)]
    assert short[2:4] == [first, second]
    assert short[4] in good
    assert GOOD["findings"][0]["text"] not in short[4]


def test_the_next_action_follows_the_summary():
    assert inspection_lines({**BARE, "health": health_of(action="Look.")})[2] == "Next: Look."


def test_a_long_log_is_told_in_forty_lines_of_eighty_columns_and_says_what_is_left():
    text = "reads 9.31 ± 0.02 m/s2 along the vertical in flight; gravity is 9.81, and it was never calibrated here"
    bad = {"verdict": "faulty", "name": "accel 2", "findings": [finding("faulty", text)] * 9}
    channel = {"sensor": "accel", "instance": 0, "source": "IMU", "stage": "raw", "samples": 5, "rate": 400.0}
    channel |= {"mean": [0.0, 0.0, -9.8], "norm": None, "unit": "m/s2"}
    document = {**BARE, "health": health_of(*[bad] * 5, GOOD), "channels": [channel] * 30, "warnings": [text] * 20}
    short, whole = inspection_lines(document), inspection_lines(document, whole=True)
    assert len(short) <= 40
    assert len(whole) > 100
    assert max(len(line) for line in [*short, *whole]) <= 80
    assert "more lines" in short[-1]
    assert "--all" in short[-1]
    assert not any(line.endswith("-") for line in whole)


def test_a_flight_is_told_with_its_rests_limits_and_next_steps():
    limit = {"warn": 0.5, "fail": 1.0, "unit": "deg/s"}
    item = {"verdict": "warn", "name": "bias", "subject": "gyro 1", "text": "It drifts.", "limit": limit}
    flight = {
        "verdict": "warn",
        "motors_known_by": "throttle",
        "rests": [{"start": 0.0, "end": 4.0}, {"start": 10.0, "end": 16.0}],
        "flown": [{"start": 4.0, "end": 10.0}],
        "items": [item, {**item, "limit": None}, {**item, "limit": {"warn": 0.02, "fail": 0.1, "unit": "1"}}],
    }
    step = {"command": "mavcal fit gyro-rest", "method": "gyro-rest", "reason": "It rests."}
    steps = [{**step, "worthwhile": worth} for worth in (True, False)]
    lines = [" ".join(line.split()) for line in inspection_lines({**BARE, "flight": flight, "next": steps}, whole=True)]
    head, rate, bare, share, worthwhile, useless = lines[2:]
    assert all(token in head for token in (" warn;", "2 rests", "10 s,", " 6 s", "throttle"))
    assert all(line.startswith(bare) for line in (rate, share))
    assert all(token in bare for token in ("warn ", "bias", "gyro 1", item["text"]))
    assert "0.5 and" in rate
    assert " 1 deg/s" in rate
    assert " 2 and" in share
    assert " 10 %" in share
    assert worthwhile.startswith("next:")
    assert step["command"] in worthwhile
    assert useless.startswith("not:")
    assert step["command"] not in useless
    assert all(line.endswith(step["reason"]) for line in (worthwhile, useless))
