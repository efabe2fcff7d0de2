"""A recording at a glance: a row a channel, times and spectra in the units that a person reads."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.recording import Channel, Recording, Sensor, Stage

RATE = 100.0


def channel(sensor: Sensor, values: np.ndarray, unit: str, instance: int = 0, stage: Stage = Stage.RAW) -> Channel:
    return Channel(sensor, instance, 40.0 + np.arange(len(values)) / RATE, values, unit, stage, "test")


@pytest.fixture
def tone():
    t = np.arange(4000) / RATE
    return channel(Sensor.GYRO, np.column_stack([np.sin(2.0 * np.pi * 12.5 * t), 0 * t, 0 * t]), "rad/s")


def test_each_instance_has_a_row_with_its_times_and_its_spectrum(tone):
    others = [channel(Sensor.ACCEL, np.ones((50, 3)), "m/s2", instance) for instance in (0, 1)]
    figure = Recording((tone, *others), source="a.bin").plot()
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels[::2] == ["Accelerometer 1\nm/s²", "Accelerometer 2\nm/s²", "Gyro 1\ndeg/s"]
    assert figure.get_suptitle() == "a.bin"


def test_a_tone_stands_in_the_spectrum_where_it_is_and_times_count_from_the_start(tone):
    times, spectrum = Recording((tone,)).plot(Sensor.GYRO).axes
    line = spectrum.lines[0]
    assert line.get_xdata()[np.argmax(line.get_ydata())] == pytest.approx(12.5, abs=0.1)
    assert times.lines[0].get_xdata()[0] == 0.0
    assert times.lines[0].get_ydata().max() == pytest.approx(np.degrees(1.0), rel=0.01)


def test_few_samples_have_no_spectrum_and_a_debiased_channel_no_row():
    few = channel(Sensor.ACCEL, np.ones((5, 3)), "m/s2")
    debiased = channel(Sensor.GYRO, np.ones((50, 3)), "rad/s", stage=Stage.DEBIASED)
    figure = Recording((few, debiased)).plot()
    assert len(figure.axes) == 2
    assert "too few" in figure.axes[1].texts[0].get_text()


def test_without_such_a_sensor_it_says_so(tone):
    with pytest.raises(InvalidInputError, match="no samples of these sensors"):
        Recording((tone,)).plot(Sensor.MAG)
