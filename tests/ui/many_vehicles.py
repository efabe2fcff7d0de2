"""Many vehicles on one UDP port, for which one process sends: ``python -m tests.ui.many_vehicles PORT COUNT``."""

from __future__ import annotations

import socket
import sys
import time
from contextlib import suppress

from bench.endurance import beat
from mavcal.calib.wire.codec import encode

SLICES = 10
"""In a second; each speaks for its share of the vehicles."""


def send(port: int, count: int) -> None:
    """Say once a second what each vehicle says, until the process is ended."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.connect(("127.0.0.1", port))
        out.settimeout(0.0)
        began, tick, sequence = time.monotonic(), 0, [0] * count
        while True:
            time.sleep(max(0.0, began + tick / SLICES - time.monotonic()))
            for k in range(tick % SLICES, count, SLICES):
                for message in beat(k):
                    with suppress(ConnectionRefusedError):
                        out.send(encode(message, k + 1, 1, sequence[k] & 0xFF))
                    sequence[k] += 1
            with suppress(BlockingIOError, ConnectionRefusedError):
                while out.recv(2048):
                    pass
            tick += 1


if __name__ == "__main__":
    send(int(sys.argv[1]), int(sys.argv[2]))
