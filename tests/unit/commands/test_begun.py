"""What the commands that run one job hand on: the settings, the job that they begin, and what is wanted of it."""

from __future__ import annotations

import importlib
from types import SimpleNamespace

import click
import pytest
from click.testing import CliRunner

from mavcal.client.requests import PlanOptions
from mavcal.service.commands.headless import Begun
from mavcal.service.commands.review import JobWish
from mavcal.service.errors import OtherVehicle
from mavcal.service.jobs.core.states import JobState
from tests.unit.commands.doubles import FakeVehicle, of_service, plain
from tests.unit.commands.test_review import PLAN

URL = "tcp:v:1"


@pytest.fixture
def handed(monkeypatch, tmp_path):
    """Runs a command as far as its job: settings, the function that begins it, and the wish."""

    def run(name, *arguments):
        module = importlib.import_module(f"mavcal.service.commands.{name}")
        caught = []
        monkeypatch.setattr(module, "run_job", lambda *what: caught.append(what) or 7)
        given = [*arguments, "--connect", URL, "--data-dir", str(tmp_path)]
        result = CliRunner().invoke(module.command, given, standalone_mode=False)
        if result.exception is not None:
            raise result.exception
        assert result.return_value == 7
        [(whom, begin, wish, *_)] = caught
        assert (whom.urls, whom.settings.connect, whom.settings.data_dir) == ((URL,), (), tmp_path)
        return begin, wish

    return run


@pytest.fixture
def asked():
    """What a service was asked for, whatever the method's name."""
    return []


@pytest.fixture
def client(asked):
    """A client that notes every request."""

    def method(name, result):
        async def note(*what, **how):
            asked.append((name, *what, how))
            return result

        return note

    begun = {name: method(name, "job") for name in ("start_job", "restore_calibration", "plan_recording")}
    return SimpleNamespace(**begun, upload_recording=method("upload", SimpleNamespace(id="upload")))


async def test_a_calibration_is_submitted_with_its_options(handed, client, asked):
    arguments = ("--option", "uncertainty=0.5", "--only", "gyro1", "--apply", "--require-proof", "--wait", "5")
    begin, wish = handed("calibrate", "gyro", *arguments)
    assert await begin(client, FakeVehicle()) == Begun("job")
    how = {"kind": "gyro", "options": {"uncertainty": 0.5}, "plan_options": PlanOptions(only=["gyro1"])}
    assert asked == [("start_job", "v1", how)]
    assert wish == JobWish(write=True, require_proof=True)


async def test_a_restore_is_of_all_sensors_or_of_those_that_are_named(handed, client, asked):
    for arguments in ((), ("--only", "gyro0,,accel1"), ("--apply", "--reboot", "--json")):
        begin, wish = handed("restore", *arguments)
        await begin(client, FakeVehicle())
    assert [how["only"] for _, _, how in asked] == [None, ["gyro0", "accel1"], None]
    assert wish == JobWish(write=True, reboot=True, as_json=True)


async def test_a_log_is_kept_and_its_fit_adopted(handed, client, asked, tmp_path):
    file = tmp_path / "a.csv"
    file.write_bytes(b"t,accel_x\n")
    arguments = ("--option", "model=ring", "--confirm-other-unit", "--unit-accel", "g")
    begin, wish = handed("plan", "gyro-rest", str(file), *arguments)
    await begin(client, FakeVehicle())
    [(_, chunks, kept), adopted] = asked
    assert (kept["name"], kept["reading"].unit_accel) == ("a.csv", "g")
    assert b"".join([chunk async for chunk in chunks]) == b"t,accel_x\n"
    how = {"method": "gyro-rest", "vehicle_id": "v1", "options": {"model": "ring"}}
    assert adopted == ("plan_recording", "upload", {**how, "plan_options": PlanOptions(confirm_other_unit=True)})
    assert wish == JobWish(write=False)


def test_a_proof_is_of_what_was_written(handed, tmp_path):
    (tmp_path / "a.csv").touch()
    with pytest.raises(click.UsageError, match="give --apply too"):
        handed("plan", "gyro-rest", str(tmp_path / "a.csv"), "--require-proof")


async def test_a_plan_that_waits_is_made_again_with_its_decisions_and_the_new_ones(handed, make_service):
    waiting = plain(
        "j", JobState.REVIEW, plan=PLAN, context={"plan_options": {"only": ["gyro0"], "adjust_level": True}}
    )
    service = make_service(waiting)
    service.joined(URL, "v1")
    service.jobs.planned = waiting
    begin, wish = handed("accept", "j", "--no-adjust-level", "--reboot")
    assert await begin(service, service.vehicles["v1"]) == Begun(of_service(waiting), ours=False)
    assert service.jobs.done == [("plan_again", "j", {"only": ["gyro0"], "adjust_level": False})]
    assert wish == JobWish(write=True, reboot=True)


async def test_a_write_is_taken_back_once_the_vehicle_may_be_written_to(handed, make_service):
    service = make_service(plain("j", JobState.SUCCEEDED))
    service.joined(URL, "v1")
    begin, wish = handed("revert", "j", "--wait", "0")
    begun = await begin(service, service.vehicles["v1"])
    assert (begun.job.state, begun.ours) == (JobState.REVERTED, False)
    assert wish == JobWish(write=True, revert=True)


@pytest.mark.parametrize("name", ["accept", "revert"])
async def test_a_job_of_another_vehicle_is_left_alone(handed, make_service, name):
    service = make_service(plain("j", JobState.REVIEW, vehicle_id="v2"))
    service.joined(URL, "v1")
    service.joined("tcp:w:1", "v2")
    begin, _ = handed(name, "j")
    with pytest.raises(OtherVehicle, match=f"job j belongs to v2, but {URL} leads to v1"):
        await begin(service, service.vehicles["v1"])
    assert service.jobs.done == []
