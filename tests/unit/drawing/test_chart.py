"""Charts: numbers where they belong, words escaped, the same picture for a page and for a file."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

from mavcal.calib.drawing import Chart, limits_of, side_by_side
from mavcal.calib.drawing.legend import Key

SVG = "{http://www.w3.org/2000/svg}"
EVIL = "<script>"


def a_chart(**more: bool) -> Chart:
    chart = Chart("t", "x", "y", (0.0, 10.0), (1.0, 100.0), 374, 278, log_y=True, **more)
    chart.line([0.0, 10.0], [1.0, 100.0], "#00f", "rising", dashed=True)
    return chart


def test_numbers_are_where_they_belong() -> None:
    chart = a_chart()
    chart.dots([5.0, 11.0], [10.0, 10.0], "#00f")
    root = ElementTree.fromstring(chart.drawn())
    line = next(root.iter("polyline"))
    assert line.get("points") == "62.0,240.0 362.0,40.0"
    assert line.get("stroke-dasharray")
    (dots,) = (e for e in root.iter("path") if e.get("stroke-linecap"))
    assert dots.get("d") == "M212.0 140.0h0"  # the other one lies outside
    assert {"1", "10", "100"} <= {e.text for e in root.iter("text")}


def test_categories_stand_below_the_axis_by_name() -> None:
    chart = Chart("t", "x", "y", (-0.5, 2.5), (0.0, 1.0), 374, 278, x_names=("+x", "+y", "+z"))
    told = {e.text for e in ElementTree.fromstring(chart.drawn()).iter("text")}
    assert {"+x", "+y", "+z"} <= told
    assert "2" not in told


def test_a_bar_ends_at_the_edge() -> None:
    chart = Chart("t", "x", "y", (0.0, 10.0), (0.0, 10.0), 374, 278)
    chart.bars([5.0], [9.0], [2.0], "#00f", "measured")
    assert "M212.0 100.0V40.0" in chart.body()  # from 7 to 11 of 10


def test_a_number_that_is_not_finite_is_left_out() -> None:
    chart = Chart("t", "x", "y", (0.0, 1.0), limits_of([2.0]))
    chart.line([0, 0.5, 1], [2.0, np.nan, 2.0], "red")
    chart.dots([0, 0.5], [2.0, np.nan], "red")
    assert "nan" not in chart.drawn()
    ElementTree.fromstring(chart.drawn())


@pytest.mark.parametrize("inside", [False, True])
def test_words_are_escaped(inside: bool) -> None:
    chart = Chart(EVIL, EVIL, EVIL, (0.0, 1.0), (0.0, 1.0), legend_inside=inside)
    chart.line([0, 1], [0, 1], EVIL, EVIL)
    chart.mark(0.5, EVIL, EVIL)
    for drawn in (chart.drawn(), side_by_side([chart], EVIL)):
        assert EVIL not in drawn
        assert ElementTree.fromstring(drawn).get("aria-label") == EVIL


@pytest.mark.parametrize("inside", [False, True])
def test_the_legend_has_room(inside: bool) -> None:
    chart = a_chart(legend_inside=inside)
    chart.line([0.0, 10.0], [1.0, 1.0], "#f00", "level")
    words = {e.text: e for e in ElementTree.fromstring(chart.drawn()).iter("text")}
    first, second = (tuple(float(words[n].attrib[k]) for k in "xy") for n in ("rising", "level"))
    assert (first[1] < second[1]) if inside else (first[0] + 5.9 * len("rising") < second[0])


def test_a_legend_tells_lines_from_dots_and_stands_in_columns() -> None:
    chart = Chart("t", "x", "y", (0.0, 10.0), (0.0, 10.0), 374, 278, legend_rows=2)
    for name in ("one", "three"):
        chart.dots([5.0], [5.0], "#00f", name)
    for name in ("two", "four"):
        chart.line([0.0, 10.0], [10.0, 10.0], "#f00", name)
    assert chart.legend[1:3] == [Key("#00f", "three", dots=True), Key("#f00", "two")]
    words = {e.text: e.attrib for e in ElementTree.fromstring(chart.drawn()).iter("text") if e.get("class") == "legend"}
    x, y = ({name: float(place[axis]) for name, place in words.items() if name} for axis in "xy")
    assert x["one"] == x["two"] < x["three"] == x["four"]
    assert y["one"] == y["three"] < y["two"] == y["four"]
    assert 'points="62.0,54.0 362.0,54.0"' in chart.body()  # the axes begin below the second row


def test_columns_stand_on_zero_and_a_band_stays_within_the_axes() -> None:
    chart = Chart("t", "x", "y", (0.0, 10.0), (-10.0, 10.0), 374, 278)
    chart.columns([2.0, 5.0, 8.0], [5.0, -5.0, 30.0], "#00f", "before", wide=1.0)
    assert 'd="M122.0 140.0V90.0M212.0 140.0V190.0M302.0 140.0V40.0"' in chart.body()
    assert 'stroke-width="30.0"' in chart.body()
    chart.band([0.0, 5.0, 10.0], [0.0, np.nan, -20.0], [5.0, 5.0, 5.0], "#00f")
    assert 'points="62.0,140.0 362.0,240.0 362.0,90.0 62.0,90.0"' in chart.body()


def test_a_file_has_its_pictures_in_a_row_and_a_style_of_its_own() -> None:
    root = ElementTree.fromstring(side_by_side([a_chart(), a_chart()], "two"))
    assert root.get("viewBox") == "0 0 748 278"
    assert [g.get("transform") for g in root.findall(f"{SVG}g")] == ["translate(0 0)", "translate(374 0)"]
    assert ".grid" in (root.findtext(f"{SVG}style") or "")
