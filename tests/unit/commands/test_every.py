from __future__ import annotations

import json
from types import SimpleNamespace

import click
import pytest

from mavcal.client import Unreachable
from mavcal.service.commands import door, vehicles
from mavcal.service.commands.every import Acted, run_every, with_each
from mavcal.service.commands.output import AnsweredNo
from mavcal.service.commands.vehicles import Found, vehicles_of
from mavcal.service.commands.whom import Whom
from mavcal.service.errors import VehicleArmed, VehicleSilent
from mavcal.service.jobs.core.states import JobState
from tests.unit.commands.doubles import FakeVehicle, plain

A, B = "udpin:0.0.0.0:14550", "tcp:b:5760"


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Links are not listened to for further vehicles."""
    monkeypatch.setattr(vehicles, "LISTEN_S", 0.0)


def found(result):
    return [(one.connect, None if one.vehicle is None else one.vehicle.id) for one in result]


async def test_one_vehicle_an_endpoint(make_service, screen):
    service = make_service()
    service.joined(A, "v1", "v2")
    service.joined(B, "v3")
    assert found(await vehicles_of(service, Whom((A, B, A), every=False, wait_s=1.0), screen)) == [(A, "v1"), (B, "v3")]


async def test_all_of_a_link_with_all(make_service, screen):
    service = make_service()
    service.joined(A, "v1", "v2", "nameless")
    service.vehicles["nameless"].firmware = ""
    assert found(await vehicles_of(service, Whom((A,), every=True, wait_s=1.0), screen)) == [(A, "v1"), (A, "v2")]


async def test_without_an_endpoint_the_links_that_are_open_count(make_service, screen):
    service = make_service()
    service.joined(A, "v1")
    service.joined(B, "v2")
    assert found(await vehicles_of(service, Whom((), every=True, wait_s=1.0), screen)) == [(A, "v1"), (B, "v2")]


async def test_without_any_link_it_is_wrong_use(make_service, screen):
    with pytest.raises(click.UsageError, match="give --connect"):
        await vehicles_of(make_service(), Whom((), every=True, wait_s=1.0), screen)


async def test_a_unit_that_two_links_reach_counts_once(make_service, screen):
    service = make_service()
    service.joined(A, "v1")
    service.joined(B)
    service.links[B].vehicles.append("v1")
    service.vehicles["v1"] = SimpleNamespace(id="v1", firmware="1.17.0", links=[A, B])
    assert found(await vehicles_of(service, Whom((A, B), every=True, wait_s=1.0), screen)) == [(A, "v1")]


async def test_a_silent_link_is_told_and_the_others_count(make_service, screen):
    service = make_service()
    service.joined(A)
    service.joined(B, "v1")
    silent, heard = await vehicles_of(service, Whom((A, B), every=True, wait_s=0.0), screen)
    assert isinstance(silent.error, VehicleSilent)
    assert silent.document["error"]["code"] == "vehicle-silent"
    assert heard.document == {"connect": B, "vehicle_id": "v1"}


async def test_each_vehicle_is_acted_on_after_its_earlier_jobs_were_ended(make_service, screen):
    service = make_service(plain("old", JobState.RUNNING))
    service.joined(A, "v1")
    service.joined(B, "v2")

    async def act(_service, vehicle, _screen):
        assert service.jobs.done == [("cancel", "old")]
        if vehicle.id == "v2":
            raise VehicleArmed("it is armed")
        return vehicle.id

    (_, first), (where, second) = await with_each(service, whom=Whom((A, B), wait_s=1.0), act=act, screen=screen)
    assert (first, where.connect) == ("v1", B)
    assert isinstance(second, VehicleArmed)


async def test_nothing_is_done_where_no_vehicle_is(make_service, screen):
    service = make_service()
    service.joined(A)

    async def act(_service, _vehicle, _screen):
        raise AssertionError

    [(_, came)] = await with_each(service, whom=Whom((A,), wait_s=0.0), act=act, screen=screen)
    assert isinstance(came, VehicleSilent)


async def test_a_service_that_goes_away_is_told_for_each_vehicle(make_service, screen):
    service = make_service()
    service.joined(A, "v1")

    async def act(_service, _vehicle, _screen):
        raise Unreachable("refused")

    [(_, came)] = await with_each(service, whom=Whom((A,)), act=act, screen=screen)
    assert isinstance(came, AnsweredNo)
    assert came.code == "unreachable"


@pytest.fixture
def tells(monkeypatch, tmp_path):
    """Runs the command with these outcomes; the exit code."""

    def run(*came, as_json=False):
        monkeypatch.setattr(door, "through_door", lambda *_: came[0] if isinstance(came[0], int) else list(came))
        return run_every(Whom((A,), every=True, data_dir=tmp_path), None, as_json=as_json)

    return run


GOOD = (Found(A, FakeVehicle("v1")), Acted(good=True, text="level: succeeded", document={"job": "j"}))
BAD = (Found(B, FakeVehicle("v2")), VehicleArmed("it is armed"))
GONE = (Found(B, error=VehicleSilent("nobody")), VehicleSilent("nobody"))


def test_every_vehicle_has_a_line(tells, capsys):
    assert tells(GOOD, BAD, GONE) == 1
    assert capsys.readouterr().out.splitlines() == [
        f"{A} v1: level: succeeded",
        f"{B} v2: it is armed",
        f"{B}: nobody",
    ]


def test_every_vehicle_is_told_as_json(tells, capsys):
    assert tells(GOOD, BAD, as_json=True) == 1
    assert json.loads(capsys.readouterr().out)["vehicles"] == [
        {"connect": A, "vehicle_id": "v1", "job": "j"},
        {"connect": B, "vehicle_id": "v2", "error": {"code": "vehicle-armed", "detail": "it is armed"}},
    ]


def test_the_exit_code_says_whether_all_are_good_or_which_signal_came(tells):
    assert tells(GOOD) == 0
    assert tells(GOOD, (GOOD[0], Acted(good=False, text="no"))) == 1
    partly = (GOOD[0], Acted(good=True, text="gyro: succeeded", in_part=True))
    assert tells(GOOD, partly) == 3
    assert tells(partly, BAD) == 1
    assert tells(143) == 143
