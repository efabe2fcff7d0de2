"""A telemetry log that grows is followed by another, not during a capture, and old ones go but for evidence."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from mavcal.service import retention
from mavcal.service.jobs.core.states import JobState
from mavcal.service.simvehicle import SimulatedVehicle

from .api_bench import Api, api
from .jobs_bench import eventually

SIZE = 2**13


def logs(a: Api) -> list[Path]:
    return sorted((a.service.settings.data_dir / "tlogs").glob("*.tlog"))


def beside(a: Api, evidence: Path) -> int:
    """Bytes of the telemetry logs, but for that one and the one that is written."""
    (link,) = a.service.links.all()
    return sum(path.stat().st_size for path in logs(a) if path not in (evidence, link.tlog.path))


async def another(a: Api) -> None:
    """Wait until the link has gone on in another file."""
    (link,) = a.service.links.all()
    path = link.tlog.path
    await eventually(lambda: link.tlog.path != path, 60)


@pytest.mark.long
async def test_logs_rotate_but_for_a_capture_and_the_oldest_go_but_for_evidence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(retention, "LOOK_S", 0.1)
    limits = {"tlog_bytes": SIZE, "tlogs_bytes": 4 * SIZE}
    with SimulatedVehicle("ardupilot", speed=4, config={"thermal": False}) as sim:
        async with api(tmp_path, connect=(sim.url,), retention=limits) as a:
            vehicle = (await a.vehicle())["id"]
            (link,) = a.service.links.all()
            sim.call("still")
            await another(a)
            job = (await a.post(f"/vehicles/{vehicle}/jobs", {"kind": "thermal", "options": {"span": 100}}, 202))["id"]
            await a.until(job, "running", "waiting_for_operator")
            store = a.service.store
            await eventually(lambda: bool(store.segments(job)), 60)
            captured_in = store.segments(job)[0].path
            start = link.tlog.position
            await eventually(lambda: link.tlog.position > start + 2 * SIZE, 120)
            assert link.tlog.path == captured_in, "the file changed under a capture"
            await a.delete(f"/jobs/{job}", 200)
            await eventually(lambda: a.service.jobs.get(job).state == JobState.CANCELLED)
            await eventually(lambda: link.tlog.path != captured_in, 60)
            for _ in range(6):
                await another(a)
            (span,) = a.service.jobs.get(job).segments
            evidence = span.path.read_bytes()[span.start_byte : span.end_byte]
            assert hashlib.sha256(evidence).hexdigest() == span.sha256
            await eventually(lambda: beside(a, captured_in) <= 6 * SIZE, 60)
            assert captured_in in logs(a)
