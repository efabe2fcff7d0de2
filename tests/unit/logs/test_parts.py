from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.logs.parts import of_parts
from mavcal.calib.recording import (
    Channel,
    Event,
    Identity,
    ParameterEntry,
    ParameterTimeline,
    Recording,
    Segment,
    Sensor,
    Stage,
)


def part(value, n=20, t0=100.0, unit="m/s2"):
    t = t0 + np.arange(n) / 50.0
    return Recording((Channel(Sensor.ACCEL, 0, t, np.full((n, 3), value), unit, Stage.RAW, "table"),))


def test_every_part_is_a_segment_and_keeps_its_samples():
    whole = of_parts([("x-up", part(1.0)), (" y-up ", part(2.0, n=5)), ("z-up", part(3.0, t0=-7.0))])
    assert [s.label for s in whole.segments] == ["x-up", "y-up", "z-up"]
    accel = whole.channel(Sensor.ACCEL)
    assert len(accel) == 45
    assert (np.diff(accel.t) > 0).all()
    for segment, value, n in zip(whole.segments, (1.0, 2.0, 3.0), (20, 5, 20), strict=True):
        inside = accel.between(segment.start, segment.end)
        assert len(inside) == n
        assert (inside.values == value).all()


def test_events_and_parameters_come_along_and_old_segments_do_not():
    timed = dataclasses.replace(
        part(1.0),
        events=(Event(100.1, "text", "hello"),),
        segments=(Segment("old", 100.0, 100.2),),
        parameters=ParameterTimeline((ParameterEntry(100.0, "A", 1.0),), end_observed=True),
    )
    whole = of_parts([("a", part(0.0)), ("b", timed)])
    (event,) = whole.events
    assert whole.segments[1].start < event.t < whole.segments[1].end
    assert [s.label for s in whole.segments] == ["a", "b"]
    assert whole.parameters.entries[0].t == pytest.approx(whole.segments[1].start)
    assert whole.parameters.end_observed


@pytest.mark.parametrize(
    ("parts", "word"),
    [
        ([], "no part"),
        ([(" ", part(1.0))], "no label"),
        ([("a", Recording(()))], "no sample"),
        ([("a", part(1.0)), ("b", part(1.0, unit="counts"))], "disagree in unit"),
        (
            [
                ("a", dataclasses.replace(part(1.0), identity=Identity(uid="1"))),
                ("b", dataclasses.replace(part(1.0), identity=Identity(uid="2"))),
            ],
            "2 different vehicles",
        ),
    ],
)
def test_what_does_not_belong_together(parts, word):
    with pytest.raises(InvalidInputError, match=word):
        of_parts(parts)
