from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from bench.guide.notes import NOTES
from bench.guide.page import markdown
from bench.guide.pictures import PICTURES
from bench.guide.svg import BLUE, Map, Plot, side_by_side
from mavcal.calib.methods import METHODS
from mavcal.service.commands.simulate import MOTION_NAMES

DOCS = Path(__file__).resolve().parents[3] / "docs"
SVG = "{http://www.w3.org/2000/svg}"


def test_every_method_has_a_note():
    assert set(METHODS) <= set(NOTES)


def test_the_page_is_what_the_methods_say():
    assert (DOCS / "methods.md").read_text() == markdown(), "write it again: python -m bench.guide --page"


def test_the_page_names_methods_and_motions_that_there_are():
    names = set(re.findall(r"`((?:accel|gyro|mag|imu|thermal)-[a-z-]+)(?: [^`]*)?`", markdown()))
    assert names <= set(METHODS) | {"gyro-rest"}
    assert " ".join(MOTION_NAMES) in markdown()


@pytest.mark.parametrize("name", PICTURES)
def test_the_pictures_are_there_and_small(name):
    text = (DOCS / "pictures" / f"{name}.svg").read_text()
    assert f"](pictures/{name}.svg)" in markdown()
    assert len(text) < 60_000
    root = ET.fromstring(text)
    assert root.tag == f"{SVG}svg"
    assert "nan" not in text


def test_a_plot_puts_numbers_where_they_belong():
    plot = Plot("t", "x", "y", (0.0, 10.0), (1.0, 100.0), 360, 250, log_y=True)
    plot.line([0.0, 10.0], [1.0, 100.0], BLUE, "rising")
    plot.dots([5.0], [10.0], BLUE)
    root = ET.fromstring(side_by_side([plot, plot], "two"))
    line = next(root.iter(f"{SVG}polyline"))
    assert line.get("points") == "58.0,208.0 346.0,30.0"
    assert next(root.iter(f"{SVG}path")).get("d") == "M202.0 119.0h0"
    assert root.get("viewBox") == "0 0 720 250"
    assert {"1", "10", "100"} <= {text.text for text in root.iter(f"{SVG}text")}


def test_a_map_keeps_areas():
    rng = np.random.default_rng(1)
    made = Map("t", "b")
    directions = rng.normal(size=(4000, 3))
    made.dots(directions, BLUE)
    places = np.array([[float(v) for v in pair] for pair in re.findall(r"M([\d.]+) ([\d.]+)h0", made.parts[0])])
    x, y = (places[:, 0] - 180.0) / 60.104, (34 + (250 - 68) / 2 - places[:, 1]) / 60.104
    assert ((x / (2 * np.sqrt(2))) ** 2 + (y / np.sqrt(2)) ** 2).max() < 1.01
    inner = (x / (2 * np.sqrt(2))) ** 2 + (y / np.sqrt(2)) ** 2 < 0.25
    assert inner.mean() == pytest.approx(0.25, abs=0.02)
