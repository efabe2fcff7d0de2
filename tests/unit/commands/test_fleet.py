from __future__ import annotations

import json
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import click
import pytest
from click.testing import CliRunner

from mavcal.client import ApiProblem, Client, Unreachable
from mavcal.service.commands import fleet
from mavcal.service.commands.fleet import FleetQuery, LocalFleet, RemoteFleet, command, opened, show
from mavcal.service.commands.output import AnsweredNo
from mavcal.service.errors import DataDirLocked, UnitUnknown
from mavcal.service.settings import Settings
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import UnitRow

DAY_S = 86400.0


def unit(unit_id="uid-a", **more):
    return {
        "unit": unit_id, "name": "", "tags": [], "autopilot": "px4", "firmware": "1.17.0 (abc)", "preflight": None,
        "age_days": None, "leaving": None, "needs_recalibration": False, "reasons": [], "sensors": [], **more,
    }  # fmt: skip


def shown(capsys, *units):
    show(list(units))
    return capsys.readouterr().out.splitlines()


def cells(capsys, **more):
    _, line = shown(capsys, unit(**more))
    return " ".join(line.split())


def test_a_unit_that_nobody_knows_anything_of_has_a_row(capsys):
    assert cells(capsys).split() == ["uid-a", "px4", "1.17.0", "no"]
    (line,) = shown(capsys)
    assert line.startswith("no unit")


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(59.0, "59 s"), (60.0, "1 min"), (3599.0, "60 min"), (3600.0, "1 h"), (86399.0, "24 h"), (2 * DAY_S, "2 d")],
)
def test_how_long_ago_is_said_in_the_largest_unit(capsys, seconds, said):
    assert f"warn {said} ago" in cells(capsys, preflight={"verdict": "warn", "age_s": seconds})


def test_the_age_of_a_calibration_and_when_it_leaves_its_limit_are_said(capsys):
    leaving = {"earliest": 0.0, "latest": 40 * DAY_S}
    line = cells(capsys, age_days=12.6, leaving=leaving, needs_recalibration=True, tags=["b", "a"], name="Heron")
    assert all(token in line for token in ("uid-a Heron", "b a", " 13 d ", "1970-01-01 to", "to 1970-02-10"))
    assert line.endswith(" yes")


def test_reasons_and_odd_sensors_stand_below_the_table(capsys):
    odd = {"odd": True, "distance": 6.25, "limit": 4.0, "group": "12 of"}
    sensor = {"sensor": "gyro", "instance": 1, "type": "ICM-42688", "oddness": odd}
    fine = {**sensor, "oddness": {**odd, "odd": False}}
    lines = shown(
        capsys,
        unit(reasons=[{"text": "It is old."}], sensors=[sensor, fine, {**sensor, "oddness": None}]),
        unit("uid-b", name="Heron", reasons=[{"text": "It drifts."}]),
    )
    old, oddity, drifts = lines[3:]
    assert old.startswith("uid-a:")
    assert old.endswith(" old.")
    assert all(token in oddity for token in ("uid-a:", "gyro 2", " 6.2 ", " 12 of", "ICM-42688", "limit 4.0"))
    assert drifts.startswith("Heron:")
    assert drifts.endswith(" drifts.")


class Source:
    """A fleet that notes what is asked of it."""

    def __init__(self):
        self.asked = []

    def units(self, query):
        self.asked.append(query)
        return [unit()]

    def csv(self, query):
        self.asked.append(query)
        return "unit\r\nuid-a\r\n"

    def unit(self, unit_id):
        return unit(unit_id, tags=["old", "kept"])

    def change(self, unit_id, **what):
        self.asked.append((unit_id, what))
        return unit(unit_id, name="Heron", tags=what.get("tags", []))


@pytest.fixture
def run(monkeypatch):
    """Runs the command on a source: what it printed, what the source was asked, and where it was."""
    source, places = Source(), []

    @contextmanager
    def at(*args, **named):
        places.append(args or tuple(named.values()))
        yield source

    monkeypatch.setattr(fleet, "opened", at)

    def invoke(*arguments):
        result = CliRunner().invoke(command, arguments, standalone_mode=False)
        if result.exception is not None:
            raise result.exception
        return result.stdout, source.asked, places

    return invoke


def test_what_is_wanted_is_asked_for(run):
    _, [query], _ = run(
        "--verdict", "fail", "--verdict", "none", "--tag", "b", "--min-age", "30", "--order", "age", "--odd"
    )
    assert query == FleetQuery(("fail", "none"), "b", 30.0, None, False, True, "age", False)  # noqa: FBT003


def test_units_are_told_as_table_json_or_csv(run):
    assert run()[0].splitlines()[1].startswith("uid-a")
    assert [one["unit"] for one in json.loads(run("--json")[0])["units"]] == ["uid-a"]
    assert run("--csv")[0].splitlines() == ["unit", "uid-a"]


@pytest.mark.parametrize("place", [("--data-dir", "/d"), ("--url", "http://h")])
def test_the_place_may_stand_before_or_after_the_name_of_a_subcommand(run, place):
    rest = ("name", "uid-a", "Heron")
    _, _, places = run(*place, *rest)
    run(*rest, *place)
    assert places[0] == places[1]
    assert str(place[1]) in map(str, places[0])


def test_tags_are_added_and_taken_away(run):
    said, [(unit_id, what)], _ = run("tag", "uid-a", "--add", "new", "--add", "kept", "--remove", "old")
    assert (unit_id, what) == ("uid-a", {"tags": ["kept", "new"]})
    assert said == "uid-a: Heron; tags: kept new\n"
    with pytest.raises(click.UsageError, match="give --add TAG"):
        run("tag", "uid-a")


def test_a_name_is_given(run):
    said, asked, _ = run("name", "uid-a", "Heron", "--json")
    assert asked == [("uid-a", {"name": "Heron"})]
    assert json.loads(said)["name"] == "Heron"


@pytest.fixture
def folder(tmp_path):
    store = SqliteStore(tmp_path)
    for name in ("uid-a", "uid-b"):
        store.save_unit(UnitRow(name, "", ("lake",) if name == "uid-b" else (), "px4", "1.17.0", 1.0))
    store.close()
    return tmp_path


def test_a_folder_is_read_changed_and_audited(folder):
    source = LocalFleet(Settings(data_dir=folder))
    assert [one["unit"] for one in source.units(FleetQuery())] == ["uid-a", "uid-b"]
    assert [one["unit"] for one in source.units(FleetQuery(tag="lake"))] == ["uid-b"]
    assert source.csv(FleetQuery(tag="lake")).splitlines()[1].startswith("uid-b")
    assert source.change("uid-a", name="Heron")["name"] == "Heron"
    changed = source.change("uid-a", tags=["boats"])
    assert (changed["name"], changed["tags"]) == ("Heron", ["boats"])  # what was not given stays
    store = SqliteStore(folder)
    trail = [(row.actor, row.action, row.subject, dict(row.detail)) for row in store.audit()]
    store.close()
    assert trail == [
        ("command line", "change unit", "uid-a", {"name": "Heron"}),
        ("command line", "change unit", "uid-a", {"tags": ["boats"]}),
    ]


def test_a_unit_that_there_is_not_is_neither_read_nor_changed(folder):
    source = LocalFleet(Settings(data_dir=folder))
    for ask in (source.unit, lambda name: source.change(name, name="x")):
        with pytest.raises(UnitUnknown, match="there is no unit uid-z"):
            ask("uid-z")


def test_a_folder_that_a_service_owns_is_read_and_not_changed(folder):
    owner = SqliteStore(folder)
    source = LocalFleet(Settings(data_dir=folder))
    assert source.unit("uid-a")["unit"] == "uid-a"
    with pytest.raises(DataDirLocked, match="or give the running service's --url"):
        source.change("uid-a", name="Heron")
    owner.close()


def test_a_name_that_is_too_long_is_wrong_use(folder):
    with pytest.raises(click.UsageError, match="at most"):
        LocalFleet(Settings(data_dir=folder)).change("uid-a", name="x" * 10_000)


class FleetClient:
    """A client of a service with so many units."""

    def __init__(self, count):
        self.names = [f"u{k}" for k in range(count)]
        self.asked = []

    def list_fleet(self, *, limit, after, **query):
        self.asked.append((after, query))
        begin = 0 if after is None else self.names.index(after) + 1
        return [
            SimpleNamespace(unit=name, model_dump=lambda mode, name=name: {"unit": name})
            for name in self.names[begin : begin + limit]
        ]


@pytest.mark.parametrize("count", [0, 1, 2, 3, 4, 5])
def test_a_service_is_asked_page_by_page(monkeypatch, count):
    monkeypatch.setattr(fleet, "PAGE", 2)
    client = FleetClient(count)
    assert [one["unit"] for one in RemoteFleet(client).units(FleetQuery())] == client.names
    assert len(client.asked) == count // 2 + 1


def test_what_was_not_asked_for_is_not_asked_of_a_service():
    client = FleetClient(0)
    RemoteFleet(client).units(FleetQuery())
    RemoteFleet(client).units(FleetQuery(("fail",), "b", 30.0, odd=True, descending=True))
    (_, nothing), (_, much) = client.asked
    assert {name for name, value in nothing.items() if value is not None} == {"order", "descending"}
    assert (much["verdict"], much["min_age_days"], much["odd"]) == (["fail"], 30.0, True)
    assert much["needs_recalibration"] is None
    assert "min_age" not in much


@pytest.mark.parametrize(
    ("error", "raised", "said"),
    [
        (ApiProblem(404, {"detail": "there is no unit x"}), AnsweredNo, "there is no unit x"),
        (ApiProblem(403, {"detail": "you may not"}), click.ClickException, "you may not"),
        (Unreachable("refused"), AnsweredNo, "refused; is `mavcal serve` running"),
    ],
)
def test_what_a_service_refuses_is_an_error_of_ours(error, raised, said):
    with pytest.raises(raised, match=said), opened(None, "http://h", None):
        raise error


def test_a_folder_or_a_service(tmp_path, monkeypatch):
    with pytest.raises(click.UsageError, match="not both"), opened(tmp_path, "http://h", None):
        pass
    with opened(tmp_path, None, None) as source:
        assert isinstance(source, LocalFleet)
    keys = []
    made = Client.__init__
    monkeypatch.setattr(Client, "__init__", lambda self, url, *, key: (keys.append(key), made(self, url, key=key))[1])
    Path(tmp_path / "key").write_text("secret\n")
    with opened(None, "http://h", tmp_path / "key") as source:
        assert isinstance(source, RemoteFleet)
    assert keys == ["secret"]
