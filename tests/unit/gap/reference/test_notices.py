from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.gap.reference import build
from mavcal.calib.recording import Sensor

from .test_recorded import channel, flown, truth


def only(recording, *sensors):
    """`recording` with the channels of `sensors` and no reference."""
    return dataclasses.replace(
        recording, channels=tuple(c for c in recording.channels if c.sensor in sensors), reference=()
    )


def said(problem, *words):
    return any(all(word in text for word in words) for text in problem.warnings)


def test_a_file_given_twice_is_told():
    bare, carrying = flown(1, reference=False), flown(1)
    with pytest.raises(InvalidInputError, match="given twice"):
        build(bare, bare.between(-1.0, 100.0))
    assert said(build(carrying, carrying.between(-1.0, 100.0)), "the same samples as the real one")
    assert said(build(carrying, nominal=(carrying.between(-1.0, 100.0),)), "the same samples as the real one")
    assert not said(build(carrying, flown(2), (flown(3),)), "same samples")


def test_why_a_simulators_recording_is_no_reference():
    real = flown(1, reference=False)
    with pytest.raises(InvalidInputError, match="no sensor in common: the real one has accel, the simulator's mag"):
        build(only(real, Sensor.ACCEL), only(flown(2), Sensor.MAG))
    other, _ = truth(-1.7 * real.channels[0].t)
    moved = [channel(sensor, real.channels[0].t, values) for sensor, values in other.items()]
    with pytest.raises(InvalidInputError, match=r"another movement \(correlation 0\.\d+ at best, 0\.97 is needed\)"):
        build(real, real.with_channels(moved))


def test_what_is_not_compared_is_said():
    real, sim = flown(1, reference=False), flown(2, reference=False)
    assert said(build(real, only(sim, Sensor.MAG)), "accel has no reference and was not compared")
    empty = dataclasses.replace(flown(1), channels=tuple(c for c in flown(1).channels if c.sensor != Sensor.GYRO))
    assert said(build(empty), "gyro has a reference and no sample")
    assert build(flown(1)).warnings == ()


def test_a_reference_that_is_much_slower_is_said():
    sim = flown(2, reference=False)
    rows = [c.take(np.arange(len(c)) % 5 == 0) if c.sensor == Sensor.GYRO else c for c in sim.channels]
    problem = build(flown(1, reference=False), sim.with_channels(rows))
    assert said(problem, "gyro", "20 samples", "100:", "10 Hz")


def test_stamps_that_were_rounded_are_said():
    real = flown(1)
    rounded = [dataclasses.replace(c, t=np.round(c.t, 1)) for c in real.channels]
    assert said(build(real.with_channels(rounded)), "90 %", "gyro", "instance 1")


def test_a_recording_of_two_parts_is_said():
    real = flown(1)

    def torn(channels):
        return tuple(dataclasses.replace(c, t=c.t + 100.0 * (c.t > 12.0)) for c in channels)

    parts = dataclasses.replace(real, channels=torn(real.channels), reference=torn(real.reference))
    assert said(build(parts), "hole", "100 s", "longest part")
