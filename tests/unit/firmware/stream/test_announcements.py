"""Arming, calibrations, versions and texts are read from the frames of one vehicle."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.firmware.stream.announcements import Announcements
from mavcal.calib.recording import Identity
from mavcal.calib.wire.frames import FrameParser


def frame(message):
    """One frame over the wire."""
    (found,) = FrameParser().feed(message.pack(dialect.MAVLink(None, 1, 1)))
    return found


@pytest.fixture
def listener():
    return Announcements(Identity(autopilot="ardupilot", uid="old"))


def told(listener, message, t=5.0):
    return [(e.t, e.kind, e.text) for e in listener.feed(t, frame(message))]


def heartbeat(*, autopilot=dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, mode=0, status=3, kind=2):
    return dialect.MAVLink_heartbeat_message(kind, autopilot, mode, 0, status, 3)


def test_a_heartbeat_says_whose_it_is_and_a_station_s_says_nothing(listener):
    assert told(listener, heartbeat(autopilot=dialect.MAV_AUTOPILOT_PX4, kind=13)) == []
    assert (listener.identity.autopilot, listener.identity.vehicle_type) == ("px4", 13)
    assert told(listener, heartbeat(autopilot=dialect.MAV_AUTOPILOT_INVALID, kind=6, mode=128, status=2)) == []
    assert (listener.identity.autopilot, listener.identity.vehicle_type) == ("px4", 13)
    told(listener, heartbeat(autopilot=dialect.MAV_AUTOPILOT_GENERIC))
    assert listener.identity.autopilot == "other"


def test_arming_is_told_when_it_changes(listener):
    modes = [128 + 1, 128, 1, 0, 128]
    found = [told(listener, heartbeat(mode=mode), t) for t, mode in enumerate(modes)]
    assert [[(t, kind) for t, kind, _ in events] for events in found] == [
        [],
        [],
        [(2.0, "disarmed")],
        [],
        [(4.0, "armed")],
    ]


def test_a_calibration_of_its_own_is_told_when_it_begins(listener):
    found = [told(listener, heartbeat(status=status), t) for t, status in enumerate([2, 2, 3, 2])]
    event = "onboard_calibration", "the vehicle says that it is calibrating"
    assert found == [[(0.0, *event)], [], [], [(3.0, *event)]]


def version(packed, *, uid=0, uid2=()):
    uid2 = [*uid2, *[0] * (18 - len(uid2))]
    return dialect.MAVLink_autopilot_version_message(0, packed, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, uid, uid2)


def test_the_version_is_three_bytes_and_the_longer_id_counts(listener):
    told(listener, version(0x04A76103))
    assert (listener.identity.firmware, listener.identity.uid) == ((4, 167, 97), "old")
    told(listener, version(0x04000000, uid=0xABC))
    assert listener.identity.uid == "0000000000000abc"
    told(listener, version(0x04000000, uid=0xABC, uid2=(1, 0, 0xFF)))
    assert listener.identity.uid == "0100ff"
    assert listener.identity.autopilot == "ardupilot"


def text(said, *, id_=0, chunk=0):
    return dialect.MAVLink_statustext_message(6, said.encode(), id_, chunk)


def test_texts_are_events_and_those_of_a_calibration_are_its(listener):
    assert told(listener, text("hello")) == [(5.0, "text", "hello")]
    assert told(listener, text("x [cal] done")) == [(5.0, "onboard_calibration", "x [cal] done")]
    assert told(listener, text("a" * 50)) == [(5.0, "text", "a" * 50)]  # without a number it is whole


def test_a_long_text_is_told_when_its_last_chunk_has_come(listener):
    assert told(listener, text("a" * 50, id_=7)) == []
    assert told(listener, text("b" * 50, id_=8)) == []
    assert told(listener, text("c" * 50, id_=7, chunk=1)) == []
    assert told(listener, text("end", id_=7, chunk=2)) == [(5.0, "text", "a" * 50 + "c" * 50 + "end")]
    assert told(listener, text("new", id_=8)) == [(5.0, "text", "new")]  # another id is another text
    assert told(listener, text("rest", id_=9, chunk=3)) == [(5.0, "text", "rest")]


def test_a_character_that_lies_in_two_chunks_is_one_character(listener):
    whole = ("a" * 49 + "°C").encode()
    first, last = (dialect.MAVLink_statustext_message(6, part, 7, k) for k, part in enumerate((whole[:50], whole[50:])))
    assert told(listener, first) == []
    assert told(listener, last) == [(5.0, "text", whole.decode())]


def test_a_compass_calibration_is_told_but_of_px4(listener):
    report = dialect.MAVLink_mag_cal_report_message(1, 3, 4, 1, 0.5, *[0.0] * 9)
    assert told(listener, report) == [(5.0, "onboard_calibration", "MAG_CAL_REPORT of compass 2")]
    progress = dialect.MAVLink_mag_cal_progress_message(0, 1, 2, 1, 50, [0] * 10, 0.0, 0.0, 0.0)
    assert told(listener, progress) == [(5.0, "onboard_calibration", "MAG_CAL_PROGRESS of compass 1")]
    told(listener, heartbeat(autopilot=dialect.MAV_AUTOPILOT_PX4))
    assert told(listener, report) == []


def test_a_pose_that_is_asked_for_is_a_calibration_and_other_commands_are_not(listener):
    pose = dialect.MAV_CMD_ACCELCAL_VEHICLE_POS
    asks = dialect.MAVLink_command_long_message(255, 0, pose, 0, 1.0, *[0.0] * 6)
    said = "the vehicle asks for a pose of its own accelerometer calibration"
    assert told(listener, asks) == [(5.0, "onboard_calibration", said)]
    other = dialect.MAVLink_command_long_message(255, 0, pose + 1, 0, 1.0, *[0.0] * 6)
    assert told(listener, other) == []
    assert len(listener.message_ids) == 6
