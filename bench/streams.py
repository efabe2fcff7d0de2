"""``python -m bench.streams [COUNT]``: what COUNT idle event streams of one service with one vehicle cost.

Prints the processor time that the service uses in a second without streams and with them; exit 1 if the streams take
more than a tenth of a processor.
"""

from __future__ import annotations

import os
import resource
import socket
import sys
import tempfile
import threading
import time
from pathlib import Path
from urllib.parse import urlsplit

from bench.running import RunningService, service
from mavcal.service.simvehicle import SimulatedVehicle

COUNT = 1000
SECONDS = 10.0
MOST_SHARE = 0.1


def opened(running: RunningService) -> socket.socket:
    """A client that has asked for everything that happens, and has its first line."""
    at = urlsplit(running.url)
    client = socket.create_connection((at.hostname or "", at.port or 0), timeout=60.0)
    client.sendall(f"GET /api/v1/events HTTP/1.1\r\nHost: {at.netloc}\r\n\r\n".encode())
    line = client.recv(4096).split(b"\r\n")[0]
    if b" 200 " not in line:
        raise RuntimeError(line.decode())
    return client


def share(running: RunningService) -> float:
    """Part of a processor that the service uses."""
    used, began = running.processor_s(), time.monotonic()
    time.sleep(SECONDS)
    return (running.processor_s() - used) / (time.monotonic() - began)


def drain(clients: list[socket.socket], over: threading.Event) -> None:
    for client in clients:
        client.settimeout(0.0)
    while not over.wait(0.5):
        for client in clients:
            try:
                client.recv(1 << 16)
            except BlockingIOError:
                continue


def main() -> int:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else COUNT
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, 3 * count + 500), hard))
    over = threading.Event()
    with (
        tempfile.TemporaryDirectory() as folder,
        SimulatedVehicle("ardupilot", config={"thermal": False}) as sim,
    ):
        os.environ["MAVCAL_LIMITS__STREAMS"] = str(count)  # the service inherits it
        with service(sim.url, Path(folder) / "data") as running:
            running.found()
            alone = share(running)
            clients = [opened(running) for _ in range(count)]
            reading = threading.Thread(target=drain, args=(clients, over))
            reading.start()
            time.sleep(2.0)
            together = share(running)
            grown = running.resident_bytes() / 2**20
            over.set()
            reading.join()
            for client in clients:
                client.close()
    print(f"processor: {alone:.3f} without streams, {together:.3f} with {count} idle ones; memory {grown:.0f} MiB")
    return 0 if together - alone <= MOST_SHARE else 1


if __name__ == "__main__":
    raise SystemExit(main())
