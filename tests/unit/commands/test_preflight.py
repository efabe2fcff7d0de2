from __future__ import annotations

import json
import re

import click
import pytest
from click.testing import CliRunner

from mavcal.client.models import PreflightModel
from mavcal.service.commands import door, preflight
from mavcal.service.commands.hands_free import Mended
from mavcal.service.commands.preflight import command, show
from mavcal.service.commands.vehicles import Found
from mavcal.service.errors import VehicleArmed
from mavcal.service.jobs.core.states import JobState
from tests.unit.commands.doubles import FakeVehicle, of_service, plain

A, B = "udpin:0.0.0.0:14550", "tcp:b:5760"


def check(verdict, name="gyro_rest", **more):
    plain = {"id": name, "verdict": verdict, "value": 0.25, "sd": 0.0123, "limit": 1.0, "unit": "deg/s"}
    return {**plain, "reason": "It turns.", "remedy": "", "evidence": [], **more}


def report(verdict, *checks, **more):
    document = {"vehicle_id": "v1", "verdict": verdict, "summary": "so it is", "checks": list(checks), "notes": []}
    return PreflightModel.model_validate({**document, "seconds": 4.26, "fixed": [], "at": 1.0, **more})


PASS, WARN, FAIL = (report(verdict, check(verdict)) for verdict in ("pass", "warn", "fail"))
ARMED = VehicleArmed("it is armed")


@pytest.fixture
def run(monkeypatch):
    """Runs the command where these came of the vehicles."""

    def with_outcomes(*came, arguments=("--connect", A)):
        def each(*_):
            if isinstance(came[0], int):
                return came[0]
            return [(Found(url, FakeVehicle(f"v{n}")), one) for n, (url, one) in enumerate(zip((A, B), came))]  # noqa: B905

        monkeypatch.setattr(door, "through_door", each)
        result = CliRunner().invoke(command, arguments, standalone_mode=False)
        if result.exception is not None:
            raise result.exception
        return result.return_value, result.stdout

    return with_outcomes


EVERY = ("--all", "--connect", A, "--connect", B)


@pytest.mark.parametrize(
    ("came", "code"),
    [((PASS,), 0), ((WARN,), 3), ((FAIL,), 1), ((PASS, WARN), 3), ((FAIL, WARN), 1), ((PASS, ARMED), 1), ((143,), 143)],
)
def test_the_exit_code_is_that_of_the_worst_vehicle(run, came, code):
    assert run(*came, arguments=EVERY)[0] == code


def test_a_check_that_cannot_be_made_is_no_pass(run):
    assert run(report("unknown", check("unknown")))[0] == 3


def test_one_vehicle_that_refuses_is_an_error_and_one_of_several_a_line(run):
    with pytest.raises(VehicleArmed):
        run(ARMED)
    _, said = run(PASS, ARMED, arguments=EVERY)
    assert said.splitlines()[-2:] == [B, "FAIL: it is armed"]


def test_one_vehicle_is_told_by_itself_and_several_by_endpoint(run):
    alone = json.loads(run(PASS, arguments=("--connect", A, "--json"))[1])
    assert (alone["verdict"], "connect" in alone) == ("pass", False)
    told = json.loads(run(PASS, ARMED, arguments=(*EVERY, "--json"))[1])["vehicles"]
    assert [one["connect"] for one in told] == [A, B]
    assert told[1]["error"] == {"code": "vehicle-armed", "detail": "it is armed"}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--fix", "gyro"), "give --apply too"),
        (("--apply",), "give --apply too"),
        (("--fix", "gyro,mag, accel", "--apply"), "cannot do accel, mag: only gyro, level"),
    ],
)
def test_what_is_to_be_written_is_said_twice(run, arguments, said):
    with pytest.raises(click.UsageError, match=said):
        run(PASS, arguments=("--connect", A, *arguments))


def shown(capsys, *found):
    show(*found)
    return capsys.readouterr().out.splitlines()


def test_a_check_that_passes_says_number_uncertainty_and_limit(capsys):
    [line, last] = shown(capsys, report("pass", check("pass")))
    assert line.startswith("PASS ")
    assert all(token in line for token in (" gyro_rest ", "[0.25 ±", "± 0.01", " 1 deg/s]"))
    assert last.startswith("PASS:")
    assert "(4.3 s)" in last


@pytest.mark.parametrize(
    ("more", "number"),
    [
        ({"sd": None}, ["0.25", "1"]),
        ({"unit": ""}, ["0.25", "0.01", "1"]),
        ({"value": None}, []),
        ({"limit": None}, []),
        ({"verdict": "warn"}, []),  # the reason says it
    ],
)
def test_a_number_is_said_where_there_is_one_to_compare(capsys, more, number):
    line = shown(capsys, report("pass", check(**{"verdict": "pass", **more})))[0]
    assert re.findall(r"[\d.]*\d", line) == number
    assert ("deg/s" in line) is ("sd" in more)


def test_what_helps_stands_below_its_check_and_names_are_aligned(capsys):
    found = report("fail", check("fail", remedy="Hold it still."), check("pass", "accel_force"), notes=["It is cold."])
    lines = shown(capsys, found, "tug")
    assert lines[0] == "tug"
    assert lines[2].strip() == "-> Hold it still."
    assert lines[1].index("It turns.") == lines[3].index("[0.25") == lines[2].index("-> ")
    assert lines[4] == "note: It is cold."


@pytest.mark.parametrize(("state", "kinds"), [("succeeded", ["gyro", "level"]), ("failed", ["gyro"])])
async def test_what_is_to_be_fixed_is_fixed_before_the_check(monkeypatch, make_service, screen, state, kinds):
    asked = []

    async def mended(_door, vehicle_id, kind, _screen, *, look):
        asked.append((kind, vehicle_id, look))
        return Mended(of_service(plain("j", JobState(state))), "It is.", in_part=False)

    async def checked(vehicle_id, *, heading):
        asked.append(("preflight", vehicle_id, heading))
        return PASS

    monkeypatch.setattr("mavcal.service.commands.hands_free.mended", mended)
    service = make_service()
    service.run_preflight = checked
    wish = preflight._Wish(("gyro", "level", "gyro"), 90.0)
    found = await preflight._checked(service, FakeVehicle(), screen, wish=wish)
    assert [fix.kind.value for fix in found.fixed] == kinds
    assert asked == [*((kind, "v1", False) for kind in kinds), ("preflight", "v1", 90.0)]
    assert screen.lines == ["px4 1.17.0 as v1", *(f"    {kind}: {state}: It is." for kind in kinds)]
