"""Start a simulated vehicle in a process of its own and command it: for tests, demonstrations and `sim:` links."""

from __future__ import annotations

import json
import os
import secrets
import select
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from mavcal.service.simvehicle.errors import ControlError, StartError

_BELOW_EPHEMERAL = range(20_000, 32_768)
"""Linux hands out ports from 32768 on (``ip_local_port_range``), other systems from 49152 on (RFC 6335)."""

START_TIMEOUT_S = 20.0
CALL_TIMEOUT_S = 10.0
STOP_TIMEOUT_S = 5.0


class ControlChannel:
    """The control channel of a running simulated vehicle: one request, one reply.

    Raises ControlError if the vehicle cannot be reached.
    """

    def __init__(self, address: str) -> None:
        host, _, port = address.rpartition(":")
        try:
            self._socket: socket.socket | None = socket.create_connection((host, int(port)), timeout=CALL_TIMEOUT_S)
        except OSError as error:
            raise ControlError(f"the simulated vehicle at {address} cannot be reached: {error}") from error
        self._buffer = b""
        self._next_id = 0
        self._lock = threading.Lock()

    def call(self, do: str, **options: Any) -> dict[str, Any]:
        """One request; its reply without `id` and `ok`.

        Raises ControlError if the vehicle refuses it, or has gone.
        """
        with self._lock:
            if self._socket is None:
                raise ControlError("the simulated vehicle has been stopped")
            self._next_id += 1
            request = {"id": self._next_id, "do": do, **options}
            try:
                self._socket.sendall(json.dumps(request).encode() + b"\n")
                reply = json.loads(self._read_line(self._socket))
            except (OSError, ValueError) as error:
                raise ControlError(f"the simulated vehicle does not answer {do!r}: {error}") from error
        if not reply.pop("ok"):
            raise ControlError(reply["error"])
        reply.pop("id")
        return dict(reply)

    def close(self) -> None:
        """Close the channel; harmless if repeated."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _read_line(self, connected: socket.socket) -> bytes:
        while b"\n" not in self._buffer:
            data = connected.recv(1 << 16)
            if not data:
                raise OSError("connection closed")
            self._buffer += data
        line, _, self._buffer = self._buffer.partition(b"\n")
        return line


class SimulatedVehicle:
    """A simulated flight controller in its own process; a context manager that ends it.

    Args:
        autopilot: "ardupilot" or "px4".
        link: "udpout" (the vehicle sends to a free port, `url` is udpin:…), "udpin", "tcp", "serial" (a pseudo-
            terminal), or a full "kind:HOST:PORT" with an address of the caller's; a list makes several links.
        seed: draws the truth of the sensors.
        speed: vehicle seconds per wall second.
        system_id: MAVLink system id.
        config: entries of `config.VehicleConfig`.
        params: file of `name,value,type` lines that replaces the parameter table.
        script: motion without an operator.
        sitl: PX4 as the simulator build.

    Attributes:
        url: what a ground station connects to; `urls` has that of every link.
        seed: the seed in use.
        process: the running process.

    Raises StartError if the process does not come up.

    >>> with SimulatedVehicle("px4", seed=3) as vehicle:
    ...     url, truth = vehicle.url, vehicle.truth()
    >>> url.startswith("udpin:127.0.0.1:"), len(truth["gyros"][0]["offset"])
    (True, 3)
    """

    def __init__(
        self,
        autopilot: str = "ardupilot",
        *,
        link: str | list[str] = "udpout",
        seed: int = 1,
        speed: float = 1.0,
        system_id: int = 1,
        config: Mapping[str, Any] | None = None,
        params: str | Path | None = None,
        script: str | None = None,
        sitl: bool = False,
    ) -> None:
        command = [sys.executable, "-m", "mavcal.service.simvehicle", "--follow-stdin", "--autopilot", autopilot]
        for one in [link] if isinstance(link, str) else link:
            command += _link_arguments(one)
        command += ["--seed", str(seed), "--speed", str(speed), "--system-id", str(system_id)]
        for option, value in (("--config", json.dumps(dict(config)) if config else None), ("--script", script)):
            command += [option, value] if value else []
        command += ["--params", str(params)] if params else []
        command += ["--sitl"] if sitl else []
        # A file, not a pipe: nobody reads it while the vehicle runs, and a full pipe would stop it.
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115 - closed by stop()
        self.process = subprocess.Popen(  # noqa: S603 - our own module
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._stderr,
            cwd=Path(__file__).parents[3],
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )
        self._control: ControlChannel | None = None
        try:
            ready = self._await_ready()
            self._control = ControlChannel(ready["control"])
        except BaseException:
            self.stop()
            raise
        self.url: str = ready["url"]
        self.urls: list[str] = ready["urls"]
        self.seed: int = ready["seed"]

    def _await_ready(self) -> dict[str, Any]:
        assert self.process.stdout is not None
        readable, _, _ = select.select([self.process.stdout], [], [], START_TIMEOUT_S)
        line = self.process.stdout.readline() if readable else b""
        if not line:
            self.process.kill()
            self.process.wait()
            self._stderr.seek(0)
            complaint = self._stderr.read().decode(errors="replace").strip()
            raise StartError(f"the simulated vehicle did not come up: {complaint or 'it said nothing'}")
        ready: dict[str, Any] = json.loads(line)
        return ready

    def call(self, do: str, **options: Any) -> dict[str, Any]:
        """One request on the control channel; its reply without `id` and `ok`.

        Raises ControlError if the vehicle refuses it, or has gone.
        """
        if self._control is None:
            raise ControlError("the simulated vehicle has been stopped")
        return self._control.call(do, **options)

    async def acall(self, do: str, **options: Any) -> dict[str, Any]:
        """`call` without blocking an event loop."""
        import asyncio  # here: the vehicle's own process, which passes this module, does without

        return await asyncio.to_thread(self.call, do, **options)

    def truth(self, since: float | None = None, until: float | None = None) -> dict[str, Any]:
        """The whole truth of the sensors at this moment, or in the mean of a span of vehicle seconds of this boot.

        As `verbs.truth_report` gives it.
        """
        span = {name: t for name, t in (("since", since), ("until", until)) if t is not None}
        return dict(self.call("truth", **span)["truth"])

    def parameters(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Values that the corrections use, and those that a read would give: in force, stored."""
        reply = self.call("parameters")
        return reply["in_force"], reply["stored"]

    def state(self) -> dict[str, Any]:
        """Vehicle time, attitude, temperatures, arming, PARAM_SETs seen, faults."""
        return self.call("state")

    def wait(self, vehicle_seconds: float, timeout: float = 60.0) -> None:
        """Block until so much vehicle time has passed. Raises ControlError after `timeout` wall seconds."""
        end = self.state()["time"] + vehicle_seconds
        deadline = time.monotonic() + timeout
        while (now := self.state())["time"] < end:
            if time.monotonic() > deadline:
                raise ControlError(f"vehicle time stands at {now['time']:.2f} s after {timeout} s of waiting")
            time.sleep(min(max((end - now["time"]) / now["speed"], 0.002), 0.1))

    def stop(self) -> None:
        """End the process and release its pipes; harmless if repeated."""
        if self._control is not None:
            self._control.close()
            self._control = None
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout, self._stderr):
            if pipe is not None:
                pipe.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()


def _link_arguments(link: str) -> list[str]:
    kind, _, address = link.partition(":")
    if link == "serial":
        return ["--serial"]
    if kind not in ("udpout", "udpin", "tcp"):
        raise StartError(f"link {link!r} must be serial, or begin with udpout, udpin or tcp")
    if not address:
        # A listening vehicle takes any free port itself; a sending one needs one that is free now.
        address = f"127.0.0.1:{free_udp_port() if kind == 'udpout' else 0}"
    return [f"--{kind}", address]


def free_udp_port() -> int:
    """A free UDP port on loopback, below the ephemeral ports, so that no other process gets it by chance."""
    while True:
        port = secrets.choice(_BELOW_EPHEMERAL)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port
