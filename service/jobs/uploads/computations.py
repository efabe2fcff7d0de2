"""Computations on uploads, as jobs ask for them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Never, Protocol

from mavcal.calib.firmware.in_force.origin import Origin
from mavcal.calib.fit import FitResult
from mavcal.service.errors import RecordingUnknown
from mavcal.service.store.rows import JobDocument

ProgressCallback = Callable[[str], None]
"""Hears how far a computation is, in words."""


@dataclass(frozen=True)
class Diagnosis:
    """What a gap diagnosis found: one sentence, and its report."""

    summary: str
    documents: tuple[JobDocument, ...]


class Computations(Protocol):
    """Computations on uploads, outside this process. When a call is cancelled, its computation is ended.

    Every method raises RecordingUnknown if an upload does not exist, and CalibError for what the computation itself
    refused. It raises ChildEnded if the computation used more than it may, and ChildrenBusy if too many are waiting.
    """

    @property
    def at_once(self) -> int:
        """Number of computations at a time; further ones wait."""

    def check(self, recording: str, method: str | None = None) -> None:
        """Raise RecordingUnknown or InvalidInputError if there is no such upload or method."""

    async def fit(
        self, recording: str, method: str, options: Mapping[str, Any], *, progress: ProgressCallback | None = None
    ) -> tuple[FitResult, ...]:
        """Fits by sensor."""

    async def fit_of_vehicle(
        self, recording: str, method: str, options: Mapping[str, Any]
    ) -> tuple[tuple[FitResult, ...], Origin]:
        """The same fits, and whose sensors they are of. Raises FirmwareError if the recording does not say."""

    async def diagnose(
        self,
        real: str,
        sim: str | None,
        nominal: Sequence[str],
        *,
        limit_s: float | None = None,
        progress: ProgressCallback | None = None,
    ) -> Diagnosis:
        """The sim-to-real gap of an upload; `limit_s` is its processor time, None: the default."""


class NoUploads:
    """The computations of an engine that has no uploads."""

    at_once = 1

    def check(self, recording: str, method: str | None = None) -> None:
        """Raise RecordingUnknown."""
        raise RecordingUnknown(f"there is no recording {recording}: uploads are not kept here")

    async def fit(self, *_order: Any, **_options: Any) -> Never:
        """Raise RecordingUnknown."""
        raise RecordingUnknown

    fit_of_vehicle = diagnose = fit
