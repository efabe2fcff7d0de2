"""Work of an executor's worker on any machine: one log, read in a child process with limits.

Every process that does such work has a fork server of its own, whether its executor has threads, processes or machines.
What comes back is data that any executor can carry.
"""

from __future__ import annotations

import asyncio
import hashlib
import multiprocessing.util
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mavcal.calib.errors import CalibError
from mavcal.service.children import Children, Limits
from mavcal.service.children.limits import die_with_parent
from mavcal.service.errors import ServiceError
from mavcal.service.lifetime import ENDS_WITH, alive, follow

Json = dict[str, Any]

MOST_CHILDREN = 64
"""Children of one process; its executor has fewer workers than that."""
_PREFIX = "mavcal-children-"
STOP_S = 10.0
"""How long the children of a process may take to end."""


def computed(task: str, order: Mapping[str, Any], limits: Limits) -> Json:
    """``{"done": result, "sha256": digest, "seconds"}`` of `order`'s ``path``, or ``{"error": {"code", "text"}}``."""
    path = Path(order["path"])
    try:
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        began = time.monotonic()
        done = _children().run(task, order, limits)
        return {"done": done, "sha256": digest, "seconds": time.monotonic() - began}
    except CalibError as error:
        return {"error": {"code": "invalid-input", "text": str(error)}}
    except ServiceError as error:
        return {"error": {"code": error.code, "text": str(error)}}
    except OSError as error:
        return {"error": {"code": "file-unreadable", "text": f"{path.name} cannot be read: {error.strerror}"}}


def with_parent(pid: int) -> None:
    """Tie a process of a pool to its parent, so that it ends with the parent, however that ends."""
    die_with_parent(pid)  # at once, on Linux, even if nobody has asked yet what became of that one
    follow({ENDS_WITH: str(pid)})


def stop() -> None:
    """End the children of this process, whatever they are doing."""
    global _worker
    with _lock:
        worker, _worker = _worker, None
    if worker is not None:
        worker.stop()


class _Worker:
    """The children of this process, on an event loop in a thread of its own."""

    def __init__(self) -> None:
        self.pid = os.getpid()
        _sweep(Path(tempfile.gettempdir()))
        self._folder = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{self.pid}-"))
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="children", daemon=True)
        self._thread.start()
        self._children = asyncio.run_coroutine_threadsafe(self._made(), self._loop).result()

    async def _made(self) -> Children:
        return Children(self._folder / "orders", most=MOST_CHILDREN)

    async def _stopped(self) -> None:
        """End the children, and give waiting callers time to receive the error."""
        await self._children.stop()
        others = asyncio.all_tasks() - {asyncio.current_task()}
        if others:
            await asyncio.wait(others, timeout=STOP_S)

    def run(self, task: str, order: Mapping[str, Any], limits: Limits) -> Json:
        """The result of one task; errors as of :meth:`service.children.Children.run`."""
        return asyncio.run_coroutine_threadsafe(self._children.run(task, order, limits), self._loop).result()

    def stop(self) -> None:
        """End every child, the fork server and the thread."""
        if self.pid != os.getpid():  # of the process that this one was forked from
            return
        asyncio.run_coroutine_threadsafe(self._stopped(), self._loop).result(2 * STOP_S)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(STOP_S)
        self._loop.close()
        shutil.rmtree(self._folder, ignore_errors=True)


def _sweep(folder: Path) -> None:
    """Remove what killed processes have left."""
    for left in folder.glob(f"{_PREFIX}*"):
        pid = left.name.removeprefix(_PREFIX).partition("-")[0]
        if pid.isdecimal() and not alive(int(pid)):
            shutil.rmtree(left, ignore_errors=True)


_lock = threading.Lock()
_worker: _Worker | None = None


def _children() -> _Worker:
    global _worker
    with _lock:
        if _worker is None or _worker.pid != os.getpid():
            _worker = _Worker()
            # Runs at the end of a process of a pool too, where atexit does not.
            multiprocessing.util.Finalize(None, stop, exitpriority=10)
        return _worker
