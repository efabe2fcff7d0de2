"""A sender of numbered frames in a process of its own: ``python -m bench.speed.sender SPEC``, SPEC as JSON.

Every RAW_IMU frame carries its number as its time stamp, so that a receiver knows exactly which ones arrived, whatever
the eight-bit sequence says. Frames are made beforehand; sending costs one system call a datagram.
"""

from __future__ import annotations

import json
import random
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from mavcal.calib.wire.codec import RawMessage, encode

RAW_IMU = 27
SYSTEM, COMPONENT = 9, 1
MARKER = struct.pack("<hhh", 0x5A17, -0x3C2B, 0x7B31)
"""Bytes that stand in every frame of this sender and in nothing else: they count the frames in a recording."""
_REST = MARKER + struct.pack("<hhhhhhBh", 4, 5, 6, 7, 8, 9, 1, 3500)
_NUMBER_AT = 10
_LAST_AFTER_S = 1.0
"""Pause before the last frame: it shows what was lost before it, and finds the receiver's buffer empty."""
_STEP_S = 0.0005
_TCP_PIECE = 1 << 16


@dataclass(frozen=True)
class Spec:
    """What to send: `kind` "udp" to `port`, or "tcp": wait for one connection on a free port.

    Frames are numbered 0 to `count` - 1; one more follows after a pause. `rate`: frames a second, 0 as many as go.
    `loss`: share of frames left out at random, their numbers and sequence numbers with them.
    """

    kind: str
    count: int
    rate: float
    port: int = 0
    loss: float = 0.0
    seed: int = 1

    def sent(self) -> list[int]:
        """The numbers that are sent, in order, the last one included."""
        draw = random.Random(self.seed)
        kept = (i for i in range(1, self.count) if not (self.loss and draw.random() < self.loss))
        return [0, *kept, self.count]


def frame(number: int) -> bytes:
    """The frame of that number."""
    return encode(RawMessage(RAW_IMU, struct.pack("<Q", number) + _REST), SYSTEM, COMPONENT, number & 0xFF)


def numbers_of(raws: Iterable[bytes]) -> bytes:
    """The numbers of many frames as eight bytes each: the cheapest way to keep them until the run is over."""
    return b"".join([raw[_NUMBER_AT : _NUMBER_AT + 8] for raw in raws])


class Sender:
    """The running process; after :meth:`finish` it has said how long it took."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process
        self.port = int(self._line()["port"])

    def go(self) -> None:
        """Begin to send."""
        assert self._process.stdin is not None
        self._process.stdin.write(b"go\n")
        self._process.stdin.flush()

    def finish(self) -> float:
        """Wait until everything was sent; seconds that it took without the last pause."""
        return float(self._line()["seconds"])

    def _line(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError("the sender has ended early")
        return dict(json.loads(line))


@contextmanager
def started(spec: Spec) -> Iterator[Sender]:
    """A sender with its frames made, which waits for :meth:`Sender.go`; it ends with the context."""
    process = subprocess.Popen(
        [sys.executable, "-m", "bench.speed.sender", json.dumps(asdict(spec))],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        cwd=Path(__file__).resolve().parents[2],
    )
    try:
        yield Sender(process)
    finally:
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                pipe.close()
        process.terminate()
        process.wait()


def _send_datagrams(spec: Spec, frames: list[bytes], numbers: list[int]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.connect(("127.0.0.1", spec.port))
        _say(port=spec.port)
        sys.stdin.readline()
        began = time.perf_counter()
        at, body = 0, len(frames) - 1
        while at < body:
            due = spec.count if not spec.rate else (time.perf_counter() - began) * spec.rate
            while at < body and numbers[at] <= due:
                out.send(frames[at])
                at += 1
            if spec.rate:
                time.sleep(_STEP_S)
        seconds = time.perf_counter() - began
        time.sleep(_LAST_AFTER_S)
        out.send(frames[-1])
    _say(seconds=seconds)


def _send_stream(frames: list[bytes]) -> None:
    data = b"".join(frames)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        _say(port=listener.getsockname()[1])
        connection, _ = listener.accept()
    with connection:
        sys.stdin.readline()
        began = time.perf_counter()
        for at in range(0, len(data), _TCP_PIECE):
            connection.sendall(data[at : at + _TCP_PIECE])
        _say(seconds=time.perf_counter() - began)
        sys.stdin.read()  # closing earlier, with their heartbeats unread, would reset the connection


def _say(**what: float) -> None:
    print(json.dumps(what), flush=True)


def main() -> None:
    """Make the frames, say the port, wait for a line, send, say how long it took."""
    spec = Spec(**json.loads(sys.argv[1]))
    numbers = spec.sent()
    frames = [frame(number) for number in numbers]
    if spec.kind == "tcp":
        _send_stream(frames)
        return
    _send_datagrams(spec, frames, numbers)
    sys.stdin.read()


if __name__ == "__main__":
    main()
