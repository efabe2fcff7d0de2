"""An autopilot that learns a compass's offset says so, or writes a parameter."""

from __future__ import annotations

from mavcal.calib.firmware.in_force.rewritten import compass_offset_changes
from mavcal.calib.recording import Event, ParameterEntry, ParameterTimeline, Recording

SAID = "[vehicle_magnetometer] 1 (197388) EST:0 offset: [0.000, 0.000, 0.000]->[0.047, -0.029, 0.000]"


def test_what_px4_says_when_it_disarms_is_a_change():
    recording = Recording((), events=(Event(155.44, "text", SAID), Event(3.0, "text", "[commander] offset: none")))
    assert compass_offset_changes(recording) == {1: (155.44,)}


def test_parameters_of_either_autopilot_count_once_they_change():
    entries = [
        ParameterEntry(0.0, "COMPASS_OFS_X", 3.0),
        ParameterEntry(0.0, "COMPASS_OFS2_Y", 1.0),
        ParameterEntry(0.0, "CAL_MAG0_ZOFF", 0.0),
        ParameterEntry(20.0, "COMPASS_OFS2_Y", 4.0),
        ParameterEntry(30.0, "COMPASS_OFS_X", 3.0),
        ParameterEntry(40.0, "CAL_MAG0_ZOFF", 0.1),
    ]
    recording = Recording((), parameters=ParameterTimeline(tuple(entries)))
    assert compass_offset_changes(recording) == {0: (40.0,), 1: (20.0,)}
