"""Messages beside the inertial ones, row by row."""

from __future__ import annotations

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.stream.assembler import wire_dtype
from mavcal.calib.firmware.stream.auxiliary import Auxiliary
from mavcal.calib.recording import Sensor


def rows_of(message_id, **fields):
    rows = np.zeros(len(next(iter(fields.values()))), dtype=wire_dtype(message_id))
    for name, values in fields.items():
        rows[name] = values
    return rows


def fed(message_id, t=None, **fields):
    rows = rows_of(message_id, **fields)
    return Auxiliary().feed(message_id, np.arange(1.0, len(rows) + 1) if t is None else np.array(t), rows)


@pytest.mark.parametrize(
    ("message", "fields", "sensor", "unit", "t", "values"),
    [
        ("SYS_STATUS", {"current_battery": [-1, 0, 250]}, Sensor.CURRENT, "A", [2, 3], [[0.0], [2.5]]),
        (
            "BATTERY_STATUS",
            {"current_battery": [100, 200, -1], "id": [0, 1, 0]},
            Sensor.CURRENT,
            "A",
            [1],
            [[1.0]],
        ),
        ("VFR_HUD", {"throttle": [0, 100, 101]}, Sensor.THROTTLE, "1", [1, 2], [[0.0], [1.0]]),
        (
            "ATTITUDE_QUATERNION",
            {"q1": [2, 0.5, 0, np.nan], "q2": [0, 0, 0.75, 1], "q3": [0] * 4, "q4": [0] * 4},
            Sensor.ATTITUDE,
            "1",
            [1, 3],
            [[1, 0, 0, 0], [0, 1, 0, 0]],
        ),
        (
            "ATTITUDE",
            {"roll": [np.pi, 0, np.nan], "pitch": [0, np.pi / 2, 0], "yaw": [0, 0, 0]},
            Sensor.ATTITUDE,
            "1",
            [1, 2],
            [[0, 1, 0, 0], [np.sqrt(0.5), 0, np.sqrt(0.5), 0]],
        ),
        (
            "GLOBAL_POSITION_INT",
            {"lat": [0, 475000000, 0], "lon": [0, 0, -82500000], "alt": [1, 500500, 7]},
            Sensor.POSITION,
            "deg deg m",
            [2, 3],
            [[47.5, 0, 500.5], [0, -8.25, 0.007]],
        ),
        (
            "GPS_RAW_INT",
            {"lat": [475000000] * 3, "lon": [82500000] * 3, "alt": [500500] * 3, "fix_type": [2, 3, 4]},
            Sensor.POSITION,
            "deg deg m",
            [2, 3],
            [[47.5, 8.25, 500.5]] * 2,
        ),
    ],
)
def test_what_is_valid_becomes_a_channel_in_si_units(message, fields, sensor, unit, t, values):
    (channel,) = fed(getattr(dialect, f"MAVLINK_MSG_ID_{message}"), **fields)
    assert (channel.sensor, channel.instance, channel.unit, channel.source) == (sensor, 0, unit, message)
    assert channel.t.tolist() == t
    np.testing.assert_allclose(channel.values, values, atol=1e-6)


def test_a_late_row_is_left_out_in_this_chunk_and_the_next():
    listener, hud = Auxiliary(), dialect.MAVLINK_MSG_ID_VFR_HUD
    (first,) = listener.feed(hud, np.array([2.0, 1.0, 2.0, np.nan]), rows_of(hud, throttle=[1, 2, 3, 4]))
    assert first.values.ravel().tolist() == pytest.approx([0.01, 0.03])
    listener = Auxiliary()
    listener.feed(hud, np.array([2.0, 3.0]), rows_of(hud, throttle=[1, 2]))
    assert listener.feed(hud, np.array([2.9]), rows_of(hud, throttle=[1])) == []
    assert len(listener.feed(hud, np.array([3.0]), rows_of(hud, throttle=[1]))) == 1


def test_a_message_that_the_dialect_does_not_have_is_refused():
    with pytest.raises(InvalidInputError, match="message id 999999 is not in the dialect"):
        wire_dtype(999_999)


def test_the_layout_of_a_payload_is_that_of_the_wire():
    assert wire_dtype(dialect.MAVLINK_MSG_ID_STATUSTEXT)["text"] == np.dtype("S50")
    assert wire_dtype(dialect.MAVLINK_MSG_ID_STATUSTEXT).itemsize == 54
    cells = wire_dtype(dialect.MAVLINK_MSG_ID_BATTERY_STATUS)["voltages"]
    assert (cells.base, cells.shape) == (np.dtype("<u2"), (10,))
