"""What a child is asked for, by the data of its order alone."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest

from mavcal.calib.errors import FirmwareError, InvalidInputError
from mavcal.calib.gap.progress import DEFAULT_LIMIT_S, GapProgress, GapStage
from mavcal.service.children import tasks
from mavcal.service.children.tasks import diagnose, fit, inspect, series
from tests.clock import ManualClock
from tests.unit.gap.export.making import effect, report


@pytest.fixture
def told():
    return []


@pytest.fixture
def rest(tmp_path):
    """A part of an order: a table of a vehicle at rest, in g."""
    noise = 1e-3 * np.random.default_rng(1).normal(size=(600, 6))
    rows = [",".join(f"{v:.9f}" for v in (k / 50, *(noise[k] + [0, 0, -1, 0.01, 0.02, 0.03]))) for k in range(600)]
    file = tmp_path / "rest.csv"
    file.write_text("t,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z\n" + "\n".join(rows) + "\n")
    return {"path": str(file), "reading": {"unit_accel": "g"}}


def test_a_recording_is_inspected_with_its_reading(rest, told):
    found = inspect(rest, told.append)
    accel = next(c for c in found["channels"] if c["sensor"] == "accel")
    assert accel["mean"][2] == pytest.approx(-9.80665, rel=1e-3)
    assert told == ["reading"]
    json.dumps(found, allow_nan=False)


def test_a_fit_is_data_that_json_carries(rest, told):
    order = {**rest, "method": "gyro-rest", "options": {}, "origin": False}
    found = fit(order, told.append)
    [one] = found["fits"]
    assert (one["method"], one["sensor"], found["origin"]) == ("gyro-rest", "gyro", None)
    assert told == ["reading", "fitting"]
    json.dumps(found, allow_nan=False)


def test_a_fit_takes_its_options_and_refuses_others(rest, told):
    with pytest.raises(InvalidInputError, match="no option speed"):
        fit({**rest, "method": "gyro-rest", "options": {"speed": 1}, "origin": False}, told.append)
    with pytest.raises(FirmwareError, match="a table never does"):
        fit({**rest, "method": "gyro-rest", "options": {}, "origin": True}, told.append)


def test_a_series_is_thinned_for_a_picture(rest, told):
    found = series(rest, told.append)["series"]
    assert {one["sensor"] for one in found} >= {"accel", "gyro"}
    json.dumps(found, allow_nan=False)


@pytest.fixture
def asked(monkeypatch):
    """What the diagnosis is asked for; it finds an offset."""
    handed = {}

    def run(real, sim, nominal, **more):
        handed.update(real=real, sim=sim, nominal=nominal, **more)
        return report(effect("accel_bias", bias=(0.3, 0.0, -0.1)))

    monkeypatch.setattr("mavcal.calib.gap.run", run)
    return handed


def test_a_diagnosis_has_every_recording_in_its_role(rest, told, asked):
    bare = {"path": rest["path"]}
    order = {"real": {**rest, "sha256": "ab"}, "sim": bare, "nominal": [rest, bare], "limit_s": 5.0}
    found = diagnose(order, told.append)
    lengths = [abs(r.channels[0].values[:, 2].mean()) for r in (asked["real"], asked["sim"], *asked["nominal"])]
    assert lengths == pytest.approx([9.80665, 1.0, 9.80665, 1.0], rel=1e-2)  # each read as its own part says
    assert (asked["inputs"], asked["without"], asked["nested"], asked["pace"].limit_s) == (
        {"real": "ab"},
        (),
        True,
        5.0,
    )
    assert (found["report"]["verdict"], found["page"]) == ("explained", None)
    assert found["summary"].startswith("The real sensors differ")
    assert found["seconds"] >= 0.0
    assert told[:2] == ["reading", "diagnosing"]


def test_a_diagnosis_may_be_told_what_to_leave_out(rest, told, asked, monkeypatch):
    monkeypatch.setattr("mavcal.calib.gap_report.gap_to_html", lambda _, title: f"<h1>{title}</h1>")
    order = {"real": rest, "sim": None, "nominal": [], "without": ["gyro_bias"], "nested": False, "title": "a flight"}
    found = diagnose(order, told.append)
    assert (asked["sim"], asked["inputs"], asked["without"], asked["nested"]) == (None, None, ["gyro_bias"], False)
    assert asked["pace"].limit_s == DEFAULT_LIMIT_S
    assert found["page"] == "<h1>a flight</h1>"


def test_a_diagnosis_ends_by_the_clock_where_that_runs_out_first(rest, told, asked, monkeypatch):
    clock = ManualClock(100.0)
    monkeypatch.setattr(
        tasks, "time", SimpleNamespace(monotonic=clock, process_time=lambda: 3.0, perf_counter=lambda: 0.0)
    )
    order = {"real": rest, "sim": None, "nominal": [], "wall_s": 600.0}
    diagnose(order, told.append)
    pace = asked["pace"]
    assert (pace.limit_s, pace.now) == (DEFAULT_LIMIT_S, 0.0)
    clock.now += 300.0
    assert pace.now == pytest.approx(0.5 * DEFAULT_LIMIT_S)
    diagnose({**order, "limit_s": None}, told.append)
    assert asked["pace"].limit_s == 600.0


def test_of_the_steps_of_a_stage_a_few_a_second_are_told(monkeypatch, told):
    clock = ManualClock(100.0)
    monkeypatch.setattr(tasks, "time", SimpleNamespace(monotonic=clock))
    show = tasks._seldom(told.append)
    for share in (0.0, 0.1, 0.2):
        show(GapProgress(GapStage.REFERENCE, share, None))
    show(GapProgress(GapStage.SELECTION, 0.3, 9.0))  # another stage is told at once
    assert len(told) == 2
    clock.advance(tasks._EVERY_S)
    show(GapProgress(GapStage.REFERENCE, 0.4, None))
    assert len(told) == 3
    assert told[0] != told[2]
