from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from bench.guide.notes import NOTES
from bench.guide.page import markdown
from bench.guide.pictures import PICTURES
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
