"""What is shipped knows no recording by its name: data sets belong to ``bench`` and to the tests."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
RECORDING = re.compile(r"[\w-]+\.(bin|csv|log|mat|npz|tlog|ulg)", re.IGNORECASE)
OWN = {"service.log", "flight.tlog", "fake.tlog", "fleet.csv", "mavcal-fleet.csv", "log.bin"}
"""The service's own files and addresses, and the example of an endpoint."""


def shipped() -> dict[str, str]:
    paths = [p for folder in ("calib", "service") for p in sorted((ROOT / folder).rglob("*.py"))]
    return {p.relative_to(ROOT).as_posix(): p.read_text(encoding="utf-8") for p in paths}


def named(source: str) -> set[str]:
    """Texts of a source that are the name of a recording."""
    texts = {n.value for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Constant) and isinstance(n.value, str)}
    parts = {part for text in texts if " " not in text for part in text.replace(":", "/").split("/")}
    return {part for part in parts if RECORDING.fullmatch(part)} - OWN


@pytest.mark.long
def test_no_recording_is_named_in_shipped_code() -> None:
    assert {name: found for name, source in shipped().items() if (found := named(source))} == {}


@pytest.mark.parametrize("source", ["LABELLED = {'28_magnet_A.mat': 'x'}", "path = data / 'null.bin'", "x = 'a/b.csv'"])
def test_a_name_is_seen(source: str) -> None:
    assert named(source)


@pytest.mark.long
@pytest.mark.shared
def test_no_data_set_is_named_in_shipped_code(shared_data: Path) -> None:
    sets = {p.name for p in shared_data.iterdir() if p.is_dir() and "_" in p.name}
    files = {p.stem for p in shared_data.rglob("*") if p.is_file() and re.search(r"\d", p.stem) and len(p.stem) > 8}
    assert sets
    names = re.compile("|".join(map(re.escape, sorted(sets | files))), re.IGNORECASE)
    assert {name: found for name, source in shipped().items() if (found := set(names.findall(source)))} == {}
