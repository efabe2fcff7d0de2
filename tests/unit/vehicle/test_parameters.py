from __future__ import annotations

import asyncio
import math
import struct
from collections.abc import Iterable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire.parameters import ParamType
from mavcal.service.errors import (
    ParameterMissing,
    ParameterRejected,
    ParameterTimeout,
    VehicleArmed,
    VehicleConflict,
    VehicleSilent,
)
from mavcal.service.link.types import LinkEvent, LinkEventKind
from tests.unit.vehicle.fake import FakeVehicle, delay_answers, heartbeat, param_value, real

NAME = "INS_ACCOFFS_Y"


class Firmware:
    """Answers the parameter protocol from a table; what it does wrong is switched on by tests."""

    def __init__(self, fake: FakeVehicle, table: dict[str, tuple[bytes, int]]) -> None:
        self.fake = fake
        self.table = table
        self.lose: set[int] = set()
        self.deaf_to_sets = False
        self.silent_echo = False
        self.list_requests = 0
        fake.link.respond = self.respond

    def names(self) -> list[str]:
        return list(self.table)

    def value(self, name: str, *, listed: bool = False) -> Any:
        bits, kind = self.table[name]
        index = self.names().index(name) if listed else 65535
        return param_value(name, bits, kind, len(self.table), index)

    def respond(self, message: Any) -> Iterable[Any]:
        kind = message.get_type()
        if kind == "PARAM_REQUEST_LIST":
            self.list_requests += 1
            return [self.value(n, listed=True) for i, n in enumerate(self.names()) if i not in self.lose]
        if kind == "PARAM_REQUEST_READ":
            if message.param_index >= 0:
                return [self.value(self.names()[message.param_index], listed=True)]
            return [self.value(message.param_id)] if message.param_id in self.table else []
        if kind == "PARAM_SET" and message.param_id in self.table:
            if not self.deaf_to_sets:
                self.table[message.param_id] = (message.bits, message.param_type)
            return [] if self.silent_echo else [self.value(message.param_id)]
        return []


def three(fake: FakeVehicle) -> Firmware:
    return Firmware(fake, {f"INS_ACCOFFS_{axis}": (real(0.5), 9) for axis in "XYZ"})


async def test_a_write_is_rounded_to_float32_and_confirmed_by_its_echo(ardupilot: FakeVehicle) -> None:
    three(ardupilot)
    echo = await ardupilot.run(ardupilot.vehicle.parameters.set(NAME, 0.1, ParamType.REAL32))
    assert echo.parameter.bits == struct.pack("<f", 0.1)
    assert echo.parameter.value == struct.unpack("<f", struct.pack("<f", 0.1))[0]
    assert (echo.sent, ardupilot.link.sent_of("PARAM_REQUEST_READ")) == (1, [])


async def test_the_old_value_in_the_echo_of_a_vectors_neighbour_is_not_taken(ardupilot: FakeVehicle) -> None:
    # setting _X echoes _X, _Y and _Z; the _Y among them still holds its old value and must not confirm the new one
    firmware = three(ardupilot)

    def respond(message: Any) -> Iterable[Any]:
        if message.get_type() != "PARAM_SET":
            return firmware.respond(message)
        if message.param_id == "INS_ACCOFFS_X":
            firmware.respond(message)
            return [firmware.value(f"INS_ACCOFFS_{axis}") for axis in "XYZ"]
        stale = firmware.value(message.param_id)
        sent = len(ardupilot.link.sent_of("PARAM_SET"))
        return [stale] if sent < 3 else [stale, *firmware.respond(message)]

    ardupilot.link.respond = respond
    await ardupilot.run(ardupilot.vehicle.parameters.set("INS_ACCOFFS_X", 0.25, ParamType.REAL32))
    echo = await ardupilot.run(ardupilot.vehicle.parameters.set(NAME, 0.25, ParamType.REAL32))
    assert echo.parameter.value == 0.25
    assert echo.sent == 2


async def test_a_lost_echo_is_made_up_for_by_a_read(ardupilot: FakeVehicle) -> None:
    firmware = three(ardupilot)
    firmware.silent_echo = True
    echo = await ardupilot.run(ardupilot.vehicle.parameters.set(NAME, -1.5, ParamType.REAL32))
    assert (echo.sent, len(ardupilot.link.sent_of("PARAM_REQUEST_READ")), echo.parameter.value) == (3, 1, -1.5)


async def test_a_write_that_the_vehicle_ignores_is_told_with_what_it_holds(ardupilot: FakeVehicle) -> None:
    three(ardupilot).deaf_to_sets = True
    with pytest.raises(ParameterRejected, match=r"0\.7 was written, the vehicle holds 0\.5") as caught:
        await ardupilot.run(ardupilot.vehicle.parameters.set(NAME, 0.7, ParamType.REAL32))
    assert caught.value.sent == 3


async def test_silence_means_that_there_is_no_such_parameter(ardupilot: FakeVehicle) -> None:
    three(ardupilot)
    await ardupilot.run(ardupilot.vehicle.parameters.read("INS_ACCOFFS_X"))
    with pytest.raises(ParameterMissing, match="NOPE"):
        await ardupilot.run(ardupilot.vehicle.parameters.read("NOPE"))
    asked = [m.param_id for m in ardupilot.link.sent_of("PARAM_REQUEST_READ")]
    assert asked.count("NOPE") >= 3


async def test_silence_on_a_dead_link_does_not_mean_that(ardupilot: FakeVehicle) -> None:
    three(ardupilot)
    await ardupilot.run(ardupilot.vehicle.parameters.read("INS_ACCOFFS_X"))
    ardupilot.link.respond = lambda _message: ()
    with pytest.raises(ParameterTimeout):
        await ardupilot.run(ardupilot.vehicle.parameters.read("INS_ACCOFFS_Z"))
    ardupilot.alive = False
    with pytest.raises(VehicleSilent):
        await ardupilot.run(ardupilot.vehicle.parameters.read("INS_ACCOFFS_Z"))


async def test_a_read_survives_loss(ardupilot: FakeVehicle) -> None:
    firmware = three(ardupilot)
    heard = 0

    def respond(message: Any) -> Iterable[Any]:
        nonlocal heard
        heard += message.get_type() == "PARAM_REQUEST_READ" and message.param_id == NAME
        return firmware.respond(message) if heard == 6 else ()

    ardupilot.link.respond = respond
    parameter = await ardupilot.run(ardupilot.vehicle.parameters.read(NAME))
    assert parameter.value == 0.5


async def test_silence_counts_even_if_nothing_was_heard_before(ardupilot: FakeVehicle) -> None:
    three(ardupilot)
    began = ardupilot.clock.now
    with pytest.raises(ParameterMissing):
        await ardupilot.run(ardupilot.vehicle.parameters.read("NOPE"))
    assert ardupilot.clock.now - began < 3.0
    ardupilot.link.respond = lambda _message: ()
    with pytest.raises(ParameterTimeout):
        await ardupilot.run(ardupilot.vehicle.parameters.read("NOPE"))


async def test_names_that_are_not_there_are_proved_absent_side_by_side(ardupilot: FakeVehicle) -> None:
    """Each reader's proof is its own: the answers that another one asked for neither prolong nor shorten it."""
    three(ardupilot)
    read = ardupilot.vehicle.parameters.read
    for axis in "XYZ":
        await ardupilot.run(read(f"INS_ACCOFFS_{axis}"))
    ardupilot.link.sent.clear()
    began = ardupilot.clock.now
    both = asyncio.gather(read("NOPE"), read("NEITHER"), return_exceptions=True)
    assert [type(e) for e in await ardupilot.run(finished(both))] == [ParameterMissing, ParameterMissing]
    assert ardupilot.clock.now - began < 3.5
    asked = [m.param_id for m in ardupilot.link.sent_of("PARAM_REQUEST_READ")]
    assert min(asked.count("NOPE"), asked.count("NEITHER")) >= 4
    beside = {m for m in asked if m not in ("NOPE", "NEITHER")}
    assert len(beside) == 2


@pytest.mark.parametrize(("lost", "questions", "limit_s"), [(0, 3, 1.5), (12, 6, 3.5)])
async def test_absence_takes_more_questions_where_answers_were_lost(
    ardupilot: FakeVehicle, lost: int, questions: int, limit_s: float
) -> None:
    firmware = three(ardupilot)
    vehicle = ardupilot.vehicle
    for number in range(30):
        await ardupilot.run(vehicle.parameters.read("INS_ACCOFFS_X"))
        if number < lost:
            vehicle.pace.trip(answered=False)
    ardupilot.link.sent.clear()
    ardupilot.link.respond = firmware.respond
    began = ardupilot.clock.now
    with pytest.raises(ParameterMissing):
        await ardupilot.run(vehicle.parameters.read("NOPE"))
    assert ardupilot.clock.now - began < limit_s
    asked = [m.param_id for m in ardupilot.link.sent_of("PARAM_REQUEST_READ")]
    assert asked.count("NOPE") >= questions


async def test_nothing_is_asked_again_while_its_answer_is_under_way(ardupilot: FakeVehicle) -> None:
    """On a link whose answers take 1.6 s, asking again each second would only fill it."""
    three(ardupilot)
    delay = 0.9
    delay_answers(ardupilot, lambda: delay)
    for axis in "XYZ":
        await ardupilot.run(ardupilot.vehicle.parameters.read(f"INS_ACCOFFS_{axis}"))
    delay = 1.6
    ardupilot.link.sent.clear()
    await ardupilot.run(ardupilot.vehicle.parameters.read("INS_ACCOFFS_X"))
    await ardupilot.run(ardupilot.vehicle.parameters.set("INS_ACCOFFS_X", 0.25))
    assert len(ardupilot.link.sent_of("PARAM_REQUEST_READ")) == 1
    assert len(ardupilot.link.sent_of("PARAM_SET")) == 1


async def test_a_read_that_was_lost_is_repeated_soon_where_answers_come_at_once(ardupilot: FakeVehicle) -> None:
    firmware = three(ardupilot)
    for axis in "XYZ":
        await ardupilot.run(ardupilot.vehicle.parameters.read(f"INS_ACCOFFS_{axis}"))
    lost = ["INS_ACCOFFS_X"]

    def respond(message: Any) -> Iterable[Any]:
        if message.get_type() == "PARAM_REQUEST_READ" and message.param_id in lost:
            lost.remove(message.param_id)
            return ()
        return firmware.respond(message)

    ardupilot.link.respond = respond
    began = ardupilot.clock.now
    await ardupilot.run(ardupilot.vehicle.parameters.read("INS_ACCOFFS_X"))
    assert ardupilot.clock.now - began <= 0.75


async def test_a_stream_of_other_values_does_not_end_a_read(ardupilot: FakeVehicle) -> None:
    # another ground station lists all parameters meanwhile
    task = asyncio.ensure_future(ardupilot.vehicle.parameters.read(NAME))
    for k in range(30):
        await asyncio.sleep(0)
        ardupilot.hear(param_value(f"P{k}", real(k)))
        ardupilot.advance(0.01)
    ardupilot.hear(param_value(NAME, real(7.0)))
    assert (await task).value == 7.0


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e39])
async def test_what_is_no_float32_is_never_sent(ardupilot: FakeVehicle, value: float) -> None:
    with pytest.raises(ParameterRejected):
        await ardupilot.run(ardupilot.vehicle.parameters.set(NAME, value, ParamType.REAL32))
    assert ardupilot.link.sent_of("PARAM_SET") == []


@pytest.mark.parametrize("value", [-1, -8388000, 1310988, 16777217])
async def test_px4_integers_arrive_bit_by_bit(px4: FakeVehicle, value: int) -> None:
    Firmware(px4, {"CAL_ACC3_ID": (struct.pack("<i", 0), 6)})
    echo = await px4.run(px4.vehicle.parameters.set("CAL_ACC3_ID", value, ParamType.INT32))
    assert echo.parameter.value == value
    assert echo.parameter.bits == struct.pack("<i", value)
    assert px4.vehicle.parameters["CAL_ACC3_ID"].value == value


async def test_ardupilot_integers_travel_as_floats_and_only_exact_ones(ardupilot: FakeVehicle) -> None:
    Firmware(ardupilot, {"COMPASS_DEV_ID": (real(97539), 6), "INS_USE": (real(1), 2)})
    parameters = ardupilot.vehicle.parameters
    assert (await ardupilot.run(parameters.read("COMPASS_DEV_ID"))).value == 97539
    assert (await ardupilot.run(parameters.set("INS_USE", 0, ParamType.INT8))).parameter.bits == real(0)
    with pytest.raises(ParameterRejected, match="exactly"):
        await ardupilot.run(parameters.set("COMPASS_DEV_ID", 16777217, ParamType.INT32))
    with pytest.raises(ParameterRejected, match="does not fit"):
        await ardupilot.run(parameters.set("INS_USE", 0.7, ParamType.INT8))
    with pytest.raises(ParameterRejected, match="does not fit"):
        await ardupilot.run(parameters.set("INS_USE", 300, ParamType.INT8))


async def test_a_write_of_the_wrong_type_is_refused_before_it_is_sent(px4: FakeVehicle) -> None:
    # PX4 would store the bytes of 1.0f as the integer 1065353216, or drop the write without a word
    Firmware(px4, {"SENS_IMU_AUTOCAL": (struct.pack("<i", 1), 6)})
    await px4.run(px4.vehicle.parameters.read("SENS_IMU_AUTOCAL"))
    with pytest.raises(ParameterRejected, match="INT32"):
        await px4.run(px4.vehicle.parameters.set("SENS_IMU_AUTOCAL", 1.0, ParamType.REAL32))
    echo = await px4.run(px4.vehicle.parameters.set("SENS_IMU_AUTOCAL", 0))
    assert echo.parameter.kind is ParamType.INT32
    assert len(px4.link.sent_of("PARAM_SET")) == 1


async def test_param_error_is_believed_where_it_comes(ardupilot: FakeVehicle) -> None:
    codes = {"GONE": 1, "LOCKED": 5}

    def respond(message: Any) -> Iterable[Any]:
        if message.get_type() in ("PARAM_REQUEST_READ", "PARAM_SET"):
            name = message.param_id
            return [dialect.MAVLink_param_error_message(253, 190, name.encode(), -1, codes[name])]
        return []

    ardupilot.link.respond = respond
    began = ardupilot.clock.now
    with pytest.raises(ParameterMissing):
        await ardupilot.run(ardupilot.vehicle.parameters.read("GONE"))
    with pytest.raises(ParameterRejected, match="read only") as caught:
        await ardupilot.run(ardupilot.vehicle.parameters.set("LOCKED", 1.0, ParamType.REAL32))
    assert caught.value.sent == 1
    assert ardupilot.clock.now - began < 1.0


async def test_arming_in_the_middle_stops_the_writing(ardupilot: FakeVehicle) -> None:
    def respond(message: Any) -> Iterable[Any]:
        return [heartbeat(armed=True)] if message.get_type() == "PARAM_SET" else []

    ardupilot.link.respond = respond
    with pytest.raises(VehicleArmed, match="sent 1 times") as caught:
        await ardupilot.run(ardupilot.vehicle.parameters.set(NAME, 1.0, ParamType.REAL32))
    assert caught.value.sent == 1
    assert len(ardupilot.link.sent_of("PARAM_SET")) == 1


async def test_nothing_is_sent_while_it_is_not_certain_who_listens(ardupilot: FakeVehicle) -> None:
    ardupilot.vehicle.link_event(LinkEvent(LinkEventKind.DUPLICATE_SYSTEM, "two senders", 1, 1))
    with pytest.raises(VehicleConflict, match="two senders"):
        await ardupilot.run(ardupilot.vehicle.parameters.set(NAME, 1.0, ParamType.REAL32))
    assert ardupilot.link.sent_of("PARAM_SET") == []
    ardupilot.vehicle.link_event(LinkEvent(LinkEventKind.DUPLICATE_SYSTEM, "others", 2, 1))
    ardupilot.advance(31.0)
    assert ardupilot.vehicle.conflicts == ()


async def test_a_change_by_somebody_else_is_noticed(ardupilot: FakeVehicle) -> None:
    three(ardupilot)
    await ardupilot.run(ardupilot.vehicle.parameters.read(NAME))
    seen: list[tuple[Any, Any]] = []
    forget = ardupilot.vehicle.parameters.listen(lambda new, old: seen.append((new.value, old and old.value)))
    ardupilot.hear(param_value(NAME, real(9.0)))
    assert seen == [(9.0, 0.5)]
    assert ardupilot.vehicle.parameters[NAME].value == 9.0
    forget()
    ardupilot.hear(param_value(NAME, real(8.0)))
    assert len(seen) == 1


async def test_a_list_with_lost_values_is_completed_by_index(ardupilot: FakeVehicle) -> None:
    firmware = Firmware(ardupilot, {f"P{k}": (real(k), 9) for k in range(200)})
    firmware.lose = {0, 7, 8, 9, 10, 55, *range(120, 150), 199}
    progress: list[tuple[int, int]] = []
    listed = await ardupilot.run(ardupilot.vehicle.list_parameters(lambda *p: progress.append(p)))
    assert {name: p.value for name, p in listed.parameters.items()} == {f"P{k}": k for k in range(200)}
    assert firmware.list_requests == 1
    assert progress[-1] == (200, 200)
    assert len(ardupilot.link.sent_of("PARAM_REQUEST_READ")) == len(firmware.lose)


async def test_a_list_that_changes_its_length_is_read_again(ardupilot: FakeVehicle) -> None:
    firmware = Firmware(ardupilot, {f"P{k}": (real(k), 9) for k in range(20)})
    grown = {"A": (real(-1), 9), **firmware.table}

    def respond(message: Any) -> Iterable[Any]:
        if message.get_type() == "PARAM_REQUEST_LIST" and firmware.list_requests == 0:
            first = list(firmware.respond(message))[:10]
            firmware.table = grown  # a group was switched on: every index moves
            return [*first, *(firmware.value(n, listed=True) for n in list(grown)[11:])]
        return firmware.respond(message)

    ardupilot.link.respond = respond
    listed = await ardupilot.run(ardupilot.vehicle.list_parameters())
    assert set(listed.parameters) == set(grown)


async def test_a_list_that_shrinks_half_way_leaves_no_stale_name(ardupilot: FakeVehicle) -> None:
    # every index moves down by one, and what was heard before looks like a complete list together with the rest
    firmware = Firmware(ardupilot, {f"P{k}": (real(k), 9) for k in range(20)})

    def respond(message: Any) -> Iterable[Any]:
        if message.get_type() == "PARAM_REQUEST_LIST" and firmware.list_requests == 0:
            first = list(firmware.respond(message))[:10]
            del firmware.table["P0"]
            return [*first, *(firmware.value(n, listed=True) for n in firmware.names()[10:])]
        return firmware.respond(message)

    ardupilot.link.respond = respond
    listed = await ardupilot.run(ardupilot.vehicle.list_parameters())
    assert set(listed.parameters) == {f"P{k}" for k in range(1, 20)}


async def test_px4s_hash_is_no_parameter(px4: FakeVehicle) -> None:
    firmware = Firmware(px4, {"A": (struct.pack("<i", -1), 6), "B": (real(2.0), 9)})

    def respond(message: Any) -> Iterable[Any]:
        listed = list(firmware.respond(message))
        if message.get_type() == "PARAM_REQUEST_LIST":
            listed.insert(0, param_value("_HASH_CHECK", b"\x01\x02\x03\x04", 5, 2))
        return listed

    px4.link.respond = respond
    listed = await px4.run(px4.vehicle.list_parameters())
    assert set(listed.parameters) == {"A", "B"}
    assert listed["A"].value == -1
    assert listed.hash == b"\x01\x02\x03\x04"


async def test_a_list_that_never_completes_says_how_much_is_missing(ardupilot: FakeVehicle) -> None:
    firmware = Firmware(ardupilot, {f"P{k}": (real(k), 9) for k in range(30)})
    firmware.lose = {3, 4}

    def respond(message: Any) -> Iterable[Any]:
        return firmware.respond(message) if message.get_type() == "PARAM_REQUEST_LIST" else ()

    ardupilot.link.respond = respond
    with pytest.raises(ParameterTimeout, match="2 of 30"):
        await ardupilot.run(ardupilot.vehicle.list_parameters())
    ardupilot.alive = False
    with pytest.raises(VehicleSilent):
        await ardupilot.run(ardupilot.vehicle.list_parameters())


async def test_a_restart_forgets_what_was_known(ardupilot: FakeVehicle) -> None:
    ardupilot.hear(param_value(NAME, real(9.0)))
    for stamp in (50_000, 51_000, 1_000, 1_100, 1_200):
        ardupilot.hear(dialect.MAVLink_system_time_message(0, stamp))
    assert ardupilot.vehicle.state.rebooted == 1
    assert NAME not in ardupilot.vehicle.parameters


async def finished(work: asyncio.Future[Any]) -> Any:
    return await work


@pytest.mark.parametrize(("target", "taken"), [(0, True), (253, True), (1, False), (252, False)])
async def test_a_refusal_for_another_station_is_not_ours(ardupilot: FakeVehicle, target: int, taken: bool) -> None:
    def respond(message: Any) -> Iterable[Any]:
        if message.get_type() == "PARAM_SET":
            return [dialect.MAVLink_param_error_message(target, 190, NAME.encode(), -1, 5)]
        return [param_value(NAME, real(0.5))] if message.get_type() == "PARAM_REQUEST_READ" else []

    ardupilot.link.respond = respond
    with pytest.raises(ParameterRejected, match="read only" if taken else "the vehicle holds 0.5"):
        await ardupilot.run(ardupilot.vehicle.parameters.set(NAME, 1.0, ParamType.REAL32))
    assert (len(ardupilot.link.sent_of("PARAM_SET")) == 1) == taken


async def test_a_refusal_of_another_parameter_is_not_this_ones(ardupilot: FakeVehicle) -> None:
    def respond(message: Any) -> Iterable[Any]:
        if message.get_type() != "PARAM_REQUEST_READ":
            return []
        refusal = dialect.MAVLink_param_error_message(253, 190, b"OTHER", -1, 1)
        return [refusal, param_value(NAME, real(0.5))]

    ardupilot.link.respond = respond
    assert (await ardupilot.run(ardupilot.vehicle.parameters.read(NAME))).value == 0.5


async def test_the_type_of_a_parameter_is_asked_for_where_it_is_not_known(px4: FakeVehicle) -> None:
    Firmware(px4, {"CAL_GYRO0_ID": (struct.pack("<i", 7), 6)})
    echo = await px4.run(px4.vehicle.parameters.set("CAL_GYRO0_ID", 1310988))
    assert (echo.parameter.value, echo.parameter.kind) == (1310988, ParamType.INT32)


async def test_a_listed_parameter_of_a_type_that_nobody_can_read_is_left_out(ardupilot: FakeVehicle) -> None:
    firmware = three(ardupilot)
    firmware.table["LOG_WIDE"] = (real(1.5), 10)  # a double does not fit into the field
    found = await ardupilot.run(ardupilot.vehicle.list_parameters())
    assert sorted(found.parameters) == sorted(set(firmware.table) - {"LOG_WIDE"})
