"""Missions in DataFlash logs: which upload counts, what a multicopter can fly, and the same around another home."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.errors import InvalidInputError, UnreadableError
from mavcal.calib.logs.missions.course import Place, durations, moved, with_take_off
from mavcal.calib.logs.missions.items import LoggedMission, MissionItem
from mavcal.calib.logs.missions.reading import read_mission
from tests.unit.logs import dataflash_file as made

CMD = made.Message(90, "CMD", "QHHHffffLLfB", "TimeUS,CTot,CNum,CId,Prm1,Prm2,Prm3,Prm4,Lat,Lng,Alt,Frame")
OLD_CMD = made.Message(90, "CMD", "IHHHfffffff", "TimeMS,CTot,CNum,CId,Prm1,Prm2,Prm3,Prm4,Lat,Lng,Alt")
MODE = made.Message(91, "MODE", "QMBB", "TimeUS,Mode,ModeNum,Rsn")
EV = made.Message(92, "EV", "QB", "TimeUS,Id")
TAKE_OFF, WAYPOINT, LAND, AUTO, ARMED = 22, 16, 21, 3, 10
HOME = MissionItem(0, WAYPOINT, 0, latitude=47.0, longitude=8.0, altitude=400.0)


def cmd(total: int, number: int, command: int, alt: float = 0.0, **other: Any) -> bytes:
    given = {"Lat": 470_000_000, "Lng": 80_000_000, "Frame": 0 if number == 0 else 3, **other}
    return CMD.rows(1, CTot=total, CNum=number, CId=command, Alt=alt, **given).tobytes()


def upload(height: float, last: int = LAND) -> bytes:
    """Home, take-off, waypoint, an end."""
    items = [(WAYPOINT, 400.0), (TAKE_OFF, height), (WAYPOINT, height), (last, 0.0)]
    return b"".join(cmd(4, number, command, alt) for number, (command, alt) in enumerate(items))


def log(path: Path, *parts: bytes) -> Path:
    head = made.head() + b"".join(m.definition() for m in (CMD, MODE, EV))
    path.write_bytes(head + b"".join(parts))
    return path


def auto() -> bytes:
    return MODE.rows(1, Mode=AUTO, ModeNum=AUTO).tobytes()


def armed() -> bytes:
    return EV.rows(1, Id=ARMED).tobytes()


def test_items_are_those_of_the_log(tmp_path: Path) -> None:
    place = {"Lat": 470_001_000, "Lng": 80_002_000, "Prm1": 2.5}
    file = log(tmp_path / "x.bin", cmd(3, 0, WAYPOINT, 400.0), cmd(3, 1, 22, 5.0), cmd(3, 2, 19, 7.0, **place))
    mission = read_mission(file)
    assert mission.home == HOME
    assert mission.items[1] == MissionItem(2, 19, 3, (2.5, 0.0, 0.0, 0.0), 47.0001, 8.0002, 7.0)
    assert mission.items[1].name == "item 2 (LOITER_TIME)"
    assert mission.last == 1


@pytest.mark.parametrize(
    ("parts", "height"),
    [
        ((upload(5.0), upload(6.0), armed(), auto(), upload(7.0)), 6.0),
        ((auto(), upload(5.0), armed(), upload(6.0)), 5.0),  # AUTO was chosen before arming
        ((armed(), upload(5.0), auto(), upload(6.0)), 5.0),  # a log that begins with arming
        ((upload(5.0), armed(), upload(6.0)), 5.0),
        ((armed(), auto(), upload(5.0), upload(6.0)), 5.0),  # nothing before the flight
        ((upload(5.0), cmd(4, 1, TAKE_OFF, 9.0), armed(), auto(), cmd(4, 2, WAYPOINT, 9.0)), 5.0),  # items begun
        ((upload(5.0), upload(6.0)[:-48], armed(), auto()), 5.0),  # an upload that broke off
    ],
)
def test_the_last_complete_upload_before_the_flight_counts(
    tmp_path: Path, parts: tuple[bytes, ...], height: float
) -> None:
    assert read_mission(log(tmp_path / "x.bin", *parts)).items[0].altitude == height


def test_a_log_without_frames_counts_heights_from_home(tmp_path: Path) -> None:
    rows = [OLD_CMD.rows(1, CTot=3, CNum=k, CId=c, Lat=47.0, Lng=8.0, Alt=a) for k, (c, a) in
            enumerate([(WAYPOINT, 400.0), (TAKE_OFF, 5.0), (LAND, 0.0)])]  # fmt: skip
    path = tmp_path / "x.bin"
    path.write_bytes(made.head() + OLD_CMD.definition() + b"".join(row.tobytes() for row in rows))
    mission = read_mission(path)
    assert [item.frame for item in (mission.home, *mission.items)] == [0, 3, 3]


def test_a_text_log_is_read_too(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    fmt = f"FMT, 90, 48, CMD, {CMD.letters}, {CMD.columns}\n"
    rows = ["1,3,0,16,0,0,0,0,47.0,8.0,400,0", "1,3,1,22,0,0,0,0,0,0,5,3", "1,3,2,20,0,0,0,0,0,0,0,3"]
    path.write_text(fmt + "".join(f"CMD, {row}\n" for row in rows))
    assert [item.command for item in read_mission(path).items] == [22, 20]


@pytest.mark.parametrize(
    ("content", "error", "said"),
    [
        (made.flight(0.5, seed=1), UnreadableError, r"no CMD message.*--mission standard"),
        (b"ULog\x01\x12\x35" + bytes(40), UnreadableError, r"\(no navigator_mission_item.*--mission standard"),
        (b"t,accel_x\n0,1\n", UnreadableError, r"no log of ArduPilot or PX4.*--mission standard"),
        (
            made.head() + CMD.definition() + cmd(0, 0, WAYPOINT),
            InvalidInputError,
            "no complete mission.*messages: 1, items: 0",
        ),
        (made.head() + CMD.definition() + cmd(3, 0, 16) + cmd(3, 2, 16), InvalidInputError, "messages: 2, items: 3"),
    ],
)
def test_a_log_without_a_mission_says_what_is_possible(
    tmp_path: Path, content: bytes, error: type[Exception], said: str
) -> None:
    path = tmp_path / "x.bin"
    path.write_bytes(content)
    with pytest.raises(error, match=said):
        read_mission(path)


def test_a_file_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(UnreadableError, match="cannot be opened"):
        read_mission(tmp_path / "none.bin")


def item(command: int, number: int = 1, **other: Any) -> MissionItem:
    return dataclasses.replace(MissionItem(number, command, 3), **other)


@pytest.mark.parametrize(
    ("refused", "said"),
    [
        (item(17, 4), r"item 4 \(LOITER_UNLIM\)"),
        (item(177, 2), r"item 2 \(DO_JUMP\)"),
        (item(4711, 3), r"item 3 \(command 4711\)"),
        (item(WAYPOINT, 2, frame=10), r"item 2 \(WAYPOINT\) has frame 10"),
        (item(93, 2, parameters=(-1.0, 12.0, 0.0, 0.0)), "time of day"),
        (item(WAYPOINT, 2, parameters=(float("nan"), 0.0, 0.0, 0.0)), "no number"),
        (item(WAYPOINT, 2, latitude=91.0, longitude=1.0), "lies at 91 deg"),
        (item(TAKE_OFF, 2, altitude=float("nan")), "nan m"),
    ],
)
def test_what_a_multicopter_cannot_fly_is_refused_by_number_and_command(refused: MissionItem, said: str) -> None:
    with pytest.raises(InvalidInputError, match=said):
        LoggedMission(HOME, (item(TAKE_OFF), refused))


def test_a_mission_that_moves_nothing_is_none() -> None:
    with pytest.raises(InvalidInputError, match="none of the mission's 1 items"):
        LoggedMission(HOME, (item(178),))


@pytest.mark.parametrize("command", [112, 114, 115, 178, 201, 203])
def test_other_commands_are_passed_on(command: int) -> None:
    told = item(command, 2, parameters=(1.0, 2.0, 3.0, 4.0))
    assert moved(LoggedMission(HOME, (item(TAKE_OFF), told)), Place(10.0, 20.0, 5.0)).items[1] == told


def test_a_take_off_is_added_where_the_mission_begins_in_the_air() -> None:
    high = item(WAYPOINT, frame=0, altitude=412.0)
    added = with_take_off(LoggedMission(HOME, (item(178), high))).items[0]
    assert (added.command, added.frame, added.altitude, added.name) == (22, 3, 12.0, "added TAKEOFF")
    low = with_take_off(LoggedMission(HOME, (item(WAYPOINT, altitude=0.5),)))
    assert low.items[0].altitude == 3.0
    begun = LoggedMission(HOME, (item(178), item(TAKE_OFF, altitude=4.0)))
    assert with_take_off(begun) is begun
    with pytest.raises(InvalidInputError, match=r"item 1 \(LAND\) is the first"):
        with_take_off(LoggedMission(HOME, (item(LAND),)))


places = st.builds(Place, st.floats(-80.0, 80.0), st.floats(-180.0, 179.0), st.floats(-100.0, 5000.0))
offsets = st.floats(-5000.0, 5000.0)


@given(places, places, offsets, offsets, st.floats(-50.0, 500.0))
def test_every_item_keeps_its_metres_from_home(
    before: Place, after: Place, north: float, east: float, up: float
) -> None:
    latitude, longitude = before.at(north, east)
    home = dataclasses.replace(HOME, latitude=before.latitude, longitude=before.longitude, altitude=before.altitude)
    there = {"latitude": latitude, "longitude": longitude}
    items = (
        item(WAYPOINT, frame=0, altitude=before.altitude + up, **there),
        item(WAYPOINT, frame=3, altitude=up, **there),
        item(TAKE_OFF, altitude=up),
    )
    absolute, relative, bare = moved(LoggedMission(home, items), after).items
    for one in (absolute, relative):
        if one.placed:
            assert after.offset(one.latitude, one.longitude) == pytest.approx((north, east), abs=1e-4)
    assert absolute.altitude - after.altitude == pytest.approx(up, abs=1e-6)
    assert (relative.altitude, bare) == (up, items[2])


def test_an_item_takes_as_long_as_its_way_and_its_wait() -> None:
    home = Place(47.0, 8.0, 400.0)
    latitude, longitude = home.at(100.0, 0.0)
    there = {"latitude": latitude, "longitude": longitude, "altitude": 15.0}
    items = (
        item(TAKE_OFF, altitude=15.0), item(WAYPOINT, **there), item(178, parameters=(1.0, 2.0, 0.0, 0.0)),
        item(19, parameters=(7.0, 0.0, 0.0, 0.0), **there), item(18, parameters=(2.0, 0.0, 20.0, 0.0), **there),
        item(93, parameters=(4.0, 0.0, 0.0, 0.0)), item(20),
    )  # fmt: skip
    up, way, change, wait, turns, delay, back = durations(LoggedMission(HOME, items), 5.0)
    assert (up, way, change) == (pytest.approx(13.0), pytest.approx(23.0), 0.0)
    assert (wait, delay) == (pytest.approx(10.0), pytest.approx(7.0))
    assert turns == pytest.approx(3.0 + 2 * 62.8, rel=0.01)
    assert 50.0 < back < 120.0
