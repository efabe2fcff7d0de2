"""The map of the packages counts what the imports say."""

from __future__ import annotations

from bench.house import arrows, circles, report

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
