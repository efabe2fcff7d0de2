"""What `deploy/` says, read by the tests: the unit, its environment file, the image; a service started from them."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.patience import patience, scaled

ROOT = Path(__file__).resolve().parents[2]
DEPLOY = ROOT / "deploy"
UNIT = DEPLOY / "mavcal.service"
STATE = "/var/lib"
"""What `%S` is in a unit of the system."""
READY_S = 20.0


def unit(path: Path = UNIT) -> dict[str, list[str]]:
    """Every setting of a unit with its values in order."""
    found: dict[str, list[str]] = {}
    for line in path.read_text().splitlines():
        if line and line[0] not in "#[":
            name, _, value = line.partition("=")
            found.setdefault(name, []).append(value.replace("%S", STATE))
    return found


def environment_of(path: Path) -> dict[str, str]:
    """The lines of an environment file, as systemd reads them."""
    lines = [line for line in path.read_text().splitlines() if line and line[0] != "#"]
    return dict(word.split("=", 1) for line in lines for word in shlex.split(line))


def clean_environment() -> dict[str, str]:
    """Ours without what would reach the settings or another interpreter."""
    return {k: v for k, v in os.environ.items() if not k.startswith(("MAVCAL_", "PYTHON", "VIRTUAL_ENV"))}


@dataclass(frozen=True)
class Installed:
    """What `deploy/install` put below a folder; the unit's paths lead into it."""

    folder: Path

    def at(self, path: str) -> Path:
        return self.folder / path.lstrip("/")

    @property
    def unit(self) -> dict[str, list[str]]:
        return unit(self.at("/etc/systemd/system/mavcal.service"))

    @property
    def environment_file(self) -> Path:
        return self.at(self.unit["EnvironmentFile"][0].removeprefix("-"))

    def command(self) -> list[str]:
        """The unit's ExecStart; its script names an interpreter that is not there yet."""
        program, *arguments = shlex.split(self.unit["ExecStart"][0])
        return [str(self.at(program).with_name("python")), str(self.at(program)), *arguments]

    def environment(self) -> dict[str, str]:
        """The unit's Environment and, above it, its EnvironmentFile."""
        given = dict(line.split("=", 1) for line in self.unit["Environment"])
        given["MAVCAL_DATA_DIR"] = str(self.at(given["MAVCAL_DATA_DIR"]))
        return clean_environment() | given | environment_of(self.environment_file)

    @contextmanager
    def started(self, *before: str) -> Iterator[Running]:
        """The service, run as the unit says, behind the words `before`."""
        folder = self.at(self.unit["WorkingDirectory"][0])
        data = self.at(STATE) / self.unit["StateDirectory"][0]
        data.mkdir(parents=True, exist_ok=True, mode=0o700)
        with started([*before, *self.command()], self.environment(), folder) as running:
            yield running


@dataclass(frozen=True)
class Running:
    """A service that listens."""

    process: subprocess.Popen[bytes]
    url: str
    log: Path

    def ended(self, within_s: float) -> int:
        """Exit code after SIGTERM."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(timeout=within_s)


@contextmanager
def started(command: Sequence[str], environment: Mapping[str, str], folder: Path) -> Iterator[Running]:
    """A service from its announcement on; killed if it has not ended."""
    log = folder / "said.txt"
    with log.open("wb") as said, subprocess.Popen(
        command, env=dict(environment), cwd=folder, stdout=said, stderr=said
    ) as process:  # fmt: skip
        try:
            limit = patience(READY_S)
            while (found := re.search(r"the panel is at (http://\S+)/", log.read_text())) is None:
                assert process.poll() is None, log.read_text()
                assert not limit.over, log.read_text()
                time.sleep(0.05)
            yield Running(process, found[1], log)
        finally:
            process.kill()


@dataclass(frozen=True)
class Instruction:
    """One instruction of a Dockerfile, with its stage."""

    stage: int
    name: str
    text: str

    @property
    def words(self) -> list[str]:
        """Words that are no flags; those of the JSON form as they are."""
        if self.text.startswith("["):
            return [str(word) for word in json.loads(self.text)]
        return [word for word in shlex.split(self.text) if not word.startswith("--")]

    @property
    def command(self) -> list[str]:
        """The command after the flags and CMD of a HEALTHCHECK."""
        return [str(word) for word in json.loads(self.text[self.text.index("[") :])]


def image() -> list[Instruction]:
    """The instructions of the Dockerfile; stage 0 is what comes before the first FROM."""
    lines = [line for line in (DEPLOY / "Dockerfile").read_text().splitlines() if not line.startswith("#")]
    found: list[Instruction] = []
    for line in re.sub(r"\\\n\s*", "", "\n".join(lines)).splitlines():
        if line:
            name, _, text = line.partition(" ")
            stage = (found[-1].stage if found else 0) + (name == "FROM")
            found.append(Instruction(stage, name, text))
    return found


def seconds_of(unit_time: str) -> float:
    """A time of a unit that is a plain number of seconds, for a machine as busy as this one."""
    return scaled(float(unit_time))
