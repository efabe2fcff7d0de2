"""How many examples a property is tried with: ten in ``scripts/test``, its full number in ``scripts/test -m long``."""

from __future__ import annotations

import pytest
from hypothesis import settings

FEW = 10
USUAL = 100
"""Hypothesis's own number, for a property that states none."""
_full = False


def examples(full: int) -> int:
    """The number of examples of this run, for a property that is worth `full` of them."""
    return full if _full else min(full, FEW)


def configure(config: pytest.Config) -> None:
    """Settle the number before any test is imported; wall-clock deadlines would judge the machine, not the code."""
    global _full
    _full = is_long(config)
    settings.register_profile("mavcal", deadline=None, print_blob=True, max_examples=examples(USUAL))
    settings.load_profile("mavcal")


def is_long(config: pytest.Config) -> bool:
    """Whether long tests were asked for: ``-m long``."""
    return str(config.option.markexpr).strip() == "long"


def choose_properties(items: list[pytest.Item]) -> None:
    """A property counts as a long test where those were asked for."""
    for item in items:
        if getattr(getattr(item, "obj", None), "is_hypothesis_test", False):
            item.add_marker(pytest.mark.long)
