"""Points in space: one scale in all directions, everything inside the picture."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from mavcal.calib.drawing import SpaceView
from mavcal.calib.drawing.space import SphereMap

MIDDLE, HALF = np.array([100.0, -20.0, 5.0]), 60.0


def view() -> SpaceView:
    return SpaceView("t", ("x, m", "y, m", "z, m"), MIDDLE, HALF)


def places(markup: str) -> np.ndarray:
    return np.array([[float(v) for v in pair] for pair in re.findall(r"[ML]([-\d.]+) ([-\d.]+)", markup)])


def test_a_sphere_is_a_disk_about_the_middle_and_up_is_up() -> None:
    made, directions = view(), np.random.default_rng(1).normal(size=(5000, 3))
    made.dots(MIDDLE + 50.0 * directions / np.linalg.norm(directions, axis=1)[:, None], "blue", "sphere")
    at = places(made.parts[0])
    (centre,) = places(SpaceView._path(made, MIDDLE[None, :]))
    reach = np.hypot(*(at - centre).T)
    spread = [reach[np.abs(at - centre)[:, k] < 0.2 * reach.max()].max() for k in (0, 1)]
    assert abs(spread[0] / spread[1] - 1.0) < 0.02
    made.lines([MIDDLE + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 30.0]])], "red")
    low, high = places(made.parts[1])
    assert low[0] == high[0]
    assert low[1] > high[1]


def test_the_whole_cube_and_its_numbers_are_inside_the_picture() -> None:
    made = view()
    made.dots(MIDDLE + HALF * np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)]), "blue")
    at = places(made.body())
    assert at.min() >= 0.0
    assert (at <= [made.width, made.height]).all()
    words = {e.text for e in ElementTree.fromstring(f"<g>{made.body()}</g>").iter("text")}
    assert {"t", "x, m", "y, m", "z, m", "50", "100", "150"} <= words


def test_its_words_are_escaped_and_the_origin_has_a_cross() -> None:
    made = SpaceView("<t>", ("<x>", "<y>", "<z>"), np.zeros(3), 1.0)
    made.cross(np.zeros(3), "black")
    made.dots(np.zeros((1, 3)), "blue", "<name>")
    texts = {e.text for e in ElementTree.fromstring(f"<g>{made.body()}</g>").iter("text")}
    assert {"<t>", "<x>", "<y>", "<z>", "<name>"} <= texts
    assert "h10m-5 -5v10" in made.body()


def test_a_map_keeps_areas():
    rng = np.random.default_rng(1)
    made = SphereMap("t", "b")
    directions = rng.normal(size=(4000, 3))
    made.dots(directions, "blue")
    places = np.array([[float(v) for v in pair] for pair in re.findall(r"M([\d.]+) ([\d.]+)h0", made.parts[0])])
    x, y = (places[:, 0] - 180.0) / 60.104, (34 + (250 - 68) / 2 - places[:, 1]) / 60.104
    assert ((x / (2 * np.sqrt(2))) ** 2 + (y / np.sqrt(2)) ** 2).max() < 1.01
    inner = (x / (2 * np.sqrt(2))) ** 2 + (y / np.sqrt(2)) ** 2 < 0.25
    assert inner.mean() == pytest.approx(0.25, abs=0.02)


def test_words_stand_where_their_direction_is():
    made = SphereMap("t", "")
    made.mark(0, 0, "+x")
    made.mark(0, 90, "+z")
    forward, up = (ElementTree.fromstring(part).attrib for part in made.parts)
    assert forward["x"] == up["x"] == "180.0"
    assert float(up["y"]) == pytest.approx(float(forward["y"]) - 85.0, abs=1.0)


def test_its_words_are_escaped() -> None:
    texts = [e.text for e in ElementTree.fromstring(f"<g>{SphereMap('<t>', '<b>').body()}</g>").iter("text")]
    assert texts == ["<t>", "<b>"]
