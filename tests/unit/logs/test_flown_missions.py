"""The mission in logs of PX4: what its navigator named is flown, what it adds at an end is not."""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

import pytest

from mavcal.calib.errors import InvalidInputError, UnreadableError
from mavcal.calib.logs.missions.course import Place
from mavcal.calib.logs.missions.items import Frame, NavCommand
from mavcal.calib.logs.missions.reading import read_mission
from tests.unit.logs.ulog_file import UlogFile

HOME = Place(47.39774488975114, 8.545597895702942, 489.9)
MISSION, HOLD, RTL = 3, 4, 5
SECOND = 1_000_000
ITEM = (
    "float latitude;float longitude;float time_inside;float acceptance_radius;float yaw;float altitude;"
    "uint16_t sequence_current;uint16_t nav_cmd;uint8_t altitude_is_relative;"
)
COMMAND = "double param5;double param6;float param1;float param2;float param3;float param4;float param7;"


class Flight:
    """A log that is written as the flight goes on; times in s."""

    def __init__(self, *, without: str = "") -> None:
        self.log = UlogFile()
        topics = {
            "vehicle_status": "uint8_t nav_state;uint8_t arming_state;",
            "home_position": "double lat;double lon;float alt;",
            "navigator_mission_item": ITEM,
            "position_setpoint_triplet": "double current.lat;double current.lon;",
            "vehicle_command": f"{COMMAND}uint32_t command;uint8_t from_external;",
        }
        self._number = {name: self.log.topic(name, fields) for name, fields in topics.items() if name != without}
        self.home(HOME.altitude, 1.0)

    def _row(self, name: str, t: float, *values: float) -> None:
        if name in self._number:
            self.log.row(self._number[name], round(t * SECOND), *values)

    def home(self, altitude: float, t: float) -> None:
        self._row("home_position", t, HOME.latitude, HOME.longitude, altitude)

    def mode(self, number: int, t: float) -> None:
        self._row("vehicle_status", t, number, 2)

    def item(
        self, t: float, number: int, command: int, altitude: float = 10.0, *, north: float = 0.0, relative: bool = True,
        waits: float = 0.0, yaw: float = math.nan, exact: bool = True,
    ) -> None:  # fmt: skip
        latitude, longitude = HOME.at(north, 0.0)
        self._row(
            "navigator_mission_item", t, latitude, longitude, waits, 0.0, yaw, altitude, number, command, int(relative)
        )
        if exact:
            self._row("position_setpoint_triplet", t + 0.05, latitude, longitude)

    def command(self, t: float, number: int, *p: float, external: bool = False) -> None:
        first, second, third, fourth, fifth, sixth, seventh = (*p, *(0.0,) * (7 - len(p)))
        self._row("vehicle_command", t, fifth, sixth, first, second, third, fourth, seventh, number, int(external))

    def read(self, folder: Path) -> Any:
        file = folder / "flight.ulg"
        file.write_bytes(self.log.bytes)
        return read_mission(file)


def flight(**other: Any) -> Flight:
    """Up, 20 m north at another speed, 5 s there, and an end in the air."""
    made = Flight(**other)
    made.mode(HOLD, 2.0)
    made.item(5.0, 0, 16)  # looked at before it was flown
    made.mode(MISSION, 10.0)
    made.item(10.0, 0, 22, HOME.altitude + 10.0, relative=False)
    made.item(20.0, 0, 16)
    made.command(29.0, 178, 1.0, 3.0, -1.0)
    made.item(29.0, 2, 19, 12.0, north=20.0, waits=5.0)
    made.item(60.0, 2, 17, HOME.altitude + 12.0, north=20.0, relative=False)
    return made


def test_what_was_begun_in_mission_mode_is_the_mission(tmp_path: Path) -> None:
    mission = flight().read(tmp_path)
    assert mission.autopilot == "px4"
    assert [(one.number, one.command) for one in mission.items] == [(0, 22), (1, 16), (2, 178), (3, 19)]
    assert [one.frame for one in mission.items] == [Frame.GLOBAL, Frame.RELATIVE, Frame.MISSION, Frame.RELATIVE]
    assert mission.items[2].parameters == (1.0, 3.0, -1.0, 0.0)
    assert mission.items[3].parameters[0] == 5.0
    assert math.isnan(mission.items[3].parameters[3])  # the heading is free
    assert (mission.home.latitude, mission.home.longitude) == (HOME.latitude, HOME.longitude)


@pytest.mark.parametrize(("exact", "error_m"), [(True, 1e-6), (False, 0.3)])
def test_places_are_those_of_the_setpoints(tmp_path: Path, exact: bool, error_m: float) -> None:
    made = Flight()
    made.mode(MISSION, 10.0)
    made.item(10.0, 0, 22, exact=exact)
    made.item(20.0, 1, 16, north=20.0, exact=exact)
    made.item(30.0, 2, 21, 0.0, north=20.0, exact=exact)
    mission = made.read(tmp_path)
    north, east = HOME.offset(mission.items[1].latitude, mission.items[1].longitude)
    assert abs(north - 20.0) < error_m
    assert abs(east) < error_m
    assert error_m < 0.1 or abs(north - 20.0) > 1e-3  # a float32 alone would be told from a double


def test_what_is_named_anew_is_one_item(tmp_path: Path) -> None:
    """Headings that follow a region of interest, and a pilot who holds it and lets it go on."""
    made = Flight()
    made.mode(MISSION, 10.0)
    made.item(10.0, 0, 22)
    made.item(15.0, 1, 16, north=20.0, yaw=0.1)
    made.item(16.0, 1, 16, north=20.0, yaw=0.2)
    made.mode(HOLD, 17.0)
    made.item(17.1, 1, 17, north=15.0)
    made.mode(MISSION, 20.0)
    made.item(20.0, 1, 31, 12.0, north=15.0)  # climbs where it is
    made.item(22.0, 1, 16, north=20.0, yaw=0.3)
    made.item(30.0, 2, 21, 0.0)
    made.item(40.0, 2, 0)
    assert [one.command for one in made.read(tmp_path).items] == [22, 16, 21]


def test_home_is_that_of_the_flight(tmp_path: Path) -> None:
    """Its altitude follows the receiver."""
    made = flight()
    for k, altitude in enumerate((490.0, 492.0, 491.0)):
        made.home(altitude, 15.0 + k)
    made.home(480.0, 70.0)
    assert made.read(tmp_path).home.altitude == 491.0


def test_a_return_is_part_of_it_where_the_mission_says_so(tmp_path: Path) -> None:
    made = flight()
    made.command(70.0, NavCommand.RETURN_TO_LAUNCH)
    made.mode(RTL, 70.1)
    made.item(71.0, 2, 16, 30.0)  # of the way home
    assert [one.command for one in made.read(tmp_path).items] == [22, 16, 178, 19, 20]


def test_a_pilots_command_is_none_of_the_mission(tmp_path: Path) -> None:
    made = flight()
    made.command(40.0, 178, 1.0, 9.0, external=True)
    made.command(41.0, 1000)
    assert [one.command for one in made.read(tmp_path).items] == [22, 16, 178, 19]


@pytest.mark.parametrize(
    ("without", "said"),
    [
        ("navigator_mission_item", r"which mission it flew \(no navigator_mission_item\).*PX4 1.11.*SDLOG_PROFILE"),
        ("home_position", r"no home_position"),
        ("vehicle_status", r"no vehicle_status"),
    ],
)
def test_a_log_that_does_not_say_it_is_refused(tmp_path: Path, without: str, said: str) -> None:
    with pytest.raises(UnreadableError, match=rf"{said}.*--mission standard"):
        flight(without=without).read(tmp_path)


def test_a_flight_without_a_mission_says_so(tmp_path: Path) -> None:
    made = Flight()
    made.mode(HOLD, 2.0)
    made.item(5.0, 0, 16)
    with pytest.raises(UnreadableError, match=r"never in AUTO\.MISSION.*--mission standard"):
        made.read(tmp_path)


def test_what_cannot_be_flown_is_named(tmp_path: Path) -> None:
    made = flight()
    made.mode(MISSION, 61.0)
    made.item(62.0, 3, 17, north=90.0)
    with pytest.raises(InvalidInputError, match=r"item 4 \(LOITER_UNLIM\)"):
        made.read(tmp_path)


def test_a_log_without_a_setpoint_or_a_command_still_has_its_items(tmp_path: Path) -> None:
    assert len(flight(without="position_setpoint_triplet").read(tmp_path).items) == 4
    assert len(flight(without="vehicle_command").read(tmp_path).items) == 3


def test_a_damaged_log_is_no_crash(tmp_path: Path) -> None:
    file = tmp_path / "x.ulg"
    file.write_bytes(flight().log.bytes[:40] + struct.pack("<I", 7))
    with pytest.raises(UnreadableError):
        read_mission(file)
