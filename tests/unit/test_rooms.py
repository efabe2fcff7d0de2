"""The size of the rooms: docstrings, comments and blank lines are no code, and lazy imports are imports."""

from __future__ import annotations

from scripts.rooms import Room, code_lines, importers, kinds, modules, room_of, rooms

CODE = '''"""What it is."""

import a  # a comment

SIZE = 3
"""In metres."""


def size() -> str:
    """Says it.

    At length.
    """
    # nothing
    return """two
lines"""
'''
PROGRAM = {
    "calib": "from mavcal.calib.mag import sphere\n",
    "calib.mag": "",
    "calib.mag.sphere": "def fit():\n    from mavcal.calib.triad import Triad\n",
    "calib.triad": "class Triad: ...\n",
    "service.app": "import mavcal.calib.triad\nfrom mavcal.service import app\n",
}


def test_docstrings_comments_and_blank_lines_are_no_code() -> None:
    assert code_lines(CODE) == 5


def test_an_import_in_a_function_counts_and_a_module_is_no_importer_of_itself() -> None:
    assert importers(PROGRAM) == {
        "calib.mag.sphere": {"calib"},
        "calib.triad": {"calib.mag.sphere", "service.app"},
    }


def test_a_room_is_a_folder_of_its_side() -> None:
    assert [room_of(name, PROGRAM) for name in PROGRAM] == ["calib", "calib/mag", "calib/mag", "calib", "service"]
    assert rooms(PROGRAM) == [
        Room("calib", 2, 2, 0),
        Room("calib/mag", 2, 2, 1),
        Room("service", 2, 1, 0),
        Room("**program**", 6, 5, 1),
    ]


def test_of_the_program_every_module_lies_in_a_room() -> None:
    known = modules()
    assert {"calib/gap", "service/jobs", "client"} <= {room_of(name, known) for name in known}
    jobs = {name: source for name, source in known.items() if name.startswith("service.jobs")}
    *found, program = rooms(jobs)
    assert [room.name for room in found] == ["service/jobs"]
    assert program.files == len(jobs)
    assert "functions" in kinds(jobs)
