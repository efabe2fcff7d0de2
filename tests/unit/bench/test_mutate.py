"""Mutants: each changes one thing, and none changes wording."""

from __future__ import annotations

import ast

import pytest

from bench.mutate.operators import mutants, mutated
from bench.mutate.patch import replacements
from bench.mutate.trial import ROOT
from mavcal.calib.firmware import rotations

SOURCE = '''
"""Text."""
LIMIT: float = 3.0

def inside(x: float, *, strict: bool = True) -> bool:
    """Whether it is."""
    log.info("asked", x=1)
    if x < LIMIT and not strict:
        raise ValueError(f"{x} is below {LIMIT + 1}")
    return x + 1 > 2
'''


def changed():
    return {m.text.partition(":")[0]: ast.unparse(mutated(SOURCE, m)) for m in mutants(SOURCE, "a.py")}


def test_every_mutant_is_another_program_that_can_be_compiled():
    original = ast.unparse(ast.parse(SOURCE))
    made = [ast.unparse(mutated(SOURCE, m)) for m in mutants(SOURCE, "a.py")]
    assert len(set(made)) == len(made)
    for source in made:
        compile(source, "a.py", "exec")
        assert source != original


@pytest.mark.parametrize(
    ("what", "there"),
    [
        ("Lt to LtE", "x <= LIMIT"),
        ("Gt to GtE", "x + 1 >= 2"),
        ("and to or", "or not strict"),
        ("without not", "x < LIMIT and strict"),
        ("Add to Sub", "x - 1 > 2"),
        ("3.0 to 4.0", "LIMIT: float = 4.0"),
        ("True to False", "strict: bool=False"),
        ("if True", "if True:"),
        ("if False", "if False:"),
        ("left out", "pass"),
        ("return None", "return None"),
    ],
)
def test_a_change_is_made_where_it_says(what, there):
    assert there in changed()[what]


def test_wording_annotations_and_logging_stay():
    for source in changed().values():
        assert "log.info('asked', x=1)" in source
        assert "x: float" in source
        assert '"""Text."""' in source


def test_the_functions_that_a_mutant_changes_are_those_that_are_imported():
    path = ROOT / "calib/firmware/rotations.py"
    of_rotations = mutants(path.read_text(encoding="utf-8"), "calib/firmware/rotations.py")
    mutant = next(m for m in of_rotations if m.inside and "argmin" in m.text)
    ((function, code),) = replacements(mutant)
    assert function is rotations.nearest_rotation
    assert code != function.__code__
