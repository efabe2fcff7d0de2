"""Computations by workers of a fleet: done, refused, cancelled, and finished by another one when a worker is killed."""

from __future__ import annotations

import asyncio
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import psycopg
import pytest

from mavcal.calib.errors import CalibError
from mavcal.service.core import Service, running_service
from mavcal.service.jobs.core.states import ENDED, JobState
from mavcal.service.lifetime import ending_with_us
from mavcal.service.workers.queue import lock_of, moved
from tests.patience import patience, scaled
from tests.service.gap_tables import write_table
from tests.service.test_computed_jobs_killed import write_rest

from .instance_process import LEASE_S, settings

ROOT = Path(__file__).resolve().parents[2]


@contextmanager
def worker(folder: Path, url: str, number: int = 1) -> Iterator[subprocess.Popen[bytes]]:
    """A worker process, ready to work."""
    environment = ending_with_us() | {
        "MAVCAL_DATABASE_URL": url,
        "MAVCAL_UPLOADS_DIR": str(folder / "uploads"),
        "MAVCAL_DATA_DIR": str(folder / f"worker{number}"),
        "MAVCAL_FLEET__LEASE_S": str(LEASE_S),
        "MAVCAL_LIMITS__FILE_PROCESSES": "1",
    }
    path = folder / f"worker{number}.log"
    with path.open("wb") as log:
        command = [sys.executable, "-W", "error", "-m", "mavcal", "worker"]
        process = subprocess.Popen(command, cwd=ROOT, env=environment, stdout=log, stderr=log)
        try:
            limit = patience(40)
            while b"worker ready" not in path.read_bytes():
                assert process.poll() is None, path.read_text()
                assert not limit.over
                time.sleep(0.05)
            yield process
        finally:
            process.terminate()
            try:
                process.wait(scaled(20))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
                raise


async def upload(service: Service, path: Path) -> str:
    content = await asyncio.to_thread(path.read_bytes)

    async def chunks() -> AsyncIterator[bytes]:
        yield content

    return (await service.recordings.add(path.name, chunks(), {})).id


async def until(service: Service, job_id: str, *states: JobState) -> None:
    limit = patience(90)
    while (job := service.jobs.get(job_id)).state not in states:
        assert not limit.over, job
        await asyncio.sleep(0.02)


def rows(url: str, sql: str) -> list[tuple[object, ...]]:
    with psycopg.connect(url) as connection:
        return connection.execute(sql).fetchall()  # type: ignore[call-overload, no-any-return]


async def to_thread(stack: ExitStack, folder: Path, url: str, number: int = 1) -> subprocess.Popen[bytes]:
    return await asyncio.to_thread(stack.enter_context, worker(folder, url, number))


@pytest.mark.long
async def test_a_worker_fits_and_diagnoses_and_says_what_it_refuses(tmp_path: Path, database_url: str) -> None:
    with ExitStack() as stack:
        async with running_service(settings(tmp_path, database_url, name="a")) as service:
            await to_thread(stack, tmp_path, database_url)
            rest = await upload(service, write_rest(tmp_path / "rest.npz", rows=4000))
            table = await upload(service, write_table(tmp_path / "real.csv", seconds=20.0))
            fitted = await service.jobs.computing.fitted(rest, "gyro-rest", {})
            assert fitted.state == JobState.SUCCEEDED
            assert [fit.method for fit in fitted.results] == ["gyro-rest"]
            with pytest.raises(CalibError, match="accel"):
                await service.jobs.computing.fitted(rest, "accel-six-face", {})
            gap = await service.jobs.computing.diagnose(table, None, [])
            await until(service, gap.id, *ENDED)
            assert service.jobs.get(gap.id).state == JobState.SUCCEEDED
            assert b"verdict" in (await service.jobs.document(gap.id, "report.json")).body
            assert service.children.fork_server_pid is not None  # uploads are read here; nothing else was
    assert rows(database_url, "SELECT id FROM computations") == []
    assert rows(database_url, "SELECT id FROM procrastinate_jobs") == []


@pytest.mark.long
@pytest.mark.timeout(240)
async def test_a_job_of_a_killed_worker_is_finished_by_another(tmp_path: Path, database_url: str) -> None:
    with ExitStack() as stack:
        async with running_service(settings(tmp_path, database_url, name="a")) as service:
            first = await to_thread(stack, tmp_path, database_url)
            recording = await upload(service, write_rest(tmp_path / "rest.npz", rows=1_500_000))
            job = await service.jobs.computing.fit(recording, "allan", {})
            await until(service, job.id, JobState.FITTING)
            first.send_signal(signal.SIGKILL)
            await asyncio.to_thread(first.wait)
            assert service.jobs.get(job.id).state == JobState.FITTING
            await to_thread(stack, tmp_path, database_url, 2)
            await until(service, job.id, *ENDED)
            assert service.jobs.get(job.id).state == JobState.SUCCEEDED
            events = [event.data.get("state") for event in service.store.events(job.id) if event.kind == "state"]
            assert events == ["queued", "fitting", "succeeded"]
    assert b"dead worker taken back" in (tmp_path / "worker2.log").read_bytes()


@pytest.mark.long
async def test_a_cancelled_job_ends_at_the_worker_and_the_next_one_begins(tmp_path: Path, database_url: str) -> None:
    with ExitStack() as stack:
        async with running_service(settings(tmp_path, database_url, name="a")) as service:
            recording = await upload(service, write_rest(tmp_path / "rest.npz", rows=1_500_000))
            waiting = await service.jobs.computing.fit(recording, "allan", {})
            await asyncio.sleep(1.0)
            assert service.jobs.get(waiting.id).state == JobState.QUEUED  # nobody computes yet
            await to_thread(stack, tmp_path, database_url)
            await until(service, waiting.id, JobState.FITTING)
            await service.jobs.cancel(waiting.id)
            assert service.jobs.get(waiting.id).state == JobState.CANCELLED
            again = await service.jobs.computing.fit(recording, "gyro-rest", {})
            await until(service, again.id, JobState.SUCCEEDED)  # the one process is free again
    assert rows(database_url, "SELECT id FROM computations") == []


@pytest.mark.long
@pytest.mark.timeout(240)
async def test_a_computation_of_a_killed_instance_begins_again_under_another(tmp_path: Path, database_url: str) -> None:
    """Its job has no vehicle: whoever finds it left takes it up."""
    with ExitStack() as stack:
        await to_thread(stack, tmp_path, database_url)
        async with running_service(settings(tmp_path, database_url, name="b")) as second:
            recording = await upload(second, write_rest(tmp_path / "rest.npz", rows=1_500_000))
            code = (
                "import asyncio, sys\nfrom pathlib import Path\n"
                "from mavcal.service.core import running_service\n"
                "from tests.service.instance_process import settings\n"
                "async def main(folder, url, recording):\n"
                "    async with running_service(settings(Path(folder), url, name='a')) as service:\n"
                "        await service.jobs.computing.fit(recording, 'allan', {})\n"
                "        await asyncio.sleep(600)\n"
                "asyncio.run(main(*sys.argv[1:]))\n"
            )
            command = [sys.executable, "-c", code, str(tmp_path), database_url, recording]
            first = subprocess.Popen(command, cwd=ROOT, env=ending_with_us())  # noqa: ASYNC220 - it returns at once
            try:
                limit = patience(60)
                while not second.jobs.list():
                    assert not limit.over
                    await asyncio.sleep(0.05)
                job_id = second.jobs.list()[0].id
                await until(second, job_id, JobState.FITTING)
            finally:
                first.kill()
                await asyncio.to_thread(first.wait)
            await until(second, job_id, *ENDED)
            assert second.jobs.get(job_id).state == JobState.SUCCEEDED
            assert second.jobs.get(job_id).context["starts"] == 2


def test_paths_of_uploads_are_told_by_name(tmp_path: Path) -> None:
    order = {"real": {"path": str(tmp_path / "a.bin"), "reading": {"map": ["x", "y"]}}, "sim": None, "n": 1.5}
    told = moved(order, tmp_path, None)
    assert told == {"real": {"path": "uploads:a.bin", "reading": {"map": ["x", "y"]}}, "sim": None, "n": 1.5}
    elsewhere = Path("/srv/uploads")
    assert moved(told, None, elsewhere)["real"]["path"] == "/srv/uploads/a.bin"
    assert moved("uploads:../../etc/passwd", None, elsewhere) == "/srv/uploads/passwd"


def test_computations_of_one_vehicle_have_one_lock() -> None:
    assert lock_of("1", "70682a") == lock_of("2", "70682a") != lock_of("1", "70682b")
    assert lock_of("1", None) != lock_of("2", None)
