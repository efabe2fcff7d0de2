from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree

import pytest
from markupsafe import Markup

from mavcal.calib.drawing.picture import dotted, side_by_side, svg, text

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
