from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.flight.rest import Known, Phase, ground, rests
from mavcal.calib.methods.source import Source
from mavcal.calib.recording import Channel, Event, Identity, Recording, Sensor, Stage
from tests.unit.flight.made import Unit, log


def calm(**changes):
    """A flight in which nothing shakes: to stillness alone it is one long rest."""
    recording = log([Unit()], (30.0, 31.0), seed=1, **changes)
    channels = [
        dataclasses.replace(c, values=np.where((c.t > 60.0)[:, None] & (c.t < 100.0)[:, None], c.values[:1], c.values))
        if c.sensor in (Sensor.ACCEL, Sensor.GYRO)
        else c
        for c in recording.channels
    ]
    return recording.with_channels(channels)


def test_rests_lie_before_and_after_the_flight_and_not_in_a_calm_hover():
    first, last = rests(calm())
    assert (first.phase, last.phase) == (Phase.BEFORE, Phase.AFTER)
    assert first.end <= 60.0 < 100.0 < last.start
    assert first.duration > 58.0
    assert last.duration > 18.0
    assert {first.known, last.known} == {Known.ARMING}


def test_a_hover_passes_for_rest_where_nothing_tells_of_the_motors():
    found = rests(calm(events=False))
    assert {r.known for r in found} == {Known.STILLNESS}
    assert sum(r.duration for r in found if r.start >= 60.0 and r.end <= 100.5) > 30.0


def test_motor_outputs_tell_where_arming_was_not_logged():
    recording = calm(events=False)
    t = np.arange(0.0, 120.0, 0.1)
    spinning = np.where((t > 59.95) & (t < 99.95), 0.4, 0.0)
    motors = Channel(Sensor.MOTOR, 0, t, np.column_stack([spinning, spinning]), "1", Stage.RAW, "RCOU")
    with_motors = recording.with_channels([*recording.channels, motors])
    first, last = rests(with_motors)
    assert first.known == Known.MOTORS
    assert first.end <= 60.0 < 100.0 < last.start
    assert ground(with_motors).running[0].start == pytest.approx(59.9, abs=0.11)


def test_a_log_that_begins_armed_has_flown_from_its_first_sample():
    recording = dataclasses.replace(calm(), events=(Event(100.0, "disarmed", ""),))
    (only,) = rests(recording)
    assert only.phase == Phase.AFTER
    assert only.start > 100.0


def test_two_flights_have_a_rest_between_them():
    said = [Event(t, k, "") for t, k in ((20.0, "armed"), (30.0, "disarmed"), (60.0, "armed"), (100.0, "disarmed"))]
    recording = dataclasses.replace(calm(), events=tuple(said))
    assert [r.phase for r in rests(recording)] == [Phase.BEFORE, Phase.BETWEEN, Phase.AFTER]


def test_nothing_to_judge_by_is_said():
    assert ground(Recording(())).off == ()
    with pytest.raises(InvalidInputError, match="neither accelerometer nor gyroscope"):
        rests(Recording(()))


def test_methods_of_a_vehicles_log_do_not_take_a_hover_for_rest():
    recording = dataclasses.replace(calm(), events=(Event(20.0, "armed", ""), Event(100.0, "disarmed", "")))
    stills = Source(recording, None, recording).stills(0, held=False)
    assert [(s.start < 20.0 and s.end <= 20.0) or s.start >= 100.5 for s in stills] == [True] * len(stills)
    assert sum(s.duration for s in stills) > 38.0
    table = dataclasses.replace(recording, identity=Identity())
    assert sum(s.duration for s in Source(table, None, table).stills(0, held=False)) > 100.0
