from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest

from mavcal.calib import report
from mavcal.calib.earth import EarthField
from mavcal.calib.errors import InvalidInputError, ProcedureError
from mavcal.calib.procedures.protocol import Done
from mavcal.calib.procedures.registry import PROCEDURES, create, replay, specification, validate_options
from mavcal.calib.procedures.spec import ProcedureContext
from mavcal.calib.recording import Event, Identity, Recording, Sensor
from mavcal.service.commands.calibrate import KINDS
from scripts.procedures import markdown

CONTEXT = ProcedureContext(
    identity=Identity(autopilot="other"), parameters={"X": 1.0}, earth_field=EarthField([20.5, 1.2, 44.0], norm_sd=0.15)
)


def least(kind):
    """What has to be given."""
    return {o.name: o.low for o in PROCEDURES[kind].options if o.default is None}


def test_the_kinds_are_those_of_the_jobs():
    assert list(PROCEDURES) == list(KINDS)
    assert specification("gyro-rest") is PROCEDURES["gyro"]


@pytest.mark.parametrize("kind", PROCEDURES)
def test_defaults_are_filled_in_and_lie_within_their_limits(kind):
    options = validate_options(kind, least(kind))
    assert options == {o.name: o.default for o in PROCEDURES[kind].options} | least(kind)
    assert validate_options(kind, dict(options)) == options


@pytest.mark.parametrize(
    ("kind", "options", "part"),
    [
        ("gyro", {"uncertainty": 5.0}, "between 0.001 and 1"),
        ("gyro", {"uncertainty": "much"}, "finite number deg/s"),
        ("gyro", {"uncertainty": True}, "finite number"),
        ("gyro", {"uncertainty": math.nan}, "finite number"),
        ("accel", {"speed": 1}, "its options are: uncertainty, obliques, patience"),
        ("compassmot", {}, "known are: gyro, accel, mag, thermal, level, accel-one-axis"),
    ],
)
def test_wrong_options_are_refused_in_one_sentence(kind, options, part):
    with pytest.raises(InvalidInputError, match=part):
        create(kind, options, CONTEXT)


def test_the_document_is_the_one_that_the_specifications_make():
    path = Path(__file__).resolve().parents[3] / "docs" / "procedures.md"
    assert path.read_text() == markdown(), "write docs/procedures.md again: scripts/procedures"


def test_every_specification_speaks_of_both_autopilots():
    for spec in PROCEDURES.values():
        assert set(spec.autopilots) == {"ardupilot", "px4"}
        assert all(h.writes and h.cannot_represent for h in spec.autopilots.values())


@pytest.mark.parametrize("kind", PROCEDURES)
def test_an_empty_recording_ends_with_a_cause_and_a_remedy(kind):
    outcome = replay(kind, least(kind), CONTEXT, Recording(()))
    assert "no" in outcome.cause
    assert outcome.remedy


@pytest.mark.parametrize("kind", PROCEDURES)
def test_a_restart_of_the_vehicle_ends_every_procedure(kind, bench):
    recording = bench().hold(4.0).record()
    again = bench(start=3.0).hold(30.0).record()
    both = Recording(
        tuple(
            type(a)(
                a.sensor, a.instance, np.append(a.t, b.t), np.vstack([a.values, b.values]), a.unit, a.stage, a.source
            )
            for a, b in zip(recording.channels, again.channels, strict=True)
        )
    )
    assert "restarted" in replay(kind, least(kind), CONTEXT, both).cause
    armed = Recording(again.channels, events=(Event(6.0, "armed", "armed"),))
    assert "armed" in replay(kind, least(kind), CONTEXT, armed).cause


def test_replayed_and_live_give_the_same_digits(bench, chunks):
    recording = bench().hold(20.0).record()
    live = create("gyro", {}, CONTEXT)
    for part in chunks(recording, np.arange(100.0, 120.0, 0.1)):
        live.feed(part)
    replayed = replay("gyro", {}, CONTEXT, recording)
    assert isinstance(replayed, Done)
    assert report.to_json(live.outcome.results[0]) == report.to_json(replayed.results[0])


def test_what_a_procedure_says_is_json(bench):
    procedure = create("gyro", {}, CONTEXT)
    for step in procedure.feed(bench().hold(20.0).record()):
        json.dumps(report.to_json(step), allow_nan=False)


def test_an_ended_or_dumb_procedure_takes_no_answers(bench):
    procedure = create("gyro", {}, CONTEXT)
    with pytest.raises(ProcedureError, match="accepts none"):
        procedure.answer("finish")
    procedure.feed(bench().hold(20.0).record())
    with pytest.raises(ProcedureError, match="has ended"):
        procedure.answer("finish")


def test_a_sensor_that_falls_silent_is_left_out(bench):
    recording = bench(gyros=bench().gyros * 2, accels=bench().accels * 2).hold(30.0).record()
    short = recording.with_channels(
        c.between(0.0, 104.0) if (c.sensor, c.instance) == (Sensor.GYRO, 1) else c for c in recording.channels
    )
    outcome = replay("gyro", {"uncertainty": 0.003}, CONTEXT, short)
    assert [f.instance for f in outcome.results] == [0]
    assert any("gyro 2 stopped" in w for w in outcome.results[0].warnings)


def nasty(name, recording, rng):
    """`recording` with every value spoilt in one way."""
    spoil = {
        "zeros": lambda v: np.zeros_like(v),
        "constant": lambda v: np.full_like(v, 3.25),
        "noise": lambda v: rng.normal(0.0, 12.0, v.shape),
        "spikes": lambda v: np.where(rng.random(v.shape) < 0.02, 900.0, v),
        "holes": lambda v: np.where(rng.random(v.shape) < 0.4, np.nan, v),
        "nothing": lambda v: np.full_like(v, np.nan),
        "huge": lambda v: v * 1e200,
        "tiny": lambda v: v * 1e-200,
    }[name]
    return recording.with_channels(dataclasses.replace(c, values=spoil(c.values)) for c in recording.channels)


@pytest.mark.sampled
@pytest.mark.parametrize("kind", PROCEDURES)
@pytest.mark.parametrize("spoilt", ["zeros", "constant", "noise", "spikes", "holes", "nothing", "huge", "tiny"])
def test_whatever_arrives_ends_in_a_result_or_in_one_sentence(kind, spoilt, bench):
    recording = bench(mags=bench().mags).hold(12.0).tumble(12.0, 50.0).record()
    outcome = replay(kind, least(kind), CONTEXT, nasty(spoilt, recording, np.random.default_rng(4)))
    if isinstance(outcome, Done):
        assert all(np.isfinite(f.values).all() for f in outcome.results)
    else:
        assert outcome.cause
        assert outcome.remedy


@pytest.mark.parametrize("kind", PROCEDURES)
def test_one_sample_of_everything_is_too_little(kind, bench):
    recording = bench().hold(1.0).record()
    one = recording.with_channels(c.take(slice(0, 1)) for c in recording.channels)
    assert replay(kind, least(kind), CONTEXT, one).cause


@pytest.mark.parametrize("kind", PROCEDURES)
def test_time_stamps_that_stand_still_do_no_harm(kind, bench):
    recording = bench().hold(6.0).record()
    stopped = recording.with_channels(
        dataclasses.replace(c, t=np.where(c.t > 103.0, 103.0, c.t)) for c in recording.channels
    )
    assert replay(kind, least(kind), CONTEXT, stopped)
