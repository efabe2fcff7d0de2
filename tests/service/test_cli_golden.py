"""Every live command says what it said before: text, JSON and exit codes, by golden files (``golden_cli``)."""

from __future__ import annotations

import json

import pytest

from .golden_cli import BOTH_WAYS, DIFFERENT, FOLDER, SCENARIOS, WAYS, Step, by_url, differences

pytestmark = [pytest.mark.long, pytest.mark.timeout(1200)]


def told(name: str) -> list[Step]:
    found: list[Step] = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    return found


def compare(found: list[Step], expected: list[Step]) -> None:
    assert [step["command"] for step in found] == [step["command"] for step in expected]
    for now, before in zip(found, expected, strict=True):
        assert now == before, now["command"]


@pytest.mark.parametrize("name", SCENARIOS)
def test_commands_say_what_they_said(name: str) -> None:
    compare(SCENARIOS[name](), told(name))


@pytest.mark.parametrize("name", BOTH_WAYS)
def test_commands_say_with_connect_what_they_said(name: str) -> None:
    compare(BOTH_WAYS[name](WAYS["--connect"]), told(name))


@pytest.mark.parametrize("name", BOTH_WAYS)
def test_commands_say_through_a_service_the_same_but_for_known_differences(name: str) -> None:
    found = differences(BOTH_WAYS[name](WAYS["--url"]), told(name))
    assert sorted(step["command"] for step in found.values()) == sorted(DIFFERENT[name])
    assert found == json.loads(by_url(name).read_text(encoding="utf-8"))
