"""Many mutants in one session of pytest: a child for each, in which existing functions get the changed code.

A session that has collected its tests is forked: a mutant then costs its tests and nothing else. Only what is in the
body of a function and does not run while modules are loaded can be changed this way; :mod:`bench.mutate.trial` does
the rest.
"""

from __future__ import annotations

import ast
import gc
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from types import CodeType, FunctionType

import pytest

from bench.mutate.operators import Mutant, mutated
from bench.mutate.trial import QUIETLY, ROOT, Answer, Limits, in_child

Ask = Callable[[Mutant, Sequence[str], Limits], Answer]


class UnpatchableError(Exception):
    """The change shows only when the module is loaded."""


def session(files: Sequence[str], work: Callable[[Ask], None]) -> None:
    """Collect the tests of `files`, then let `work` ask them about mutants."""
    pytest.main([*QUIETLY, *files], plugins=[_Session(work)])


class _Session:
    def __init__(self, work: Callable[[Ask], None]) -> None:
        self._work = work

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        items = {item.nodeid: item for item in session.items}

        def ask(mutant: Mutant, tests: Sequence[str], limits: Limits) -> Answer:
            chosen = [items[test] for test in tests if test in items]
            replaced = replacements(mutant)

            def run(told: int) -> int:
                for function, code in replaced:
                    function.__code__ = code
                return _run(session, chosen, told, limits)

            return in_child(run, limits)

        self._work(ask)
        return True


def _run(session: pytest.Session, items: Sequence[pytest.Item], told: int, limits: Limits) -> int:
    """Run some tests in this child until one fails."""
    first = _First(told)
    session.config.pluginmanager.register(first)
    for item, following in zip(items, [*items[1:], None], strict=True):
        item.add_marker(pytest.mark.timeout(limits.test_s), append=False)
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        if first.failed:
            return int(pytest.ExitCode.TESTS_FAILED)
    return int(pytest.ExitCode.OK)


class _First:
    def __init__(self, told: int) -> None:
        self._told = told
        self.failed = False

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and not self.failed:
            self.failed = True
            with open(self._told, "wb", closefd=False) as file:
                file.write(report.nodeid.encode())


def replacements(mutant: Mutant) -> list[tuple[FunctionType, CodeType]]:
    """The functions that exist, with their code as the mutant has it.

    Raises
    ------
    UnpatchableError
        If no function shows the change, or one of them cannot take it.
    """
    path = ROOT / mutant.path
    source = path.read_text(encoding="utf-8")
    old = _codes(compile(ast.parse(source), str(path), "exec"))
    new = _codes(compile(mutated(source, mutant), str(path), "exec"))
    changed = {
        place: ours
        for place, codes in new.items()
        for ours, theirs in zip(codes, old.get(place, ()), strict=False)
        if ours != theirs and ours.co_name != "<module>"
    }
    found = []
    imported = {str(ROOT / "mavcal" / mutant.path), str(path)}
    gc.unfreeze()  # what is frozen is among no objects
    for thing in gc.get_objects():
        if isinstance(thing, FunctionType) and thing.__code__.co_filename in imported:
            code = changed.get(_place(thing.__code__))
            if code is not None:
                if code.co_freevars != thing.__code__.co_freevars:
                    raise UnpatchableError(mutant.text)
                found.append((thing, code))
    if not found:
        raise UnpatchableError(mutant.text)
    return found


def _codes(module: CodeType) -> dict[tuple[str, int], list[CodeType]]:
    found = defaultdict(list)
    for code in _inner(module):
        found[_place(code)].append(code)
    return found


def _inner(code: CodeType) -> Iterator[CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _inner(constant)


def _place(code: CodeType) -> tuple[str, int]:
    return code.co_qualname, code.co_firstlineno
