"""What the subcommands of a campaign hand on."""

from __future__ import annotations

import click
import pytest
from click.testing import CliRunner

from mavcal.service.commands import campaign_archive, campaign_run
from mavcal.service.commands.campaign import command
from mavcal.service.commands.campaign_output import OutputOptions
from mavcal.service.commands.headless import Begun
from mavcal.service.commands.whom import Whom

URL = "tcp:v:1"


@pytest.fixture
def handed(monkeypatch, tmp_path):
    """Runs a subcommand as far as its campaign: the arguments of what would run it."""
    caught = []
    monkeypatch.setattr(campaign_run, "run_vehicles", lambda *what: caught.append(what) or 7)
    monkeypatch.setattr(campaign_archive, "run_archive", lambda *what: caught.append(what) or 7)

    def run(*arguments):
        result = CliRunner().invoke(command, [*arguments, "--data-dir", str(tmp_path)], standalone_mode=False)
        if result.exception is not None:
            raise result.exception
        assert result.return_value == 7
        where, *rest = caught.pop()
        settings = getattr(where, "settings", where)
        assert (settings.data_dir, settings.connect) == (tmp_path, ())  # its own links are not opened
        return [where, *rest] if isinstance(where, Whom) else rest

    return run


class Noting:
    """Notes what is asked for."""

    def __init__(self):
        self.asked = []

    def __getattr__(self, name):
        async def note(*what, **how):
            self.asked.append((name, *what, how))
            return "job"

        return note


async def test_every_vehicle_that_is_heard_is_checked(handed):
    whom, begin, output = handed(
        "preflight", "--connect", URL, "--connect", "tcp:w:1", "--vehicle", "v1", "--at-once", "3"
    )
    assert (whom.urls, whom.ids, whom.every, output) == ((URL, "tcp:w:1"), ("v1",), False, OutputOptions())
    client = Noting()
    assert await begin(client, ["v1", "tcp:w:1"]) == Begun("job")
    assert client.asked == [("start_preflight_campaign", {"vehicles": ["v1", "tcp:w:1"], "at_once": 3})]


async def test_a_calibration_has_its_options(handed):
    arguments = ("--option", "uncertainty=0.5", "--only", "gyro0", "--apply", "--reboot", "--csv", "a.csv", "--json")
    _, begin, output = handed("calibrate", "gyro", "--connect", URL, *arguments)
    assert (str(output.table), output.as_json) == ("a.csv", True)
    client = Noting()
    await begin(client, ["v1"])
    [(name, how)] = client.asked
    plan = how.pop("plan_options")
    assert (name, plan.model_dump(exclude_unset=True)) == ("start_calibration_campaign", {"only": ["gyro0"]})
    asked = {"vehicles": ["v1"], "kind": "gyro", "options": {"uncertainty": 0.5}, "apply": True, "reboot": True}
    assert how == {**asked, "at_once": None}


def test_a_restart_is_a_part_of_writing(handed):
    with pytest.raises(click.UsageError, match="give --apply too"):
        handed("calibrate", "gyro", "--connect", URL, "--reboot")


async def test_a_folder_is_fitted_by_one_method(handed):
    arguments = ("--glob", "*.bin", "--option", "model=ring", "--unit-accel", "g", "--executor", "processes:2")
    executor, begin, output = handed("fit", "gyro-rest", "logs", *arguments)
    assert (executor, output) == ("processes:2", OutputOptions())
    found = Noting()
    await begin(found)
    [(name, folder, pattern, method, chosen, how)] = found.asked
    assert (name, str(folder), pattern, method) == ("fit", "logs", "*.bin", "gyro-rest")
    assert (chosen, how["at_once"], how["reading"]["unit_accel"]) == ({"model": "ring"}, None, "g")


async def test_a_folder_is_diagnosed_beside_files_that_are_there(handed, tmp_path):
    sim, nominal = tmp_path / "sim.csv", tmp_path / "n.csv"
    with pytest.raises(click.BadParameter, match="there is no file"):
        handed("gap", "logs", "--sim", str(sim))
    sim.touch()
    with pytest.raises(click.BadParameter, match="there is no file"):
        handed("gap", "logs", "--sim", str(sim), "--nominal", str(nominal))
    nominal.touch()
    _, begin, _ = handed("gap", "logs", "--sim", str(sim), "--nominal", str(nominal), "--at-once", "2")
    found = Noting()
    await begin(found)
    [(name, folder, pattern, given_sim, given_nominal, how)] = found.asked
    assert (name, str(folder), pattern, how["at_once"]) == ("gap", "logs", "*", 2)
    assert (given_sim, given_nominal) == (sim, (nominal,))


@pytest.mark.parametrize("of_folder", [True, False])
async def test_a_campaign_is_resumed_where_it_was_begun(handed, monkeypatch, of_folder):
    monkeypatch.setattr(campaign_archive, "is_of_folder", lambda _data_dir, _job: of_folder)
    if of_folder:
        executor, begin, _ = handed("resume", "c", "--executor", "threads:3")
        found = Noting()
        await begin(found)
        assert (executor, found.asked) == ("threads:3", [("resume", "c", {})])
    else:
        whom, _, _ = handed("resume", "c", "--connect", URL, "--wait", "5")
        assert (whom.urls, whom.wait_s) == ((URL,), 5.0)
