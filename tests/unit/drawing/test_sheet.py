"""A finished picture: shown by a notebook, saved as SVG and as nothing else."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from xml.etree import ElementTree

import pytest

from mavcal.calib.drawing import Blank, Chart, sheet
from mavcal.calib.errors import CalibError

SVG = "{http://www.w3.org/2000/svg}"
MADE = sheet([Chart("t", "x", "y", (0.0, 1.0), (0.0, 1.0), 300, 200), Blank("nothing", 300, 200)], "A <heading>")


def test_a_picture_is_saved_as_svg(tmp_path: Path) -> None:
    MADE.save(tmp_path / "a.svg")
    MADE.save(str(tmp_path / "b.SVG"))
    assert (tmp_path / "a.svg").read_text(encoding="utf-8") == MADE.svg == (tmp_path / "b.SVG").read_text("utf-8")
    ElementTree.parse(tmp_path / "a.svg")


@pytest.mark.parametrize("name", ["a.png", "a.pdf", "a", "svg"])
def test_another_ending_is_refused_and_nothing_written(name: str, tmp_path: Path) -> None:
    with pytest.raises(CalibError, match=r"save .* as \.svg"):
        MADE.save(tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_notebook_shows_it_and_nothing_changes_it() -> None:
    assert MADE._repr_svg_() == MADE.svg
    assert repr(MADE) == "Drawing()"
    with pytest.raises(dataclasses.FrozenInstanceError):
        MADE.svg = ""  # type: ignore[misc]


def test_panels_stand_below_their_heading() -> None:
    root = ElementTree.fromstring(MADE.svg)
    assert root.attrib["viewBox"] == "0 0 600 230"
    assert root.attrib["aria-label"] == root.findtext(f"{SVG}text") == "A <heading>"
    assert [g.get("transform") for g in root.findall(f"{SVG}g")] == ["translate(0 30)", "translate(300 30)"]


def test_its_style_touches_nothing_around_it_in_a_notebook() -> None:
    rules = (ElementTree.fromstring(MADE.svg).findtext(f"{SVG}style") or "").split("}")
    assert all(rule.strip().startswith(".drawn ") for rule in rules if rule.strip())
