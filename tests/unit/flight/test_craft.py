"""Only aircraft fly, and a vehicle of any kind rests."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.flight.craft import Craft, craft_of
from mavcal.calib.flight.rest import Known, ground
from mavcal.calib.mag.motor_drives import Drive, DriveKind
from mavcal.calib.methods.overview import overview
from mavcal.calib.recording import Channel, Identity, Recording, Sensor, Stage
from tests.unit.flight.made import Unit, log

COPTER, PLANE, ROVER, BOAT, SUB, VTOL = 2, 1, 10, 11, 12, 20


def sentences(document):
    """Every text of an answer."""
    if isinstance(document, dict):
        for value in document.values():
            yield from sentences(value)
    elif isinstance(document, (list, tuple)):
        for value in document:
            yield from sentences(value)
    elif isinstance(document, str):
        yield document


@pytest.mark.parametrize(
    ("kind", "craft"),
    [(COPTER, Craft.AIR), (PLANE, Craft.AIR), (VTOL, Craft.AIR), (ROVER, Craft.GROUND), (BOAT, Craft.WATER),
     (SUB, Craft.WATER), (None, Craft.UNKNOWN)],
)  # fmt: skip
def test_the_kind_of_vehicle_is_known_by_its_type(kind, craft):
    assert craft_of(Identity("ardupilot", kind)) == craft


@pytest.mark.parametrize("kind", [ROVER, BOAT, SUB])
def test_nothing_that_is_said_of_a_rover_or_a_boat_flies(kind):
    moved = log([Unit(), Unit()], (30.0, 40.0), seed=1)
    made = dataclasses.replace(moved, identity=Identity("ardupilot", kind))
    texts = [text for text in sentences(overview(made)) if "mavcal fit" not in text and "mag-flight" not in text]
    flying = [
        text for text in texts if any(word in text for word in ("in flight", "flew", "the flight", "a flight", "fly "))
    ]
    assert flying == []


def test_a_reversible_motor_that_rests_is_off_and_runs_either_way():
    t = np.arange(0.0, 60.0, 0.1)
    backward = np.where((t > 20.0) & (t < 40.0), -0.4, 0.0)
    accel = Channel(Sensor.ACCEL, 0, t, np.tile([0.0, 0.0, -9.8], (len(t), 1)), "m/s2", Stage.FILTERED, "IMU")
    motor = Channel(Sensor.MOTOR, 0, t, backward, "1", Stage.RAW, "RCOU")
    stood = ground(Recording((accel, motor), identity=Identity("ardupilot", ROVER)))
    assert stood.known == Known.MOTORS
    assert [(round(s.start), round(s.end)) for s in stood.running] == [(20, 40)]


def test_the_throttle_of_a_sub_rests_at_half():
    t = np.arange(0.0, 60.0, 0.1)
    throttle = Channel(Sensor.THROTTLE, 0, t, np.where(t > 30.0, 0.3, 0.5), "1", Stage.RAW, "VFR_HUD")
    for kind, start in ((SUB, 30.0), (COPTER, 0.0)):
        running = ground(Recording((throttle,), identity=Identity("ardupilot", kind))).running
        assert [round(s.start) for s in running] == [start]


def test_the_field_of_a_reversible_thruster_follows_its_drive_and_the_square_of_it():
    t = np.arange(0.0, 60.0, 0.1)
    both, forward = np.sin(t), np.abs(np.sin(t))
    drive = Drive.of(
        DriveKind.MOTORS, Channel(Sensor.MOTOR, 0, t, np.column_stack([both, forward]), "1", Stage.RAW, "R")
    )
    assert drive is not None
    assert (drive.numbers, drive.squares) == ((1, 1, 2), (False, True, False))
    np.testing.assert_allclose(drive.values, np.column_stack([both, both**2, forward]))
