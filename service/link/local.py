"""Local transports: a serial device, a replayed recording, a simulated vehicle."""

from __future__ import annotations

import contextlib
import errno
import json
import math
import os
import selectors
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import serial

from mavcal.calib.wire.frames import Frame
from mavcal.calib.wire.tlog import iter_tlog
from mavcal.service.errors import EndpointError, LinkDown, LinkError, PortBusy
from mavcal.service.link.endpoint import Endpoint
from mavcal.service.link.transports import Chunk, Disconnected, Transport
from mavcal.service.link.types import Address
from mavcal.service.link.udp import UdpTransport

_REPLAY_CHUNK = 200
_SPAWN_S = 20.0
_STOP_S = 3.0


class SerialTransport(Transport):
    """A serial device, read without waiting like any other descriptor."""

    lossless = False

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._port: serial.Serial | None = None

    def open(self, selector: selectors.BaseSelector) -> None:
        """Open the device for ourselves alone."""
        endpoint = self._endpoint
        try:
            port = serial.Serial(endpoint.path, endpoint.baud, timeout=0, write_timeout=0, exclusive=True)
        except (OSError, ValueError) as exc:  # SerialException is an OSError
            raise _serial_error(exc, endpoint) from exc
        self._port = port
        selector.register(port, selectors.EVENT_READ)

    def receive(self) -> list[Chunk]:
        """Read the available bytes."""
        if self._port is None:
            return []
        try:
            data = self._port.read(4096)
        except OSError as exc:
            raise Disconnected(f"the device has gone: {exc}") from exc
        return [Chunk(bytes(data), (self._endpoint.path, 0))] if data else []

    def send(self, data: bytes, peer: Address | None) -> None:
        """Write; bytes that do not fit into the driver's buffer are lost."""
        if self._port is None:
            return
        with contextlib.suppress(serial.SerialTimeoutException):
            try:
                self._port.write(data)
            except OSError as exc:
                if isinstance(exc, serial.SerialTimeoutException):
                    raise
                raise Disconnected(f"the device has gone: {exc}") from exc

    def default_peer(self) -> Address | None:
        """The device."""
        return (self._endpoint.path, 0)

    def close(self) -> None:
        """Close the device."""
        if self._port is not None:
            self._port.close()
            self._port = None


def _serial_error(exc: Exception, endpoint: Endpoint) -> LinkError:
    number = getattr(exc, "errno", None)
    if number in (errno.EBUSY, errno.EAGAIN) or "exclusively lock" in str(exc):
        return PortBusy(f"{endpoint}: another program uses {endpoint.path}. Close it there first.")
    if number == errno.EACCES:
        return EndpointError(f"{endpoint}: no right to open {endpoint.path}. Add this user to the group 'dialout'.")
    if isinstance(exc, ValueError):
        return EndpointError(f"{endpoint}: {exc}")
    return LinkDown(f"{endpoint}: {endpoint.path} is not there. Is the vehicle plugged in and powered?")


class FileTransport(Transport):
    """Replays a .tlog at ``speed`` times its own pace, or as fast as it is read (``speed=0``)."""

    ends = True
    answers = False

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._speed = endpoint.number("speed", 1.0)
        self._records: Iterator[tuple[int, Frame]] | None = None
        self._next: tuple[int, Frame] | None = None
        self._began: tuple[float, int] = (0.0, 0)
        self._done = False

    def open(self, selector: selectors.BaseSelector) -> None:
        """Read the file."""
        if not 0 <= self._speed < math.inf:
            raise EndpointError(f"{self._endpoint}: the speed is a number from 0 on; 0 is as fast as possible.")
        try:
            data = _regular(Path(self._endpoint.path).expanduser())
        except OSError as exc:
            raise EndpointError(f"{self._endpoint}: the file cannot be read: {exc.strerror}.") from exc
        self._records = iter_tlog(data)
        self._next = next(self._records, None)
        if self._next is None:
            raise EndpointError(f"{self._endpoint}: there is no MAVLink frame in this file; is it a .tlog?")
        self._began = (time.monotonic(), self._next[0])

    def _due(self) -> float:
        """Monotonic time at which the next record is due."""
        if self._next is None or self._speed == 0:
            return 0.0
        return self._began[0] + (self._next[0] - self._began[1]) / 1e6 / self._speed

    def wait(self) -> float | None:
        """Time until the next record is due, s."""
        return 1.0 if self._done else max(0.0, min(1.0, self._due() - time.monotonic()))

    def receive(self) -> list[Chunk]:
        """The records that are due."""
        if self._records is None:
            return []
        now = time.monotonic()
        raws: list[bytes] = []
        while self._next is not None and len(raws) < _REPLAY_CHUNK and self._due() <= now:
            raws.append(self._next[1].raw)
            self._next = next(self._records, None)
        if not raws and self._next is None:
            self._done = True
            raise Disconnected("the recording has ended")
        return [Chunk(b"".join(raws), (self._endpoint.path, 0))] if raws else []

    def send(self, data: bytes, peer: Address | None) -> None:
        """Discard the bytes: a recording takes no input."""

    def close(self) -> None:
        """Forget the records."""
        self._records = None


def _regular(path: Path) -> bytes:
    """The content of a regular file; a device or a pipe might have no end. Raises OSError."""
    with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as opened:
        if not stat.S_ISREG(os.fstat(opened.fileno()).st_mode):
            raise OSError(errno.EINVAL, "it is no regular file")
        return opened.read()


class SimTransport(UdpTransport):
    """A simulated vehicle in a child process, which lives and ends with the link."""

    ends = True

    def __init__(self, endpoint: Endpoint) -> None:
        super().__init__(endpoint, ("127.0.0.1", 0), None)
        self._child: subprocess.Popen[bytes] | None = None
        self.control: str | None = None
        """Host and port of the simulator's control channel."""

    def open(self, selector: selectors.BaseSelector) -> None:
        """Bind a port of our own, then start the simulator that speaks to it."""
        super().open(selector)
        with tempfile.TemporaryFile() as complaints:
            try:
                self._child = subprocess.Popen(  # noqa: S603 - our own module, arguments from a validated endpoint
                    self._command(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=complaints
                )
                self.control = _ready_line(self._child)["control"]
            except (OSError, ValueError, KeyError) as exc:
                self.close()
                complaints.seek(0)
                complaint = complaints.read(1000).decode("utf-8", "replace").strip() or str(exc)
                raise EndpointError(f"{self._endpoint}: the simulated vehicle did not start: {complaint}") from exc

    def receive(self) -> list[Chunk]:
        """Take datagrams, as long as the child lives."""
        chunks = super().receive()
        if not chunks and self._child is not None and self._child.poll() is not None:
            raise Disconnected(f"the simulated vehicle has ended with code {self._child.returncode}")
        return chunks

    def _command(self) -> list[str]:
        command = [sys.executable, "-m", "mavcal.service.simvehicle", "--autopilot", self._endpoint.autopilot]
        command += ["--udpout", f"127.0.0.1:{self.local_port}", "--control", "0", "--follow-stdin"]
        for name, value in self._endpoint.place.options:
            if name == "hand":  # who moves it is a matter of the service
                continue
            command += [f"--{name.replace('_', '-')}", value]
        return command

    def close(self) -> None:
        """Stop the simulator."""
        super().close()
        child, self._child = self._child, None
        if child is None:
            return
        assert child.stdin is not None
        assert child.stdout is not None
        with contextlib.suppress(OSError):
            child.stdin.close()
        child.terminate()
        try:
            child.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
        child.stdout.close()


def _ready_line(child: subprocess.Popen[bytes]) -> dict[str, str]:
    """Wait for the one line of JSON that says the simulator is ready."""
    assert child.stdout is not None
    with selectors.DefaultSelector() as selector:
        selector.register(child.stdout, selectors.EVENT_READ)
        if not selector.select(_SPAWN_S):
            raise ValueError(f"nothing was heard from it within {_SPAWN_S:g} s")
    line = child.stdout.readline()
    if not line:
        raise ValueError(f"it ended with code {child.wait(_STOP_S)}")
    ready = json.loads(line)
    if not isinstance(ready, dict) or not ready.get("ready"):
        raise ValueError(f"it said {line[:200]!r}")
    return ready
