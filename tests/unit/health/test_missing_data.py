"""What a log lacks, by the names of the parameters that change it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.health.report import health
from mavcal.calib.methods.overview import overview
from mavcal.calib.recording import Channel, Event, Identity, ParameterTimeline, Recording, Sensor, Stage
from tests.unit.health.made import CALIBRATED, flight

COPTER, PLANE, ROVER = 2, 1, 10


def lacks(recording, kind=COPTER, mask=None, autopilot="ardupilot"):
    parameters = dict(CALIBRATED) if mask is None else {**CALIBRATED, "LOG_BITMASK": mask}
    made = dataclasses.replace(
        recording, identity=Identity(autopilot, kind), parameters=ParameterTimeline.constant(parameters)
    )
    return " / ".join(health(made).lacks)


def without(*sensors):
    recording = flight(1)
    return recording.with_channels(c for c in recording.channels if c.sensor not in sensors)


def test_the_bit_of_the_vehicle_s_own_kind_is_named():
    for kind, bit in ((COPTER, 13), (PLANE, 10), (ROVER, 11)):
        said = lacks(without(Sensor.MAG), kind)
        assert "Set LOG_BITMASK" in said
        assert f"bit {bit} (Compass)" in said
    unnamed = lacks(without(Sensor.MAG), None)
    assert '"Compass"' in unnamed
    assert "(Compass)" not in unnamed
    px4 = lacks(without(Sensor.MAG), autopilot="px4")
    assert "Set SDLOG_PROFILE" in px4
    assert "bit 6" in px4


@pytest.mark.parametrize(
    ("sensor", "bit", "mask", "is_set"),
    [
        (Sensor.ATTITUDE, 0, 0.0, False),
        (Sensor.ATTITUDE, 0, 65535.0, True),
        (Sensor.POSITION, 2, -22530.0, True),  # 16 signed bits
    ],
)
def test_a_bit_that_is_set_is_not_asked_for_again(sensor, bit, mask, is_set):
    (said,) = (text for text in lacks(without(sensor), mask=mask).split(" / ") if f"LOG_BITMASK bit {bit}" in text)
    assert ("Set LOG_BITMASK" not in said) is is_set


def test_everything_that_can_be_missing_is_said_with_what_it_would_tell():
    bare = without(Sensor.ATTITUDE, Sensor.POSITION, Sensor.TEMPERATURE, Sensor.THROTTLE, Sensor.VIBRATION, Sensor.MAG)
    said = lacks(bare)
    for name in ("attitude:", "position:", "temperature of", "battery current or throttle:", "VIBE:", "compass:"):
        assert name in said
    slow = bare.with_channels(c.take(slice(None, None, 25)) for c in bare.channels)
    assert "inertial samples at 20 Hz or more (it has 2)" in lacks(slow)
    assert "Set LOG_BITMASK bit 18 (Fast IMU)" in lacks(slow)


def test_a_log_that_begins_armed_is_asked_for_its_rest_by_the_parameter_of_its_autopilot():
    armed = dataclasses.replace(flight(1), events=(Event(0.0, "armed", ""),))
    assert "Set LOG_DISARMED 1" in lacks(armed)
    assert "SDLOG_MODE" not in lacks(armed)
    assert "Set SDLOG_MODE 2" in lacks(armed, autopilot="px4")


def test_a_current_that_reads_zero_is_no_current():
    recording = flight(1)
    current = dataclasses.replace(
        next(c for c in recording.channels if c.sensor == Sensor.THROTTLE), sensor=Sensor.CURRENT, unit="A"
    )
    zero = dataclasses.replace(current, values=0.0 * current.values)
    assert "battery current, which reads 0 throughout" in lacks(recording.with_channels([*recording.channels, zero]))
    assert "battery current" not in lacks(recording.with_channels([*recording.channels, current]))


def test_losses_of_the_logger_are_said():
    drops = tuple(Event(40.0 + k, "drop", "the vehicle could not write 12 messages of this log") for k in range(3))
    recording = flight(1)
    assert drops[0].text in lacks(dataclasses.replace(recording, events=(*recording.events, drops[0])))
    several = lacks(dataclasses.replace(recording, events=(*recording.events, *drops)))
    assert "3 stretches" in several
    assert "40.0 s" in several


def streamed(kind=COPTER, parameters=None, firmware=None, autopilot="ardupilot", rate=2.0):
    """What telemetry at `rate` brings of a flight: rounded inertial samples and attitudes."""
    t = np.arange(0.0, 120.0, 1.0 / rate)
    noise = np.random.default_rng(3).integers(-2, 3, (len(t), 3))
    channels = [
        Channel(Sensor.ACCEL, 0, t, 0.0098 * noise + [0.0, 0.0, -9.8], "m/s2", Stage.FILTERED, "RAW_IMU", 0.0098),
        Channel(Sensor.GYRO, 0, t, 1e-3 * noise, "rad/s", Stage.FILTERED, "RAW_IMU", 1e-3),
    ]
    timeline = ParameterTimeline.constant({**CALIBRATED, "LOG_BITMASK": 65535.0, **(parameters or {})})
    return Recording(tuple(channels), identity=Identity(autopilot, kind, firmware), parameters=timeline)


@pytest.mark.parametrize(
    ("vehicle", "name"),
    [
        ({"parameters": {"SR0_RAW_SENS": 2.0}}, "Raise SR0_RAW_SENS to 20 (it is 2)"),
        ({"parameters": {"SR0_RAW_SENS": 2.0, "SR1_EXTRA1": 4.0}}, "Raise SRn_RAW_SENS to 20"),
        ({"parameters": {"MAV1_RAW_SENS": 2.0}}, "Raise MAV1_RAW_SENS to 20 (it is 2)"),
        ({"firmware": (4, 7, 0)}, "Raise MAVn_RAW_SENS to 20"),
        ({"firmware": (4, 5, 7)}, "Raise SRn_RAW_SENS to 20"),
        ({"autopilot": "px4"}, "Ask for SCALED_IMU at 20 Hz or more (SET_MESSAGE_INTERVAL), or set MAV_n_MODE"),
    ],
)
def test_what_telemetry_lacks_is_mended_by_its_stream_rates(vehicle, name):
    recording = streamed(**vehicle)
    answer = str(overview(recording))
    assert name in answer
    assert not any(
        word in answer for word in ("LOG_BITMASK", "SDLOG", "INS_LOG", "LOG_DISARMED", "this firmware does not log")
    )


def test_a_rest_in_slow_telemetry_is_called_too_slow_to_use_and_no_flight():
    answer = str(overview(streamed()))
    assert "2 Hz are too slow to tell a rest: 8 Hz are needed" in answer
    assert "while motionless" in answer
    assert "in flight; gravity" not in answer
    assert "no rest of" not in answer
    assert "too slow" not in str(overview(streamed(rate=25.0)))
