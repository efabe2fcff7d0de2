from __future__ import annotations

import asyncio
import json

import pytest
from click.testing import CliRunner

from mavcal.client.models import VehicleModel
from mavcal.service.api.views import vehicle_model
from mavcal.service.commands import recover, status
from mavcal.service.commands.vehicles import Found
from mavcal.service.commands.whom import Whom
from mavcal.service.errors import VehicleSilent
from mavcal.service.jobs.core.model import Result
from mavcal.service.jobs.core.states import JobState
from tests.unit.api.test_views import a_vehicle
from tests.unit.commands.doubles import plain

URL = "tcp:v:1"


async def one(make_service, *jobs):
    heard = VehicleModel.model_validate(vehicle_model(a_vehicle()).model_dump(mode="json"))
    return await status._one(make_service(*jobs), Found(URL, heard))


async def test_a_vehicle_is_told_with_the_last_calibration_of_each_kind(make_service):
    done = {"state": JobState.SUCCEEDED, "outcome": Result("done")}
    told = await one(
        make_service,
        plain("a", **{**done, "updated_at": 1.0}),
        plain("b", **{**done, "updated_at": 60.0}),
        plain("c", **{**done, "kind": "mag", "updated_at": 2.0}),
        plain("d", **{**done, "vehicle_id": "v2", "updated_at": 99.0}),
        plain("e", JobState.FAILED, kind="level"),
    )
    assert told["calibrated"] == {"gyro": {"job": "b", "at": 60.0}, "mag": {"job": "c", "at": 2.0}}
    assert (told["connect"], told["id"], told["autopilot"]) == (URL, "v1", "px4")


async def test_a_silent_link_is_told_by_its_error(make_service):
    told = await status._one(make_service(), Found(URL, error=VehicleSilent("nobody")))
    assert told == {"connect": URL, "error": {"code": "vehicle-silent", "detail": "nobody"}}


async def test_a_vehicle_has_its_lines(make_service, capsys):
    status._show(await one(make_service, plain("b", JobState.SUCCEEDED, updated_at=60.0)))
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == URL
    assert lines[1:] == [
        "  px4 1.17.0 as v1",
        "  disarmed, on_ground, 9.9% of its messages lost",
        "  not to be written to: it is armed",
        "  not to be written to: it flies",
        "  gyro calibrated 1970-01-01 00:01 UTC by job b",
    ]
    status._show(await one(make_service))
    assert capsys.readouterr().out.splitlines()[-1] == "  no calibration of it is known here"
    status._show({"connect": URL, "error": {"detail": "nobody"}})
    assert capsys.readouterr().out.splitlines() == [URL, "  nobody"]


@pytest.mark.parametrize(("found", "code"), [([{}], 0), ([{}, {"error": {"detail": "nobody"}}], 1), ([], 0)])
def test_a_vehicle_that_is_silent_makes_the_exit_code(monkeypatch, tmp_path, found, code):
    async def told(*_):
        return found

    monkeypatch.setattr(status, "_status", told)
    monkeypatch.setattr("mavcal.service.logs.configure_logging", lambda **_: None)
    arguments = ["--connect", URL, "--data-dir", str(tmp_path), "--json"]
    result = CliRunner().invoke(status.command, arguments, standalone_mode=False)
    assert result.return_value == code
    assert json.loads(result.stdout) == {"vehicles": found}


async def test_what_was_left_is_brought_to_an_end_and_what_is_of_others_named(make_service, screen, capsys):
    service = make_service(plain("a", JobState.QUEUED), plain("b", JobState.IN_DOUBT, vehicle_id="v2"))
    service.joined(URL, "v1", "v2")
    assert await recover._recovered(service, Whom((URL,), wait_s=1.0), screen, as_json=True) == 0
    assert service.jobs.done == [("cancel", "a"), ("wait_for_cleanup",)]
    assert screen.lines[-1] == "job b (gyro) of v2 is in_doubt"
    assert '"of_other_vehicles": [{"id": "b"' in capsys.readouterr().out


async def test_what_stays_in_doubt_makes_the_exit_code(make_service, screen):
    service = make_service(plain("a", JobState.IN_DOUBT))
    service.joined(URL, "v1")
    assert await recover._recovered(service, Whom((URL,), wait_s=0.0), screen, as_json=False) == 1
    assert "nothing is in doubt on this vehicle" not in screen.lines


async def test_where_nothing_was_left_it_is_said(make_service, screen):
    service = make_service()
    service.joined(URL, "v1")
    assert await recover._recovered(service, Whom((URL,), wait_s=1.0), screen, as_json=False) == 0
    assert screen.lines[-1] == "nothing is in doubt on this vehicle"


async def test_a_vehicle_that_is_silent_leaves_what_is_in_doubt_named(make_service, screen):
    service = make_service(plain("a", JobState.IN_DOUBT))
    service.joined(URL)
    with pytest.raises(VehicleSilent):
        await recover._recovered(service, Whom((URL,), wait_s=0.0), screen, as_json=False)
    assert screen.lines == ["job a (gyro) is in doubt"]


@pytest.mark.parametrize(
    ("shared", "said"), [(False, "until the next `mavcal recover`"), (True, "the service goes on")]
)
async def test_a_recovery_that_is_stopped_says_what_stays(make_service, screen, shared, said):
    service = make_service(shared=shared)
    waiting = asyncio.ensure_future(recover._recover(service, whom=Whom((URL,)), screen=screen, as_json=False))
    await asyncio.sleep(0)
    waiting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await waiting
    [line] = screen.lines
    assert line.startswith("stopped; ")
    assert said in line
