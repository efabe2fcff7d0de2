"""The page for those who test their own ground station names all that the simulated vehicle can do."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from mavcal.service.simvehicle import ControlError
from mavcal.service.simvehicle.faults import Injector
from mavcal.service.simvehicle.verbs import Verbs

PAGE = Path(__file__).resolve().parents[3] / "docs" / "ground-station.md"


def documented(table: str) -> set[str]:
    """Names in the first column of the table with that head."""
    rows = PAGE.read_text(encoding="utf-8").partition(f"| {table} | ")[2].partition("\n\n")[0].splitlines()[2:]
    return {name for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[1])}


def known(refusal: pytest.ExceptionInfo[ControlError]) -> set[str]:
    return set(str(refusal.value).rpartition("known: ")[2].split(", "))


def test_every_verb_is_on_the_page() -> None:
    process: Any = SimpleNamespace()
    with pytest.raises(ControlError) as refusal:
        Verbs(process)("no such verb", {})
    assert known(refusal) == documented("verb")


def test_every_fault_is_on_the_page() -> None:
    site: Any = SimpleNamespace(vehicle=SimpleNamespace())
    with pytest.raises(ControlError) as refusal:
        Injector(site).arm({"kind": "no such fault"})
    assert known(refusal) == documented("fault")
