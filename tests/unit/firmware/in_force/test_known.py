from __future__ import annotations

import itertools

import numpy as np
import pytest

from mavcal.calib.firmware.in_force.known import KnownCalibration
from mavcal.calib.firmware.in_force.undo import GUARD_AFTER_S
from mavcal.calib.recording import Channel, ParameterEntry, ParameterTimeline, Recording, Sensor, Stage

X, Y = "CAL_GYRO0_XOFF", "CAL_GYRO0_YOFF"


def recorded(start: float, end: float, *entries: tuple[float, str]) -> Recording:
    """A gyro at 10 Hz beside a position at 1 Hz, and parameters as they are heard."""
    t, slow = np.arange(start, end, 0.1), np.arange(start, end)
    channels = (
        Channel(Sensor.GYRO, 0, t, np.zeros((len(t), 3)), "rad/s", Stage.RAW, "HIGHRES_IMU"),
        Channel(Sensor.POSITION, 0, slow, np.ones((len(slow), 3)), "deg deg m", Stage.RAW, "GLOBAL_POSITION_INT"),
    )
    return Recording(channels, ParameterTimeline(tuple(ParameterEntry(t, name, 0.5) for t, name in entries)))


def gyro_times(recording: Recording) -> np.ndarray:
    return np.concatenate([np.zeros(0), *(c.t for c in recording.channels if c.sensor == Sensor.GYRO)])


def test_samples_count_from_the_reading_of_the_last_parameter_on() -> None:
    whole = recorded(0.0, 10.0, (2.0, X), (2.5, "SENS_BOARD_ROT"), (4.0, Y), (7.0, X))
    counted = KnownCalibration([X, Y]).feed(whole)
    assert gyro_times(counted)[0] == pytest.approx(4.0 + GUARD_AFTER_S)
    assert gyro_times(counted)[-1] == pytest.approx(9.9)
    positions = [c for c in counted.channels if c.sensor == Sensor.POSITION]
    assert [len(c) for c in positions] == [10]


@pytest.mark.parametrize("cuts", [(1.0, 3.0), (2.2, 4.05, 4.3), (8.0,)])
def test_chunks_count_the_same_samples_as_the_whole(cuts: tuple[float, ...]) -> None:
    entries = ((2.0, X), (4.0, Y))
    whole = gyro_times(KnownCalibration([X, Y]).feed(recorded(0.0, 10.0, *entries)))
    known, edges = KnownCalibration([X, Y]), (0.0, *cuts, 10.0)
    parts = []
    for start, end in itertools.pairwise(edges):
        heard = [entry for entry in entries if start <= entry[0] < end]
        parts.append(gyro_times(known.feed(recorded(start, end, *heard))))
    found = np.concatenate(parts)
    assert len(found) == pytest.approx(len(whole), abs=len(cuts))  # grids of chunks are not in step
    assert found.min() >= 4.0 + GUARD_AFTER_S


def test_nothing_counts_while_a_parameter_is_not_known() -> None:
    known = KnownCalibration([X, Y])
    assert len(gyro_times(known.feed(recorded(0.0, 5.0, (1.0, X))))) == 0
    assert len(gyro_times(known.feed(recorded(5.0, 9.0, (5.0, Y))))) > 0


def test_a_recording_whose_parameters_are_not_asked_for_counts_as_a_whole() -> None:
    whole = recorded(0.0, 5.0)
    assert gyro_times(KnownCalibration([]).feed(whole)).tolist() == gyro_times(whole).tolist()
