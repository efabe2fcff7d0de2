"""Computations that a test decides about, instead of child processes."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.in_force.origin import Origin
from mavcal.calib.fit import FitResult
from mavcal.service.errors import RecordingUnknown
from mavcal.service.jobs.uploads import Diagnosis, ProgressCallback
from mavcal.service.store.rows import JobDocument

FOREIGN = Origin("px4", "other", (), {})
DIAGNOSED = Diagnosis("The gap is explained.", (JobDocument("report.json", "application/json", b"{}"),))


@dataclass
class FakeComputations:
    """Knows the uploads `a` and `b` and the method `gyro-rest`; ends when it is let, with what it is given."""

    fits: tuple[FitResult, ...] = ()
    origin: Origin = FOREIGN
    refusal: Exception | None = None
    go: asyncio.Event = field(default_factory=asyncio.Event)
    begins: bool = True
    """Whether a child takes the work up before it may end."""
    lines: tuple[str, ...] = ("reading",)
    """What such a child tells."""
    limits: list[float | None] = field(default_factory=list)
    """Time limits of the diagnoses that were asked for, s."""
    begun: int = 0
    ended: int = 0
    at_once: int = 2

    def __post_init__(self) -> None:
        self.go.set()

    def check(self, recording: str, method: str | None = None) -> None:
        if recording not in {"a", "b"}:
            raise RecordingUnknown
        if method not in {None, "gyro-rest"}:
            raise InvalidInputError(f"there is no method {method}")

    async def fit(
        self, recording: str, method: str, options: Mapping[str, Any], *, progress: ProgressCallback | None = None
    ) -> tuple[FitResult, ...]:
        await self._work(progress)
        return self.fits

    async def fit_of_vehicle(
        self, recording: str, method: str, options: Mapping[str, Any]
    ) -> tuple[tuple[FitResult, ...], Origin]:
        await self._work(None)
        return self.fits, self.origin

    async def diagnose(
        self,
        real: str,
        sim: str | None,
        nominal: Sequence[str],
        *,
        limit_s: float | None = None,
        progress: ProgressCallback | None = None,
    ) -> Diagnosis:
        self.limits.append(limit_s)
        await self._work(progress)
        return DIAGNOSED

    async def _work(self, progress: ProgressCallback | None) -> None:
        self.begun += 1
        try:
            if progress is not None and self.begins:
                for line in self.lines:
                    progress(line)
            await self.go.wait()
            if self.refusal is not None:
                raise self.refusal
        finally:
            self.ended += 1
