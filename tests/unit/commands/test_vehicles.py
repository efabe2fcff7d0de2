"""Which vehicles of a running service a command is about."""

from __future__ import annotations

import click
import pytest

from mavcal.service.commands import vehicles
from mavcal.service.commands.vehicles import served, vehicle_of, vehicles_of
from mavcal.service.commands.whom import Whom
from mavcal.service.errors import VehicleSilent

A, URL = "udpin:0.0.0.0:14550", "http://h:1"


@pytest.fixture
def two(make_service):
    """A service with two vehicles."""
    service = make_service(shared=True)
    service.joined(A, "v1", "v2")
    service.vehicles["v2"].system = 7
    return service


def about(*ids, **more):
    return Whom(url=URL, ids=ids, wait_s=0.05, **more)


async def test_the_only_one_is_chosen(make_service, screen):
    service = make_service(shared=True)
    service.joined(A, "v1")
    assert (await vehicle_of(service, about(), screen)).id == "v1"


async def test_of_several_none_is_chosen_and_all_are_listed(two, screen):
    with pytest.raises(click.UsageError, match=r"has v1 \(px4, system 1\), v2 \(px4, system 7\): .*--vehicle ID"):
        await served(two, about(), screen)


@pytest.mark.parametrize(("named", "found"), [("v1", "v1"), ("7", "v2"), ("v2", "v2")])
async def test_one_is_chosen_by_its_id_or_system_id(two, screen, named, found):
    assert [vehicle.id for vehicle in await served(two, about(named), screen)] == [found]


async def test_a_system_id_of_several_is_no_choice(two, screen):
    two.vehicles["v2"].system = 1
    with pytest.raises(click.UsageError, match="1 is the system id of several"):
        await served(two, about("1"), screen)


async def test_several_are_chosen_and_all_of_them_by_all(two, screen):
    assert [vehicle.id for vehicle in await served(two, about("7", "v1", "v2"), screen)] == ["v2", "v1"]
    two.vehicles["v1"].firmware = ""
    assert [found.vehicle.id for found in await vehicles_of(two, about(every=True), screen)] == ["v2"]


async def test_one_that_is_not_there_is_waited_for_and_the_others_are_listed(two, screen, monkeypatch):
    monkeypatch.setattr("mavcal.service.commands.headless.QUIET_S", 0.0)
    monkeypatch.setattr(vehicles, "_LOOK_S", 0.0)
    with pytest.raises(click.UsageError, match="vehicle v9 is not there: the service has v1"):
        await served(two, about("v9"), screen)
    [said] = screen.lines
    assert "waiting up to 0.05 s for vehicle v9" in said


async def test_a_service_without_a_vehicle_is_silent(make_service, screen):
    with pytest.raises(VehicleSilent, match=r"heard no vehicle within .* check its power"):
        await served(make_service(shared=True), about(), screen)


async def test_a_vehicle_is_told_with_the_endpoint_at_which_the_service_hears_it(two, screen):
    class Link:
        id, url = A, "serial:/dev/ttyACM0:115200"

    async def links():
        return [Link]

    two.list_links = links
    assert [found.document for found in await vehicles_of(two, about("v1"), screen)] == [
        {"connect": Link.url, "vehicle_id": "v1"}
    ]
