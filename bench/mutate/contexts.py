"""A pytest plugin: while `coverage` measures, each test is a context of its own; what a passed test took is kept.

Which tests reach a line is what the choice of tests for a mutant rests on. `coverage`'s own contexts are names of
functions, which do not tell the cases of one test apart. The times go into a file beside the data.
"""

from __future__ import annotations

import json
import time
from collections.abc import Generator
from pathlib import Path

import coverage
import pytest

SECONDS_SUFFIX = "-seconds"
_SECONDS: dict[str, float] = {}
_FAILED: set[str] = set()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """The test's id is the context of what it, its fixtures and its threads run."""
    measuring = coverage.Coverage.current()
    began = time.process_time()
    if measuring is not None:
        measuring.switch_context(item.nodeid)
    try:
        return (yield)
    finally:
        if measuring is not None:
            measuring.switch_context("")
        _SECONDS[item.nodeid] = time.process_time() - began


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """A test that fails or is skipped cannot notice anything."""
    if not report.passed:
        _FAILED.add(report.nodeid)


def pytest_sessionfinish() -> None:
    """Beside what is there already, as a measurement may be added to."""
    measuring = coverage.Coverage.current()
    if measuring is not None:
        beside = Path(str(measuring.get_data().base_filename()) + SECONDS_SUFFIX)
        known = json.loads(beside.read_text()) if beside.exists() else {}
        passed = {test: seconds for test, seconds in _SECONDS.items() if test not in _FAILED}
        beside.write_text(json.dumps(known | passed))
