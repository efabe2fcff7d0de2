"""The control channel: one JSON object a line over TCP on loopback, each answered by one."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Mapping
from typing import Any

from mavcal.service.simvehicle.errors import SimulatedVehicleError
from mavcal.service.simvehicle.links import bound_socket

MAX_LINE = 1 << 20
Handler = Callable[[str, Mapping[str, Any]], dict[str, Any]]


class ControlServer:
    """Accepts any number of clients; every request names what to `do` and is answered with its `id`."""

    def __init__(self, port: int, handler: Handler) -> None:
        self._listener = bound_socket(socket.SOCK_STREAM, ("127.0.0.1", port))
        self._listener.listen()
        host, self.port = self._listener.getsockname()
        self.address = f"{host}:{self.port}"
        self._handler = handler
        self._clients: dict[socket.socket, bytearray] = {}

    def sockets(self) -> list[socket.socket]:
        """What to wait on."""
        return [self._listener, *self._clients]

    def poll(self) -> None:
        """Answer everything that has arrived."""
        try:
            client, _ = self._listener.accept()
            client.setblocking(False)  # noqa: FBT003
            self._clients[client] = bytearray()
        except (BlockingIOError, OSError):
            client = None
        for client in list(self._clients):
            self._serve(client)

    def _serve(self, client: socket.socket) -> None:
        buffer = self._clients[client]
        try:
            data = client.recv(65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        buffer += data
        if not data or len(buffer) > MAX_LINE:
            self._forget(client)
            return
        while (end := buffer.find(b"\n")) >= 0:
            line = bytes(buffer[:end])
            del buffer[: end + 1]
            self._answer(client, line)

    def _answer(self, client: socket.socket, line: bytes) -> None:
        identifier: Any = None
        try:
            request = json.loads(line)
            if not isinstance(request, dict) or not isinstance(request.get("do"), str):
                raise ValueError('a request is an object such as {"id": 1, "do": "state"}')
            identifier = request.pop("id", None)
            reply = {"id": identifier, "ok": True, **self._handler(request.pop("do"), request)}
        except (SimulatedVehicleError, ValueError, TypeError, KeyError) as error:
            reply = {"id": identifier, "ok": False, "error": f"{type(error).__name__}: {error}"}
        try:
            client.setblocking(True)  # noqa: FBT003
            client.settimeout(1.0)
            client.sendall(json.dumps(reply).encode() + b"\n")
            client.setblocking(False)  # noqa: FBT003
        except OSError:
            self._forget(client)

    def _forget(self, client: socket.socket) -> None:
        client.close()
        self._clients.pop(client, None)

    def close(self) -> None:
        """Release the port and every client."""
        for client in list(self._clients):
            self._forget(client)
        self._listener.close()
