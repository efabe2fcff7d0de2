"""Uploaded recordings: kept as files with their digest; child processes read and fit them on request."""

from __future__ import annotations

import asyncio
import errno
import hashlib
import os
import secrets
import time
from collections.abc import AsyncIterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path, PurePath
from typing import Any

from mavcal.calib.errors import CalibError, FirmwareError, InvalidInputError
from mavcal.calib.firmware.in_force.origin import Origin
from mavcal.calib.fit import FitResult
from mavcal.calib.methods import METHODS
from mavcal.calib.report import fit_from_json, fit_to_json
from mavcal.service.children import FIT, INSPECT, Children, Limits
from mavcal.service.errors import DiskFull, RecordingUnknown, UploadError, UploadTooLarge
from mavcal.service.jobs.planning import origin_from_json
from mavcal.service.store.protocol import Store
from mavcal.service.store.rows import RecordingRow

Json = dict[str, Any]


class Recordings:
    """The uploads of one data directory.

    Nothing of a file is read in this process: `children` do it within `limits`. Bytes are written by threads that
    do nothing else, so a slow disk holds up uploads alone.
    """

    def __init__(self, store: Store, folder: Path, *, limit_bytes: int, children: Children, limits: Limits) -> None:
        self._store = store
        self._folder = folder
        self._limit_bytes = limit_bytes
        self._children = children
        self._limits = limits
        self._writers = ThreadPoolExecutor(2, thread_name_prefix="upload")
        folder.mkdir(parents=True, exist_ok=True)

    def close(self) -> None:
        """Give the threads back."""
        self._writers.shutdown(wait=False, cancel_futures=True)

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
        ChildEnded, ChildrenBusy
            Reading it took more than it may, or too many files are waiting.
        """
        shown = PurePath(name).name or "upload"
        recording_id = secrets.token_hex(8)
        path = self._folder / f"{recording_id}{_suffix(name)}"
        try:
            size, sha256 = await self._receive(path, chunks)
            order = {"path": str(path), "reading": dict(reading)}
            document = await self._children.run(INSPECT, order, self._limits)
        except CalibError as error:
            path.unlink(missing_ok=True)
            raise UploadError(_renamed(str(error), path, shown)) from error
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
        ChildEnded, ChildrenBusy
            As for :meth:`add`.
        """
        return [fit_to_json(fit) for fit in (await self._fit(recording_id, method, options, origin=False))[0]]

    async def fit_of_vehicle(
        self, recording_id: str, method: str, options: Mapping[str, Any]
    ) -> tuple[tuple[FitResult, ...], Origin]:
        """The same fits, and whose sensors they are of.

        Raises
        ------
        RecordingUnknown, InvalidInputError, ChildEnded, ChildrenBusy
            As for :meth:`fit`.
        FirmwareError
            If the recording does not say whose sensors it is of.
        """
        fits, origin = await self._fit(recording_id, method, options, origin=True)
        if origin is None:
            raise FirmwareError("the recording does not say whose sensors it is of")
        return fits, origin

    def check(self, recording_id: str, method: str) -> RecordingRow:
        """The upload, if it is there and the method is one. Raises RecordingUnknown, InvalidInputError."""
        row = self.get(recording_id)
        if method not in METHODS:
            raise InvalidInputError(f"there is no method {method!r}; there are {', '.join(METHODS)}")
        return row

    async def _fit(
        self, recording_id: str, method: str, options: Mapping[str, Any], *, origin: bool
    ) -> tuple[tuple[FitResult, ...], Origin | None]:
        row = self.check(recording_id, method)
        reading = row.body.get("reading")
        if not isinstance(reading, dict):
            raise UploadError(f"the record of {row.name} on the disk is damaged: upload the file again")
        order: Json = {"path": str(row.path), "reading": reading, "method": method}
        order |= {"options": dict(options), "origin": origin}
        try:
            done = await self._children.run(FIT, order, self._limits)
        except CalibError as error:
            raise type(error)(_renamed(str(error), row.path, row.name)) from error
        whose = done["origin"]
        return tuple(fit_from_json(fit) for fit in done["fits"]), None if whose is None else origin_from_json(whose)

    async def _receive(self, path: Path, chunks: AsyncIterator[bytes]) -> tuple[int, str]:
        size, digest = 0, hashlib.sha256()
        try:
            with path.open("xb") as file:
                async for chunk in chunks:
                    size += len(chunk)
                    if size > self._limit_bytes:
                        raise UploadTooLarge(f"the upload is larger than {self._limit_bytes} bytes: cut the recording")
                    digest.update(chunk)
                    await self._write(file.write, chunk)
                await self._write(os.fsync, file.fileno())
        except OSError as error:
            if error.errno in {errno.ENOSPC, errno.EDQUOT}:
                raise DiskFull from error
            raise
        if size == 0:
            raise UploadError("the upload is empty")
        return size, digest.hexdigest()

    async def _write(self, function: Any, *arguments: Any) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._writers, function, *arguments)


def _suffix(name: str) -> str:
    suffix = PurePath(name).suffix.lower()
    return suffix if suffix[1:].isalnum() and len(suffix) <= 8 else ""


def _renamed(text: str, path: Path, shown: str) -> str:
    """`text` with the uploader's name of the file instead of ours."""
    return text.replace(str(path), shown).replace(path.name, shown)
