"""The seal: hashes of the generator and of the labels, made and committed before a case is diagnosed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from mavcal.calib.blind.cases import FIRST_SEALED, Tier

HERE = Path(__file__).resolve().parent
SCORER = {"score.py", "figures.py", "intervals.py", "answers.py", "seal.py"}
"""Modules that judge answers; the generator's digits do not depend on them."""
APART = "airframe"
"""Folder of another generator, which has its own seal."""


def generator_sha256() -> str:
    """Of every module that shapes a case, names and bytes."""
    digest = hashlib.sha256()
    for path in _modules():
        if path.name not in SCORER:
            digest.update(path.relative_to(HERE).as_posix().encode() + b"\0")
            digest.update(_sealed_bytes(path) + b"\0")
    return digest.hexdigest()


def _modules() -> list[Path]:
    return [path for path in sorted(HERE.rglob("*.py")) if path.relative_to(HERE).parts[0] != APART]


def _sealed_bytes(path: Path) -> bytes:
    """As when the seals were made: the package had no common name in front then."""
    return path.read_bytes().replace(b"from mavcal.calib", b"from calib")


def scorer_sha256() -> str:
    """Of the modules that judge."""
    digest = hashlib.sha256()
    for path in _modules():
        if path.name in SCORER:
            digest.update(path.name.encode() + b"\0" + _sealed_bytes(path) + b"\0")
    return digest.hexdigest()


def labels_bytes(labels: Iterable[Mapping[str, Any]]) -> bytes:
    """One canonical line a label, in the order of the ids."""
    lines = (json.dumps(label, sort_keys=True) for label in sorted(labels, key=lambda x: str(x["id"])))
    return "".join(f"{line}\n" for line in lines).encode()


def labels_sha256(labels: Iterable[Mapping[str, Any]]) -> dict[str, str]:
    """What is committed before the run: a hash for the labels of each tier."""
    by_tier: dict[str, list[Mapping[str, Any]]] = {}
    for label in labels:
        by_tier.setdefault(str(label["tier"]), []).append(label)
    return {tier: hashlib.sha256(labels_bytes(rows)).hexdigest() for tier, rows in sorted(by_tier.items())}


def seeds(first: int, count: int) -> Sequence[int]:
    """Consecutive seeds that are all of one kind, for development or sealed."""
    if first < FIRST_SEALED < first + count:
        raise ValueError(f"seeds {first} to {first + count - 1} mix development and sealed ones")
    return range(first, first + count)


PLAN: Mapping[Tier, int] = {
    Tier.NULL: 1000,
    Tier.SINGLE: 1000,
    Tier.LADDER: 480,
    Tier.MIXED: 400,
    Tier.LEFT_OUT: 400,
    Tier.UNKNOWN: 400,
    Tier.KNOWN_AND_UNKNOWN: 200,
    Tier.NUISANCE: 320,
    Tier.NULL_TILTED: 300,
}
"""Cases a tier in a full sealed run."""
