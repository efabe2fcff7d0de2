"""From a log to the vehicle: what a job recorded, uploaded, fitted, planned for the same vehicle, and written."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import structlog

from mavcal.calib.wire.tlog import iter_tlog
from mavcal.service.logs import configure_logging
from mavcal.service.simvehicle import SimulatedVehicle

from .api_bench import Api, Json, served
from .jobs_bench import GYRO_OFFSETS, SPEED, stored, zero_gyro_offsets

AUTOPILOT_VERSION = 148
GYRO = {"kind": "gyro", "options": {"uncertainty": 0.02}}


@pytest.fixture(scope="module")
def sim() -> Iterator[SimulatedVehicle]:
    with SimulatedVehicle("ardupilot", speed=SPEED, seed=33, config={"thermal": False}) as vehicle:
        yield vehicle


@pytest.fixture(autouse=True)
def rested(sim: SimulatedVehicle) -> Iterator[None]:
    sim.call("clear_faults")
    sim.call("disarm")
    sim.call("still")
    zero_gyro_offsets(sim)
    configure_logging(as_json=False)
    yield
    structlog.reset_defaults()


async def logged(a: Api, vehicle: Json) -> tuple[Json, bytes]:
    """A live job in review, and the telemetry log of everything up to the end of its capture."""
    job = await a.post(f"/vehicles/{vehicle['id']}/jobs", GYRO, 202)
    job = await a.until(job["id"], "review")
    await a.delete(f"/jobs/{job['id']}", 200)
    return job, log_of(a, job)[: job["segments"][-1]["end_byte"]]


def log_of(a: Api, job: Json) -> bytes:
    (path,) = (a.service.settings.data_dir / "tlogs").rglob(job["segments"][-1]["path"])
    assert isinstance(path, Path)
    return path.read_bytes()


async def upload(a: Api, content: bytes, name: str = "flight.tlog") -> str:
    found: Any = await a.call("POST", "/api/v1/recordings", 201, params={"name": name}, content=content)
    return str(found["id"])


@pytest.mark.long
async def test_a_log_is_fitted_planned_written_proved_and_taken_back(tmp_path, sim):
    async with served(tmp_path, connect=(sim.url,)) as a:
        vehicle = await a.vehicle()
        live, content = await logged(a, vehicle)
        before = stored(sim)
        where = f"/recordings/{await upload(a, content)}/jobs"
        body = {"vehicle_id": vehicle["id"], "method": "gyro-rest"}
        job = await a.post(where, body, 202)
        assert (job["kind"], job["state"], job["options"]["method"]) == ("recording", "fitting", "gyro-rest")
        job = await a.until(job["id"], "review")
        assert stored(sim) == before
        planned = {c["name"]: c["new"] for c in job["plan"]["changes"]}
        same = {c["name"]: c["new"] for c in live["plan"]["changes"] if c["name"] in GYRO_OFFSETS}
        for name, value in same.items():
            assert planned[name] == pytest.approx(value, abs=5e-4)
        assert (await a.get(f"/jobs/{job['id']}/export.param")).count("# was ") == len(planned)

        again = await a.post(f"/jobs/{job['id']}/plan", None, 200)
        await a.post(f"/jobs/{job['id']}/apply", {"plan_sha256": again["sha256"], "prove_s": 0}, 202)
        await a.until(job["id"], "succeeded")
        after = stored(sim)
        assert {name: after[name] for name in planned} == planned

        # The same log once more: every gyro agrees with what is in force, which is a success and nothing to take back.
        done = await a.post(where, body, 202)
        done = await a.until(done["id"], "succeeded")
        assert done["plan"]["changes"] == []
        assert done["outcome"]["text"].startswith(
            "Nothing to write: gyro 1 agrees with what is in force: differs by 0.0"
        )
        assert len(done["plan"]["agreements"]) == 3
        await a.post(f"/jobs/{done['id']}/revert", {}, 409)
        await a.post(f"/jobs/{job['id']}/revert", {}, 202)
        await a.until(job["id"], "reverted")
        assert stored(sim) == before


async def test_a_log_of_other_sensors_is_refused_with_the_reason(tmp_path, sim):
    async with served(tmp_path, connect=(sim.url,)) as a:
        vehicle = await a.vehicle()
        _, content = await logged(a, vehicle)
        recording = await upload(a, content)
        body = {"vehicle_id": vehicle["id"], "method": "gyro-rest"}
        job = await a.post(f"/recordings/{recording}/jobs", body, 202)
        await a.until(job["id"], "review")
        held = stored(sim)["INS_GYR2_ID"]
        sim.call("fault", kind="foreign_write", name="INS_GYR2_ID", value=1234)
        outcome = await failed(a, recording, body)
        assert outcome["code"] == "other-vehicle"
        assert "gyro 2 had the device id" in outcome["cause"]
        assert "1234" in outcome["cause"]
        problem = await a.post(f"/jobs/{job['id']}/plan", None, 409)
        assert problem["type"].endswith("other-vehicle")
        sim.call("fault", kind="foreign_write", name="INS_GYR2_ID", value=held)


@pytest.mark.long
async def test_what_is_of_no_vehicle_is_never_planned(tmp_path, sim):
    async with served(tmp_path, connect=(sim.url,)) as a:
        vehicle = await a.vehicle()
        rows = "".join(f"{k / 50},0.01,0.02,0.0{k % 10}\n" for k in range(400))
        recording = await upload(a, f"t,gyro_x,gyro_y,gyro_z\n{rows}".encode(), "rest.csv")
        body = {"vehicle_id": vehicle["id"], "method": "gyro-rest"}
        outcome = await failed(a, recording, body)
        assert "does not say which vehicle" in outcome["cause"]
        await a.post(f"/recordings/{recording}/jobs", body | {"method": "nothing"}, 422)
        await a.post(f"/recordings/{recording}/jobs", {"method": "gyro-rest"}, 422)
        await a.post("/recordings/none/jobs", body, 404)
        assert len(await a.get("/jobs")) == 1


async def test_a_log_without_a_board_id_is_written_only_as_confirmed_and_the_audit_says_so(tmp_path, sim):
    async with served(tmp_path, connect=(sim.url,)) as a:
        vehicle = await a.vehicle()
        _, content = await logged(a, vehicle)
        where = f"/recordings/{await upload(a, without_version(content))}/jobs"
        body = {"vehicle_id": vehicle["id"], "method": "gyro-rest"}
        job = await a.post(where, body, 202)
        job = await a.until(job["id"], "review")
        (blocker,) = job["plan"]["blockers"]
        assert "does not say which board it is of" in blocker
        assert "confirm_other_unit" in blocker
        problem = await a.post(f"/jobs/{job['id']}/apply", {"plan_sha256": job["plan"]["sha256"]}, 409)
        assert problem["type"].endswith("plan-blocked")

        again = await a.post(f"/jobs/{job['id']}/plan", {"plan_options": {"confirm_other_unit": True}}, 200)
        assert again["blockers"] == []
        assert (await a.get(f"/jobs/{job['id']}"))["plan_options"] == {"confirm_other_unit": True}
        assert "the operator has confirmed" in again["warnings"][0]
        await a.post(f"/jobs/{job['id']}/apply", {"plan_sha256": again["sha256"], "prove_s": 0}, 202)
        await a.until(job["id"], "succeeded")
        (row,) = [row for row in a.service.store.audit() if row.action == "apply"]
        assert row.detail["confirmed"] == ["confirm_other_unit"]


@pytest.mark.long
async def test_a_plan_is_decided_over_http_from_the_start_and_again(tmp_path, sim):
    async with served(tmp_path, connect=(sim.url,)) as a:
        vehicle = await a.vehicle()
        where = f"/vehicles/{vehicle['id']}/jobs"
        problem = await a.post(where, GYRO | {"plan_options": {"only": ["mag0"]}}, 422)
        assert "gyro does not calibrate mag0" in problem["detail"]
        decided = {"only": ["gyro1"], "keep_gyro_at_boot": True}
        job = await a.post(where, GYRO | {"plan_options": decided}, 202)
        job = await a.until(job["id"], "review")
        assert job["plan_options"] == decided
        names = {c["name"] for c in job["plan"]["changes"]}
        assert "INS_GYR_CAL" in names
        assert names & set(GYRO_OFFSETS) == {f"INS_GYR2OFFS_{axis}" for axis in "XYZ"}

        again = await a.post(f"/jobs/{job['id']}/plan", {"plan_options": {}}, 200)
        assert {c["name"] for c in again["changes"]} >= set(GYRO_OFFSETS)
        assert again["warnings"][0].startswith("the next boot discards these gyro offsets")
        problem = await a.post(f"/jobs/{job['id']}/plan", {"plan_options": {"only": ["gyro7"]}}, 422)
        assert "there is no gyro7 to plan for; there are: gyro0, gyro1, gyro2" in problem["detail"]
        await a.post(f"/jobs/{job['id']}/plan", {"plan_options": {"keep_gyros": True}}, 422)


@pytest.mark.long
async def test_a_sensor_that_the_vehicle_does_not_have_ends_the_job_at_once_with_the_list(tmp_path, sim):
    async with served(tmp_path, connect=(sim.url,)) as a:
        vehicle = await a.vehicle()
        body = GYRO | {"plan_options": {"only": ["gyro7"]}}
        job = await a.post(f"/vehicles/{vehicle['id']}/jobs", body, 202)
        job = await a.until(job["id"], "failed")
        assert "there is no gyro7 to plan for; there are: accel0, accel1, accel2, gyro0" in job["outcome"]["cause"]


def without_version(content: bytes) -> bytes:
    """The telemetry log without AUTOPILOT_VERSION, as many are."""
    kept = [(at, frame) for at, frame in iter_tlog(content) if frame.message_id != AUTOPILOT_VERSION]
    return b"".join(struct.pack(">Q", at) + frame.raw for at, frame in kept)


@pytest.mark.long
async def test_a_job_of_a_recording_is_answered_at_once_and_can_be_cancelled(tmp_path, sim, monkeypatch):
    monkeypatch.setattr("mavcal.service.computations.FIT", "tests.service.child_tasks:hang_on_path")
    async with served(tmp_path, connect=(sim.url,)) as a:
        vehicle = await a.vehicle()
        recording = await upload(a, b"t,gyro_x,gyro_y,gyro_z\n0,0,0,0\n1,0,0,0\n", "rest.csv")
        body = {"vehicle_id": vehicle["id"], "method": "gyro-rest"}
        job = await a.post(f"/recordings/{recording}/jobs", body, 202)
        assert job["state"] == "fitting"
        assert (await a.delete(f"/jobs/{job['id']}", 200))["state"] == "cancelled"
        left = await a.post(f"/recordings/{recording}/jobs", body, 202)
    async with served(tmp_path) as a:  # the service was stopped meanwhile
        found = await a.get(f"/jobs/{left['id']}")
        assert found["state"] == "fitting"  # it begins again


async def failed(a: Api, recording: str, body: Json) -> Json:
    """The outcome of a job that is accepted and then fails."""
    job = await a.post(f"/recordings/{recording}/jobs", body, 202)
    return dict((await a.until(job["id"], "failed"))["outcome"])
