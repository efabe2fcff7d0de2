"""Uploaded recordings: kept as files with their digest; a child process reads each as it comes."""

from __future__ import annotations

import asyncio
import errno
import hashlib
import os
import secrets
import time
from collections.abc import AsyncIterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path, PurePath
from typing import Any

from mavcal.calib.errors import CalibError
from mavcal.service.children import INSPECT, SERIES, Children, Limits
from mavcal.service.errors import DiskFull, RecordingUnknown, UploadError, UploadTooLarge
from mavcal.service.store.rows import RecordingRow
from mavcal.service.store.sql import Store


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

    def close(self) -> None:
        """Shut the thread pool down."""
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
        return replace(row, path=self._folder / row.path.name)  # the folder may lie elsewhere than when it was uploaded

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
            raise UploadError(without_path(str(error), path, shown)) from error
        except BaseException:
            path.unlink(missing_ok=True)
            raise
        body = {"reading": dict(reading), "inspection": {**document, "source": shown}}
        row = RecordingRow(recording_id, time.time(), shown, path, size, sha256, body)
        await self._store.do(lambda: self._store.add_recording(row))
        return row

    async def series(self, recording_id: str) -> list[dict[str, Any]]:
        """The sensors of an upload over its time, thinned for a picture.

        Raises
        ------
        RecordingUnknown
            If there is none.
        ChildEnded, ChildrenBusy
            Reading it took more than it may, or too many files are waiting.
        """
        row = self.get(recording_id)
        order = {"path": str(row.path), "reading": dict(row.body.get("reading") or {})}
        try:
            found: list[dict[str, Any]] = (await self._children.run(SERIES, order, self._limits))["series"]
        except CalibError as error:
            raise UploadError(without_path(str(error), row.path, row.name)) from error
        return found

    async def _receive(self, path: Path, chunks: AsyncIterator[bytes]) -> tuple[int, str]:
        size, digest = 0, hashlib.sha256()
        try:
            await self._write(partial(self._folder.mkdir, parents=True, exist_ok=True))
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


def without_path(text: str, path: Path, shown: str) -> str:
    """`text` with the uploader's name of the file instead of ours."""
    return text.replace(str(path), shown).replace(path.name, shown)
