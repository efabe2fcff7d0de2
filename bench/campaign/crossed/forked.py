"""A simulated vehicle in a process that is forked instead of started, so that each worker pays for its imports once."""

from __future__ import annotations

import importlib
import json
import os
import runpy
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn

from mavcal.service.simvehicle import ControlChannel, SimulatedVehicle, free_udp_port

POLL_S = 0.005
PACKAGE = SimulatedVehicle.__module__.rpartition(".")[0]
for _name in ("server", "ardupilot", "px4"):
    importlib.import_module(f"{PACKAGE}.{_name}")  # only so that no fork has to; the child is the package's program


class Forked:
    """A child of this process: `body` runs in it, and its result is the exit code. Fork before any thread is begun."""

    def __init__(self, body: Callable[[], int]) -> None:
        from_us, self._into_it = os.pipe()
        self._out_of_it, to_us = os.pipe()
        self._code: int | None = None
        sys.stdout.flush()
        sys.stderr.flush()
        self.pid = os.fork()
        if self.pid == 0:
            os.dup2(from_us, 0)
            os.dup2(to_us, 1)
            for fd in (from_us, to_us, self._into_it, self._out_of_it):
                os.close(fd)
            _run(body)
        os.close(from_us)
        os.close(to_us)
        self.stdin = os.fdopen(self._into_it, "wb")
        self.stdout = os.fdopen(self._out_of_it, "rb")

    def poll(self) -> int | None:
        """The exit code, -9 after SIGKILL; None: it runs."""
        if self._code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self._code = None if pid == 0 else os.waitstatus_to_exitcode(status)
        return self._code

    def wait(self, timeout: float | None = None) -> int:
        """The exit code, once it has ended. Raises subprocess.TimeoutExpired."""
        deadline = None if timeout is None else time.monotonic() + timeout
        while (code := self.poll()) is None:
            if deadline is not None and time.monotonic() > deadline:
                raise subprocess.TimeoutExpired("forked", timeout or 0.0)
            time.sleep(POLL_S)
        return code

    def terminate(self) -> None:
        """Ask it to end."""
        if self.poll() is None:
            os.kill(self.pid, signal.SIGTERM)

    def kill(self) -> None:
        """End it."""
        if self.poll() is None:
            os.kill(self.pid, signal.SIGKILL)


def _run(body: Callable[[], int]) -> NoReturn:
    code = 70
    try:
        sys.stdin, sys.stdout = open(0), open(1, "w")  # noqa: SIM115 - until the process ends
        code = body()
        sys.stdout.flush()
    finally:
        os._exit(code)


class ForkedVehicle(SimulatedVehicle):
    """A simulated vehicle on one link, ``udpout`` or ``tcp``."""

    def __init__(self, autopilot: str, *, link: str, seed: int, speed: float, config: Mapping[str, Any]) -> None:
        port = free_udp_port() if link == "udpout" else 0
        arguments = ["--follow-stdin", "--autopilot", autopilot, f"--{link}", f"127.0.0.1:{port}", "--seed", str(seed)]
        arguments += ["--speed", str(speed), "--config", json.dumps(dict(config))]
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - closed by stop()
        self.process = Forked(lambda: _vehicle(arguments))  # type: ignore[assignment]
        self._control = None
        try:
            ready = self._await_ready()
            self._address = ready["control"]
            self.connect()
        except BaseException:
            self.stop()
            raise
        self.url, self.urls, self.seed = ready["url"], ready["urls"], ready["seed"]

    def connect(self) -> None:
        """A control channel of this process's own: a forked one must not share it."""
        self._control = ControlChannel(self._address)


def _vehicle(arguments: Sequence[str]) -> int:
    """The program of a simulated vehicle, as ``python -m`` would run it."""
    sys.argv = [PACKAGE, *arguments]
    try:
        runpy.run_module(PACKAGE, run_name="__main__", alter_sys=True)
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0
