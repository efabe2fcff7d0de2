"""``python -m mavcal.service.children.fork_server FIRST LATER``: forks a limited child for each order and reports
how it ended.

Lines of JSON on stdin: ``{"start": id, "task": "module:function", "folder": path, "limits": {...}}``,
``{"stop": id}``; on stdout: ``{"id", "progress"}``, ``{"id", "status", "cpu_s", "peak_bytes"}``. A child finds
``order.json`` in its folder and leaves ``result.json`` there, ``{"done": ...}`` or ``{"refused": {"kind", "text"}}``.
This process has one thread and reads nothing that is not the service's; when its input closes it kills its children
and ends.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import json
import os
import selectors
import signal
import socket
import sys
import traceback
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NoReturn

from mavcal.service.children.limits import DEFECT, OUT_OF_MEMORY, Limits, confine, die_with_parent

Json = dict[str, Any]

LONGEST_LINE = 400
"""Characters of a progress line that are passed on."""
_PIPE_BYTES = 1 << 16
_QUIET_S = 2.0
"""Time without a child and an order after which the server counts as idle, s."""


class ForkServer:
    """The loop that starts, watches and ends children."""

    def __init__(self, later: Iterable[str] = ()) -> None:
        self._later = list(later)
        """Modules to be imported one at a time while idle."""
        self._selector = selectors.DefaultSelector()
        self._children: dict[int, str] = {}
        """Order by process id."""
        self._pipes: dict[str, int] = {}
        """Reading end of the progress pipe by order."""
        self._pending = b""

    def run(self) -> None:
        """Serve until the input closes."""
        woken, waker = socket.socketpair()
        for end in (woken, waker):
            os.set_blocking(end.fileno(), False)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(waker.fileno(), warn_on_full_buffer=False)
        self._selector.register(woken, selectors.EVENT_READ, "ended")
        self._selector.register(0, selectors.EVENT_READ, "orders")
        patience = _QUIET_S
        try:
            while True:
                idle = self._later and not self._children
                ready = self._selector.select(patience if idle else None)
                patience = _QUIET_S if ready else 0.0
                if not ready and idle:
                    importlib.import_module(self._later.pop(0))
                    gc.freeze()
                for key, _ in ready:
                    if key.data == "ended":
                        with contextlib.suppress(BlockingIOError):
                            woken.recv(4096)
                    elif key.data == "orders":
                        if not self._orders():
                            return
                    else:
                        self._progress(key.data)
                self._reap()
        finally:
            for pid in self._children:
                _kill(pid)

    def _orders(self) -> bool:
        chunk = os.read(0, _PIPE_BYTES)
        *lines, self._pending = (self._pending + chunk).split(b"\n")
        for line in lines:
            order = json.loads(line)
            if "start" in order:
                self._start(order)
            else:
                for pid in [pid for pid, name in self._children.items() if name == order["stop"]]:
                    _kill(pid)
        return bool(chunk)

    def _start(self, order: Json) -> None:
        reading, writing = os.pipe()
        fork_server = os.getpid()
        pid = os.fork()
        if pid == 0:
            _child(order, fork_server, writing)
        os.close(writing)
        os.set_blocking(reading, False)
        self._children[pid] = order["start"]
        self._pipes[order["start"]] = reading
        self._selector.register(reading, selectors.EVENT_READ, order["start"])

    def _progress(self, name: str) -> None:
        pipe = self._pipes.get(name)
        if pipe is None:
            return
        try:
            chunk = os.read(pipe, _PIPE_BYTES)
        except BlockingIOError:
            return
        if not chunk:
            self._close(name)
            return
        line = chunk.decode("utf-8", "replace").strip().rpartition("\n")[2][:LONGEST_LINE]
        if line:
            _say({"id": name, "progress": line})

    def _close(self, name: str) -> None:
        pipe = self._pipes.pop(name, None)
        if pipe is not None:
            self._selector.unregister(pipe)
            os.close(pipe)

    def _reap(self) -> None:
        while self._children:
            pid, status, used = os.wait4(-1, os.WNOHANG)
            if pid == 0:
                return
            name = self._children.pop(pid, None)
            if name is None:
                continue
            self._progress(name)
            self._close(name)
            peak = used.ru_maxrss * (1 if sys.platform == "darwin" else 1024)
            _say({"id": name, "status": status, "cpu_s": used.ru_utime + used.ru_stime, "peak_bytes": peak})


def _child(order: Json, fork_server: int, progress: int) -> NoReturn:
    """Run one task in this freshly forked process; never returns."""
    code = DEFECT
    try:
        os.setsid()
        die_with_parent(fork_server)
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        folder = Path(order["folder"])
        progress = _descriptors(folder / "stderr", progress)
        confine(Limits(**order["limits"]))
        code = _work(order["task"], folder, progress)
    except MemoryError:
        code = OUT_OF_MEMORY
    except BaseException:  # noqa: BLE001 - whatever it is, the child ends here and its stderr tells
        traceback.print_exc()
        sys.stderr.flush()
    finally:
        os._exit(code)


def _descriptors(stderr: Path, progress: int) -> int:
    """Keep only an empty stdin, a file as stderr, and the progress pipe; returns the pipe's descriptor."""
    nothing = os.open(os.devnull, os.O_RDONLY)
    complaints = os.open(stderr, os.O_WRONLY | os.O_CREAT, 0o600)
    os.dup2(nothing, 0)
    os.dup2(complaints, 1)
    os.dup2(complaints, 2)
    if progress != 3:
        os.dup2(progress, 3)
    os.closerange(4, os.sysconf("SC_OPEN_MAX") if os.sysconf("SC_OPEN_MAX") < 1 << 16 else 1 << 16)
    return 3


def _work(task: str, folder: Path, progress: int) -> int:
    from mavcal.calib.errors import CalibError

    module, _, name = task.partition(":")
    function = getattr(importlib.import_module(module), name)
    order = json.loads((folder / "order.json").read_bytes())

    def on_progress(text: str) -> None:
        os.write(progress, (text.replace("\n", " ")[:LONGEST_LINE] + "\n").encode("utf-8", "replace"))

    result: Json
    try:
        result = {"done": function(order, on_progress)}
    except CalibError as error:
        result = {"refused": {"kind": type(error).__name__, "text": str(error)}}
    fresh = folder / "result.new"
    fresh.write_text(json.dumps(result, allow_nan=False), encoding="utf-8")
    fresh.replace(folder / "result.json")
    return 0


def _kill(pid: int) -> None:
    """Kill the process group of the child, or the child alone before it has a group."""
    for end in (os.killpg, os.kill):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            end(pid, signal.SIGKILL)


def _say(message: Json) -> None:
    data = json.dumps(message).encode() + b"\n"
    while data:
        data = data[os.write(1, data) :]


def main() -> None:
    """Import what every child needs, then serve."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the service's to answer
    first, later = ([name for name in names.split(",") if name] for names in sys.argv[1:3])
    for module in first:
        importlib.import_module(module)
    gc.freeze()
    with contextlib.suppress(BrokenPipeError):
        ForkServer(later).run()


if __name__ == "__main__":
    main()
