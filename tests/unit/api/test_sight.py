"""What a key that is bound to tags may see; tests/service/test_fleet.py asks every route."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from mavcal.service.api.models.vehicles import LinkModel
from mavcal.service.api.sight import FILTERED, Sight
from mavcal.service.app import create_app
from mavcal.service.core import Service
from mavcal.service.errors import (
    Forbidden,
    GapUnknown,
    JobUnknown,
    LinkUnknown,
    RecordingUnknown,
    ServiceError,
    VehicleUnknown,
)
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.link.types import LinkState
from mavcal.service.settings import ApiKey, Settings
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import UnitRow

DIGEST = "0" * 64


def job(job_id: str, vehicle_id: str | None) -> Job:
    return Job(job_id, vehicle_id, "gyro", {}, JobState.REVIEW, 0.0, 0.0)


class Vehicles:
    """Two that are heard: one is tagged, one has another tag."""

    roads = tuple((x, SimpleNamespace(id=f"link-{x}")) for x in "ab")
    heard = tuple(SimpleNamespace(id=f"uid-{x}", link=road, links=(road,)) for x, road in roads)

    def all(self) -> tuple[Any, ...]:
        return self.heard

    def get(self, vehicle_id: str) -> Any:
        for vehicle in self.heard:
            if vehicle_id in (vehicle.id, f"{vehicle.link.id}-1-1"):
                return vehicle
        raise VehicleUnknown("There is no such vehicle; heard so far: uid-a, uid-b.")


class Jobs:
    """One of each vehicle, one of none."""

    known = (job("ja", "uid-a"), job("jb", "uid-b"), job("fit", None))

    def get(self, job_id: str) -> Job:
        for one in self.known:
            if one.id == job_id:
                return one
        raise JobUnknown


@pytest.fixture
def service() -> Iterator[Service]:
    store = SqliteStore(None)
    for unit, tag in (("uid-a", "boats"), ("uid-b", "planes")):
        store.save_unit(UnitRow(unit, "", (tag,), "px4", "", 0.0))
    yield cast(Service, SimpleNamespace(store=store, vehicles=Vehicles(), jobs=Jobs()))
    store.close()


@pytest.fixture
def boats(service: Service) -> Sight:
    return Sight(service, {"boats", "lakes"})


def link(*vehicles: str) -> LinkModel:
    return LinkModel(
        id="l",
        url="udp",
        state=next(iter(LinkState)),
        reason="",
        vehicles=list(vehicles),
        crc_errors=0,
        signing_key=None,
    )


def test_a_key_without_tags_sees_everything(service: Service) -> None:
    sight = Sight(service)
    assert sight.everything
    assert sight.vehicle("uid-b")
    assert sight.vehicle(None)
    assert sight.job_of("whatever")
    assert sight.link(link()) == link()
    sight.require("get_metrics", "GET", {})
    sight.require("get_vehicle", "GET", {"vehicle_id": "uid-b"})


def test_vehicles_by_either_name_and_their_jobs(boats: Sight) -> None:
    assert boats.vehicle("uid-a")
    assert boats.vehicle("link-a-1-1")
    assert not any(map(boats.vehicle, ("uid-b", "link-b-1-1", "uid-c", None)))
    assert boats.job_of("ja")
    assert not any(map(boats.job_of, ("jb", "fit", "none")))


def test_a_link_is_seen_with_its_visible_vehicles(boats: Sight) -> None:
    assert boats.link(link("uid-a", "uid-b")) == link("uid-a")
    assert boats.link(link("uid-b")) is None
    assert boats.link(link()) is None


@pytest.mark.parametrize(
    ("names", "error"),
    [
        ({"vehicle_id": "uid-b"}, VehicleUnknown),
        ({"job_id": "jb"}, JobUnknown),
        ({"job_id": "ja", "vehicle_id": "uid-b"}, VehicleUnknown),
        ({"gap_id": "fit"}, GapUnknown),
        ({"recording_id": "r"}, RecordingUnknown),
        ({"link_id": "link-b"}, LinkUnknown),
    ],
)
def test_what_is_hidden_is_not_there(boats: Sight, names: dict[str, str], error: type[Exception]) -> None:
    with pytest.raises(error) as caught:
        boats.require("any", "GET", names)
    assert "heard so far" not in str(caught.value)


def test_what_is_seen_may_be_asked_for(boats: Sight) -> None:
    boats.require("get_vehicle", "GET", {"vehicle_id": "uid-a"})
    boats.require("get_document", "GET", {"job_id": "ja", "name": "x"})
    boats.require("get_link", "GET", {"link_id": "link-a"})
    boats.require("list_jobs", "GET", {})


@pytest.mark.parametrize(
    ("operation", "method", "names"),
    [("get_metrics", "GET", {}), ("open_link", "POST", {}), ("new", "GET", {}), ("new", "GET", {"thing_id": "uid-a"}),
     ("close_link", "DELETE", {"link_id": "link-a"})],
)  # fmt: skip
def test_what_is_not_known_to_filter_is_refused(
    boats: Sight, operation: str, method: str, names: dict[str, str]
) -> None:
    with pytest.raises(Forbidden):
        boats.require(operation, method, names)


def test_the_operations_that_filter_are_there_and_name_nothing_in_their_address(tmp_path: Path) -> None:
    paths = create_app(Settings(data_dir=tmp_path)).openapi()["paths"]
    found = {o["operationId"]: path for path, methods in paths.items() for o in methods.values()}
    assert all("{" not in found[name] for name in FILTERED)


REFUSED = {"list_signing_keys", "list_methods", "list_audit", "check_audit", "get_metrics"}
"""What is read without a name in the address, and not by a key that is bound to tags."""
OPEN = {"get_health", "get_readiness", "get_registration"}


def test_whoever_adds_what_is_read_without_a_name_decides_who_sees_it(tmp_path: Path) -> None:
    paths = create_app(Settings(data_dir=tmp_path)).openapi()["paths"]
    found = {methods["get"]["operationId"] for path, methods in paths.items() if "{" not in path and "get" in methods}
    assert found - FILTERED == REFUSED | OPEN, "name it in FILTERED of service/api/sight.py, or here"


def test_an_admin_has_no_tags_and_a_tag_is_a_word() -> None:
    with pytest.raises(ValueError, match="sees every vehicle"):
        ApiKey(name="x", sha256=DIGEST, scopes=frozenset({"admin"}), tags=frozenset({"boats"}))
    with pytest.raises(ValueError, match="pattern"):
        ApiKey(name="x", sha256=DIGEST, tags=frozenset({"two words"}))
    assert ApiKey(name="x", sha256=DIGEST).tags == frozenset()


def test_a_change_of_tags_acts_at_once(service: Service, boats: Sight) -> None:
    row = service.store.unit("uid-a")
    assert row is not None
    service.store.save_unit(dataclasses.replace(row, tags=("planes",)))
    assert not boats.vehicle("uid-a")


def test_a_unit_is_seen_by_any_of_its_tags_and_by_a_key_without_any(service: Service, boats: Sight) -> None:
    assert boats.tagged(["planes", "lakes"])
    assert not boats.tagged(["planes"])
    assert not boats.tagged([])  # nobody has said whose it is
    assert Sight(service).tagged([])


def test_a_link_may_be_looked_at_and_not_touched_for_others_may_be_on_it(boats: Sight) -> None:
    for method in ("GET", "HEAD"):
        boats.require("get_link", method, {"link_id": "link-a"})
    for method in ("POST", "PUT", "PATCH", "DELETE"):
        with pytest.raises(Forbidden, match="others may be on this link"):
            boats.require("sign_link", method, {"link_id": "link-a"})
        with pytest.raises(LinkUnknown):  # a link that is not seen is not there, whatever is asked of it
            boats.require("sign_link", method, {"link_id": "link-b"})


@pytest.mark.parametrize(
    ("kind", "name", "said"),
    [
        ("vehicle_id", "uid-b", "there is no vehicle uid-b"),
        ("unit_id", "uid-c", "there is no unit uid-c"),
        ("gap_id", "jb", "there is no gap diagnosis jb"),
        ("recording_id", "r1", "there is no recording r1"),
    ],
)
def test_what_is_hidden_is_said_to_be_absent_in_the_words_of_what_is_absent(
    boats: Sight, kind: str, name: str, said: str
) -> None:
    with pytest.raises(ServiceError) as refused:
        boats.require("get", "GET", {kind: name})
    assert str(refused.value) == said
    assert refused.value.status_code == 404
