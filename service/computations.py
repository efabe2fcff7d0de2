"""Fits and gap diagnoses of uploads, each in a child process with limits."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from mavcal.calib.errors import CalibError, FirmwareError, InvalidInputError
from mavcal.calib.firmware.in_force.origin import Origin
from mavcal.calib.fit import FitResult
from mavcal.calib.methods import METHODS
from mavcal.calib.report import Json, from_json
from mavcal.service.children import DIAGNOSE, FIT, Limits, Runs
from mavcal.service.errors import UploadError
from mavcal.service.jobs.uploads import Diagnosis, ProgressCallback
from mavcal.service.recordings import Recordings, without_path
from mavcal.service.store.rows import JobDocument, RecordingRow

REPORT, PAGE = "report.json", "report.html"
"""Documents of a gap diagnosis: the report, and the same as a page."""

_IN_TIME = 0.8
"""Share of the child's time limit that a diagnosis takes at most, so that it answers before it is ended."""


class UploadComputations:
    """The :class:`~service.jobs.uploads.Computations` on the uploads of one data directory.

    Parameters
    ----------
    recordings
        The uploads.
    children
        Child processes for the work.
    of_fits, of_gaps
        Limits of a fit and of a diagnosis.
    """

    def __init__(self, recordings: Recordings, children: Runs, of_fits: Limits, of_gaps: Limits) -> None:
        self._recordings = recordings
        self._children = children
        self._of_fits, self._of_gaps = of_fits, of_gaps

    @property
    def at_once(self) -> int:
        """Number of computations at a time."""
        return self._children.most

    def check(self, recording: str, method: str | None = None) -> None:
        """Raise RecordingUnknown or InvalidInputError if there is no such upload or method."""
        self._recordings.get(recording)
        if method is not None and method not in METHODS:
            raise InvalidInputError(f"there is no method {method!r}; there are {', '.join(METHODS)}")

    async def fit(
        self, recording: str, method: str, options: Mapping[str, Any], *, progress: ProgressCallback | None = None
    ) -> tuple[FitResult, ...]:
        """One fit a sensor; errors as in the protocol."""
        return (await self._fit(recording, method, options, origin=False, progress=progress))[0]

    async def fit_of_vehicle(
        self, recording: str, method: str, options: Mapping[str, Any]
    ) -> tuple[tuple[FitResult, ...], Origin]:
        """The same fits, and whose sensors they are of. Raises FirmwareError if the recording does not say."""
        fits, origin = await self._fit(recording, method, options, origin=True, progress=None)
        if origin is None:
            raise FirmwareError("the recording does not say which vehicle its sensors belong to")
        return fits, origin

    async def diagnose(
        self,
        real: str,
        sim: str | None,
        nominal: Sequence[str],
        *,
        limit_s: float | None = None,
        progress: ProgressCallback | None = None,
    ) -> Diagnosis:
        """The sim-to-real gap of an upload; errors as in the protocol."""
        uploads = [self._recordings.get(i) for i in (real, *(() if sim is None else (sim,)), *nominal)]
        parts = [_part(upload) for upload in uploads]
        order: Json = {
            "real": parts[0],
            "sim": None if sim is None else parts[1],
            "nominal": parts[1 if sim is None else 2 :],
            "title": f"Sim-to-real gap of {uploads[0].name}",
            "vehicle": _vehicle(uploads[0]),
            "wall_s": _IN_TIME * self._of_gaps.wall_s,
            **({} if limit_s is None else {"limit_s": min(limit_s, _IN_TIME * self._of_gaps.wall_s)}),
        }
        try:
            done = await self._children.run(DIAGNOSE, order, self._of_gaps, progress=progress)
        except CalibError as error:
            raise type(error)(_with_names(str(error), uploads)) from error
        report = json.dumps(done["report"], allow_nan=False).encode()
        documents = (
            JobDocument(REPORT, "application/json", report),
            JobDocument(PAGE, "text/html", str(done["page"]).encode()),
        )
        return Diagnosis(str(done["summary"]), documents)

    async def _fit(
        self,
        recording: str,
        method: str,
        options: Mapping[str, Any],
        *,
        origin: bool,
        progress: ProgressCallback | None,
    ) -> tuple[tuple[FitResult, ...], Origin | None]:
        self.check(recording, method)
        row = self._recordings.get(recording)
        order: Json = {
            **_part(row),
            "method": method,
            "options": dict(options),
            "origin": origin,
            "vehicle": _vehicle(row),
        }
        try:
            done = await self._children.run(FIT, order, self._of_fits, progress=progress)
        except CalibError as error:
            raise type(error)(_with_names(str(error), [row])) from error
        whose = done["origin"]
        return tuple(from_json(fit, FitResult) for fit in done["fits"]), None if whose is None else from_json(
            whose, Origin
        )


def _part(row: RecordingRow) -> Json:
    reading = row.body.get("reading")
    if not isinstance(reading, dict):
        raise UploadError(f"the record of {row.name} on the disk is damaged: upload the file again")
    return {"path": str(row.path), "reading": reading, "sha256": row.sha256}


def _vehicle(row: RecordingRow) -> str | None:
    """The unique id of the vehicle whose recording it is; None: the recording does not say."""
    inspection = row.body.get("inspection")
    identity = inspection.get("identity") if isinstance(inspection, dict) else None
    uid = identity.get("uid") if isinstance(identity, dict) else None
    return str(uid) if uid else None


def _with_names(text: str, uploads: Sequence[RecordingRow]) -> str:
    for upload in uploads:
        text = without_path(text, upload.path, upload.name)
    return text
