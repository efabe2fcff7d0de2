from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from mavcal.calib.drawing.sphere import SphereMap


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
