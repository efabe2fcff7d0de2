from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pytest

from mavcal.calib.firmware.in_force.rewritten import HOLD_S, CertainOffsets, read_again
from mavcal.calib.recording import Channel, Event, ParameterEntry, ParameterTimeline, Recording, Sensor, Stage

X = "CAL_GYRO0_XOFF"
HABIT = {"IMU_GYRO_CAL_EN": 1, X: 0.0, "CAL_GYRO0_ID": 7}
END = 40.0


def recorded(
    start: float, end: float, entries: Sequence[tuple[float, float]], events: Sequence[Event] = ()
) -> Recording:
    """A gyro and an accelerometer at 10 Hz, and an offset as it is heard."""
    t = np.arange(round(start * 10), round(end * 10)) / 10
    channels = tuple(
        Channel(sensor, 0, t, np.zeros((len(t), 3)), "", Stage.CORRECTED, "SCALED_IMU")
        for sensor in (Sensor.GYRO, Sensor.ACCEL)
    )
    heard = tuple(ParameterEntry(t, X, value) for t, value in entries if start <= t < end)
    return Recording(channels, ParameterTimeline(heard), events=tuple(events))


def times(parts: Sequence[Recording], sensor: Sensor = Sensor.GYRO) -> list[float]:
    return [round(float(t), 1) for part in parts for c in part.channels if c.sensor == sensor for t in c.t]


def read(change: float, until: float = END, every: float = 2.0) -> list[tuple[float, float]]:
    """Readings of an offset that the vehicle rewrites at `change` and says nothing of."""
    return [(t, 0.0 if t < change else 0.02) for t in np.arange(0.0, until, every).tolist()]


def test_a_change_that_nobody_told_costs_the_samples_between_two_readings():
    gyro = times([CertainOffsets(whole=True).feed(recorded(0.0, END, read(21.0)))])
    left = sorted(set(np.round(np.arange(0, END, 0.1), 1).tolist()) - set(gyro))
    assert left[0] == pytest.approx(19.5)
    assert left[-1] == pytest.approx(22.0)
    assert len(left) == 26


def test_a_slow_reading_silences_no_gyro_beside_the_other_sensors():
    """Eight seconds without a gyro beside its accelerometer are a lost gyro to a procedure."""
    kept = CertainOffsets(whole=True).feed(recorded(0.0, END, read(21.0, every=8.0)))
    assert times([kept]) == times([kept], Sensor.ACCEL)
    assert len(times([kept])) < 10 * (END - 8.0)


@pytest.mark.parametrize("cuts", [(3.0, 21.5, 22.3), (10.0, 20.1), np.arange(0.3, END - 0.1, 0.3).tolist()])
def test_chunks_leave_out_the_same_samples_as_the_whole(cuts):
    entries = read(21.0)
    whole = CertainOffsets(whole=True).feed(recorded(0.0, END, entries))
    certain = CertainOffsets()
    parts = [certain.feed(recorded(a, b, entries)) for a, b in itertools.pairwise((0.0, *cuts, END))]
    found = times(parts)
    assert found == [t for t in times([whole]) if t < 39.9 - HOLD_S]
    assert times(parts, Sensor.ACCEL) == [t for t in times([whole], Sensor.ACCEL) if t < 39.9 - HOLD_S]
    said = [entry for part in parts for entry in part.parameters.entries]
    assert said == [e for e in whole.parameters.entries if e.t < 39.9 - HOLD_S]


def test_where_nobody_reads_the_offsets_what_the_vehicle_tells_is_trusted():
    told = [(0.0, 0.0), (21.3, 0.02), (39.0, 0.02)]
    assert len(times([CertainOffsets(whole=True).feed(recorded(0.0, END, told))])) == 400


def test_chunks_without_a_sample_that_is_certain_have_no_empty_channels():
    certain = CertainOffsets()
    assert certain.feed(recorded(0.0, 1.0, read(21.0))).channels == ()
    assert CertainOffsets(whole=True).feed(recorded(21.0, 21.1, [])).channels != ()


def test_a_restart_is_handed_on_at_once():
    certain = CertainOffsets()
    assert times([certain.feed(recorded(30.0, 33.0, []))]) == []
    after = certain.feed(recorded(0.0, 1.0, [], [Event(0.0, "reboot", "it restarted")]))
    assert [e.kind for e in after.events] == ["reboot"]
    assert times([after])[0] == 30.0
    assert times([after])[-1] == 0.9


@pytest.mark.parametrize(
    ("kind", "autopilot", "parameters", "names"),
    [
        ("thermal", "px4", HABIT | {"CAL_GYRO1_XOFF": 0.0, "CAL_GYRO1_ID": 0}, (X,)),
        ("gyro", "px4", HABIT, ()),
        ("thermal", "px4", HABIT | {"IMU_GYRO_CAL_EN": 0}, ()),
        ("thermal", "px4", {X: 0.0, "CAL_GYRO0_ID": 7}, ()),
        ("thermal", "ardupilot", {"INS_GYROFFS_X": 0.0}, ()),
    ],
)
def test_offsets_are_read_again_where_the_vehicle_rewrites_those_of_a_sensor(kind, autopilot, parameters, names):
    assert read_again(kind, autopilot, parameters) == names
