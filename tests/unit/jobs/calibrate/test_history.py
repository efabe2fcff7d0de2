from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from mavcal.calib.firmware.plan import Change, Fingerprint, ParameterKind, WritePlan
from mavcal.calib.recording import Identity, Sensor
from mavcal.calib.report import to_json
from mavcal.service.jobs.calibrate.history import history_of, verified_jobs
from mavcal.service.jobs.core.model import RESTORE, Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import JobRow, SnapshotPurpose
from tests.unit.api import samples

IDENTITY = Identity("ardupilot", 2, (4, 7, 0), "00ab", 1, 1)
GYRO = Change("INS_GYROFFS_X", 0.0, 0.01, ParameterKind.REAL32, "", sensor=Sensor.GYRO)
SESSION = replace(GYRO, name="INS_GYR_CAL", new=0.0, session=True, sensor=None)
FINGERPRINT = Fingerprint("ardupilot", "00ab", "4.7.0", (("INS_GYR_ID", 7),))
PLAN = WritePlan(FINGERPRINT, "a" * 64, (GYRO, SESSION))


def job(name: str, at: float = 1.0, **more: Any) -> Job:
    fields: dict[str, Any] = {"vehicle_id": "v1", "kind": "gyro", "state": JobState.SUCCEEDED, "plan": PLAN}
    fields |= {"context": {"identity": to_json(IDENTITY)}, **more}
    return Job(name, fields.pop("vehicle_id"), fields.pop("kind"), {}, fields.pop("state"), 0.0, at, **fields)


def names(*jobs: Job, identity: Identity = IDENTITY, vehicle: str = "v1") -> list[str]:
    return [one.id for one in verified_jobs(jobs, vehicle, identity)]


def test_what_was_verified_on_a_vehicle_counts_oldest_first() -> None:
    assert names(job("new", 9.0), job("old", 1.0), job("middle", 5.0)) == ["old", "middle", "new"]


@pytest.mark.parametrize(
    "other",
    [
        job("x", state=JobState.FAILED),
        job("x", state=JobState.REVIEW),
        job("x", state=JobState.REVERTED),
        job("x", plan=None),
        job("x", kind=RESTORE),  # which put back what another one had verified
        job("x", vehicle_id=None),
    ],
)
def test_nothing_else_was_verified(other: Job) -> None:
    assert names(other, job("good")) == ["good"]
    assert names(other) == []


def test_a_new_board_of_the_same_address_inherits_from_the_one_before() -> None:
    before = job("before", vehicle_id="old board")
    assert names(before) == ["before"]
    assert names(before, job("own")) == ["own"]  # not once it has one of its own
    two = job("two", vehicle_id="another board")
    assert names(before, two) == []  # which of them it was is not known


@pytest.mark.parametrize(
    "change", [{"system": 2}, {"component": 2}, {"autopilot": "px4"}, {"system": None}], ids=lambda c: next(iter(c))
)
def test_a_board_of_another_address_inherits_nothing(change: dict[str, Any]) -> None:
    before = job("before", vehicle_id="old board")
    assert names(before, identity=replace(IDENTITY, **change)) == []


@pytest.mark.parametrize("context", [{}, {"identity": {"system": "one"}}])
def test_a_job_that_does_not_say_whose_it_is_is_of_nobody_else(context: dict[str, Any]) -> None:
    assert names(job("before", vehicle_id="old board", context=context)) == []


def test_what_a_job_left_is_what_was_read_and_what_was_written() -> None:
    store = SqliteStore(None)
    store.save_job(JobRow("j", "v1", "gyro", "succeeded", 0.0, 1.0, {}))
    read = {"INS_GYROFFS_X": 0.0, "INS_GYROFFS_Y": 0.5, "INS_GYR_CAL": 1.0, "INS_GYR_ID": 2752772}
    store.add_snapshot("j", 0.0, SnapshotPurpose.COMPOSED_ON, "a" * 64, read)
    warm = replace(samples.fit(), sensor=Sensor.ACCEL, instance=1, temperature=31.5)
    unknown = replace(warm, instance=2, temperature=None)
    [left] = history_of([job("j", 4.0, results=(warm, unknown, samples.fit()))], store)
    store.close()
    assert (left.job, left.at, left.uid) == ("j", 4.0, "00ab")
    assert left.sensors == {Sensor.GYRO}
    assert left.parameters["INS_GYROFFS_X"] == 0.01
    assert left.parameters["INS_GYROFFS_Y"] == 0.5
    assert left.parameters["INS_GYR_CAL"] == 1.0  # a setting of the session was put back
    assert left.device_ids == {"gyro0": 2752772}
    assert left.temperatures == {1: 31.5}


def test_of_the_rows_of_px4_only_those_of_sensors_that_sent_samples_were_heard() -> None:
    store = SqliteStore(None)
    store.save_job(JobRow("j", "v1", "gyro", "succeeded", 0.0, 1.0, {}))
    rows = {
        f"CAL_{kind}{i}_ID": 10 * number + i for number, kind in enumerate(("ACC", "GYRO", "MAG"), 1) for i in (0, 1)
    }
    store.add_snapshot("j", 0.0, SnapshotPurpose.COMPOSED_ON, "a" * 64, rows)
    plan = replace(PLAN, fingerprint=replace(FINGERPRINT, autopilot="px4"))
    fit = replace(samples.fit(), sensor=Sensor.GYRO, instance=0)
    [left] = history_of([job("j", plan=plan, results=(fit,))], store)
    store.close()
    assert set(left.device_ids.values()) == {10, 11, 20, 21, 30, 31}
    assert left.heard == {10, 20}  # an inertial unit sends both in one message


def test_a_job_whose_reading_is_lost_says_what_its_plan_says() -> None:
    store = SqliteStore(None)
    [left] = history_of([job("j", plan=replace(PLAN, fingerprint=replace(FINGERPRINT, uid="")))], store)
    store.close()
    assert left.parameters == {"INS_GYROFFS_X": 0.01}
    assert (left.device_ids, left.uid) == ({"INS_GYR_ID": 7}, None)
