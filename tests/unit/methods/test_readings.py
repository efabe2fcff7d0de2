"""Rows of a table may be readings that were written down one by one, whether or not they have a time."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.fit import FitStatus
from mavcal.calib.logs.tables import NO_TIME
from mavcal.calib.methods import METHODS
from mavcal.calib.methods.source import Source
from mavcal.calib.recording import Channel, Event, Recording, Sensor, Stage

FACES = np.array(  # METHODS S4
    [
        [-9.6490, 0.2225, -0.1925],
        [0.0146, -9.5593, 0.0153],
        [-0.0210, 0.1928, -9.9271],
        [9.9363, 0.1840, -0.0210],
        [0.0008, 9.9094, -0.0655],
        [0.2828, 0.1528, 9.7232],
    ]
)


def table(t, values, *, timed=True):
    said = () if timed else (Event(0.0, NO_TIME, ""),)
    return Recording((Channel(Sensor.ACCEL, 0, t, values, "m/s2", Stage.RAW, "table"),), events=said)


@pytest.mark.parametrize("step", [0.02, 0.1, 0.5, 1.0, 60.0])
def test_faces_with_a_time_give_the_digits_of_faces_without(step):
    options = {"convention": "accelcal"}
    (counted,) = METHODS["accel-six-face"].run(table(np.arange(6.0), FACES, timed=False), options)
    (timed,) = METHODS["accel-six-face"].run(table(step * np.arange(6.0), FACES), options)
    assert timed.status == FitStatus.OK
    assert timed.native["A"] == counted.native["A"]
    assert timed.native["A"][0][0] == pytest.approx(1.0017879105, abs=1e-9)


def test_several_readings_of_a_face_a_few_seconds_apart():
    rng = np.random.default_rng(1)
    values = np.repeat(FACES, 5, axis=0) + 0.01 * rng.normal(size=(30, 3))
    (fit,) = METHODS["accel-six-face"].run(table(3.0 * np.arange(30.0), values), {"convention": "accelcal"})
    assert fit.status == FitStatus.OK
    assert fit.native["A"][0][0] == pytest.approx(1.0018, abs=0.003)


@pytest.mark.parametrize("rate", [10.0, 100.0])
def test_a_stream_is_no_table_of_readings(rate):
    rng = np.random.default_rng(2)
    t = np.arange(0.0, 60.0, 1.0 / rate)
    face = np.minimum((t // 10.0).astype(int), 5)
    stream = table(t, FACES[face] + 0.05 * rng.normal(size=(len(t), 3)))
    assert not Source.of(stream, None).readings(stream.channels[0])


def test_the_noise_of_a_rest_is_no_turn():
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 10.0, 0.01)
    rest = table(t, np.array([0.0, 0.0, -9.8]) + 0.1 * rng.normal(size=(len(t), 3)))
    assert not Source.of(rest, None).readings(rest.channels[0])
