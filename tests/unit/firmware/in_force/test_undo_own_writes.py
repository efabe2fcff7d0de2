"""PX4 rewrites a gyro's offset by itself: all three axes at once, told one after the other."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.firmware.in_force.fingerprint import means_the_same
from mavcal.calib.firmware.in_force.undo import GUARD_AFTER_S, GUARD_BEFORE_S, undo
from mavcal.calib.recording import (
    Channel,
    Identity,
    ParameterEntry,
    ParameterTimeline,
    Recording,
    Sensor,
    Stage,
)

ROW = {"CAL_GYRO0_ID": 1310988, "CAL_GYRO0_PRIO": 50, "CAL_GYRO0_ROT": -1, "SENS_BOARD_ROT": 0}
ROW |= {f"CAL_GYRO0_{axis}OFF": 0.0 for axis in "XYZ"} | {f"SENS_BOARD_{axis}_OFF": 0.0 for axis in "XYZ"}
RAW = np.array([0.008, -0.007, 0.006])
CHANGED = 10.0


@pytest.mark.parametrize("order", ["XYZ", "ZXY"])
@pytest.mark.parametrize("apart", [0.0, 0.02])
def test_an_offset_that_only_the_whole_change_brings_into_memory_is_undone_whole(order: str, apart: float) -> None:
    """No axis, and no first two of them, lie 0.01 rad/s from the memory; the whole change does."""
    entries = [ParameterEntry(0.0, name, value) for name, value in ROW.items()]
    new = dict(zip("XYZ", RAW, strict=True))
    entries += [ParameterEntry(CHANGED + apart * k, f"CAL_GYRO0_{a}OFF", float(new[a])) for k, a in enumerate(order)]
    t = np.arange(0.0, 20.0, 0.02)
    streamed = np.where(t[:, None] < CHANGED - 0.3, RAW, 0.0)  # the firmware tells it up to 0.4 s late
    gyro = Channel(Sensor.GYRO, 0, t, streamed, "rad/s", Stage.CORRECTED, source="SCALED_IMU")
    recording = Recording((gyro,), ParameterTimeline(tuple(entries)), identity=Identity("px4"))
    (raw,) = undo(recording).channels
    assert raw.stage == Stage.RAW
    np.testing.assert_allclose(raw.values, np.broadcast_to(RAW, raw.values.shape), atol=1e-7)
    assert len(gyro) - len(raw) <= (GUARD_BEFORE_S + GUARD_AFTER_S) / 0.02 + 2


@pytest.mark.parametrize(
    ("name", "before", "after", "same"),
    [
        ("CAL_GYRO0_PRIO", -1, 50, True),
        ("CAL_GYRO0_PRIO", 50, -1, True),
        ("CAL_MAG1_PRIO", -1, 75, True),
        ("CAL_GYRO0_PRIO", 50, 0, False),
        ("CAL_GYRO0_PRIO", -1, 0, False),
        ("CAL_GYRO0_PRIO", 50, 75, False),
        ("CAL_GYRO0_ROT", -1, 50, False),
    ],
)
def test_an_uninitialised_priority_is_the_default_one(name: str, before: int, after: int, same: bool) -> None:
    assert means_the_same(name, before, after) == same
