"""``python -m bench.hostile [COUNT]``: hostile datagrams flood a link that a vehicle is on; exit 1 if it suffers.

The flood is made of random bytes, and of frames that are cut, have a wrong checksum or come from made-up systems. Some
are PARAM_VALUE in the vehicle's name from another address (false echoes), some have the service's own ids.
"""

from __future__ import annotations

import random
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bench.running import service
from mavcal.calib import wire

COUNT = 1_000_000
KINDS = 4000
RATE = 15_000
MOST_MIB = 150.0
MOST_ANSWER_S = 2.0


def heartbeat() -> dialect.MAVLink_heartbeat_message:
    return dialect.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3)


def hostile(rng: random.Random) -> bytes:
    """One datagram."""
    false_echo = dialect.MAVLink_param_value_message(
        b"INS_GYROFFS_X", rng.gauss(0.0, 9.0), 9, 1000, rng.randrange(1000)
    )
    whole = wire.encode(false_echo, 1, 1, rng.randrange(256))
    kind = rng.randrange(6)
    if kind == 0:
        return rng.randbytes(rng.randrange(1, 300))
    if kind == 1:
        return whole[: rng.randrange(1, len(whole))]
    if kind == 2:
        return whole[:-1] + bytes([whole[-1] ^ 0x5A])
    if kind == 3:
        return wire.encode(heartbeat(), rng.randrange(2, 253), rng.randrange(1, 256), rng.randrange(256))
    if kind == 4:
        return wire.encode(heartbeat(), 253, 190, rng.randrange(256))
    return whole


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def main(arguments: Sequence[str]) -> int:
    count = int(arguments[0]) if arguments else COUNT
    rng = random.Random(20_261_123)
    pool = [hostile(rng) for _ in range(KINDS)]
    port = free_port()
    to = ("127.0.0.1", port)
    over = threading.Event()

    def vehicle() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as us:
            sequence = 0
            while not over.wait(0.25):
                us.sendto(wire.encode(heartbeat(), 1, 1, sequence % 256), to)
                sequence += 1

    with (
        tempfile.TemporaryDirectory() as folder,
        service(f"udpin:127.0.0.1:{port}", Path(folder)) as running,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as attacker,
    ):
        threading.Thread(target=vehicle, daemon=True).start()
        while not any(v.system == 1 for v in running.client.list_vehicles()):
            time.sleep(0.1)
        before, used = running.resident_bytes(), running.processor_s()
        slowest, sent, began = 0.0, 0, time.monotonic()
        while sent < count:
            for _ in range(RATE // 10):
                attacker.sendto(pool[rng.randrange(KINDS)], to)
            sent += RATE // 10
            if sent % RATE == 0:
                asked = time.monotonic()
                running.client.list_links()
                slowest = max(slowest, time.monotonic() - asked)
            time.sleep(max(0.0, began + sent / RATE - time.monotonic()))
        took = time.monotonic() - began
        grown = (running.resident_bytes() - before) / 2**20
        time.sleep(1.0)
        vehicles = running.client.list_vehicles()
        (true,) = [v for v in vehicles if v.system == 1]
        (link,) = running.client.list_links()
        print(f"{sent} datagrams in {took:.0f} s; damaged frames seen: {link.crc_errors}; vehicles: {len(vehicles)}")
        spent = running.processor_s() - used
        print(f"memory grew by {grown:.0f} MiB; slowest answer {slowest:.2f} s; {spent:.0f} s of a processor")
        print(f"the true vehicle: silent {true.silent}, writable {true.writable}, {'; '.join(true.obstacles)}")
        over.set()
    good = not true.silent and not true.writable and grown < MOST_MIB and slowest < MOST_ANSWER_S
    return 0 if good else 1


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
