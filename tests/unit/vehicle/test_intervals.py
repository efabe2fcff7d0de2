"""Intervals of many messages at once: on links that lose, on firmwares that refuse, round or stay silent."""

from __future__ import annotations

from collections.abc import Iterable
from random import Random
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.errors import VehicleSilent
from mavcal.service.vehicle import commands
from mavcal.service.vehicle.intervals import get_intervals, set_intervals
from tests.unit.vehicle.fake import FakeVehicle, ack

IDS = (26, 27, 29, 105, 116, 129, 191, 192)
GET, SET, REQUEST = commands.GET_MESSAGE_INTERVAL, commands.SET_MESSAGE_INTERVAL, commands.REQUEST_MESSAGE


class Firmware:
    """Has an interval for each message; loses what it hears and says by a chance."""

    def __init__(self, fake: FakeVehicle, *, loss: float = 0.0, seed: int = 1) -> None:
        self.intervals = dict.fromkeys(IDS, -1)
        self.refuse: set[int] = set()
        self.least_us = 0
        self.answers = {GET, REQUEST}
        self._loss, self._chance = loss, Random(seed)
        fake.link.respond = self.respond

    def respond(self, message: Any) -> Iterable[Any]:
        if message.get_type() != "COMMAND_LONG" or self._lost():
            return []
        return [reply for reply in self._replies(message) if not self._lost()]

    def _lost(self) -> bool:
        return self._chance.random() < self._loss

    def _replies(self, message: Any) -> list[Any]:
        if message.command == SET:
            number = int(message.param1)
            if number in self.refuse:
                return [ack(SET, commands.DENIED)]
            asked = int(message.param2)
            self.intervals[number] = max(asked, self.least_us) if asked > 0 else asked
            return [ack(SET, commands.ACCEPTED)]
        if message.command not in self.answers:
            return [ack(message.command, commands.UNSUPPORTED)]
        number = int(message.param1 if message.command == GET else message.param2)
        told = dialect.MAVLink_message_interval_message(number, self.intervals.get(number, 0))
        return [told, ack(message.command, commands.ACCEPTED)]


def asked(fake: FakeVehicle, command: int) -> int:
    return sum(message.command == command for message in fake.link.sent_of("COMMAND_LONG"))


async def test_all_are_set_and_confirmed_in_one_round(ardupilot: FakeVehicle) -> None:
    firmware = Firmware(ardupilot)
    began = ardupilot.clock.now
    results = await ardupilot.run(set_intervals(ardupilot.vehicle, dict.fromkeys(IDS, 20_000.0)))
    assert results == dict.fromkeys(IDS, commands.ACCEPTED)
    assert firmware.intervals == dict.fromkeys(IDS, 20_000)
    assert (asked(ardupilot, SET), asked(ardupilot, GET)) == (len(IDS), len(IDS))
    assert ardupilot.clock.now - began < 0.2
    assert await ardupilot.run(get_intervals(ardupilot.vehicle, IDS)) == dict.fromkeys(IDS, 20_000)


@pytest.mark.parametrize("seed", range(6))
async def test_a_link_that_loses_much_costs_rounds_and_not_one_wait_for_each_message(
    ardupilot: FakeVehicle, seed: int
) -> None:
    """15 % lost each way, eight messages: one after the other this took 51 s on a link of the bench."""
    firmware = Firmware(ardupilot, loss=0.15, seed=seed)
    began = ardupilot.clock.now
    assert await ardupilot.run(get_intervals(ardupilot.vehicle, IDS)) == dict.fromkeys(IDS, -1)
    results = await ardupilot.run(set_intervals(ardupilot.vehicle, dict.fromkeys(IDS, 20_000.0)))
    assert results == dict.fromkeys(IDS, commands.ACCEPTED)
    assert firmware.intervals == dict.fromkeys(IDS, 20_000)
    assert ardupilot.clock.now - began < 10.0


@pytest.mark.parametrize("way", [GET, REQUEST])
async def test_a_way_of_asking_that_is_refused_costs_no_wait(ardupilot: FakeVehicle, way: int) -> None:
    firmware = Firmware(ardupilot)
    firmware.answers = {way}
    began = ardupilot.clock.now
    assert await ardupilot.run(get_intervals(ardupilot.vehicle, IDS)) == dict.fromkeys(IDS, -1)
    assert ardupilot.clock.now - began < 0.3


async def test_a_refusal_is_told_of_its_message_alone(ardupilot: FakeVehicle) -> None:
    firmware = Firmware(ardupilot)
    firmware.refuse = {IDS[3]}
    results = await ardupilot.run(set_intervals(ardupilot.vehicle, dict.fromkeys(IDS, 20_000.0)))
    assert results == {**dict.fromkeys(IDS, commands.ACCEPTED), IDS[3]: commands.DENIED}
    assert firmware.intervals[IDS[3]] == -1


async def test_what_the_firmware_slows_down_is_acknowledged_all_the_same(ardupilot: FakeVehicle) -> None:
    firmware = Firmware(ardupilot)
    firmware.least_us = 8_000
    began = ardupilot.clock.now
    results = await ardupilot.run(set_intervals(ardupilot.vehicle, {26: 5_000.0, 27: 7_500.0, 116: -1, 129: 0}))
    assert set(results.values()) == {commands.ACCEPTED}
    assert firmware.intervals == {**dict.fromkeys(IDS, -1), 26: 8_000, 27: 8_000, 129: 0}
    assert ardupilot.clock.now - began < 1.0


async def test_a_vehicle_that_has_fallen_silent_is_no_refusal(ardupilot: FakeVehicle) -> None:
    Firmware(ardupilot, loss=1.0)
    ardupilot.alive = False
    with pytest.raises(VehicleSilent):
        await ardupilot.run(set_intervals(ardupilot.vehicle, dict.fromkeys(IDS, 20_000.0)))
