"""What a method is given of a recording, and how its options are read."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.logs.tables import NO_TIME
from mavcal.calib.methods import METHODS
from mavcal.calib.methods.method import gravity_of, mean_or_none
from mavcal.calib.methods.source import Source
from mavcal.calib.recording import Channel, Event, Identity, ParameterTimeline, Recording, Segment, Sensor, Stage

G = 9.80665
RATE = 50.0
UNITS = {Sensor.ACCEL: "m/s2", Sensor.GYRO: "rad/s", Sensor.MAG: "uT", Sensor.TEMPERATURE: "degC"}


def raw(sensor, values, *, instance=0, stage=Stage.RAW, unit=None):
    values = np.asarray(values, dtype=float)
    t = np.arange(len(values)) / RATE
    return Channel(sensor, instance, t, values, unit or UNITS[sensor], stage, "made")


def level(seconds, *, instance=0, tilt=0.0):
    force = np.tile([G * np.sin(tilt), 0.0, -G * np.cos(tilt)], (int(seconds * RATE), 1))
    return raw(Sensor.ACCEL, force, instance=instance)


def gyro(values, *, instance=0, **more):
    return raw(Sensor.GYRO, values, instance=instance, **more)


def source(*channels, instance=None, **more):
    return Source.of(Recording(channels, **more), instance)


def test_a_sensor_that_only_a_filter_debiased_is_no_channel():
    useless = gyro(np.zeros((50, 3)), stage=Stage.DEBIASED)
    good = gyro(np.ones((50, 3)), instance=1)
    found = source(useless, good).channels(Sensor.GYRO)
    assert [channel.instance for channel in found] == [1]
    assert source(useless, good).maybe(Sensor.GYRO, 0) is None
    with pytest.raises(InvalidInputError):
        source(useless).channels(Sensor.GYRO)


def test_a_companion_is_the_one_of_that_number_else_the_first():
    first, second = level(1.0), level(1.0, instance=2)
    both = source(first, second)
    assert both.companion(Sensor.ACCEL, 2).instance == 2
    assert both.companion(Sensor.ACCEL, 1).instance == 0
    assert source(gyro(np.zeros((50, 3)))).companion(Sensor.ACCEL, 0) is None


def test_the_only_thermometer_serves_every_instance():
    own, shared = (raw(Sensor.TEMPERATURE, np.full((50, 1), T), instance=k) for T, k in ((40.0, 1), (30.0, 0)))
    assert source(shared, own).temperature(1).values[0, 0] == 40.0
    assert source(shared, own).temperature(2).values[0, 0] == 30.0
    assert source(own).temperature(2) is None


@pytest.mark.parametrize(
    ("parameters", "stage", "relative"),
    [
        ({"A": 1.0}, Stage.RAW, False),
        ({}, Stage.RAW, True),  # none were seen
        ({"A": 1.0}, Stage.CORRECTED, True),  # its calibration could not be undone
    ],
)
def test_a_fit_is_absolute_only_of_bare_samples_with_known_parameters(parameters, stage, relative):
    channel = gyro(np.zeros((50, 3)), stage=stage)
    timeline = ParameterTimeline.constant(parameters) if parameters else ParameterTimeline()
    assert source(channel, parameters=timeline).relative(channel) is relative


def test_labelled_segments_are_the_still_spans_whatever_moves():
    segments = (Segment("a", 0.5, 1.0), Segment("b", 2.0, 3.5))
    found = source(gyro(np.full((250, 3), 5.0)), segments=segments).stills(0, held=True)
    assert [(s.start, s.end) for s in found] == [(0.5, 1.0), (2.0, 3.5)]


def test_rows_without_time_have_no_still_span():
    at_rest = (level(5.0), gyro(np.zeros((250, 3))))
    assert len(source(*at_rest).stills(0, held=False)) == 1
    counted = source(*at_rest, events=(Event(0.0, NO_TIME, "rows are counted"),))
    assert not counted.timed
    assert counted.stills(0, held=False) == ()


def test_a_hand_may_hold_what_is_not_at_rest_on_a_table():
    swaying = np.outer(0.1 * np.sin(np.arange(250)), [1.0, 0.0, 0.0])
    held = source(level(5.0), gyro(swaying))
    assert len(held.stills(0, held=True)) == 1
    assert held.stills(0, held=False) == ()


def test_the_longest_rest_is_cut_out_and_a_table_without_one_is_whole():
    rates = np.zeros((900, 3))
    rates[200:300] = 3.0  # four seconds of rest, then twelve
    part = source(level(18.0), gyro(rates)).longest_rest(gyro(rates))
    assert 6.0 <= part.t[0] < 7.0
    assert part.t[-1] > 17.0
    moving = gyro(np.full((250, 3), 3.0))
    assert source(level(5.0), moving).longest_rest(moving) is moving


def test_damage_and_what_was_undone_of_its_sensor_are_told_with_a_fit():
    events = (
        Event(0.0, "damage", "a hole of three seconds"),
        Event(0.0, "undo", "gyro 1 of ardupilot: its offsets were taken out"),
        Event(0.0, "undo", "gyro 2 of ardupilot: nothing was known"),
        Event(0.0, "armed", "by the pilot"),
    )
    recording = Recording((gyro(1e-3 * np.random.default_rng(1).normal(size=(400, 3))),), events=events)
    (fit,) = METHODS["gyro-rest"].run(recording)
    assert "a hole of three seconds" in fit.warnings
    assert "gyro 1 of ardupilot: its offsets were taken out" in fit.warnings
    assert not any("gyro 2" in text or "by the" in text for text in fit.warnings)


def test_a_vehicle_that_was_never_at_rest_gets_no_offset():
    rng = np.random.default_rng(2)
    flying = (level(10.0), gyro(2.0 + rng.normal(size=(500, 3))))
    log = Recording(flying, events=(Event(0.5, "armed", ""),), identity=Identity(autopilot="ardupilot"))
    (fit,) = METHODS["gyro-rest"].run(log)
    assert fit.status == FitStatus.REFUSED
    assert "armed" in fit.message
    assert "disarmed" in fit.movements["offset_x"]
    (table,) = METHODS["gyro-rest"].run(dataclasses.replace(log, identity=Identity()))
    assert "armed" not in table.message  # a table says nothing of arming


@pytest.mark.parametrize(
    ("start", "end", "n"),
    [(None, None, 500), (2.0, None, 400), (None, 2.0, 101), (2.0, 4.0, 101), (9.98, 20.0, 1)],
)
def test_a_part_of_a_recording_has_both_of_its_ends(start, end, n):
    field = raw(Sensor.MAG, 40.0 * np.random.default_rng(3).normal(size=(500, 3)))
    fits = METHODS["mag-minmax"].run(Recording((field,)), {"from": start, "until": end})
    assert fits[0].n_samples == n


def test_a_part_without_samples_says_what_there_is():
    recording = Recording((level(10.0),))
    said = r"no sample lies from 20 s and until 30 s: the recording has 0\.0 to 10\.0 s on its clock"
    with pytest.raises(InvalidInputError, match=said):
        METHODS["accel-one-axis"].run(recording, {"from": 20.0, "until": 30.0})
    with pytest.raises(InvalidInputError, match="no sample lies until -5 s: the recording has"):
        METHODS["accel-one-axis"].run(recording, {"until": -5.0})


def test_options_that_a_method_does_not_have_are_listed():
    with pytest.raises(InvalidInputError, match=r"gyro-rest has no option colour, size; it takes .*instance"):
        METHODS["gyro-rest"].run(Recording(()), {"size": 1, "colour": "red"})


def test_several_recordings_need_a_method_that_pools_them_whole():
    one = Recording((level(2.0),))
    with pytest.raises(InvalidInputError, match="accel-one-axis takes one recording, not 2"):
        METHODS["accel-one-axis"].run_pooled([one, one])
    with pytest.raises(InvalidInputError, match="--from and --until cut one recording"):
        METHODS["mag-thermal"].run_pooled([one, one], {"until": 1.0})


def test_the_gravity_of_a_unit_is_known_or_stated():
    counts = raw(Sensor.ACCEL, np.ones((10, 3)), unit="counts")
    assert gravity_of({"gravity": None}, level(1.0)) == G
    assert gravity_of({"gravity": 9.78}, level(1.0)) == 9.78
    assert gravity_of({"gravity": 2048.0}, counts) == 2048.0
    for options in ({"gravity": None}, {"gravity": 9.78, "latitude": 10.0}):  # a place tells m/s2, and no counts
        with pytest.raises(InvalidInputError, match="gravity in counts is not known: state it with --gravity"):
            gravity_of(options, counts)


def test_a_place_and_a_gravity_are_not_stated_together():
    recording = Recording((level(2.0),))
    with pytest.raises(InvalidInputError, match=r"state gravity \(9\.8\) or the latitude \(50\), not both"):
        METHODS["accel-one-axis"].run(recording, {"gravity": 9.8, "latitude": 50.0})
    with pytest.raises(InvalidInputError, match="an altitude of 400 m without a latitude says nothing of gravity"):
        METHODS["accel-one-axis"].run(recording, {"altitude": 400.0})


def test_the_mean_is_that_of_the_numbers():
    assert mean_or_none([20.0, np.nan, 30.0, np.inf]) == 25.0
    assert mean_or_none([]) is None
    assert mean_or_none(np.array([np.nan])) is None
