"""The service's side of its children: orders in, results out, a bounded number at a time."""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import structlog

import mavcal.calib.errors
from mavcal.calib.errors import CalibError, InvalidInputError
from mavcal.service.children.limits import Limits, cause_of
from mavcal.service.children.tasks import FIRST, LATER, Json
from mavcal.service.errors import ChildEnded, ChildrenBusy

log = structlog.get_logger(__name__)

ProgressCallback = Callable[[str], None]

MOST_WAITING = 32
"""Orders that may be waiting or running at a time."""
LARGEST_RESULT = 1 << 26
"""Largest result that is accepted, bytes."""
STOP_S = 5.0
"""How long the fork server may take to end."""
_STDERR_TOLD = 4000


class Runs(Protocol):
    """Runs tasks of :mod:`service.children.tasks` within limits."""

    most: int
    """The most items of a campaign that run at a time."""

    async def run(
        self, task: str, order: Mapping[str, Any], limits: Limits, *, progress: ProgressCallback | None = None
    ) -> Json:
        """See :meth:`Children.run`."""


@dataclass
class _Running:
    ended: asyncio.Future[Json]
    progress: ProgressCallback | None


class Children:
    """Runs tasks of :mod:`service.children.tasks` in limited child processes.

    Parameters
    ----------
    folder
        Where orders and results lie while they are needed; what a crash left there is removed before the first.
    most
        Children at a time.
    first, later
        Modules that the fork server imports for its children before it serves, and while it is idle.
    """

    def __init__(self, folder: Path, *, most: int, first: Sequence[str] = FIRST, later: Sequence[str] = LATER) -> None:
        self._folder = folder
        self._modules = ",".join(first), ",".join(later)
        self.most = most
        """Children at a time."""
        self._slots = asyncio.Semaphore(most)
        self._asked = 0
        self._running: dict[str, _Running] = {}
        self._fork_server: asyncio.subprocess.Process | None = None
        self._listening: asyncio.Task[None] | None = None
        self._starting = asyncio.Lock()
        self._files = ThreadPoolExecutor(1, thread_name_prefix="children")
        self._stopped = False
        self._swept = False

    @property
    def fork_server_pid(self) -> int | None:
        """The process that starts children; None while there is none."""
        return None if self._fork_server is None else self._fork_server.pid

    async def run(
        self, task: str, order: Mapping[str, Any], limits: Limits, *, progress: ProgressCallback | None = None
    ) -> Json:
        """The result of one task; `progress` hears each step. When this is cancelled the child is killed.

        Raises
        ------
        CalibError
            What the task itself refused, as the same class.
        ChildEnded
            If the child used more than `limits`, crashed, or left no result.
        ChildrenBusy
            If too many orders are waiting.
        """
        if self._stopped:
            raise ChildEnded("the service is stopping")
        if self._asked >= MOST_WAITING:
            raise ChildrenBusy(f"{self._asked} files are waiting to be read: try again when one is done")
        self._asked += 1
        try:
            async with self._slots:
                return await self._one(task, order, limits, progress)
        finally:
            self._asked -= 1

    async def stop(self) -> None:
        """Kill every child and end the fork server."""
        self._stopped = True
        fork_server, self._fork_server = self._fork_server, None
        if fork_server is not None:
            assert fork_server.stdin is not None
            fork_server.stdin.close()
            try:
                async with asyncio.timeout(STOP_S):
                    await fork_server.wait()
            except TimeoutError:
                fork_server.kill()
                await fork_server.wait()
        if self._listening is not None:
            await self._listening
        self._files.shutdown(wait=True)
        shutil.rmtree(self._folder, ignore_errors=True)

    async def _one(
        self, task: str, order: Mapping[str, Any], limits: Limits, progress: ProgressCallback | None
    ) -> Json:
        name = secrets.token_hex(8)
        folder = self._folder / name
        await self._off_loop(self._written, folder, order)
        running = _Running(asyncio.get_running_loop().create_future(), progress)
        try:
            await self._send({"start": name, "task": task, "folder": str(folder), "limits": asdict(limits)}, running)
            try:
                async with asyncio.timeout(limits.wall_s):
                    ended = await asyncio.shield(running.ended)
            except TimeoutError:
                raise ChildEnded(f"it took longer than {limits.wall_s:g} s") from None
            result: Json = await self._off_loop(_result_of, folder, ended, limits)
            return result
        finally:
            await self._end(name, running)
            with contextlib.suppress(RuntimeError):  # the service is stopping: it removes the whole folder
                await self._off_loop(partial(shutil.rmtree, folder, ignore_errors=True))

    async def _end(self, name: str, running: _Running) -> None:
        """Kill the child if it still runs; its place is free only when it is gone."""
        if name in self._running and self._fork_server is not None:
            with contextlib.suppress(OSError):
                self._write(self._fork_server, {"stop": name})
            with contextlib.suppress(ChildEnded):
                await running.ended
        self._running.pop(name, None)

    async def _send(self, line: Json, running: _Running) -> None:
        async with self._starting:
            if self._stopped:  # meanwhile
                raise ChildEnded("the service is stopping")
            if self._fork_server is None:
                self._fork_server = await asyncio.create_subprocess_exec(
                    *(sys.executable, "-m", "mavcal.service.children.fork_server", *self._modules),
                    stdin=asyncio.subprocess.PIPE,
                    stdout=asyncio.subprocess.PIPE,
                )
                self._listening = asyncio.create_task(self._listen(self._fork_server), name="fork server")
            self._running[line["start"]] = running
            self._write(self._fork_server, line)

    def _write(self, fork_server: asyncio.subprocess.Process, line: Json) -> None:
        assert fork_server.stdin is not None
        fork_server.stdin.write(json.dumps(line).encode() + b"\n")

    async def _listen(self, fork_server: asyncio.subprocess.Process) -> None:
        """Dispatch the messages of the fork server; its end is the end of every child."""
        assert fork_server.stdout is not None
        while line := await fork_server.stdout.readline():
            message = json.loads(line)
            running = self._running.get(message["id"])
            if running is None:
                continue
            if "progress" in message:
                if running.progress is not None:
                    running.progress(message["progress"])
                continue
            del self._running[message["id"]]
            if not running.ended.done():
                running.ended.set_result(message)
        await fork_server.wait()
        if self._fork_server is fork_server:
            self._fork_server = None
            log.error("fork server ended", returncode=fork_server.returncode)
        for running in self._running.values():
            if not running.ended.done():
                running.ended.set_exception(ChildEnded("the process that reads files ended; try again"))
                running.ended.exception()  # it may be that nobody waits any more
        self._running.clear()

    def _written(self, folder: Path, order: Mapping[str, Any]) -> None:
        """Write an order to its file, in the thread for files."""
        if not self._swept:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder.mkdir(parents=True, mode=0o700)
            self._swept = True
        folder.mkdir(mode=0o700)
        (folder / "order.json").write_text(json.dumps(order), encoding="utf-8")

    async def _off_loop(self, function: Callable[..., Any], *arguments: Any) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._files, function, *arguments)


def _result_of(folder: Path, ended: Json, limits: Limits) -> Json:
    """The result that the child wrote, as data."""
    if ended["status"] != 0:
        complaints = (folder / "stderr").read_bytes()[-_STDERR_TOLD:] if (folder / "stderr").exists() else b""
        log.warning("child ended", status=ended["status"], cpu_s=ended["cpu_s"], peak_bytes=ended["peak_bytes"],
                    stderr=complaints.decode(errors="replace"))  # fmt: skip
        raise ChildEnded(cause_of(ended["status"], limits))
    path = folder / "result.json"
    try:
        if path.stat().st_size > LARGEST_RESULT:
            raise ChildEnded(f"its result is larger than {LARGEST_RESULT >> 20} MiB")
        result = json.loads(path.read_bytes())
        if "refused" in result:
            raise refusal(str(result["refused"]["kind"]), str(result["refused"]["text"]))
        done: Json = result["done"]
        return done
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        if isinstance(error, CalibError):
            raise
        raise ChildEnded("it left no result that can be read") from error


def refusal(kind: str, text: str) -> CalibError:
    """The error that the task raised; any error not of this package becomes invalid input."""
    made = getattr(mavcal.calib.errors, kind, None)
    known = isinstance(made, type) and issubclass(made, CalibError)
    return made(text) if known else InvalidInputError(text)  # type: ignore[misc]
