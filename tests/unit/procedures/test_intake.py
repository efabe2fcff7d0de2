from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib.procedures.intake import TICK, Intake
from mavcal.calib.recording import Channel, Event, Recording, Sensor, Stage
from tests.examples import examples


def channel(t, sensor=Sensor.ACCEL, instance=0, source="A", stage=Stage.RAW, values=None):
    t = np.asarray(t, dtype=float)
    rows = np.column_stack([t, -t, t * 0]) if values is None else values
    return Channel(sensor, instance, t, rows, "m/s2", stage, source)


def content(ticks):
    return [(k.start, k.end, {key: (c.t.tolist(), c.values.tolist()) for key, c in k.channels.items()}) for k in ticks]


def run(chunks):
    intake, ticks = Intake(), []
    for chunk in chunks:
        intake.add(chunk)
        ticks += intake.ticks()
    ticks += intake.ticks(to_the_end=True)
    return ticks, intake


RECORDING = Recording(
    (
        channel(np.arange(5.01, 9.0, 0.02)),
        channel(np.arange(5.013, 9.0, 0.1), Sensor.MAG, source="M"),
        channel(np.arange(5.5, 9.0, 1.0), Sensor.TEMPERATURE, source="T"),
    )
)


@settings(deadline=None, max_examples=examples(25))
@given(st.lists(st.floats(5.0, 9.0), max_size=40))
def test_ticks_do_not_depend_on_the_chunks(cuts):
    edges = [-np.inf, *sorted(cuts), np.inf]
    pieces = [RECORDING.between(a, b) for a, b in itertools.pairwise(edges)]
    assert content(run(pieces)[0]) == content(run([RECORDING])[0])


def test_every_sample_falls_into_exactly_one_tick_on_the_grid():
    ticks, _ = run([RECORDING])
    for c in RECORDING.channels:
        np.testing.assert_array_equal(np.concatenate([k.channels[c.key].t for k in ticks if c.key in k.channels]), c.t)
    assert all(k.start % TICK == 0 and k.end == k.start + TICK for k in ticks)


def test_messages_that_overtake_each_other_fall_into_their_own_tick():
    early, late = channel([1.0, 1.3]), channel([0.9], Sensor.GYRO, source="G")
    ticks, _ = run([Recording((early,)), Recording((late,))])
    assert [k.start for k in ticks] == [0.75, 1.0, 1.25]
    assert ticks[0].channels.keys() == {late.key}


def test_a_late_datagram_of_the_same_channel_is_put_in_order():
    ticks, _ = run([Recording((channel([1.0, 1.1]),)), Recording((channel([1.05]),))])
    assert ticks[0].channels[channel([0]).key].t.tolist() == [1.0, 1.05, 1.1]


def test_time_going_back_ends_the_capture_at_the_last_sample_before():
    both = Recording((channel([5.0, 5.1, 5.2, 0.1, 0.2]),))
    for pieces in ([both], [Recording((channel([5.0, 5.1, 5.2]),)), Recording((channel([0.1, 0.2]),))]):
        ticks, intake = run(pieces)
        assert intake.broken
        assert "restarted" in intake.broken.cause
        assert np.concatenate([c.t for k in ticks for c in k.channels.values()]).tolist() == [5.0, 5.1, 5.2]


def test_a_restart_that_the_reader_saw_ends_the_capture():
    recording = replace(Recording((channel(np.arange(1.0, 3.0, 0.1)),)), events=(Event(2.0, "reboot", "boot"),))
    ticks, intake = run([recording])
    assert intake.broken
    assert max(c.t.max() for k in ticks for c in k.channels.values()) < 2.0


def test_rows_that_are_no_numbers_are_left_out_and_counted():
    values = np.ones((5, 3))
    values[1, 2], values[3, 0] = np.nan, 1e30
    broken = channel(np.arange(5) * 0.1, values=values)
    ticks, intake = run([Recording((broken,))])
    assert sum(len(c) for k in ticks for c in k.channels.values()) == 3
    assert intake.dropped == {broken.key: 2}


def test_debiased_streams_are_ignored():
    ticks, _ = run([Recording((channel([1.0, 2.0], stage=Stage.DEBIASED),))])
    assert ticks == []


def test_a_gap_of_days_costs_no_time():
    ticks, _ = run([Recording((channel([0.0, 5e5]),))])
    assert [k.start for k in ticks] == [0.0, 5e5]
