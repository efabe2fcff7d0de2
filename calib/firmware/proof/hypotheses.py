"""Which combinations of old and new values the streams allow.

A hypothesis states which changes of a plan did *not* take effect. If it is true, its discrepancy scatters about zero
with a known covariance; whitened, it is a unit normal. Two hypotheses at a distance ``d`` are compared along the line
between them. One is rejected if the data lie more than :data:`THRESHOLD` standard deviations from it towards the other,
and nearer to the other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
import scipy
from numpy.typing import NDArray

from mavcal.calib.firmware.plan import ProofVerdict

Array = NDArray[np.float64]
Hypothesis = frozenset[str]
"""Names of the changes that did not take effect."""

THRESHOLD: Final = 3.29
"""Threshold, in standard deviations: one false alarm in 2000 along one line, and fewer than one in 1000 per parameter
over several lines."""
CERTAIN: Final = 4.0
"""Threshold for "not everything was applied" if no single parameter is responsible: it is tested along many lines
between combinations."""
OBSERVABLE: Final = 3.0
"""Effects below this many standard deviations are not judged (DESIGN 6, rule 4)."""
UNEXPLAINED: Final = 1e-4
"""P-value below which no hypothesis is accepted."""
MOST_EXHAUSTIVE: Final = 8


@dataclass(frozen=True, eq=False)
class StreamJudgement:
    """Verdicts on the changes that act on one sensor, from its streams."""

    verdicts: dict[str, ProofVerdict]
    distance: dict[str, float]
    """Standard deviations between "applied" and "not applied", for each change alone; 0 without `alone`."""
    alone: dict[str, Hypothesis]
    """The smallest hypothesis that refuses a change and that a vehicle can have; no entry: there is none."""
    explained: bool
    """False: the streams scatter more than expected; distances are in observed standard deviations."""


def combinations_of(names: Sequence[str]) -> tuple[Hypothesis, ...]:
    """Every subset of few `names`; of many: none, all, singles, pairs, all but one, and each group of one stem.

    A firmware that ignores a vector ignores all of it, so the components of a vector are a group.
    """
    if len(names) <= MOST_EXHAUSTIVE:
        sizes = range(len(names) + 1)
        return tuple(frozenset(c) for size in sizes for c in combinations(names, size))
    groups: dict[str, set[str]] = {}
    for name in names:
        groups.setdefault(_stem(name), set()).add(name)
    chosen = [frozenset(c) for size in (0, 1, 2) for c in combinations(names, size)]
    chosen += [frozenset(names), *(frozenset(names) - {n} for n in names)]
    chosen += [frozenset(a | b) for a in groups.values() for b in groups.values()]
    return tuple(dict.fromkeys(chosen))


def judge(names: Sequence[str], whitened: Callable[[Hypothesis], Array | None]) -> StreamJudgement:
    """Judge every combination of `names` by its whitened discrepancy (n,); None: impossible on any vehicle.

    "Everything applied" must not be None. If even the best combination is significantly off, the streams scatter more
    than expected. All standard deviations are then widened until it fits, so the new values are rejected only if the
    old ones fit far better.
    """
    found = [(h, point) for h in combinations_of(names) if (point := whitened(h)) is not None]
    hypotheses = [h for h, _ in found]
    points = np.array([point for _, point in found])
    squares, size = (points**2).sum(axis=1), max(points.shape[1], 1)
    explained = bool(squares.min() <= scipy.special.chdtri(size, UNEXPLAINED))
    if not explained:
        points = points / np.sqrt(squares.min() / size)
    place = {h: k for k, h in enumerate(hypotheses)}
    applied = points[place[frozenset()]]
    ordered = sorted(hypotheses, key=len)
    alone = {n: h for n in names if (h := next((h for h in ordered if n in h), None)) is not None}
    distance = {n: float(np.linalg.norm(points[place[alone[n]]] - applied)) if n in alone else 0.0 for n in names}
    allowed = [h for h, kept in zip(hypotheses, _allowed(points, THRESHOLD), strict=True) if kept]
    verdicts = {n: _verdict(n, distance[n], allowed) for n in names}
    if not explained:  # what scatters for no known reason proves nothing
        weaker = {ProofVerdict.PROVED: ProofVerdict.CONSISTENT}
        verdicts = {n: weaker.get(v, v) for n, v in verdicts.items()}
    if ProofVerdict.CONTRADICTED not in verdicts.values():
        certain = [h for h, kept in zip(hypotheses, _allowed(points, CERTAIN), strict=True) if kept]
        verdicts |= dict.fromkeys(_simplest(certain, distance), ProofVerdict.CONTRADICTED)
    return StreamJudgement(verdicts, distance, alone, explained)


def _simplest(allowed: Sequence[Hypothesis], distance: dict[str, float]) -> frozenset[str]:
    """Simplest explanation in `allowed`: the fewest vectors, then the fewest parameters; empty: all applied.

    Several equally simple explanations share what is common to them, or else all of them are named.
    """
    visible = [frozenset(n for n in h if distance[n] >= OBSERVABLE) for h in allowed]
    if frozenset() in visible:
        return frozenset()
    size = {h: (len({_stem(n) for n in h}), len(h)) for h in visible}
    least = [h for h in visible if size[h] == min(size.values())]
    return frozenset.intersection(*least) or frozenset.union(*least)


def _allowed(points: Array, threshold: float) -> NDArray[np.bool_]:
    """The hypotheses that no other one beats."""
    squares = (points**2).sum(axis=1)
    apart = np.sqrt(np.maximum(squares[:, None] + squares[None, :] - 2.0 * points @ points.T, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (squares[:, None] - squares[None, :] + apart**2) / (2.0 * apart)
    beaten = (apart > 1e-9) & (along > np.maximum(threshold, 0.5 * apart))
    return np.asarray(~beaten.any(axis=1))


def _verdict(name: str, distance: float, allowed: Sequence[Hypothesis]) -> ProofVerdict:
    if distance < OBSERVABLE:
        return ProofVerdict.NOT_OBSERVABLE
    refused = [name in hypothesis for hypothesis in allowed]
    if all(refused):
        return ProofVerdict.CONTRADICTED
    return ProofVerdict.CONSISTENT if any(refused) else ProofVerdict.PROVED


def _stem(name: str) -> str:
    """Common name of the components of a vector: INS_ACCOFFS_X -> INS_ACCOFFS, CAL_ACC0_XOFF -> CAL_ACC0_OFF."""
    head, _, tail = name.rpartition("_")
    if tail in ("X", "Y", "Z", "0", "1", "2"):
        return head
    return f"{head}_{tail[1:]}" if tail[:1] in "XYZ" else name
