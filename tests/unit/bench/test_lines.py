"""Lines are counted by what stands on them, and by whom they serve; the ratio never counts tests of instruments."""

from __future__ import annotations

import pytest

from bench.lines import Lines, counted, groups, table, written


@pytest.mark.parametrize(
    ("source", "all_code_bare"),
    [
        ("", (0, 0, 0)),
        ("\n\n", (2, 0, 0)),
        ("# why\n    # indented\n", (2, 0, 0)),
        ("x = 1  # one\n", (1, 1, 1)),
        ("x = (\n    1,\n\n    # two\n    2,\n)\n", (6, 4, 4)),
        ('def f():\n    """One.\n\n    Two.\n    """\n    return 1\n', (6, 5, 2)),
        ('a = 1\n"""About a."""\n', (2, 2, 1)),
        ('text = """one\n\n# no comment\n"""\n', (4, 3, 3)),
        ('x = "# no comment"\n', (1, 1, 1)),
        ("x = 1", (1, 1, 1)),
    ],
)
def test_a_line_is_code_if_something_of_python_stands_on_it(source, all_code_bare):
    assert counted(source) == Lines(1, *all_code_bare)


@pytest.mark.parametrize(
    ("path", "group"),
    [
        ("service/jobs/engine.py", "program"),
        ("calib/gap/model.py", "program"),
        ("service/simvehicle/world.py", "instruments"),
        ("calib/blind/cases.py", "instruments"),
        ("bench/lines.py", "instruments"),
        ("tests/unit/jobs/test_engine.py", "tests"),
        ("tests/conftest.py", "tests"),
        ("tests/unit/bench/test_lines.py", "tests of instruments"),
        ("tests/unit/simvehicle/test_world.py", "tests of instruments"),
        ("tests/unit/blind/test_cases.py", "tests of instruments"),
        ("client/api.py", None),
        ("examples/fit.py", None),
    ],
)
def test_each_module_is_counted_once_and_where_it_belongs(path, group):
    found = groups({path: "x = 1\n"})
    assert {name: n.files for name, n in found.items() if n.files} == ({group: 1} if group else {})


def test_tests_of_instruments_do_not_raise_the_ratio():
    program = {"calib/a.py": "x = 1\n" * 10}
    few = groups(program | {"tests/unit/test_a.py": "y = 1\n" * 5})
    more = groups(program | {"tests/unit/test_a.py": "y = 1\n" * 5, "tests/unit/bench/test_b.py": "z = 1\n" * 100})
    last = table(few).splitlines()[-1]
    assert last == "| tests : program (target 0.8) | | 0.50 | 0.50 | 0.50 |"
    assert table(more).splitlines()[-1] == last


def test_without_a_program_there_is_no_ratio():
    assert table(groups({"tests/a.py": "x = 1\n"})).splitlines()[-1].endswith("| - | - | - |")


def test_the_page_keeps_what_stands_around_the_table():
    page = "before\n<!-- scripts/lines -->\nold\n<!-- /scripts/lines -->\nafter\n"
    assert written(page, "new") == "before\n<!-- scripts/lines -->\nnew\n<!-- /scripts/lines -->\nafter\n"
    assert written(written(page, "new"), "old") == page


@pytest.mark.parametrize("page", ["no place", "<!-- scripts/lines -->\nno end", "<!-- /scripts/lines -->"])
def test_a_page_without_a_place_is_refused(page):
    with pytest.raises(ValueError, match="no place"):
        written(page, "new")
