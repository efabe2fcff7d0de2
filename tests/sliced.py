"""One part in N of the tests, drawn by a seed: what ``.ci/run`` takes of the long ones."""

from __future__ import annotations

import hashlib

import pytest


def add_options(parser: pytest.Parser) -> None:
    group = parser.getgroup("mavcal")
    group.addoption("--part", type=int, default=1, metavar="N", help="run one test in N, drawn by --part-seed")
    group.addoption("--part-seed", default="0", metavar="TEXT", help="what the tests of --part are drawn by")


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
