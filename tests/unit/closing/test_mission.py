"""The standard mission asks for what a diagnosis needs; the targets say what they should."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect
from scipy.spatial.transform import Rotation

from mavcal.calib.logs.missions.items import LoggedMission, MissionItem
from mavcal.service.closing import autopilot as ways
from mavcal.service.closing.mission import LOW, standard_mission


def test_it_flies_out_and_back_at_two_speeds_along_both_axes() -> None:
    legs = standard_mission().legs
    assert {leg.ahead for leg in legs} == {0.0, 8.0, -8.0, 4.0, -4.0}
    assert {leg.right for leg in legs} == {0.0, 8.0, -8.0, 4.0, -4.0}
    assert {leg.down for leg in legs} >= {-2.0, -3.0, -4.0, 2.0, 3.0, 4.0}


def test_it_turns_leans_rests_and_lands_from_low() -> None:
    mission = standard_mission()
    assert [leg.turn for leg in mission.legs if leg.turn] == [90.0, 180.0, 270.0, 360.0]
    leans = [leg for leg in mission.legs if leg.leans]
    assert sum(leg.roll > 0 for leg in leans) == sum(leg.pitch < 0 for leg in leans) == 3
    assert mission.rest_s >= 5.0
    assert mission.rest_after_s >= 5.0
    assert [leg.until_height for leg in mission.legs if leg.until_height] == [LOW]
    assert 90.0 < mission.seconds < 150.0


def test_the_height_over_all_climbs_is_the_same() -> None:
    assert sum(leg.down * leg.seconds for leg in standard_mission().legs if leg.until_height is None) == 0.0


@pytest.mark.parametrize("euler", [(0.3, -0.2, 2.5), (0.0, 0.0, 0.0), (-0.1, 0.3, -3.0)])
def test_an_attitude_target_is_the_rotation_of_its_angles(euler: tuple[float, float, float]) -> None:
    message = ways.attitude_target(5, (1, 1), euler, 0.5)
    expected = Rotation.from_euler("ZYX", euler[::-1]).as_quat(scalar_first=True)
    np.testing.assert_allclose(np.abs(np.dot(message.q, expected)), 1.0, atol=1e-12)
    assert message.type_mask == 7


def test_a_velocity_target_leaves_position_acceleration_and_yaw_rate_alone() -> None:
    message = ways.velocity_target(5, (1, 1), 1.0, 2.0, 3.0, yaw=math.pi)
    used = [bit for bit in range(12) if not message.type_mask >> bit & 1 and bit != 9]
    assert used == [3, 4, 5, 10]
    assert (message.vx, message.vy, message.vz, message.yaw) == (1.0, 2.0, 3.0, math.pi)


@pytest.mark.parametrize(
    ("number", "kind", "mode", "auto"), [(3, ways.ArduPilot, 4, 3), (12, ways.Px4, 6 << 16, 4 << 16 | 4 << 24)]
)
def test_each_firmware_is_flown_its_own_way(number: int, kind: type[ways.Autopilot], mode: int, auto: int) -> None:
    heartbeat = dialect.MAVLink_heartbeat_message(2, number, 0, 0, 0, 3)
    way = ways.autopilot_of(heartbeat)
    assert isinstance(way, kind)
    assert way.guided == mode
    assert way.auto == auto
    guide = way.guide((1, 1))
    assert (guide.command, guide.param1) == (dialect.MAV_CMD_DO_SET_MODE, 1)
    assert guide.param2 in (4, 6)


def test_a_mission_has_home_for_ardupilot_and_free_headings_for_px4() -> None:
    home = MissionItem(-1, 16, 0, latitude=47.0, longitude=8.0, altitude=400.0)
    item = MissionItem(0, 22, 3, (1.0, 0.0, 0.0, math.nan), 47.0, 8.0, 5.0)
    mission = LoggedMission(home, (item,))
    assert ways.ArduPilot().items(mission) == (home, dataclasses.replace(item, parameters=(1.0, 0.0, 0.0, 0.0)))
    assert ways.Px4().items(mission) == (item,)
