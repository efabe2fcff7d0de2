from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import pytest
from markupsafe import Markup

from mavcal.calib.drawing import Blank, Chart, sheet
from mavcal.calib.drawing.picture import dotted, side_by_side, svg, text
from mavcal.calib.errors import CalibError

SVG = "{http://www.w3.org/2000/svg}"


@dataclass
class Square:
    width: int
    height: int

    def body(self) -> Markup:
        return text(0, 0, f"{self.width}x{self.height}")


def placed(columns: int | None, *pictures: Square) -> tuple[str, dict[str, str]]:
    """The frame of a file, and where each picture is in it."""
    root = ElementTree.fromstring(side_by_side(pictures, "told", columns=columns))
    groups = root.findall(f"{SVG}g")
    return root.attrib["viewBox"], {"".join(g.itertext()): g.attrib["transform"] for g in groups}


@pytest.mark.parametrize("columns", [None, 3, 4])
def test_pictures_stand_in_one_row(columns: int | None) -> None:
    frame, where = placed(columns, Square(10, 20), Square(30, 5), Square(7, 9))
    assert frame == "0 0 47 20"
    assert list(where.values()) == ["translate(0 0)", "translate(10 0)", "translate(40 0)"]


def test_rows_are_as_high_as_their_highest_picture_and_the_file_as_wide_as_its_widest_row() -> None:
    frame, where = placed(2, Square(10, 20), Square(30, 5), Square(7, 9))
    assert frame == "0 0 40 29"
    assert where == {"10x20": "translate(0 0)", "30x5": "translate(10 0)", "7x9": "translate(0 20)"}


def test_words_are_words_and_attributes_attributes() -> None:
    evil = '"><script>'
    for drawn in (text(1, 2, evil, kind=evil), svg(1, 2, [], evil), side_by_side([Square(1, 1)], evil)):
        assert "<script" not in drawn
        ElementTree.fromstring(drawn)
    assert ElementTree.fromstring(svg(1, 2, [], evil)).attrib["aria-label"] == evil


def test_a_word_without_a_kind_has_no_class() -> None:
    plain = ElementTree.fromstring(text(1.26, 2, "x", anchor="end"))
    assert plain.attrib == {"x": "1.3", "y": "2.0", "text-anchor": "end"}
    assert ElementTree.fromstring(text(0, 0, "x", kind="title")).attrib["class"] == "title"


def test_dots_are_one_path_of_points_with_the_size_as_radius() -> None:
    path = ElementTree.fromstring(dotted([1.0, 2.0], [3.0, 4.0], "red", size=1.5))  # type: ignore[arg-type]
    assert path.attrib["d"] == "M1.0 3.0h0M2.0 4.0h0"
    assert path.attrib["stroke-width"] == "3"
    assert path.attrib["stroke-linecap"] == "round"


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
