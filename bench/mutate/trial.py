"""One mutant against its tests: a child of a warm process loads the changed module instead of the real one."""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from types import ModuleType

import pytest

from bench.mutate.operators import Mutant, mutated

ROOT = Path(__file__).resolve().parents[2]
QUIETLY = (
    *("-q", "-p", "no:randomly", "-p", "no:cacheprovider", "-p", "no:xdist"),
    *("-W", "ignore::pytest.PytestAssertRewriteWarning"),  # of what is imported before pytest, and is none of ours
)


class Verdict(StrEnum):
    """What the tests made of a mutant; what takes far longer than the tests without it was noticed as well."""

    KILLED = "killed"
    TIMED_OUT = "timed out"
    SURVIVED = "survived"


@dataclass(frozen=True)
class Limits:
    """Seconds of processor time and of the clock for one child, and of the clock for one test."""

    cpu_s: float
    wall_s: float
    test_s: float


def warm_up() -> None:
    """Import what no mutant changes and every test needs: a child that did so itself would take three seconds more."""
    for name in ("numpy.testing", "scipy.linalg", "scipy.optimize", "scipy.stats", "scipy.spatial", "scipy.signal"):
        __import__(name)
    for name in ("pydantic", "structlog", "fastapi.testclient", "uvicorn", "pymavlink.dialects.v20.all", "pyulog"):
        __import__(name)
    for name in ("hypothesis", "_hypothesis_pytestplugin", "pytest_asyncio.plugin", "pytest_timeout"):
        __import__(name)
    for name in ("schemathesis.pytest.plugin", "anyio.pytest_plugin", "coverage"):
        __import__(name)


@dataclass(frozen=True)
class Answer:
    """What some tests made of a mutant, and the test that failed; empty where loading the code failed or time ended."""

    verdict: Verdict
    by: str = ""


def answer_of(mutant: Mutant, tests: Sequence[str], limits: Limits) -> Answer:
    """`tests` are ids, met in this order until one fails, in a child that loads the changed module."""
    files = list(dict.fromkeys(test.partition("::")[0] for test in tests))

    def run(told: int) -> int:
        with open(os.devnull, "r+b") as nothing:
            for stream in (0, 1, 2):
                os.dup2(nothing.fileno(), stream)
        sys.meta_path.insert(0, _Changed(mutant))
        patient = ("-o", f"timeout={limits.test_s:.0f}")
        return int(pytest.main(["-x", *QUIETLY, *patient, *files], plugins=[_Chosen(tests, told)]))

    return in_child(run, limits)


def in_child(run: Callable[[int], int], limits: Limits) -> Answer:
    """What `run` says as an exit code of pytest; it writes the test that failed into the file that it is given."""
    with tempfile.TemporaryFile() as told:
        pid = os.fork()
        if pid == 0:
            code = 70
            try:
                os.setpgid(0, 0)
                seconds = int(limits.cpu_s) + 1
                resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
                os.chdir(ROOT)
                code = run(told.fileno())
            finally:
                os._exit(code)
        status = _ended(pid, limits.wall_s)
        told.seek(0)
        by = told.read().decode()
    if os.WIFSIGNALED(status):
        late = os.WTERMSIG(status) in {signal.SIGXCPU, signal.SIGKILL}
        return Answer(Verdict.TIMED_OUT if late else Verdict.KILLED, by)
    survived = os.WEXITSTATUS(status) in {pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED}
    return Answer(Verdict.SURVIVED if survived else Verdict.KILLED, by)


def _ended(pid: int, wall_s: float) -> int:
    """How a child ended; beyond its time it is killed with all that it started."""
    began = time.monotonic()
    while True:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return status
        if time.monotonic() - began > wall_s:
            os.killpg(pid, signal.SIGKILL)
            return os.waitpid(pid, 0)[1]
        time.sleep(0.01)


class _Chosen:
    """Lets some tests run, in their order, and tells which fails first."""

    def __init__(self, tests: Sequence[str], told: int) -> None:
        self._place = {test: place for place, test in enumerate(tests)}
        self._told = told

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = sorted(
            (item for item in items if item.nodeid in self._place), key=lambda item: self._place[item.nodeid]
        )

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            os.write(self._told, report.nodeid.encode())


class _Changed(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds one module, and loads it changed."""

    def __init__(self, mutant: Mutant) -> None:
        self._path = ROOT / mutant.path
        parts = ("mavcal", *Path(mutant.path).with_suffix("").parts)
        self._package = parts[-1] == "__init__"
        self._name = ".".join(parts[:-1] if self._package else parts)
        self._tree = mutated(self._path.read_text(encoding="utf-8"), mutant)

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if name != self._name:
            return None
        spec = importlib.machinery.ModuleSpec(name, self, origin=str(self._path), is_package=self._package)
        spec.has_location = True
        if self._package:
            spec.submodule_search_locations = [str(self._path.parent)]
        return spec

    def exec_module(self, module: ModuleType) -> None:
        exec(compile(self._tree, str(self._path), "exec"), module.__dict__)
