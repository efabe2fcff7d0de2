"""The map of the packages counts what the imports say."""

from __future__ import annotations

from graphlib import CycleError

import pytest

from bench.house import arrows, circles, folder_report, longest, report, rooms_of

MODULES = {
    "mavcal.p.a": "from mavcal.p.b import x\nfrom typing import *\nif TYPE_CHECKING:\n    import mavcal.p.c\n",
    "mavcal.p.b": "from mavcal.p import c\n",
    "mavcal.p.c": "import numpy\n",
    "mavcal.p": "",
}


def test_arrows_follow_every_form_of_import():
    found = arrows(MODULES)
    assert found["mavcal.p.a"] == {"mavcal.p.b", "mavcal.p.c"}
    assert found["mavcal.p.b"] == {"mavcal.p.c"}
    assert found["mavcal.p.c"] == frozenset()


def test_a_relative_import_is_an_arrow_too():
    found = arrows({"p": "from .q import a\n", "p.q": "", "p.q.a": "from . import b\nfrom .. import q\n", "p.q.b": ""})
    assert found["p"] == {"p.q.a"}
    assert found["p.q.a"] == {"p.q.b", "p.q"}


def test_a_circle_of_three_is_one_circle():
    assert circles(arrows(MODULES)) == []
    closed = arrows(MODULES | {"mavcal.p.c": "from mavcal.p.a import y\n"})
    assert circles(closed) == [["mavcal.p.a", "mavcal.p.b", "mavcal.p.c"]]


def test_the_report_counts_files_lines_arrows_and_circles():
    assert report("p", MODULES).splitlines()[0] == "p: 4 files, 6 lines, 3 arrows, 0 circles"


FOLDER = {
    "p": "from p.last import x\n",
    "p.last": "from p.room.one import x\nfrom p.low import y\n",
    "p.room": "",
    "p.room.one": "from p.room.two import x\n",
    "p.room.two": "from p.low import x\n",
    "p.low": "import numpy\n",
}


def test_modules_of_a_folder_are_one_room_and_a_module_beside_it_is_another():
    rooms = rooms_of(arrows(FOLDER), "p")
    assert rooms == {"__init__": {"last"}, "last": {"room", "low"}, "room": {"low"}, "low": frozenset()}


def test_floors_count_rooms_and_a_walk_counts_files():
    line = folder_report("p", FOLDER).splitlines()[0]
    assert line == "p: 6 files, 4 rooms, 4 floors, 4 arrows between rooms, longest walk 5 files"


def test_rooms_are_listed_lowest_first():
    listed = [line.split()[0] for line in folder_report("p", FOLDER).splitlines()[1:]]
    assert listed == ["low", "room", "last", "__init__"]


def test_a_circle_has_no_longest_walk():
    with pytest.raises(CycleError):
        longest({"a": frozenset("b"), "b": frozenset("a")})
