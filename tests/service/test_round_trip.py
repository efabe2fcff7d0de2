"""A live job, its stream as a telemetry log, that as a table: the same digits everywhere."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from mavcal.calib import logs
from mavcal.calib.firmware.in_force.undo import undo
from mavcal.calib.logs.tables import write_table
from mavcal.calib.recording import Recording, Segment, Sensor
from mavcal.service.cli import cli
from mavcal.service.simvehicle import SimulatedVehicle

from .api_bench import Api, Json, served
from .jobs_bench import SPEED

CONFIG = {"thermal": False, "parameters": {"INS_GYR_CAL": 0}}
"""Without the calibration at boot, after which a job may find nothing to write."""


@pytest.fixture(scope="module")
def sim() -> Iterator[SimulatedVehicle]:
    with SimulatedVehicle("ardupilot", speed=SPEED, seed=35, config=CONFIG) as vehicle:
        yield vehicle


async def recorded(a: Api, kind: str, options: Json) -> tuple[Json, bytes]:
    """The job in review, and the bytes of its segment of the telemetry log."""
    vehicle = await a.vehicle()
    job = await a.post(f"/vehicles/{vehicle['id']}/jobs", {"kind": kind, "options": options}, 202)
    job = await a.until(job["id"], "review")
    (segment,) = job["segments"]
    (path,) = (a.service.settings.data_dir / "tlogs").rglob(segment["path"])
    return job, path.read_bytes()[segment["start_byte"] : segment["end_byte"]]


def mavcal(*words: str) -> Any:
    done = CliRunner().invoke(cli, [*words, "--json"])
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


def first(document: Json) -> Json:
    """The fit of the gyroscope that streams without rounding: a table holds no bins."""
    return next(f for f in document.get("fits", [document]) if f["instance"] == 0)


def digits(fit: Json) -> tuple[Any, ...]:
    return fit["n_used"], fit["residual_rms"], fit["model"]["offset"], fit["sd"]["offset"]


def counted(recording: Recording, fit: Json) -> Segment:
    """The span of the log that the job fitted: it counts from when every sensor streams."""
    gyro, n = recording.channel(Sensor.GYRO), fit["n_used"]
    means = (gyro.values[k : k + n].mean(axis=0) for k in range(len(gyro) - n + 1))
    start = next(k for k, mean in enumerate(means) if np.allclose(mean, fit["model"]["offset"], rtol=1e-12, atol=0.0))
    return Segment("rest", float(gyro.t[start]), float(np.nextafter(gyro.t[start + n - 1], np.inf)))


@pytest.mark.long
async def test_job_log_and_tables_give_the_same_digits(tmp_path, sim):
    async with served(tmp_path / "data", connect=(sim.url,)) as a:
        job, content = await recorded(a, "gyro", {"uncertainty": 0.02})
    live = first({"fits": job["results"]})
    log = tmp_path / "capture.tlog"
    log.write_bytes(content)

    whole = first(mavcal("fit", "gyro-rest", str(log)))
    assert whole["n_used"] > live["n_used"]  # the log runs on until the job has noticed that it is done
    assert not whole["relative"]
    for ending in ("npz", "csv"):
        table = tmp_path / f"capture.{ending}"
        mavcal("convert", str(log), str(table), "--raw")
        assert digits(first(mavcal("fit", "gyro-rest", str(table)))) == digits(whole)

    recording = undo(logs.read(log))
    rest = counted(recording, live)
    for ending in ("npz", "csv"):
        table = Path(tmp_path / f"rest.{ending}")
        write_table(dataclasses.replace(recording, segments=(rest,)), table)
        assert digits(first(mavcal("fit", "gyro-rest", str(table)))) == digits(live)
