"""Which tests run: all, one part in N drawn by a seed (``.ci/run``), or few of many parameters (``sampled``)."""

from __future__ import annotations

import hashlib

import pytest


def add_options(parser: pytest.Parser) -> None:
    group = parser.getgroup("mavcal")
    group.addoption("--part", type=int, default=1, metavar="N", help="run one test in N, drawn by --part-seed")
    group.addoption("--part-seed", default="0", metavar="TEXT", help="what the tests of --part are drawn by")


_SAMPLE = 8
"""Of the parameters of a ``sampled`` test ``scripts/test`` takes one in so many, the first one always."""


def leave_most_to_the_night(items: list[pytest.Item]) -> None:
    """Of a test that is marked ``sampled`` all parameters but the first, ninth, ... count as long tests."""
    seen: dict[str, int] = {}
    for item in items:
        if item.get_closest_marker("sampled"):
            name = item.nodeid.partition("[")[0]
            if seen.get(name, 0) % _SAMPLE:
                item.add_marker(pytest.mark.long)
            seen[name] = seen.get(name, 0) + 1


def choose(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave the drawn ones in `items`, and tell pytest of the others."""
    of, seed = config.getoption("--part"), config.getoption("--part-seed")
    drawn = [item for item in items if is_drawn(item.nodeid, of, seed)]
    if len(drawn) < len(items):
        config.hook.pytest_deselected(items=[item for item in items if item not in set(drawn)])
        items[:] = drawn


def is_drawn(name: str, of: int, seed: str) -> bool:
    """Whether the test of this name is of the part; the same for each process and each machine.

    >>> [name for name in ("a", "b", "c", "d") if is_drawn(name, 2, "1")]
    ['a']
    """
    return int.from_bytes(hashlib.sha256(f"{seed} {name}".encode()).digest()[:8]) % of == 0
