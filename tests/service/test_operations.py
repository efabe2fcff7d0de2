"""The operations of ``docs/deploy.md`` work: every block of commands is run, in the order of the page."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bench.running import RunningService, service
from mavcal.service.simvehicle import SimulatedVehicle
from tests.patience import scaled

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "deploy.md").read_text()
LIVE = 4
"""So many blocks are for a service that is stopped; the others need one that runs."""
NEEDED = ("bash", "curl", "tar", "du", "grep")


def blocks() -> list[str]:
    return re.findall(r"^```bash\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def test_every_command_stands_in_a_block_that_is_run() -> None:
    assert len(blocks()) > 12
    assert PAGE.count("```") == 2 * len(blocks())


@pytest.mark.long
@pytest.mark.timeout(300)
def test_every_command_of_the_page_works(tmp_path: Path) -> None:
    missing = [name for name in NEEDED if shutil.which(name) is None]
    if missing:
        pytest.skip(f"there is no {', '.join(missing)}")
    data = tmp_path / "data"
    environment = {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "DATA": str(data),
    }
    stopped, running_again = blocks()[:LIVE], blocks()[LIVE:]
    assert "healthz" in running_again[0]
    with SimulatedVehicle("ardupilot", seed=41, config={"thermal": False}) as here:
        here.call("still")
        with service(here.url, data) as running:
            job = _calibrating(running)
        for block in stopped:
            _done(block, environment)
        with (
            SimulatedVehicle("ardupilot", seed=42, config={"thermal": False}) as there,
            service(here.url, data) as running,
        ):
            there.call("still")
            running.found()
            there_and_then = {"URL": running.url.rstrip("/"), "VEHICLE": there.url, "JOB": job}
            for block in running_again:
                _done(block, {**environment, **there_and_then})
    assert (tmp_path / "data.tar.gz").stat().st_mode & 0o777 == 0o600
    assert (tmp_path / "data.restored" / "mavcal.sqlite3").exists()


def _calibrating(running: RunningService) -> str:
    """A job of the first vehicle, as a service has that is in use; its id."""
    vehicle = running.found()
    until = time.monotonic() + scaled(30.0)
    while not running.client.get_vehicle(vehicle).writable:
        assert time.monotonic() < until
        time.sleep(0.1)
    return running.client.start_job(vehicle, kind="gyro").id


def _done(block: str, environment: dict[str, str]) -> None:
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", block],
        env=environment,
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=scaled(90.0),
    )
    assert done.returncode == 0, f"{block}\n{done.stdout}\n{done.stderr}"
