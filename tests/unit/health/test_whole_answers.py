"""Sentences of one answer do not contradict each other: whole answers of every kind of log are read for such pairs."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavcal.calib import logs
from mavcal.calib.errors import CalibError
from mavcal.calib.methods.overview import overview
from mavcal.calib.recording import Event, Identity, Oddity, OddSamples, Recording, Sensor
from tests.unit.health.made import flight
from tests.unit.health.test_missing_data import streamed

CASES = Path(__file__).resolve().parents[4] / "shared" / "data" / "reported_cases"
KNOWN = sorted(p for p in CASES.rglob("*") if p.suffix in {".bin", ".tlog", ".csv", ".npz"}) if CASES.is_dir() else []
WORDS = {"accel": "accelerometer", "gyro": "gyroscope", "mag": "compass"}

EXCLUDING = (
    (r"in flight", r"never (flew|drove|was under way)"),
    (r"(flew|in flight|the flight saw)", r"(drove|while it drove|never drove)"),
    (r"\bat rest[:, ]", r"too slow to tell a rest"),
    (r"LOG_BITMASK|LOG_DISARMED|SDLOG_MODE|INS_LOG_BAT", r"SET_MESSAGE_INTERVAL"),
    (r"hardly changes", r"moved by"),
    (r"no rest of", r"\d s at rest; most autopilots"),
    (r"the motors never ran", r"mag-motor .*moved by"),
    (r"nothing to calibrate", r"mavcal fit [a-z-]+ .*worthwhile"),
)
"""Pairs that no answer may hold both of."""


def texts(document: Any) -> Iterator[str]:
    if isinstance(document, dict):
        for key, value in document.items():
            if key not in ("limit", "command", "source"):
                yield from texts(value)
    elif isinstance(document, (list, tuple)):
        for value in document:
            yield from texts(value)
    elif isinstance(document, str):
        yield document


def contradictions(document: dict[str, Any]) -> list[str]:
    """What of an answer cannot all be true."""
    said = list(texts(document))
    found = [
        f"{a!r} beside {b!r}"
        for first, second in EXCLUDING
        for a in said
        for b in said
        if re.search(first, a) and re.search(second, b)
    ]
    for text in said:
        for part, whole in re.findall(r"(\d+) of (?:its |the )?(\d+) (?:[a-z']+ )*samples", text):
            found += [text] if int(part) > int(whole) else []
        found += [text] if re.search(r"\b(nan|inf)\b|\b0 ?% of its samples", text) else []
    return [*found, *_of_health(document), *_of_steps(document)]


def _of_health(document: dict[str, Any]) -> Iterator[str]:
    health = document["health"]
    if health is None:
        return
    verdicts = [sensor["verdict"] for sensor in health["sensors"]]
    count = verdicts.count("ok")
    if (f"{count} of {len(verdicts)} sensors ok" in health["summary"]) != (count > 0):
        yield f"{health['summary']!r} of {verdicts}"
    if bool(health["action"]) != any(v in ("faulty", "suspicious") for v in verdicts):
        yield f"action {health['action']!r} of {verdicts}"
    for sensor in health["sensors"]:
        told = [f["text"] for f in sensor["findings"]]
        own = [re.sub(r"\([^()]*\)", "", t) for t in told]  # in brackets: why another one is no witness
        dead = [t for t in own if "throughout" in t or "never heard" in t or "in all of its" in t]
        if dead and len(told) > len(dead):
            yield f"{sensor['name']}: {told}"
        if len(set(told)) < len(told):
            yield f"{sensor['name']} says a thing twice: {told}"
        if sensor["verdict"] == "ok" and any(f["verdict"] in ("faulty", "suspicious") for f in sensor["findings"]):
            yield f"{sensor['name']} is ok: {told}"
        if any("no calibration cures it" in t for t in told) and sensor["findings"][0]["action"].startswith(
            "Calibrate"
        ):
            yield f"{sensor['name']}: {told}"


def _of_steps(document: dict[str, Any]) -> Iterator[str]:
    """No fit is proposed for a sensor that delivers nothing."""
    if document["health"] is None or document["next"] is None:
        return
    for sensor, method in (("mag", "mag-"), ("gyro", "gyro-"), ("accel", "accel-")):
        own = [s for s in document["health"]["sensors"] if s["sensor"] == sensor]
        dead = [s for s in own if any("throughout" in f["text"] for f in s["findings"])]
        if own and len(dead) == len(own):
            yield from (str(s) for s in document["next"] if s["worthwhile"] and s["method"].startswith(method))


def changed(sensor: Sensor, instance: int, change: Callable[[Any], Any]) -> Recording:
    made = flight(1)
    return made.with_channels(
        dataclasses.replace(c, values=change(c.values)) if (c.sensor, c.instance) == (sensor, instance) else c
        for c in made.channels
    )


def of_kind(kind: int, recording: Recording) -> Recording:
    return dataclasses.replace(recording, identity=Identity("ardupilot", kind))


MADE = {
    "a copter": of_kind(2, flight(1)),
    "a rover": of_kind(10, flight(2)),
    "a sub that lay still": dataclasses.replace(of_kind(12, flight(3).between(0.0, 19.0)), events=()),
    "an unknown vehicle": flight(4),
    "one unit": flight(5, units=1),
    "slow telemetry": streamed(),
    "telemetry": streamed(rate=25.0),
    "telemetry of a PX4": streamed(autopilot="px4"),
    "dead compass": changed(Sensor.MAG, 0, np.zeros_like),
    "dead gyroscope": changed(Sensor.GYRO, 1, np.zeros_like),
    "constant accelerometer": changed(Sensor.ACCEL, 0, lambda v: np.tile(v[3], (len(v), 1))),
    "accelerometer off": changed(Sensor.ACCEL, 0, lambda v: v + np.array([0.0, 0.0, 1.5])),
    "shaken": changed(Sensor.ACCEL, 0, lambda v: v + 30.0 * np.random.default_rng(1).normal(size=v.shape)),
    "distrusted": dataclasses.replace(
        flight(6),
        events=(*flight(6).events, Event(0.0, "damage", "", OddSamples(Oddity.UNHEALTHY, Sensor.GYRO, 0, 9, 9))),
    ),
}


@pytest.mark.sampled
@pytest.mark.parametrize("name", MADE)
def test_no_sentence_of_a_made_answer_contradicts_another(name):
    assert contradictions(overview(MADE[name])) == []


@pytest.mark.sampled
@pytest.mark.shared
@pytest.mark.parametrize("path", KNOWN, ids=lambda p: f"{p.parent.name}-{p.name}")
def test_no_sentence_of_a_known_answer_contradicts_another(path):
    try:
        recording = logs.read(path)
    except CalibError:
        return  # refused by name (tests of its reader)
    if recording.channels and recording.identity.autopilot is None and path.suffix == ".csv":
        return  # a table of a bench
    assert contradictions(overview(recording)) == []


def test_the_reading_finds_what_was_once_said():
    said = {
        "health": None,
        "next": None,
        "warnings": [
            "reads 9.8 along the vertical in flight",
            "the vehicle never flew",
            "departs by 331 % of it, and 0% of its samples by more than their noise",
            "14117 of 14100 samples",
        ],
    }
    assert len(contradictions(said)) == 3
