"""A firmware as a process on loopback, and a MAVLink connection of our own beside the one that mavcal has."""

from __future__ import annotations

import os
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pymavlink import mavutil

from mavcal.service.lifetime import ending_with_us

COMPONENT = 1
ACK_S = 2.0
POLL_S = 0.02
SILENT_S = 30.0
"""A connection without a single message for so long is broken."""


class FirmwareError(Exception):
    """The firmware does not run, or does not answer."""


class FirmwareProcess:
    """Starts, stops and kills one binary, whose output goes into a file of its folder."""

    def __init__(self, command: Sequence[str], folder: Path, environment: Mapping[str, str] | None = None) -> None:
        self._command, self._folder = list(command), folder
        self._environment = {**os.environ, **(environment or {})}
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it; its first life and every further one append to the same log."""
        with (self._folder / "firmware.log").open("ab") as log:
            self._process = subprocess.Popen(  # the binary that the caller names
                self._command,
                cwd=self._folder,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env=ending_with_us(self._environment),
                start_new_session=True,
            )

    def stop(self) -> None:
        """End it and everything that it has started."""
        if self._process is None:
            return
        for signal_number in (15, 9):
            try:
                os.killpg(self._process.pid, signal_number)
                self._process.wait(timeout=5.0)
            except ProcessLookupError:
                break
            except subprocess.TimeoutExpired:
                continue
            break
        self._process = None

    @property
    def runs(self) -> bool:
        """Whether the process is there."""
        return self._process is not None and self._process.poll() is None

    def last_lines(self, count: int = 5) -> str:
        """The end of its log."""
        return "\n".join((self._folder / "firmware.log").read_text(errors="replace").splitlines()[-count:])


class SecondConnection:
    """A connection beside mavcal's: it reads the truth and acts on the world, with another system id."""

    def __init__(self, address: str, system: int = 1) -> None:
        self._address, self._system = address, system
        self._lock = threading.Lock()
        self._link: Any = None
        self._latest: dict[str, Any] = {}
        self._count, self._heard_at = 0, time.monotonic()
        self._heard: list[Callable[[Any], None]] = []
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None

    def open(self, wait_s: float = 60.0) -> None:
        """Connect, and wait for a heartbeat. Raises FirmwareError."""
        if self._address.startswith("tcp:"):
            self.wait(self._listens, wait_s, f"nothing listens on {self._address}")
        self._link = mavutil.mavlink_connection(
            self._address, source_system=250, dialect="ardupilotmega", autoreconnect=True
        )
        self._ending.clear()
        self._thread = threading.Thread(target=self._read, name="second-connection", daemon=True)
        self._thread.start()
        self.wait(lambda: "HEARTBEAT" in self._latest, wait_s, f"no heartbeat on {self._address}")

    def close(self) -> None:
        """Leave the connection."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join(timeout=5.0)
        if self._link is not None:
            self._link.close()
        self._link, self._latest = None, {}

    @property
    def silent_s(self) -> float:
        """How long nothing was heard, s."""
        return time.monotonic() - self._heard_at

    def latest(self, name: str) -> Any:
        """The newest message of that name; None: none yet."""
        return self._latest.get(name)

    def command(self, number: int, *values: float) -> None:
        """A COMMAND_LONG whose answer nobody waits for."""
        full = [*values, *[0.0] * (7 - len(values))]
        with self._lock:
            self._link.mav.command_long_send(self._system, COMPONENT, number, 0, *full)

    def stream(self, message: int, rate_hz: float) -> None:
        """Ask for a message on this connection."""
        self.command(511, message, 1e6 / rate_hz)

    def read_parameter(self, name: str, wait_s: float = 3.0) -> float | int | None:
        """The value that the vehicle holds; None: it has no such parameter.

        Raises
        ------
        FirmwareError
            If nothing at all is heard on this connection.
        """
        found: list[Any] = []
        before = self._count
        self._heard.append(lambda m: found.append(m) if m.get_type() == "PARAM_VALUE" and m.param_id == name else None)
        try:
            until = time.monotonic() + wait_s
            while not found and (time.monotonic() < until or self._count == before):
                if time.monotonic() > until + SILENT_S:
                    raise FirmwareError(f"nothing was heard on {self._address} for {wait_s + SILENT_S:g} s")
                with self._lock:
                    self._link.mav.param_request_read_send(self._system, COMPONENT, name.encode(), -1)
                self._pause(lambda: bool(found), 0.5)
        finally:
            self._heard.pop()
        return found[-1] if found else None

    def send(self, send: Callable[[Any], None]) -> None:
        """Let `send` send something by this connection's MAVLink object."""
        with self._lock:
            send(self._link.mav)

    def wait(self, condition: Callable[[], bool], seconds: float, failure: str) -> None:
        """Wait for a condition. Raises FirmwareError with that text."""
        if not self._pause(condition, seconds):
            raise FirmwareError(failure)

    def _listens(self) -> bool:
        host, port = self._address.split(":")[1:]
        try:
            socket.create_connection((host, int(port)), 1.0).close()
        except OSError:
            return False
        return True

    @staticmethod
    def _pause(condition: Callable[[], bool], seconds: float) -> bool:
        until = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > until:
                return False
            time.sleep(POLL_S)
        return True

    def _read(self) -> None:
        while not self._ending.is_set():
            try:
                message = self._link.recv_match(blocking=True, timeout=0.2)
            except OSError:
                return
            if message is not None:
                self._count += 1
                self._heard_at = time.monotonic()
                self._latest[message.get_type()] = message
                for heard in tuple(self._heard):
                    heard(message)
