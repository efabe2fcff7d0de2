"""What jobs and preflights leave in the store, and names and tags."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from mavcal.calib.firmware.plan import Agreement, Change, Fingerprint, ParameterKind, WritePlan
from mavcal.calib.fit import FitBuilder, FitResult
from mavcal.calib.fleet.record import ObservationSource
from mavcal.calib.preflight.check import Check, CheckId, Report, Verdict
from mavcal.calib.preflight.rest import RestReading
from mavcal.calib.recording import Identity, Sensor
from mavcal.calib.triad import TriadModel
from mavcal.service.errors import StoreError, UnitUnknown
from mavcal.service.fleet.book import PREFLIGHTS_KEPT, FleetBook, renamed
from mavcal.service.fleet.records import last_preflight, records_of_job, records_of_rows
from mavcal.service.jobs.core.codec import row_from_job
from mavcal.service.jobs.core.model import Failure, Job, Result
from mavcal.service.jobs.core.proof import ProofLevel
from mavcal.service.jobs.core.states import JobState
from mavcal.service.preflights import Preflight
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import SnapshotPurpose
from mavcal.service.vehicle.registry import VehicleRegistry

DIGEST = "a" * 64
PARAMETERS = {"INS_GYR_ID": 2752772, "INS_GYR2_ID": 2752780, "INS_GYR_CAL": 0, "INS_GYR1_CALTEMP": 30.0}


@pytest.fixture
def store() -> Iterator[SqliteStore]:
    store = SqliteStore(None)
    yield store
    store.close()


@pytest.fixture
def book(store: SqliteStore) -> FleetBook:
    return FleetBook(store, VehicleRegistry())


def fit(instance: int) -> FitResult:
    covariance = np.zeros((12, 12))
    covariance[:3, :3] = np.eye(3) * 1e-8
    builder = FitBuilder("gyro-rest", Sensor.GYRO, instance, "rad/s", 100, temperature=30.0)
    return builder.fitted(
        TriadModel(offset=np.full(3, 0.01)), covariance, message="", n_used=100, residual_rms=0.0, condition_number=1.0
    )


def change(instance: int) -> Change:
    name = f"INS_GYR{'' if instance == 0 else instance + 1}OFFS_X"
    return Change(name, 0.0, 0.01, ParameterKind.REAL32, "", sensor=Sensor.GYRO, instance=instance)


def job(
    changes: tuple[int, ...] = (0, 1),
    agreements: tuple[int, ...] = (),
    proof: ProofLevel = ProofLevel.FULL,
    state: JobState = JobState.SUCCEEDED,
) -> Job:
    plan = WritePlan(
        Fingerprint("ardupilot", "ab", "4.5.7", ()),
        DIGEST,
        tuple(map(change, changes)),
        agreements=tuple(Agreement(Sensor.GYRO, i, 0.5, "") for i in agreements),
    )
    return Job("j1", "uid-ab", "gyro", {}, state, 1.0, 2.0, results=(fit(0), fit(1)), plan=plan,
               outcome=Result("done", proof))  # fmt: skip


def keep(store: SqliteStore, one: Job) -> Job:
    store.save_job(row_from_job(one))
    store.add_snapshot(one.id, 1.0, SnapshotPurpose.COMPOSED_ON, DIGEST, PARAMETERS)
    return one


def waited(store: SqliteStore) -> None:
    store.soon(lambda: None).result()


def test_a_calibration_leaves_bias_part_and_temperatures(store: SqliteStore) -> None:
    first, second = records_of_job(keep(store, job()), store)
    assert (first.unit, first.device_id, first.what, first.at) == ("uid-ab", 2752772, "gyro", 2.0)
    assert first.bias == (0.01, 0.01, 0.01)
    assert first.sd == pytest.approx((1e-4, 1e-4, 1e-4))
    assert (first.applied, first.proved, first.by_itself) == (True, True, False)
    assert first.covered is not None
    assert (first.covered.low, first.covered.high) == (10.0, 50.0)
    assert second.device_id == 2752780


def test_what_was_not_written_is_no_calibration_and_what_was_not_proved_is_in_no_trend(store: SqliteStore) -> None:
    keep(store, job())
    first, second = records_of_job(job(changes=(0,)), store)
    assert (first.applied, first.observation is not None) == (True, True)
    assert (second.applied, second.observation) == (False, None)
    unproved, agreed = records_of_job(job(changes=(0,), agreements=(1,), proof=ProofLevel.NONE), store)
    assert (unproved.applied, unproved.observation) == (True, None)
    assert (agreed.applied, agreed.observation is not None) == (True, True)


def test_a_job_is_taken_when_it_ends_and_forgotten_when_it_is_taken_back(store: SqliteStore, book: FleetBook) -> None:
    done = keep(store, job())
    book.job_ended(dataclasses.replace(done, state=JobState.REVIEW))
    waited(store)
    assert store.fleet().sensors == ()
    book.job_ended(done)
    waited(store)
    assert len(records_of_rows(store.fleet("uid-ab").sensors)) == 2
    book.job_ended(dataclasses.replace(done, state=JobState.REVERTED))
    waited(store)
    assert store.fleet().sensors == ()


async def test_a_start_takes_what_was_left_out_and_forgets_what_no_longer_holds(
    store: SqliteStore, book: FleetBook
) -> None:
    done = keep(store, job())
    await book.take_up([done])
    waited(store)
    assert len(store.fleet().sensors) == 2
    doubtful = dataclasses.replace(done, state=JobState.IN_DOUBT, outcome=Failure("in-doubt", "x", ""))
    await book.take_up([doubtful])
    waited(store)
    assert store.fleet().sensors == ()


def test_a_record_that_cannot_be_kept_harms_nobody(
    store: SqliteStore, book: FleetBook, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise StoreError("the disk is broken")

    done = keep(store, job())
    with monkeypatch.context() as patch:
        patch.setattr(store, "add_sensor_records", refuse)
        book.job_ended(done)
        waited(store)
    book.job_ended(done)
    waited(store)
    assert len(store.fleet().sensors) == 2


def preflight(at: float = 5.0) -> Preflight:
    check = Check(CheckId.GYRO_REST, Verdict.FAIL, 1.0, 0.1, 0.5, "deg/s", "It turns.")
    gyro = RestReading(Sensor.GYRO, 0, 2752772, 31.0, (0.01, 0.0, 0.0), (1e-5,) * 3, (0.02, 0.0, 0.0), by_itself=False)
    accel = RestReading(Sensor.ACCEL, 0, 2753028, 31.0, (0.0, 0.0, -9.8), (1e-3,) * 3, None, by_itself=False)
    identity = Identity("ardupilot", uid="ab")
    return Preflight("uid-ab", identity, at, 3.0, Report((check,)), ("slow",), (gyro, accel))


async def test_a_preflight_is_the_last_one_and_its_readings_are_kept(store: SqliteStore, book: FleetBook) -> None:
    assert await book.keep_preflight(preflight()) == preflight()
    found = store.fleet("uid-ab")
    last = last_preflight(found.preflights[0])
    assert last is not None
    assert [(one.id, one.verdict) for one in last.failed] == [(CheckId.GYRO_REST, Verdict.FAIL)]
    accel, gyro = records_of_rows(found.sensors)
    assert (gyro.source, gyro.bias, gyro.applied) == (ObservationSource.PREFLIGHT, (0.02, 0.0, 0.0), False)
    assert gyro.observation is not None
    assert (accel.norm, accel.observation) == (9.8, None)


async def test_only_so_many_preflights_are_kept(store: SqliteStore, book: FleetBook) -> None:
    for i in range(PREFLIGHTS_KEPT + 3):
        await book.keep_preflight(preflight(float(i)))
    ats = sorted({record.at for record in store.fleet("uid-ab").sensors})
    assert ats == [float(i) for i in range(3, PREFLIGHTS_KEPT + 3)]


async def test_a_report_that_cannot_be_kept_says_so(
    store: SqliteStore, book: FleetBook, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any) -> None:
        raise StoreError("the disk is broken")

    monkeypatch.setattr(store, "save_preflight", refuse)
    found = await book.keep_preflight(preflight())
    assert found.report == preflight().report
    assert found.notes == ("slow", "this report is not in the fleet's record: the disk is broken")


async def test_names_and_tags_are_given_apart(store: SqliteStore, book: FleetBook) -> None:
    with pytest.raises(UnitUnknown):
        await book.rename("uid-ab", name="Heron")
    await book.keep_preflight(preflight())  # nothing else is known of it
    assert (await book.rename("uid-ab", name="Heron")).name == "Heron"
    changed = await book.rename("uid-ab", tags=["lake", "boats", "lake"])
    assert (changed.name, changed.tags) == ("Heron", ("boats", "lake"))
    assert renamed(store, "uid-ab", "", None).tags == ("boats", "lake")
