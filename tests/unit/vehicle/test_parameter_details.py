"""What exactly is asked and told of parameters, of lists of them, and of streams."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.wire.codec import raw_message
from mavcal.calib.wire.parameters import HASH_CHECK, NO_INDEX, ParameterEncoding, ParamType, value_from_bits
from mavcal.service.errors import (
    LinkDown,
    ParameterMissing,
    ParameterRejected,
    ParameterTimeout,
    VehicleError,
    VehicleSilent,
)
from mavcal.service.vehicle import commands
from mavcal.service.vehicle.parameter_bits import same_value
from mavcal.service.vehicle.parameters import TRIES
from mavcal.service.vehicle.streams import _Request
from tests.unit.vehicle.fake import FakeVehicle, heartbeat, param_value, real
from tests.unit.vehicle.test_parameters import NAME, Firmware, three

REAL32 = ParamType.REAL32


async def test_a_parameter_is_asked_for_by_name_and_the_first_of_the_list_by_its_place(ardupilot: FakeVehicle) -> None:
    """A place of -1 says that the name counts; the other way the name is empty."""
    three(ardupilot)
    with pytest.raises(ParameterMissing) as caught:
        await ardupilot.run(ardupilot.vehicle.parameters.read("NOPE"))
    assert caught.value.name == "NOPE"
    asked = {(m.param_id, m.param_index) for m in ardupilot.link.sent_of("PARAM_REQUEST_READ")}
    assert asked == {("NOPE", -1), ("", 0)}
    assert all((m.target_system, m.target_component) == (1, 1) for m in ardupilot.link.sent_of("PARAM_REQUEST_READ"))


async def test_nobody_counts_as_asking_after_a_read(ardupilot: FakeVehicle) -> None:
    three(ardupilot)
    parameters = ardupilot.vehicle.parameters
    await ardupilot.run(parameters.read(NAME))
    await ardupilot.run(parameters.read("INS_ACCOFFS_X"))
    assert dict(parameters._asked) == {}
    with pytest.raises(ParameterMissing):
        await ardupilot.run(parameters.read("NOPE"))
    assert dict(parameters._asked) == {}


async def test_a_link_that_goes_down_says_how_often_it_was_sent(ardupilot: FakeVehicle) -> None:
    times, send = 0, ardupilot.link.send

    def down(message: Any, target: object = None) -> None:
        nonlocal times
        if raw_message(message)[0] == dialect.MAVLINK_MSG_ID_PARAM_SET:
            times += 1
            if times == 3:
                raise LinkDown("gone")
        send(message, target)

    ardupilot.link.send = down  # type: ignore[method-assign]
    with pytest.raises(VehicleSilent, match=f"{NAME} was sent 2 times and not confirmed: gone") as caught:
        await ardupilot.run(ardupilot.vehicle.parameters.set(NAME, 1.0, REAL32))
    assert caught.value.sent == 2


async def test_a_write_that_nothing_answers_says_how_often_it_was_sent(ardupilot: FakeVehicle) -> None:
    with pytest.raises(VehicleError) as caught:
        await ardupilot.run(ardupilot.vehicle.parameters.set(NAME, 1.0, REAL32))
    assert isinstance(caught.value, ParameterTimeout)
    assert caught.value.sent == TRIES
    assert len(ardupilot.link.sent_of("PARAM_SET")) == TRIES


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (2, "the value is out of range"),
        (3, "permission denied"),
        (5, "it is read only"),
        (6, "type unsupported"),
        (9, "error 9"),
    ],
)
async def test_each_refusal_is_told_in_words(ardupilot: FakeVehicle, code: int, words: str) -> None:
    ardupilot.link.respond = lambda m: (
        [dialect.MAVLink_param_error_message(253, 190, NAME.encode(), -1, code)] if m.get_type() == "PARAM_SET" else []
    )
    with pytest.raises(ParameterRejected, match=f"The vehicle refuses {NAME}: {words}") as caught:
        await ardupilot.run(ardupilot.vehicle.parameters.set(NAME, 1.0, REAL32))
    assert (caught.value.name, caught.value.sent) == (NAME, 1)


async def test_a_value_of_another_type_does_not_confirm_a_write(ardupilot: FakeVehicle) -> None:
    ardupilot.link.respond = lambda m: [param_value(NAME, real(1.0), 6)] if m.get_type() == "PARAM_SET" else []
    with pytest.raises(VehicleError) as caught:
        await ardupilot.run(ardupilot.vehicle.parameters.set(NAME, 1.0, REAL32))
    assert caught.value.sent == TRIES


async def test_what_is_heard_keeps_its_place_and_the_length_of_the_list(ardupilot: FakeVehicle) -> None:
    parameters = ardupilot.vehicle.parameters
    ardupilot.hear(param_value("A", real(1.0), count=7, index=4))
    ardupilot.hear(param_value("A", real(2.0), count=9, index=NO_INDEX))
    assert (parameters["A"].value, parameters["A"].index, parameters.count) == (2.0, 4, 7)
    ardupilot.hear(param_value("B", real(3.0), count=9, index=NO_INDEX))
    assert parameters["B"].index is None
    ardupilot.hear(param_value("C", real(3.0), kind=10))  # a double does not fit
    assert (list(parameters), len(parameters)) == (["A", "B"], 2)
    ardupilot.hear(param_value(HASH_CHECK, b"\x01\x02\x03\x04", kind=5))
    assert parameters.hash == b"\x01\x02\x03\x04"
    parameters.forget()
    assert (list(parameters), parameters.count, parameters.hash) == ([], None, None)


async def test_whoever_no_longer_listens_may_say_so_twice(ardupilot: FakeVehicle) -> None:
    heard: list[str] = []
    forget = ardupilot.vehicle.parameters.listen(lambda new, _old: heard.append(new.name))
    other = ardupilot.vehicle.parameters.listen(lambda new, _old: heard.append(new.name.lower()))
    forget()
    forget()
    ardupilot.hear(param_value("A", real(1.0)))
    assert heard == ["a"]
    other()


# --- values


@pytest.mark.parametrize("kind", [ParamType.INT8, ParamType.UINT16, ParamType.INT32, ParamType.UINT32])
def test_a_cast_integer_is_read_as_the_nearest_one(kind: ParamType) -> None:
    assert value_from_bits(real(2.6), kind, ParameterEncoding.CAST) == 3
    assert isinstance(value_from_bits(real(2.0), kind, ParameterEncoding.CAST), int)
    assert kind.integer
    assert not REAL32.integer


def test_equal_bytes_are_equal_even_where_they_are_no_number() -> None:
    nothing = struct.pack("<f", float("nan"))
    assert same_value(nothing, nothing, REAL32, ParameterEncoding.CAST)
    assert not same_value(nothing, real(0.0), REAL32, ParameterEncoding.CAST)


# --- lists


async def test_progress_of_a_list_is_told_only_when_something_new_has_come(ardupilot: FakeVehicle) -> None:
    firmware = Firmware(ardupilot, {f"P{k}": (real(k), 9) for k in range(6)})

    def twice(message: Any) -> Iterable[Any]:
        answers = list(firmware.respond(message))
        return [answer for answer in answers for _ in range(2)]

    ardupilot.link.respond = twice
    progress: list[tuple[int, int]] = []
    assert not ardupilot.vehicle.listed
    await ardupilot.run(ardupilot.vehicle.list_parameters(lambda *p: progress.append(p)))
    assert progress == [(k, 6) for k in range(1, 7)]
    assert ardupilot.vehicle.listed


async def test_a_list_may_be_read_without_telling_anybody(ardupilot: FakeVehicle) -> None:
    Firmware(ardupilot, {f"P{k}": (real(k), 9) for k in range(6)})
    assert len(await ardupilot.run(ardupilot.vehicle.list_parameters())) == 6


# --- a vehicle


async def test_when_a_vehicle_was_last_heard_is_known(ardupilot: FakeVehicle) -> None:
    ardupilot.clock.now += 7.0
    ardupilot.hear(dialect.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0))
    assert ardupilot.vehicle.state.last_heard == ardupilot.clock.now
    before = ardupilot.vehicle.state
    ardupilot.hear(dialect.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0))
    assert ardupilot.vehicle.state.last_heard == before.last_heard
    ardupilot.clock.now += 1.0
    ardupilot.hear(heartbeat())
    assert ardupilot.vehicle.state.last_heard == ardupilot.clock.now


# --- streams


async def test_a_report_puts_back_what_was_changed_and_nothing_else(ardupilot: FakeVehicle) -> None:
    request = _Request(ardupilot.vehicle, {1: 50.0, 2: 20.0, 3: 10.0, 4: 5.0}, {1: 100, 2: 200, 3: 300, 4: 400, 5: 500})
    request._results = {1: commands.ACCEPTED, 2: 2, 3: None}
    report = request.report({1: 49.0}, {1: 48.0, 2: 1.0}, 1000.0)
    assert dict(report.previous) == {1: 100, 3: 300}  # 2 was refused, 4 and 5 were not asked for
    assert report.missing == (3, 4)
    assert report.capacity_bytes_per_s == 1000.0
    one, two, four = report.rates[1], report.rates[2], report.rates[4]
    assert (one.requested_hz, one.result, one.measured_hz, one.wall_hz) == (50.0, 0, 49.0, 48.0)
    assert (two.result, two.measured_hz, two.wall_hz) == (2, 0.0, 1.0)
    assert (four.result, four.measured_hz, four.wall_hz) == (None, 0.0, 0.0)


async def test_a_link_that_carries_everything_slows_nothing_down(ardupilot: FakeVehicle) -> None:
    request = _Request(ardupilot.vehicle, {1: 50.0}, {})
    request._results = {1: commands.ACCEPTED}
    assert request.report({1: 10.0}, {1: 10.0}, None).slowdown == 1.0
    assert request.report({1: 10.0}, {1: 10.0}, 500.0).slowdown == pytest.approx(5.0)
