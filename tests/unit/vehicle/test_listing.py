"""What has come of a parameter list, and what is said of one that does not come."""

from __future__ import annotations

import pytest

from mavcal.calib.wire.codec import ParamValue, decode_param_value, encode
from mavcal.calib.wire.frames import FrameParser
from mavcal.calib.wire.parameters import HASH_CHECK, ParamType
from mavcal.service.errors import ParameterTimeout, VehicleSilent
from mavcal.service.vehicle.listing import ParameterSet, _incomplete, _Listing
from mavcal.service.vehicle.parameter_bits import Parameter
from tests.unit.vehicle.fake import FakeVehicle, param_value, real


def heard(name: str, index: int, count: int = 2) -> ParamValue:
    raw = param_value(name, real(1.0), count=count, index=index)
    (frame,) = FrameParser().feed(encode(raw, 1, 1, 0))
    return decode_param_value(frame)


def listed(*values: ParamValue) -> _Listing:
    listing = _Listing()
    for value in values:
        listing.take(value)
    return listing


@pytest.mark.parametrize(
    "value", [heard("A", 65535), heard(HASH_CHECK, 0), heard("A", 2), heard("A", 3)], ids=["no index", "hash", "2", "3"]
)
def test_what_has_no_place_in_the_list_is_not_counted(value: ParamValue) -> None:
    listing = listed(value)
    assert (listing.names, listing.count, listing.complete) == ({}, 0, False)


def test_a_list_is_complete_when_every_index_has_a_name_of_its_own() -> None:
    listing = listed(heard("A", 0))
    assert (listing.missing, listing.complete, listing.restart) == ([1], False, False)
    listing.take(heard("A", 0))  # told twice
    assert (listing.missing, listing.restart) == ([1], False)
    listing.take(heard("B", 1))
    assert (listing.missing, listing.complete, listing.restart) == ([], True, False)
    assert not listed(heard("A", 0), heard("A", 1)).complete
    assert not listed().complete


def test_a_list_of_one_parameter_is_complete() -> None:
    listing = listed(heard("A", 0, count=1))
    assert (listing.missing, listing.complete) == ([], True)


@pytest.mark.parametrize("other", [heard("B", 1, count=3), heard("C", 0)])
def test_a_list_that_changes_while_it_comes_begins_anew(other: ParamValue) -> None:
    listing = listed(heard("A", 0), other)
    assert listing.restart
    assert listing.names == {other.param_index: other.name}
    assert listing.count == other.param_count


def test_a_set_of_parameters_is_asked_by_name() -> None:
    one = Parameter("A", 1.0, ParamType.REAL32, 0, real(1.0))
    found = ParameterSet({"A": one}, None)
    assert (len(found), found["A"], "A" in found, "B" in found) == (1, one, True, False)


async def test_each_way_in_which_a_list_stays_away_is_told(ardupilot: FakeVehicle) -> None:
    vehicle = ardupilot.vehicle
    none = _incomplete(vehicle, listed())
    assert isinstance(none, ParameterTimeout)
    assert "does not send its parameter list" in str(none)
    some = _incomplete(vehicle, listed(heard("A", 0, count=9)))
    assert isinstance(some, ParameterTimeout)
    assert "8 of 9 parameters were not received" in str(some)
    ardupilot.clock.now += 60.0
    silent = _incomplete(vehicle, listed())
    assert isinstance(silent, VehicleSilent)
    assert "no heartbeat any more" in str(silent)
