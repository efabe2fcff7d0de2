"""How large a run is, and where its random numbers come from."""

from __future__ import annotations

import sys
import zlib
from dataclasses import dataclass

QUICK_SIZES = 1000
QUICK_RUNS = 12


@dataclass(frozen=True)
class Settings:
    """`quick` is a slice for tests: small samples, few runs, no promise judged by it."""

    quick: bool = False
    seed: int = 1
    budget: float = 6.0
    silent: bool = False
    alone: bool = False
    """Without the peers, where a row can do so."""

    def sizes(self, wanted: list[int]) -> list[int]:
        """Those of `wanted` that are measured, the smallest at least."""
        return [n for n in wanted if not self.quick or n <= QUICK_SIZES] or wanted[:1]

    def runs(self, size: int) -> int:
        """Repeats at that number of samples."""
        if self.quick:
            return QUICK_RUNS
        return 200 if size < 100_000 else 60 if size < 1_000_000 else 40

    @property
    def largest(self) -> int:
        """Samples on which time is taken."""
        return 20_000 if self.quick else 1_000_000

    def seed_of(self, title: str, size: int) -> int:
        """A seed of its own for every case, the same on every machine."""
        return zlib.crc32(f"{self.seed} {title} {size}".encode())

    def say(self, what: str) -> None:
        """Progress, on the error stream."""
        if not self.silent:
            print(what, file=sys.stderr, flush=True)
