"""Vibration, clipping and scales in flight, by tones and motions whose answer is known."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib import STANDARD_GRAVITY as G
from mavcal.calib.flight.flying import FULL_SCALE, flying_items, shaking_items
from mavcal.calib.flight.item import FlightVerdict
from mavcal.calib.flight.rest import TimeSpan
from mavcal.calib.recording import Channel, Event, Oddity, OddSamples, Recording, Sensor, Stage

PASS, WARN, FAIL, NOT_TESTABLE = FlightVerdict.PASS, FlightVerdict.WARN, FlightVerdict.FAIL, FlightVerdict.NOT_TESTABLE
RATE = 200.0
T = np.arange(0.0, 20.0, 1.0 / RATE)
WHOLE = (TimeSpan(0.0, 20.0),)


def accel(values=None, *, t=T, stage=Stage.RAW, unit="m/s2", instance=0, source="IMU"):
    base = np.tile([0.0, 0.0, -9.8], (len(t), 1)) if values is None else values
    return Channel(Sensor.ACCEL, instance, t, base, unit, stage, source)


def tone(hz, size, *, t=T, axis=0, noise=0.01):
    values = np.random.default_rng(1).normal(scale=noise, size=(len(t), 3)) + np.array([0.0, 0.0, -9.8])
    values[:, axis] += size * np.sin(2.0 * np.pi * hz * t)
    return values


def vibration(*channels, flown=WHOLE):
    return shaking_items(Recording(channels), flown)[0]


def clipping(*channels, events=()):
    return shaking_items(Recording(channels, events=tuple(events)), WHOLE)[1]


@settings(max_examples=10, deadline=None)
@given(hz=st.integers(8, 90), size=st.floats(0.5, 50.0), axis=st.integers(0, 2))
def test_a_tone_is_told_by_its_frequency_and_amplitude(hz, size, axis):
    made = vibration(accel(tone(float(hz), size, axis=axis)))
    strongest = made.numbers["tones"][0]
    assert strongest["hz"] == pytest.approx(hz, abs=1.0)
    assert strongest["amplitude"] == pytest.approx(size, rel=0.05)
    assert made.value == pytest.approx(size / math.sqrt(2.0), rel=0.05)
    assert int(np.argmax(made.numbers["rms"])) == axis


@pytest.mark.parametrize(("rms", "verdict"), [(28.0, PASS), (32.0, WARN), (57.0, WARN), (64.0, FAIL)])
def test_vibration_is_judged_by_the_axis_that_shakes_most(rms, verdict):
    assert vibration(accel(tone(50.0, rms * math.sqrt(2.0)))).verdict == verdict


def test_what_is_slower_than_five_hertz_is_a_manoeuvre():
    assert vibration(accel(tone(2.0, 50.0))).value < 1.0
    assert vibration(accel(tone(7.0, 50.0))).value > 30.0


def test_the_spectrum_reaches_half_the_rate_and_takes_the_strongest_three_lines():
    values = sum(
        (tone(hz, size) for hz, size in ((20.0, 1.0), (40.0, 3.0), (60.0, 2.0), (80.0, 4.0))), np.zeros((1, 3))
    )
    made = vibration(accel(values))
    assert [round(t["hz"]) for t in made.numbers["tones"]] == [80, 40, 60]
    assert made.numbers["nyquist_hz"] == pytest.approx(RATE / 2.0)
    assert "up to 100 Hz (80 Hz of 4" in made.text


def test_noise_alone_has_no_tone():
    values = np.random.default_rng(2).normal(size=(len(T), 3))
    made = vibration(accel(values))
    assert made.numbers["tones"] == []
    assert "(no tone)" in made.text
    assert made.value == pytest.approx(math.sqrt(1.0 - 5.0 / 100.0), rel=0.05)


def test_only_the_flight_is_looked_at():
    values = np.where((T > 10.0)[:, None], tone(50.0, 60.0), tone(50.0, 0.0))
    assert vibration(accel(values), flown=(TimeSpan(0.0, 9.9),)).value < 0.1
    assert vibration(accel(values), flown=(TimeSpan(10.1, 20.0),)).value > 40.0


def test_a_pause_is_stepped_over_and_makes_no_line():
    values = tone(50.0, 10.0)
    whole, kept = accel(values), (T < 8.0) | (T > 12.0)
    made = vibration(whole.take(kept))
    assert made.value == pytest.approx(vibration(whole).value, rel=0.02)


@pytest.mark.parametrize(("seconds", "testable"), [(4.9, False), (5.2, True)])
def test_five_seconds_of_flight_are_needed(seconds, testable):
    made = vibration(accel(tone(50.0, 10.0)), flown=(TimeSpan(0.0, seconds),))
    assert (made.verdict != NOT_TESTABLE) == testable


@pytest.mark.parametrize(("hz", "testable"), [(19.0, False), (21.0, True)])
def test_twenty_samples_a_second_are_needed(hz, testable):
    t = np.arange(0.0, 20.0, 1.0 / hz)
    made = vibration(accel(t=t))
    assert (made.verdict != NOT_TESTABLE) == testable
    if not testable:
        assert made.text == "fewer than 5 s with the motors on at 20 Hz or more"


def test_an_unfiltered_channel_goes_before_a_filtered_one_and_the_faster_before_the_slower():
    filtered = accel(tone(50.0, 1.0), stage=Stage.FILTERED, source="A")
    slow = accel(tone(20.0, 1.0, t=T[::2]), t=T[::2], source="B")
    assert vibration(filtered, slow).numbers["source"] == "B"
    assert vibration(slow, accel(tone(20.0, 1.0), source="C")).numbers["source"] == "C"
    assert vibration(filtered).numbers["filtered"]
    assert vibration(accel(unit="counts")).text == "it is not in m/s2"


def test_a_filtered_channel_can_show_a_vibration_but_not_that_there_is_none():
    quiet = vibration(accel(tone(50.0, 1.0), stage=Stage.FILTERED))
    assert quiet.verdict == NOT_TESTABLE
    assert quiet.text.startswith("0.7")
    assert "what it hides is not known" in quiet.text
    assert quiet.value == pytest.approx(0.71, abs=0.02)
    for size in (8.0, 40.0):  # what passed the filter is an answer
        strong = vibration(accel(tone(50.0, size), stage=Stage.FILTERED))
        assert strong.verdict == WARN
        assert strong.text.startswith("at least")


@pytest.mark.parametrize(("value", "count"), [(0.998, 0), (1.0, 2), (-1.0, 2)])
def test_samples_at_the_end_of_the_range_are_clipped(value, count):
    values = tone(50.0, 1.0)
    values[[100, 200], 1] = value * FULL_SCALE
    made = clipping(accel(values))
    assert (made.value, made.verdict) == (count, WARN if count else PASS)
    largest = f"the largest is {abs(value) * FULL_SCALE:.1f} m/s2"
    assert made.text == (
        f"{count} samples at 16 g, {largest}" if count else f"no peaks pile up at the end of a range, {largest}"
    )


@pytest.mark.parametrize("g", [4, 8, 16, 32])
def test_a_range_is_where_the_peaks_pile_up(g):
    rng = np.random.default_rng(1)
    shaken = 0.5 * g * G * rng.normal(size=(len(T), 3))
    clipped = np.clip(shaken, -g * G, g * G)
    made = clipping(accel(1.004 * clipped + 0.1))  # as a calibration moves the end
    assert made.verdict != PASS
    assert f" samples at {g} g, the largest is" in made.text
    if g < 16:
        assert clipping(accel(shaken)).text.startswith("no peaks pile up")


def test_a_sample_clipped_on_two_axes_counts_once():
    values = tone(50.0, 1.0)
    values[100] = [FULL_SCALE, -FULL_SCALE, 0.0]
    assert clipping(accel(values)).text.startswith("1 sample at 16 g")
    values[5] = np.nan
    assert clipping(accel(values)).value == 1.0


def test_a_filtered_channel_does_not_tell_what_was_clipped_before():
    for largest, verdict in ((0.22, PASS), (0.23, NOT_TESTABLE), (0.55, NOT_TESTABLE)):
        values = tone(50.0, 0.1)
        values[100, 0] = largest * FULL_SCALE
        made = clipping(accel(values, stage=Stage.FILTERED))
        assert made.verdict == verdict
        assert made.numbers["largest"] == pytest.approx(largest * FULL_SCALE)
        assert clipping(accel(values)).verdict == PASS


def counted(count, instance=0, what=Oddity.CLIPPED, sensor=Sensor.ACCEL):
    return Event(5.0, "clipping", "", OddSamples(what, sensor, instance, count))


def test_what_the_autopilot_counted_goes_before_what_is_seen():
    values = tone(50.0, 1.0)
    values[100, 0] = FULL_SCALE
    assert clipping(accel(values), events=[counted(0)]).value == 0.0
    assert clipping(accel(), events=[counted(60), counted(41)]).verdict == FAIL
    assert clipping(accel(), events=[counted(60), counted(40)]).text == "clipped 100 times"
    others = [counted(500, 1), counted(500, what=Oddity.ZERO), counted(500, sensor=Sensor.GYRO), Event(1.0, "x", "")]
    assert clipping(accel(), events=others).value == 0.0


def test_without_a_sample_in_physical_units_no_clipping_is_told():
    assert clipping(accel(unit="counts")).text == "no sample in m/s2"
    assert clipping(accel(np.full((len(T), 3), np.nan))).verdict == NOT_TESTABLE


def moved(scale=(1.0, 1.0, 1.0), instance=0, *, size=1.0, noise=1e-3, sensor=Sensor.GYRO, **kw):
    """Three axes that swing at rates of their own, as a unit of that `scale` reads them."""
    rng = np.random.default_rng(instance)
    truth = size * np.sin(np.outer(T, [1.3, 1.9, 2.7]))
    unit = {Sensor.GYRO: "rad/s", Sensor.ACCEL: "m/s2"}[sensor]
    values = truth * scale + noise * rng.normal(size=truth.shape) + 0.05
    return Channel(sensor, instance, T, values, kw.get("unit", unit), kw.get("stage", Stage.CORRECTED), "IMU")


def scale_of(*channels, flown=WHOLE):
    made = flying_items(Recording(channels), flown, shaking=())
    return next(i for i in made if i.name.endswith("_scale"))


@settings(max_examples=10, deadline=None)
@given(scale=st.tuples(*[st.floats(0.8, 1.25)] * 3), sensor=st.sampled_from([Sensor.GYRO, Sensor.ACCEL]))
def test_the_scale_of_one_unit_over_another_is_found_axis_by_axis(scale, sensor):
    made = scale_of(moved(scale, sensor=sensor), moved(instance=1, sensor=sensor))
    assert made.numbers["scale"] == pytest.approx(scale, abs=2e-3)
    assert made.value == pytest.approx(max(abs(s - 1.0) for s in scale), abs=3e-3)


@pytest.mark.parametrize(("scale", "verdict"), [(1.01, PASS), (1.04, WARN), (0.96, WARN), (1.15, FAIL)])
def test_scales_that_differ_are_judged_by_the_worst_axis(scale, verdict):
    made = scale_of(moved((1.0, scale, 1.0)), moved(instance=1))
    assert made.verdict == verdict
    assert f"y {100.0 * (scale - 1.0):+.2f} +- " in made.text


def test_an_axis_that_did_not_move_is_not_compared():
    still = np.array([1.0, 1.0, 0.0])
    first, second = moved(), moved(instance=1)
    first, second = (dataclasses.replace(c, values=c.values * still) for c in (first, second))
    noisy = [
        dataclasses.replace(c, values=c.values + moved(noise=0.05, size=0.0, instance=5 + i).values)
        for i, c in enumerate((first, second))
    ]
    made = scale_of(*noisy)
    assert made.numbers["scale"][2] is None
    assert made.numbers["scale_sd"][2] is None
    assert "z not excited" in made.text
    assert made.numbers["scale"][0] == pytest.approx(1.0, abs=0.02)


def test_a_flight_that_moved_too_little_knows_no_scale():
    made = scale_of(moved(size=1e-3, noise=1e-2), moved(size=1e-3, noise=1e-2, instance=1))
    assert made.verdict == NOT_TESTABLE
    assert "no scale is known to 2 %" in made.text


@pytest.mark.parametrize("changed", [{"unit": "counts"}, {"stage": Stage.DEBIASED}])
def test_units_that_cannot_be_compared_are_not(changed):
    made = scale_of(moved(), moved(instance=1, **changed))
    assert made.verdict == NOT_TESTABLE
    assert made.numbers.get("scale") is None


def test_ten_seconds_of_both_are_needed_for_a_scale():
    for seconds, testable in ((9.0, False), (11.0, True)):
        made = scale_of(moved(), moved(instance=1), flown=(TimeSpan(0.0, seconds),))
        assert (made.verdict != NOT_TESTABLE) == testable


def test_every_pair_of_units_is_compared_and_what_was_told_of_shaking_is_kept():
    three = [moved(instance=i) for i in range(3)]
    made = flying_items(Recording(tuple(three)), WHOLE)
    assert [i.subject for i in made] == ["gyro 1, 2", "gyro 1, 3", "gyro 2, 3"]
    told = tuple(shaking_items(Recording((accel(),)), WHOLE))
    assert flying_items(Recording((accel(tone(50.0, 90.0)),)), WHOLE, told) == list(told)
