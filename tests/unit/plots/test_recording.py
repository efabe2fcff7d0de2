"""A recording at a glance: a row a channel, times and spectra in the units that a person reads."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.recording import Channel, Recording, Sensor, Stage
from tests.unit.plots.reading import heading, panels_of

RATE = 100.0


def channel(sensor: Sensor, values: np.ndarray, unit: str, instance: int = 0, stage: Stage = Stage.RAW) -> Channel:
    return Channel(sensor, instance, 40.0 + np.arange(len(values)) / RATE, values, unit, stage, "test")


@pytest.fixture
def tone():
    t = np.arange(4000) / RATE
    return channel(Sensor.GYRO, np.column_stack([np.sin(2.0 * np.pi * 12.5 * t), 0 * t, 0 * t]), "rad/s")


def test_each_instance_has_a_row_with_its_times_and_its_spectrum(tone):
    others = [channel(Sensor.ACCEL, np.ones((50, 3)), "m/s2", instance) for instance in (0, 1)]
    drawn = Recording((tone, *others), source="a.bin").plot()
    times = panels_of(drawn)[::2]
    assert [panel.title for panel in times] == ["Accelerometer 1", "Accelerometer 2", "Gyro 1"]
    assert [panel.labels[1] for panel in times] == ["m/s²", "m/s²", "deg/s"]
    assert heading(drawn) == "a.bin"


def test_a_tone_stands_in_the_spectrum_where_it_is_and_times_count_from_the_start(tone):
    times, spectrum = panels_of(Recording((tone,)).plot(Sensor.GYRO))
    (line,) = spectrum.lines  # the other axes have no power
    assert line.x[np.argmax(line.y)] == pytest.approx(12.5, abs=0.3)
    assert times.drawn("x").x[0] == pytest.approx(0.0, abs=0.05)
    assert times.drawn("x").y.max() == pytest.approx(np.degrees(1.0), rel=0.01)


def test_few_samples_have_no_spectrum_and_a_debiased_channel_no_row():
    few = channel(Sensor.ACCEL, np.ones((5, 3)), "m/s2")
    debiased = channel(Sensor.GYRO, np.ones((50, 3)), "rad/s", stage=Stage.DEBIASED)
    _, spectrum = panels_of(Recording((few, debiased)).plot())
    assert spectrum.texts == ["too few samples for a spectrum"]


def test_a_thermometer_has_its_times_alone_and_needs_no_legend():
    warm = channel(Sensor.TEMPERATURE, np.linspace(20.0, 30.0, 50)[:, None], "degC")
    times, nothing = panels_of(Recording((warm,)).plot())
    assert (times.title, times.labels, times.keys) == ("Temperature 1", ["time, s", "°C"], [])
    assert not nothing.texts


def test_samples_that_are_missing_are_gaps():
    values = np.random.default_rng(1).normal(size=(200, 3))
    values[50:60] = np.nan
    times, _ = panels_of(Recording((channel(Sensor.ACCEL, values, "m/s2"),)).plot())
    assert len(times.lines) == 6


def test_without_such_a_sensor_it_says_so(tone):
    with pytest.raises(InvalidInputError, match="no samples of these sensors"):
        Recording((tone,)).plot(Sensor.MAG)
