"""What reading and looking through a log needs beside the columns that it holds."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavcal.calib import logs
from mavcal.calib.flight.report import flight_report
from mavcal.calib.logs.inspection import inspect
from mavcal.calib.recording import Channel, Event, Identity, Recording, Sensor, Stage
from tests.unit.logs.dataflash_file import write_flight

MIB = 2**20
BLOCKS = 4.0 * MIB
"""What work in blocks may need however short the log is: one block of the file, its candidates, and some rows."""


@pytest.fixture(autouse=True)
def traced() -> Iterator[None]:
    tracemalloc.start()
    yield
    tracemalloc.stop()


def columns(recording: Recording) -> int:
    """Bytes of its arrays; channels of one message share their times."""
    held = {
        id(array): array.nbytes
        for channel in (*recording.channels, *recording.reference, *recording.dynamics)
        for array in (channel.t, channel.values, channel.zero_bin)
        if array is not None
    }
    return sum(held.values())


def peak(work: Callable[[], Any]) -> tuple[Any, int]:
    """What `work` returns, and the most bytes that it held at once."""
    before, _ = tracemalloc.get_traced_memory()
    tracemalloc.reset_peak()
    result = work()
    return result, tracemalloc.get_traced_memory()[1] - before


def test_reading_needs_less_than_a_third_more_than_the_columns(tmp_path: Path) -> None:
    path = tmp_path / "flight.bin"
    write_flight(path, 40 * MIB, 1)
    recording, most = peak(lambda: logs.read(path))
    assert columns(recording) > 25 * MIB
    assert most <= 1.3 * columns(recording)


def flown() -> Recording:
    """Two inertial units at 400 Hz that shake in flight for twenty minutes, and rest before it."""
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 1320.0, 0.0025)
    shaken = np.where(t > 120.0, 2.0, 0.01)[:, None]
    channels = []
    for instance in (0, 1):
        for sensor, unit, level, share in ((Sensor.ACCEL, "m/s2", -9.8, 1.0), (Sensor.GYRO, "rad/s", 0.0, 0.05)):
            values = np.array([0.0, 0.0, level]) + share * shaken * rng.standard_normal((len(t), 3))
            channels.append(Channel(sensor, instance, t, values, unit, Stage.FILTERED, "IMU"))
    events = (Event(119.0, "armed", "the vehicle was armed"),)
    return Recording(tuple(channels), events=events, identity=Identity(autopilot="ardupilot"), source="flight.bin")


@pytest.mark.long
@pytest.mark.parametrize("look", [inspect, flight_report])
def test_a_summary_needs_little_beside_the_columns(look: Callable[[Recording], Any]) -> None:
    recording = flown()
    _, most = peak(lambda: look(recording))
    assert most <= 0.2 * columns(recording) + BLOCKS


@pytest.mark.long
def test_the_summary_of_a_flight_is_that_of_its_samples() -> None:
    recording = flown()
    (first, *_), report = inspect(recording)["channels"], flight_report(recording)
    values = recording.channels[0].values
    length = np.linalg.norm(values, axis=1)
    assert first["norm"] == pytest.approx((length.mean(), length.std()), rel=1e-12)
    assert first["rate"] == pytest.approx(400.0)
    assert first["mean"] == pytest.approx(values.mean(axis=0).tolist(), rel=1e-9)
    assert report is not None
    (rest,) = report.rests
    assert (rest.start, rest.end) == pytest.approx((0.0, 119.0), abs=0.5)
    shaking = next(item for item in report.items if item.name == "vibration")
    assert shaking.value == pytest.approx(2.0 * np.sqrt(1.0 - 5.0 / 200.0), rel=0.01)  # white up to 200 Hz, less 5
