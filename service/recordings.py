"""Uploaded recordings: kept as files with their digest, read and fitted on request."""

from __future__ import annotations

import asyncio
import errno
import hashlib
import os
import secrets
import time
from collections.abc import AsyncIterator, Callable, Mapping
from concurrent.futures import Executor
from pathlib import Path, PurePath
from typing import Any

from calib import logs
from calib.errors import CalibError, InvalidInputError
from calib.firmware.origin import Origin, origin_of
from calib.fit import FitResult
from calib.flight.report import overview
from calib.methods import METHODS
from calib.report import fit_to_json
from service.errors import DiskFull, RecordingUnknown, UploadError, UploadTooLarge
from service.store.protocol import Store
from service.store.rows import RecordingRow

Json = dict[str, Any]
_Fitter = Callable[[Path, Json, str, Json], tuple[tuple[FitResult, ...], Origin | None]]


class Recordings:
    """The uploads of one data directory; everything slow runs in `executor`."""

    def __init__(self, store: Store, folder: Path, *, limit_bytes: int, executor: Executor | None = None) -> None:
        self._store = store
        self._folder = folder
        self._limit_bytes = limit_bytes
        self._executor = executor
        folder.mkdir(parents=True, exist_ok=True)

    def all(self) -> tuple[RecordingRow, ...]:
        """Every upload, oldest first."""
        return self._store.recordings()

    def get(self, recording_id: str) -> RecordingRow:
        """The upload of that id.

        Raises
        ------
        RecordingUnknown
            If there is none.
        """
        row = self._store.recording(recording_id)
        if row is None:
            raise RecordingUnknown(f"there is no recording {recording_id}; GET /api/v1/recordings lists them")
        return row

    async def add(self, name: str, chunks: AsyncIterator[bytes], reading: Mapping[str, Any]) -> RecordingRow:
        """Keep an upload that can be read as a recording; of anything else no byte stays.

        Raises
        ------
        UploadTooLarge, UploadError, DiskFull
            The upload is too large, not readable with these options, or does not fit on the disk.
        """
        shown = PurePath(name).name or "upload"
        recording_id = secrets.token_hex(8)
        path = self._folder / f"{recording_id}{_suffix(name)}"
        try:
            size, sha256 = await self._receive(path, chunks)
            document = await self._run(_inspected, path, dict(reading))
        except CalibError as error:
            path.unlink(missing_ok=True)
            raise UploadError(str(error).replace(str(path), shown).replace(path.name, shown)) from error
        except BaseException:
            path.unlink(missing_ok=True)
            raise
        body = {"reading": dict(reading), "inspection": {**document, "source": shown}}
        row = RecordingRow(recording_id, time.time(), shown, path, size, sha256, body)
        await self._store.do(lambda: self._store.add_recording(row))
        return row

    async def fit(self, recording_id: str, method: str, options: Mapping[str, Any]) -> list[Json]:
        """One method on an upload; one document a sensor.

        Raises
        ------
        RecordingUnknown
            If there is no such upload.
        InvalidInputError
            If the method is unknown or its options are not valid.
        """
        fits, _ = await self._fit(_fitted, recording_id, method, options)
        return [fit_to_json(fit) for fit in fits]

    async def fit_of_vehicle(
        self, recording_id: str, method: str, options: Mapping[str, Any]
    ) -> tuple[tuple[FitResult, ...], Origin]:
        """The same fits, and whose sensors they are of.

        Raises
        ------
        RecordingUnknown, InvalidInputError
            As for :meth:`fit`.
        FirmwareError
            If the recording does not say whose sensors it is of.
        """
        fits, origin = await self._fit(_fitted_of_vehicle, recording_id, method, options)
        assert origin is not None
        return fits, origin

    async def _fit(
        self, how: _Fitter, recording_id: str, method: str, options: Mapping[str, Any]
    ) -> tuple[tuple[FitResult, ...], Origin | None]:
        row = self.get(recording_id)
        if method not in METHODS:
            raise InvalidInputError(f"there is no method {method!r}; there are {', '.join(METHODS)}")
        fitted: tuple[tuple[FitResult, ...], Origin | None] = await self._run(
            how, row.path, dict(row.body["reading"]), method, dict(options)
        )
        return fitted

    async def _receive(self, path: Path, chunks: AsyncIterator[bytes]) -> tuple[int, str]:
        size, digest = 0, hashlib.sha256()
        try:
            with path.open("xb") as file:
                async for chunk in chunks:
                    size += len(chunk)
                    if size > self._limit_bytes:
                        raise UploadTooLarge(f"the upload is larger than {self._limit_bytes} bytes: cut the recording")
                    digest.update(chunk)
                    await self._run(file.write, chunk)
                await self._run(os.fsync, file.fileno())
        except OSError as error:
            if error.errno in {errno.ENOSPC, errno.EDQUOT}:
                raise DiskFull from error
            raise
        if size == 0:
            raise UploadError("the upload is empty")
        return size, digest.hexdigest()

    async def _run(self, function: Any, *arguments: Any) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._executor, function, *arguments)


def _suffix(name: str) -> str:
    suffix = PurePath(name).suffix.lower()
    return suffix if suffix[1:].isalnum() and len(suffix) <= 8 else ""


def _inspected(path: Path, reading: Json) -> Json:
    return overview(logs.read(path, **reading))


def _fitted(path: Path, reading: Json, method: str, options: Json) -> tuple[tuple[FitResult, ...], None]:
    return METHODS[method].run(logs.read(path, **reading), options), None


def _fitted_of_vehicle(path: Path, reading: Json, method: str, options: Json) -> tuple[tuple[FitResult, ...], Origin]:
    recording = logs.read(path, **reading)
    fits = METHODS[method].run(recording, options)
    return fits, origin_of(recording, fits)
