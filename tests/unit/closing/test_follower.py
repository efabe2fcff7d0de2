"""Whom the follower does not fly: another firmware than the log's, and vehicles that do not know where they are."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.logs.missions.items import LoggedMission, MissionItem
from mavcal.service.closing.conversation import Conversation
from mavcal.service.closing.errors import MissionRefused, SimulatorUnarmed
from mavcal.service.closing.follower import Follower
from mavcal.service.closing.mission import LogMission

HOME = MissionItem(0, 16, 0, latitude=47.0, longitude=8.0, altitude=400.0)
MISSION = LogMission(LoggedMission(HOME, (MissionItem(1, 22, 3, altitude=5.0), MissionItem(2, 21, 3))))


class Ticking:
    """A vehicle whose clock moves by a second at each look, and that says nothing else."""

    def __init__(self, autopilot: int) -> None:
        self.heartbeat = dialect.MAVLink_heartbeat_message(2, autopilot, 0, 0, 0, 3)
        self.target = (1, 1)
        self._ms = 1000

    def poll(self) -> list[Any]:
        self._ms += 1000
        return [dialect.MAVLink_attitude_message(self._ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)]

    def send(self, _message: Any) -> None:
        """Nobody listens."""


@pytest.mark.parametrize(
    ("autopilot", "error", "said"),
    [
        (dialect.MAV_AUTOPILOT_PX4, MissionRefused, r"log of ArduPilot, and the simulator is PX4.*--mission standard"),
        (dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, SimulatorUnarmed, r"no home position within 150 s.*--mission standard"),
    ],
)
def test_a_vehicle_that_cannot_fly_a_logs_mission_is_told(autopilot: int, error: type[Exception], said: str) -> None:
    vehicle = Conversation(Ticking(autopilot), lambda: None, lambda *_: None)  # type: ignore[arg-type]
    with pytest.raises(error, match=said):
        Follower(vehicle, MISSION).fly()


def test_its_length_is_told_with_its_rest() -> None:
    assert MISSION.seconds == pytest.approx(10.0 + 5.0 / 1.5 + 3.0 + 3.0 + 5.0 / 0.4 + 3.0 + 7.0)
