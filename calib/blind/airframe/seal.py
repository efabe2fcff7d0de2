"""The seal of the airframe's cases: hashes of what makes them and of what judges them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path

from mavcal.calib.blind.airframe.cases import AirTier

HERE = Path(__file__).resolve().parent
JUDGES = {"score.py", "answers.py", "seal.py"}
"""Modules that judge answers; the generator's digits do not depend on them."""
SHARED = ("answers.py", "figures.py", "intervals.py")
"""Modules of the folder above that judge too."""


def air_generator_sha256() -> str:
    """Of every module that shapes a case, names and bytes."""
    return _digest(path for path in sorted(HERE.glob("*.py")) if path.name not in JUDGES)


def air_scorer_sha256() -> str:
    """Of the modules that judge."""
    own = sorted(path for path in HERE.glob("*.py") if path.name in JUDGES)
    return _digest([*own, *(HERE.parent / name for name in SHARED)])


def _digest(paths: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for path in paths:
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


AIR_PLAN: Mapping[AirTier, int] = {
    AirTier.NULL: 200,
    AirTier.SINGLE: 300,
    AirTier.SIH: 200,
    AirTier.MIXED: 150,
    AirTier.LEFT_OUT: 100,
    AirTier.FOREIGN: 100,
    AirTier.UNKNOWN: 80,
    AirTier.LOGGING: 60,
}
"""Cases a tier in a full sealed run. Source: AIRFRAME 6; of A7, which it leaves open, a dozen a way of logging."""
