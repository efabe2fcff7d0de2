"""``docs/client.md`` does what it shows: each of its programs calibrates the simulated vehicle and takes it back."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from bench.running import RunningService, service
from mavcal.service.simvehicle.client import SimulatedVehicle
from tests.patience import scaled

from .jobs_bench import SPEED, stored

ROOT = Path(__file__).resolve().parents[2]
GUIDE = (ROOT / "docs" / "client.md").read_text()
ADDRESS = "http://127.0.0.1:8765"
LANGUAGES = {"python": ((sys.executable,), ".py"), "js": (("node",), ".mjs"), "bash": (("bash",), ".sh")}
NEEDED = {"python": (), "js": ("node",), "bash": ("bash", "curl", "jq")}

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def sim() -> Iterator[SimulatedVehicle]:
    with SimulatedVehicle("ardupilot", speed=SPEED, seed=21, config={"thermal": False}) as vehicle:
        yield vehicle


@pytest.fixture(scope="module")
def running(sim: SimulatedVehicle, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    with service(sim.url, tmp_path_factory.mktemp("guide") / "data") as found:
        found.found()
        yield found


def writable(running: RunningService) -> None:
    until = time.monotonic() + scaled(20.0)
    while not running.client.list_vehicles()[0].writable:
        assert time.monotonic() < until
        time.sleep(0.1)


def blocks() -> list[tuple[str, str]]:
    return re.findall(r"^```(\w+)\n(.*?)^```", GUIDE, re.MULTILINE | re.DOTALL)


def test_the_guide_is_one_program_a_language() -> None:
    assert [language for language, _ in blocks()] == list(LANGUAGES)
    assert all(ADDRESS in text for _, text in blocks())


@pytest.mark.long
@pytest.mark.parametrize(("language", "text"), blocks(), ids=list(LANGUAGES))
def test_a_program_of_the_guide_calibrates_and_takes_it_back(
    language: str, text: str, running: RunningService, sim: SimulatedVehicle, tmp_path: Path
) -> None:
    missing = [name for name in NEEDED[language] if shutil.which(name) is None]
    if missing:
        pytest.skip(f"there is no {', '.join(missing)}")
    command, suffix = LANGUAGES[language]
    program = tmp_path / f"guide{suffix}"
    program.write_text(text.replace(ADDRESS, running.url.rstrip("/")))
    sim.call("tumble")  # as whoever holds it does
    writable(running)
    before = stored(sim)
    done = subprocess.run(
        [*command, str(program)], cwd=ROOT, capture_output=True, text=True, check=False, timeout=scaled(120.0)
    )
    assert done.returncode == 0, done.stdout + done.stderr
    said = done.stdout.splitlines()
    assert said[-1] == "after taking it back: reverted"
    assert "about all its axes" in done.stdout
    assert [line for line in said if line in {"review", "succeeded", "reverted"}] == ["review", "succeeded", "reverted"]
    assert "COMPASS_OFS_X" in done.stdout
    assert "Every parameter was written and read back." in done.stdout
    assert stored(sim) == before
    job = running.client.list_jobs(order="newest", limit=1)[0]
    assert job.last_write is not None
    assert (job.state, job.last_write.result) == ("reverted", "reverted")
