"""Every live command says what it said before: text, JSON and exit codes, by golden files (``golden_cli``)."""

from __future__ import annotations

import json

import pytest

from .golden_cli import FOLDER, SCENARIOS

pytestmark = [pytest.mark.long, pytest.mark.timeout(1200)]


@pytest.mark.parametrize("name", SCENARIOS)
def test_commands_say_what_they_said(name: str) -> None:
    expected = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    found = SCENARIOS[name]()
    assert [step["command"] for step in found] == [step["command"] for step in expected]
    for now, before in zip(found, expected, strict=True):
        assert now == before, now["command"]
