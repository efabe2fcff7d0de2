"""How odd the oddest sensor of a healthy group is, and how often healthy and other groups are called odd."""

from __future__ import annotations

import numpy as np

from mavcal.calib.fleet.standing import FALSE_ALARMS, distances, limit_of, oddness

SIZES = (*range(6, 22), 25, 31, 41, 51, 75, 101, 151, 201, 501, 1001)
"""Odd from 21 on: a median of an even number is a mean of two, which makes the limit smaller."""


def limit(n: int, groups: int, seed: int) -> float:
    """The distance that the oddest axis of `groups` healthy groups of `n` passes in 1 of 100."""
    rng = np.random.default_rng([seed, n])
    groups = min(groups, max(4000, 1_000_000 // n))
    worst = []
    for begin in range(0, groups, 1000):
        drawn = rng.standard_normal((min(1000, groups - begin), n, 3))
        worst.append(distances(drawn).max(axis=(1, 2)))
    return float(np.quantile(np.concatenate(worst), 1.0 - FALSE_ALARMS))


def alarms(n: int, groups: int, seed: int, *, tail: float | None = None, fault: float = 0.0) -> tuple[int, int]:
    """Groups in which a healthy sensor was called odd, and in which the faulty one was.

    `tail`: degrees of freedom of a t distribution in place of the normal one; `fault`: how far the first sensor is off,
    in standard deviations.
    """
    rng = np.random.default_rng([seed, n, 1])
    wrong = right = 0
    for _ in range(groups):
        drawn = rng.standard_normal((n, 3)) if tail is None else rng.standard_t(tail, (n, 3))
        drawn[0, 0] += fault
        found = oddness(drawn.tolist(), [0.0] * n)
        wrong += any(one is not None and one.odd for one in found[1 if fault else 0 :])
        right += found[0] is not None and found[0].odd
    assert limit_of(n) > 0.0
    return wrong, right
