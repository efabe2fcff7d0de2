"""An announced sensor that sends nothing is asked for again before it is called dead: the request may be lost."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.recording import Identity
from mavcal.calib.wire.frames import Frame, FrameParser
from mavcal.service import preflights as module
from mavcal.service.preflights import SILENT_ASKS, _Heard, _silent_asked
from tests.unit.jobs.fakes import FakeVehicle

FIRST = dialect.MAVLink_scaled_imu_message(1000, 0, 0, -1000, 0, 0, 0, 0, 0, 0)
SECOND = dialect.MAVLink_scaled_imu2_message(1000, 0, 0, -1000, 0, 0, 0, 0, 0, 0)
BOTH = {"CAL_ACC0_ID": 1, "CAL_ACC1_ID": 2}


class Lossy(FakeVehicle):
    """Its second unit's request is heard at the `heard_at`-th time."""

    def __init__(self, heard: _Heard, heard_at: int) -> None:
        super().__init__({}, identity=Identity("px4", system=1, component=1))
        self.heard, self.heard_at, self.asked = heard, heard_at, 0

    def demand_streams(self, rates: Mapping[int, float]) -> float:
        self.asked += 1
        if self.asked == self.heard_at:
            self.heard.frames.append(frame(SECOND))
        return super().demand_streams(rates)


def frame(message: dialect.MAVLink_message) -> Frame:
    (found,) = FrameParser().feed(message.pack(dialect.MAVLink(None, srcSystem=1, srcComponent=1)))
    return found


@pytest.mark.parametrize(
    ("heard_at", "parameters", "asked"), [(3, BOTH, 3), (99, BOTH, SILENT_ASKS), (99, {"CAL_ACC0_ID": 1}, 0)]
)
async def test_streams_of_announced_sensors_are_asked_for_until_they_come(heard_at, parameters, asked, monkeypatch):
    monkeypatch.setattr(module, "LOOK_S", 0.0)
    vehicle = Lossy(_Heard(frames=[frame(FIRST)], parameters=parameters), heard_at)
    await _silent_asked(vehicle, {dialect.MAVLINK_MSG_ID_SCALED_IMU2: 50.0}, (), vehicle.heard)
    assert vehicle.asked == asked
