"""AUTO of the flying vehicle: what it flies of a mission, what it logs of it, and when it does not."""

from __future__ import annotations

from pathlib import Path

import pytest

from mavcal.calib.logs.missions.reading import read_mission
from mavcal.service.simvehicle.flight.items import Command, Item, MissionState
from mavcal.service.simvehicle.flight.modes import Mode
from tests.unit.simvehicle.flights import Flight

LATITUDE, LONGITUDE, ALTITUDE = -35.363261, 149.16523, 584.0
NORTH = 2e-4
"""deg: 22 m."""
HOME = Item(16, 0, (0.0,) * 4, LATITUDE, LONGITUDE, ALTITUDE)


def item(command: Command, altitude: float = 0.0, north: float = 0.0, *p: float, frame: int = 3) -> Item:
    first, second, third, fourth = (*p, *(0.0,) * (4 - len(p)))
    place = (LATITUDE + north, LONGITUDE) if north else (0.0, 0.0)
    return Item(command, frame, (first, second, third, fourth), *place, altitude)


UP = item(Command.TAKEOFF, 4.0)


class AutoFlown:
    """A mission flown to its end, and when each item was reached, s after boot."""

    def __init__(self, log: Path, *items: Item) -> None:
        self.flight = Flight(log)
        self.reached: dict[int, float] = {}
        self.highest = 0.0
        vehicle = self.flight.vehicle
        vehicle.load_mission([HOME, *items])
        vehicle.auto.reached = lambda number: self.reached.update({number: vehicle.time})
        self.flight.wait(6.0)
        assert vehicle.set_mode(Mode.GUIDED)
        assert vehicle.arm()
        assert vehicle.start_mission()

    def to_the_end(self, most_s: float = 90.0) -> AutoFlown:
        """Until it disarms; the log ends then."""
        vehicle = self.flight.vehicle
        end = vehicle.time + most_s
        while vehicle.armed and vehicle.time < end:
            self.flight.wait(0.5)
            self.highest = max(self.highest, -vehicle.airframe.place[2])
        self.flight.close()
        return self


def test_it_flies_every_item_and_disarms_where_it_lands(tmp_path: Path) -> None:
    speed, wait = item(Command.CHANGE_SPEED, 0.0, 0.0, 1.0, 4.0), item(Command.LOITER_TIME, 5.0, NORTH, 3.0)
    high = item(Command.WAYPOINT, ALTITUDE + 5.0, NORTH, frame=0)
    flown = AutoFlown(tmp_path / "x.bin", UP, speed, high, wait, item(Command.LAND)).to_the_end()
    vehicle = flown.flight.vehicle
    assert list(flown.reached) == [1, 3, 4, 5]
    assert flown.reached[3] - flown.reached[1] > 22.0 / 4.0
    assert flown.reached[4] - flown.reached[3] == pytest.approx(3.0, abs=1.0)
    assert not vehicle.armed
    assert vehicle.auto.state is MissionState.COMPLETE
    assert vehicle.airframe.place[0] == pytest.approx(22.3, abs=2.5)
    mission = read_mission(tmp_path / "x.bin")
    assert [one.command for one in mission.items] == [22, 178, 16, 19, 21]
    assert mission.items[2].altitude == ALTITUDE + 5.0
    assert mission.items[3].parameters[0] == 3.0


def test_it_returns_home_above_the_height_of_returning(tmp_path: Path) -> None:
    flown = AutoFlown(tmp_path / "x.bin", UP, item(Command.WAYPOINT, 4.0, NORTH), item(Command.RETURN_TO_LAUNCH))
    flown.to_the_end()
    assert not flown.flight.vehicle.armed
    assert flown.highest == pytest.approx(15.0, abs=1.0)
    assert flown.flight.vehicle.airframe.place[0] == pytest.approx(0.0, abs=2.5)


def test_after_the_last_item_it_stays_in_the_air(tmp_path: Path) -> None:
    delay, yaw = item(Command.DELAY, 0.0, 0.0, 2.0), item(Command.CONDITION_YAW, 0.0, 0.0, 90.0)
    flown = AutoFlown(tmp_path / "x.bin", UP, delay, yaw).to_the_end(15.0)
    vehicle = flown.flight.vehicle
    assert vehicle.armed
    assert vehicle.auto.state is MissionState.COMPLETE
    assert -vehicle.airframe.place[2] == pytest.approx(4.0, abs=0.7)


def test_it_lands_and_goes_on_where_the_mission_does(tmp_path: Path) -> None:
    flown = AutoFlown(tmp_path / "x.bin", UP, item(Command.LAND), UP, item(Command.LAND)).to_the_end()
    assert list(flown.reached) == [1, 2, 3, 4]
    assert not flown.flight.vehicle.armed


def test_auto_needs_a_take_off_on_the_ground(tmp_path: Path) -> None:
    flight = Flight(tmp_path / "x.bin")
    said: list[str] = []
    flight.vehicle.say = lambda _severity, text: said.append(text)
    assert not flight.vehicle.set_mode(Mode.AUTO)
    flight.vehicle.load_mission([HOME, item(Command.WAYPOINT, 4.0, NORTH)])
    assert not flight.vehicle.set_mode(Mode.AUTO)
    assert said == ["Auto: No mission", "Auto: Missing Takeoff Cmd"]
    flight.vehicle.load_mission([HOME, UP])
    assert not flight.vehicle.start_mission()
    flight.vehicle.load_mission([])
    assert flight.vehicle.auto.state is MissionState.NO_MISSION
    flight.close()
