"""One mutant against its tests: a child of a warm process imports the changed module in the place of the real one."""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import os
import resource
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from types import ModuleType

import pytest

from bench.mutate.operators import Mutant, mutated

ROOT = Path(__file__).resolve().parents[2]
_NO_TESTS = 5
IGNORED = ("-W", "ignore::pytest.PytestAssertRewriteWarning")
"""What is imported before pytest is not rewritten, and needs not be: it is none of ours."""


class Verdict(StrEnum):
    """What the tests made of a mutant; what takes far longer than the tests without it was noticed as well."""

    KILLED = "killed"
    TIMED_OUT = "timed out"
    SURVIVED = "survived"


@dataclass(frozen=True)
class Limits:
    """Seconds of processor time and of the clock for one child."""

    cpu_s: float
    wall_s: float


def warm_up() -> None:
    """Import what no mutant changes and every test needs."""
    for name in ("numpy", "scipy.linalg", "scipy.optimize", "scipy.stats", "scipy.spatial", "scipy.signal"):
        __import__(name)
    for name in ("pydantic", "structlog", "pymavlink.dialects.v20.all"):
        __import__(name)


def verdict_of(mutant: Mutant | None, tests: Sequence[str], limits: Limits) -> tuple[Verdict, float]:
    """What `tests` (paths) say of a mutant, and the processor time that took; None: of the code as it is."""
    began = time.monotonic()
    pid = os.fork()
    if pid == 0:
        _child(mutant, tests, limits)
    while True:
        done, status, usage = os.wait4(pid, os.WNOHANG)
        if done:
            break
        if time.monotonic() - began > limits.wall_s:
            os.killpg(pid, signal.SIGKILL)
            _, status, usage = os.wait4(pid, 0)
            return Verdict.TIMED_OUT, usage.ru_utime + usage.ru_stime
        time.sleep(0.02)
    spent = usage.ru_utime + usage.ru_stime
    if os.WIFSIGNALED(status):
        return Verdict.TIMED_OUT if os.WTERMSIG(status) in {signal.SIGXCPU, signal.SIGKILL} else Verdict.KILLED, spent
    return Verdict.SURVIVED if os.WEXITSTATUS(status) in {0, _NO_TESTS} else Verdict.KILLED, spent


def _child(mutant: Mutant | None, tests: Sequence[str], limits: Limits) -> None:
    """Never returns."""
    os.setpgid(0, 0)
    code = 70
    try:
        with open(os.devnull, "r+b") as nothing:
            for stream in (0, 1, 2):
                os.dup2(nothing.fileno(), stream)
        seconds = int(limits.cpu_s) + 1
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
        os.chdir(ROOT)
        if mutant is not None:
            sys.meta_path.insert(0, _Changed(mutant))
        code = int(
            pytest.main(["-x", "-q", "-p", "no:randomly", "-p", "no:cacheprovider", "-p", "no:xdist", *IGNORED, *tests])
        )
    finally:
        os._exit(code)


class _Changed(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds one module, and loads it changed."""

    def __init__(self, mutant: Mutant) -> None:
        self._path = ROOT / mutant.path
        parts = Path(mutant.path).with_suffix("").parts
        self._package = parts[-1] == "__init__"
        self._name = ".".join(parts[:-1] if self._package else parts)
        self._source = mutated(self._path.read_text(encoding="utf-8"), mutant)

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
        exec(compile(self._source, str(self._path), "exec"), module.__dict__)
