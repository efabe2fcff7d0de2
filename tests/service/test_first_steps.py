"""``docs/first-calibration.md`` and ``docs/first-diagnosis.md`` followed literally: what they print is compared."""

from __future__ import annotations

import json
import math
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.patience import scaled

ROOT = Path(__file__).resolve().parents[2]
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")
JOB = re.compile(r"\b[0-9a-f]{12}\b")
NEAR = 0.05
"""Share by which a number may differ from the one of the page: other processors round otherwise."""
LEAST = 2e-3

pytestmark = [pytest.mark.long, pytest.mark.timeout(900)]


class Reader:
    """Somebody who types what a page says, in an empty folder and with a data directory of their own."""

    def __init__(self, page: str, folder: Path) -> None:
        self.text = (ROOT / "docs" / page).read_text(encoding="utf-8")
        self.folder = folder
        self.job = ""

    @property
    def blocks(self) -> list[list[str]]:
        """The indented blocks of the page, in order."""
        found = re.findall(r"(?:^    .*\n)+", self.text, re.MULTILINE)
        return [[line[4:] for line in block.splitlines()] for block in found]

    def run(self, line: str) -> str:
        """What the command says; the job of the page is the one that was begun here."""
        words = shlex.split(JOB.sub(self.job, line) if self.job else line)
        assert words[0] == "mavcal"
        done = subprocess.run(
            [sys.executable, "-m", *words],
            cwd=self.folder,
            env={**os.environ, "XDG_STATE_HOME": str(self.folder / "state")},
            capture_output=True,
            text=True,
            check=False,
            timeout=scaled(300.0),
        )
        assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
        return done.stdout + done.stderr


def words(line: str) -> str:
    """A line without its numbers."""
    return NUMBER.sub("#", JOB.sub("JOB", " ".join(line.split())))


def alike(told: str, said: str) -> bool:
    """Whether two lines have the same words, and numbers that are near."""
    told, said = (JOB.sub("JOB", line.strip()) for line in (told, said))
    if words(told) != words(said):
        return False
    pairs = zip(NUMBER.findall(told), NUMBER.findall(said), strict=True)
    return all(math.isclose(float(a), float(b), rel_tol=NEAR, abs_tol=LEAST) for a, b in pairs)


def test_the_first_diagnosis_prints_what_its_page_says(tmp_path: Path) -> None:
    reader = Reader("first-diagnosis.md", tmp_path)
    for name, block in zip(
        ("real.json", "sim.json"), re.findall(r"```json\n(.*?)```", reader.text, re.DOTALL), strict=True
    ):
        json.loads(block)
        (tmp_path / name).write_text(block)
    said: list[str] = []
    for block in reader.blocks:
        if block[0].startswith("mavcal"):
            said = [line for command in block for line in reader.run(command).splitlines()]
            continue
        for line in block:
            assert any(alike(line, other) for other in said), f"{line!r} is not in\n" + "\n".join(said)
    assert (tmp_path / "gap.html").is_file()


def test_the_first_calibration_prints_what_its_page_says(tmp_path: Path) -> None:
    reader = Reader("first-calibration.md", tmp_path)
    begin = reader.text.index("## The same on the command line")
    reader.text = reader.text[begin:]
    measure, shown, write, whole = reader.blocks[:4]
    said = reader.run(measure[0])
    for _ in range(5):  # what the vehicle calibrated at its start may agree by chance: then there is nothing to write
        if JOB.search(said):
            break
        said = reader.run(measure[0])
    reader.job = JOB.findall(said)[-1]
    for line in shown:
        assert any(words(line) == words(other) for other in said.splitlines()), f"{line!r} is not in\n{said}"
    for command in write:
        reader.run(command)
    ends = re.search(r"It ends with `(.*?)`", reader.text, re.DOTALL)
    assert ends is not None
    assert " ".join(ends[1].split()) in " ".join(reader.run(whole[0]).split())
