"""Commands that ask a running service: ``follow``, ``answer``, ``cancel``, and others with --url."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bench.running import RunningService, service
from mavcal.service.api.security import digest
from mavcal.service.simvehicle import SimulatedVehicle
from tests.patience import patience, scaled

from .cli_bench import mavcal
from .deployed import clean_environment, started
from .jobs_bench import stored
from .test_cli_every import free_port
from .test_cli_recovery import Running

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def sim() -> Iterator[SimulatedVehicle]:
    config = {"thermal": False, "parameters": {"INS_GYR_CAL": 0}}
    with SimulatedVehicle("ardupilot", seed=11, speed=20, config=config) as vehicle:
        vehicle.call("still")
        yield vehicle


@pytest.fixture(scope="module")
def running(sim: SimulatedVehicle, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    with service(sim.url, tmp_path_factory.mktemp("remote") / "data") as found:
        found.found()
        yield found


def process(*arguments: str) -> tuple[int, dict[str, Any], str]:
    """Exit code, JSON and stderr of a command in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-m", "mavcal", *arguments, "--json"],
        cwd=ROOT, capture_output=True, text=True, check=False, timeout=scaled(100.0),
    )  # fmt: skip
    assert "Traceback" not in done.stderr, done.stderr
    return done.returncode, json.loads(done.stdout), done.stderr


def begun(running: RunningService, kind: str, **options: float) -> str:
    return running.client.start_job(running.found(), kind=kind, options=dict(options)).id


def asks(running: RunningService, job_id: str, text: str) -> None:
    limit = patience(30.0)
    while (prompt := running.client.get_job(job_id).prompt) is None or text not in prompt.answers:
        assert not limit.over, prompt


@pytest.mark.long
def test_a_job_is_followed_accepted_and_taken_back(running: RunningService, sim: SimulatedVehicle) -> None:
    before = stored(sim)
    job_id = begun(running, "gyro")
    code, told, said = process("follow", job_id, "--url", running.url)
    assert (code, told["state"]) == (0, "review"), said
    assert f"its plan waits: `mavcal accept {job_id} --url {running.url}` writes it" in said
    assert process("follow", job_id, "--url", running.url)[:2] == (0, told)  # at once: nothing goes on
    assert stored(sim) == before
    code, told, said = process("accept", job_id, "--url", running.url, "--only", "gyro0")
    assert (code, told["state"], told["plan_options"]) == (0, "succeeded", {"only": ["gyro0"]}), said
    assert "INS_GYROFFS_X" in said
    assert "do not touch it" not in said  # of the capture, which is over
    assert stored(sim) != before
    code, told, said = process("revert", job_id, "--url", running.url)
    assert (code, told["state"]) == (0, "reverted"), said
    assert stored(sim) == before
    code, told, _ = process("revert", job_id, "--url", running.url)
    assert (code, told["error"]["code"]) == (1, "not-revertible")


def test_a_prompt_is_answered_and_a_job_is_cancelled(running: RunningService) -> None:
    job_id = begun(running, "accel")
    code, told, _ = mavcal("answer", job_id, "nonsense", "--url", running.url)
    assert (code, told["error"]["code"]) == (1, "answer-refused")
    code, told, said = mavcal("cancel", job_id, "--url", running.url)
    assert (code, told["id"], told["state"]) == (0, job_id, "cancelled")
    assert said.startswith("cancelled")
    code, told, _ = mavcal("cancel", job_id, "--url", running.url)
    assert (code, told["error"]["code"]) == (1, "not-cancellable")
    code, told, said = mavcal("follow", job_id, "--url", running.url)
    assert (code, told["state"]) == (1, "cancelled")


@pytest.mark.long
def test_a_job_right_after_a_cancelled_one_gets_its_samples(running: RunningService, sim: SimulatedVehicle) -> None:
    """The cancelled one has asked for messages a moment ago, and puts the rates back a moment later."""
    sim.call("still")
    for _ in range(2):
        running.client.cancel_job(begun(running, "accel"))
    job_id = begun(running, "gyro")
    code, told, said = mavcal("follow", job_id, "--url", running.url)
    assert (code, told["state"]) == (0, "review"), said
    running.client.cancel_job(job_id)


@pytest.mark.long
def test_what_the_prompt_offers_is_an_answer(running: RunningService, sim: SimulatedVehicle) -> None:
    sim.call("tumble", rate_dps=45.0)
    job_id = begun(running, "mag", uncertainty=0.02, patience=3600)
    asks(running, job_id, "finish")
    code, told, said = mavcal("answer", job_id, "finish", "--url", running.url)
    assert (code, told["id"]) == (0, job_id), said
    assert mavcal("follow", job_id, "--url", running.url)[1]["state"] == "review"
    sim.call("still")


@pytest.mark.long
def test_a_service_and_its_folder_list_the_same_a_page_at_a_time(running: RunningService) -> None:
    ids = [running.client.cancel_job(begun(running, "accel")).id for _ in range(3)][::-1]
    places = (("--url", running.url), ("--data-dir", str(running.data_dir)))
    whole, folder = (mavcal("jobs", "--kind", "accel", "--state", "cancelled", *place)[1] for place in places)
    assert whole == folder
    assert [job["id"] for job in whole["jobs"]][:3] == ids
    for place in places:
        _, first, _ = mavcal("jobs", "--limit", "2", *place)
        assert ([job["id"] for job in first["jobs"]], first["next"]) == (ids[:2], ids[1])
        _, second, _ = mavcal("jobs", "--limit", "1000", "--after", ids[1], *place)
        assert (second["jobs"][0]["id"], second["next"]) == (ids[2], None)
        code, told, _ = mavcal("jobs", "--after", "nothing", *place)
        assert (code, told["error"]["code"]) == (1, "job-unknown")


@pytest.mark.long
def test_who_is_not_there_and_what_is_no_address_is_said(tmp_path: Path) -> None:
    code, told, _ = mavcal("cancel", "j1", "--url", "http://127.0.0.1:1")
    assert (code, told["error"]["code"]) == (1, "unreachable")
    for url in ("127.0.0.1:8765", "udpin:0.0.0.0:14550", "http://", "http://[::1"):
        assert mavcal("jobs", "--url", url)[0] == 2
    (tmp_path / "two").write_text("a b\n")
    assert mavcal("jobs", "--url", "http://127.0.0.1:1", "--key-file", str(tmp_path / "two"))[0] == 2
    for command in ("accept", "revert"):
        assert mavcal(command, "j1")[0] == 2
        assert mavcal(command, "j1", "--connect", "sim:px4", "--url", "http://127.0.0.1:1")[0] == 2


@pytest.mark.long
def test_a_key_lets_in_and_none_does_not(tmp_path: Path) -> None:
    keys = json.dumps([{"name": "me", "sha256": digest("secret"), "scopes": ["read"]}])
    environment = clean_environment() | {"MAVCAL_API_KEYS": keys, "MAVCAL_DATA_DIR": str(tmp_path / "data")}
    command = [sys.executable, "-m", "mavcal", "serve", "--port", "0"]
    (tmp_path / "key").write_text("secret\n")
    with started(command, environment | {"PYTHONPATH": str(ROOT)}, tmp_path) as served:
        code, told, _ = mavcal("jobs", "--url", served.url)
        assert (code, told["error"]["code"]) == (2, "authentication-required")
        place = ("--url", served.url, "--key-file", str(tmp_path / "key"))
        assert mavcal("jobs", *place)[:2] == (0, {"jobs": [], "next": None})
        code, told, _ = mavcal("cancel", "j1", *place)
        assert (code, told["error"]["code"]) == (2, "not-allowed")


@pytest.mark.long
def test_a_command_that_is_stopped_cancels_its_own_job_and_nothing_else(
    running: RunningService, sim: SimulatedVehicle
) -> None:
    theirs = begun(running, "gyro")
    assert mavcal("follow", theirs, "--url", running.url)[1]["state"] == "review"
    before = stored(sim)
    sim.call("speed", value=1.0)
    command = [sys.executable, "-u", "-m", "mavcal", "calibrate", "gyro", "--apply", "--url", running.url]
    ours = Running(command, None)
    ours.until("do not touch it")
    assert ours.stopped(signal.SIGINT) == 128 + signal.SIGINT
    assert "was cancelled, nothing was written" in ours.said
    sim.call("speed", value=20.0)
    newest, *_ = running.client.list_jobs(order="newest", limit=1)
    assert (newest.kind, newest.state.value) == ("gyro", "cancelled")
    assert running.client.get_job(theirs).state.value == "review"
    assert running.client.get_health() is not None
    assert stored(sim) == before
    running.client.cancel_job(theirs)


@pytest.mark.long
def test_a_vehicle_that_another_job_has_is_not_taken_over(running: RunningService) -> None:
    theirs = begun(running, "accel")
    for words in (("calibrate", "gyro"), ("preflight",), ("preflight", "--fix", "gyro", "--apply")):
        code, told, _ = mavcal(*words, "--url", running.url)
        assert (code, told["error"]["code"]) == (1, "physical-job-running"), told
    code, told, said = mavcal("recover", "--url", running.url)
    assert (code, told["recovered"], told["in_doubt"]) == (0, [], []), said
    assert running.client.get_job(theirs).state.value in {"running", "waiting_for_operator"}
    running.client.cancel_job(theirs)


@pytest.mark.long
def test_of_several_vehicles_one_is_chosen_or_all_are_listed(tmp_path: Path) -> None:
    link = f"udpout:127.0.0.1:{free_port()}"
    config = {"imu_count": 1, "parameters": {"INS_GYR_CAL": 0}}
    with (
        SimulatedVehicle("ardupilot", seed=8, speed=4.0, system_id=1, link=link, config=config) as one,
        SimulatedVehicle("ardupilot", seed=9, speed=4.0, system_id=2, link=link, config=config) as two,
        service(one.url, tmp_path / "data") as running,
    ):
        one.call("still")
        two.call("still")
        limit = patience(60.0)
        while not (len(heard := running.client.list_vehicles()) == 2 and all(v.uid for v in heard)):
            assert not limit.over, heard
        place = ("--url", running.url)
        ids = {vehicle.system: vehicle.id for vehicle in heard}
        for words in (("status",), ("calibrate", "gyro"), ("recover",)):
            code, told, _ = mavcal(*words, *place)
            assert (code, told["error"]["code"]) == (2, "usage")
            assert all(vehicle_id in told["error"]["detail"] for vehicle_id in ids.values())
        code, told, _ = mavcal("status", "--all", *place)
        assert (code, sorted(v["system"] for v in told["vehicles"])) == (0, [1, 2])
        for name in ("2", ids[2]):
            code, told, _ = mavcal("status", "--vehicle", name, *place)
            assert (code, [v["id"] for v in told["vehicles"]]) == (0, [ids[2]])
        code, told, said = mavcal("calibrate", "gyro", "--vehicle", "2", *place)
        assert (code, told["vehicle_id"], told["state"]) == (0, ids[2], "review"), said
        assert f"`mavcal accept {told['id']} --url {running.url}` writes it" in said  # the job says which vehicle
        code, told, said = mavcal("accept", told["id"], *place)
        assert (code, told["vehicle_id"], told["state"]) == (0, ids[2], "succeeded"), said
