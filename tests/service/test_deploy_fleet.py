"""The files of `deploy/` for a fleet: settings that exist, and an instance and a worker run as their units say."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

import httpx
import pytest

from mavcal.service.settings import Settings
from scripts.settings import settings_table
from tests.patience import patience

from .deployed import DEPLOY, ROOT, UNIT, clean_environment, environment_of, seconds_of, started, unit
from .test_api_recordings import sphere_csv

WORKER = DEPLOY / "mavcal-worker.service"
DROP_IN = DEPLOY / "mavcal-fleet.conf"
KNOWN = set(re.findall(r"MAVCAL_\w+", settings_table()))


def test_settings_of_the_fleet_are_settings() -> None:
    text = (DEPLOY / "fleet.env").read_text()
    lines = re.findall(r"^#?(MAVCAL_\w+)=(.+)$", text, re.MULTILINE)
    assert {name for name, _ in lines} <= KNOWN
    given = dict(lines)
    made = Settings(
        database_url=given["MAVCAL_DATABASE_URL"],
        uploads_dir=given["MAVCAL_UPLOADS_DIR"],
        fleet={"name": given["MAVCAL_FLEET__NAME"], "url": given["MAVCAL_FLEET__URL"]},
    )
    assert made.uploads == Path("/srv/mavcal/uploads")
    assert "CHANGE-ME" not in repr(made)


def test_units_are_such(tmp_path: Path) -> None:
    text = WORKER.read_text()
    for name in ("DynamicUser=yes", "ProtectSystem=strict", "NoNewPrivileges=yes", "DevicePolicy=closed"):
        assert f"\n{name}\n" in text
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not here: the unit was read, but not verified")
    copy = tmp_path / "mavcal-worker.service"
    copy.write_text(re.sub(r"^(ExecStart=)\S+", r"\1/bin/true", text, flags=re.MULTILINE))
    done = subprocess.run(["systemd-analyze", "verify", str(copy)], capture_output=True, text=True, check=False)
    assert "mavcal-worker" not in done.stderr, done.stderr


def command(path: Path) -> list[str]:
    """The unit's ExecStart, by this interpreter."""
    program, *arguments = shlex.split(unit(path)["ExecStart"][0])
    assert program == "/opt/mavcal/bin/mavcal"
    return [sys.executable, "-m", "mavcal", *arguments]


def environment(path: Path, database: str, folder: Path) -> dict[str, str]:
    """The unit's Environment and fleet.env, with this database and folders below `folder`."""
    given = dict(line.split("=", 1) for line in unit(path)["Environment"]) | environment_of(DEPLOY / "fleet.env")
    data = folder / Path(given["MAVCAL_DATA_DIR"]).name
    data.mkdir(mode=0o700)
    ours = {
        "MAVCAL_DATABASE_URL": database,
        "MAVCAL_UPLOADS_DIR": str(folder / "uploads"),
        "MAVCAL_DATA_DIR": str(data),
        "MAVCAL_PORT": "0",
    }
    assert {"/etc/mavcal/fleet.env"} == set(unit(DROP_IN)["EnvironmentFile"]) | set(unit(WORKER)["EnvironmentFile"])
    return clean_environment() | given | ours


@pytest.mark.long
def test_an_instance_and_a_worker_run_as_their_units_say(tmp_path: Path, database_url: str) -> None:
    instance, worker = (environment(path, database_url, tmp_path) for path in (UNIT, WORKER))
    limit = patience(90.0)
    with (
        started(command(UNIT), instance, tmp_path) as running,
        subprocess.Popen(command(WORKER), env=worker, cwd=ROOT) as working,
        httpx.Client(base_url=f"{running.url}/api/v1", timeout=60.0) as client,
    ):
        try:
            table = client.post("/recordings", params={"name": "sphere.csv"}, content=sphere_csv()).json()
            job = client.post("/fits", json={"method": "mag-ellipsoid", "recording": table["id"]}).json()
            while job["state"] != "succeeded":  # nobody but the worker computes: without it the fit stays queued
                assert job["state"] not in {"failed", "cancelled"}, job
                assert working.poll() is None
                assert not limit.over, running.log.read_text()
                time.sleep(0.1)
                job = client.get(f"/jobs/{job['id']}").json()
            working.terminate()
            assert working.wait(seconds_of(unit(WORKER)["TimeoutStopSec"][0])) == 0
            assert running.ended(seconds_of(unit(UNIT)["TimeoutStopSec"][0])) == 0, running.log.read_text()
        finally:
            working.kill()
