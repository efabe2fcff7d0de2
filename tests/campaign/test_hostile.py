"""What floods a link harms neither the service nor its vehicle.

The flood is made of random bytes, and of frames that are cut, have a wrong checksum or come from made-up systems. Some
are PARAM_VALUE in the vehicle's name from another address (false echoes), some have the service's own ids.
"""

from __future__ import annotations

import random
import socket
import threading
import time
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from bench.running import service
from mavcal.calib.wire.codec import encode
from mavcal.service.simvehicle import free_udp_port

COUNT = 30_000
KINDS = 4000
RATE = 15_000
MOST_BYTES = 150 << 20
MOST_ANSWER_S = 2.0


def heartbeat() -> dialect.MAVLink_heartbeat_message:
    return dialect.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3)


def hostile(rng: random.Random) -> bytes:
    """One datagram."""
    false_echo = dialect.MAVLink_param_value_message(
        b"INS_GYROFFS_X", rng.gauss(0.0, 9.0), 9, 1000, rng.randrange(1000)
    )
    whole = encode(false_echo, 1, 1, rng.randrange(256))
    kind = rng.randrange(6)
    if kind == 0:
        return rng.randbytes(rng.randrange(1, 300))
    if kind == 1:
        return whole[: rng.randrange(1, len(whole))]
    if kind == 2:
        return whole[:-1] + bytes([whole[-1] ^ 0x5A])
    if kind == 3:
        return encode(heartbeat(), rng.randrange(2, 253), rng.randrange(1, 256), rng.randrange(256))
    if kind == 4:
        return encode(heartbeat(), 253, 190, rng.randrange(256))
    return whole


def speak(to: tuple[str, int], over: threading.Event) -> None:
    """A vehicle's heartbeats."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as us:
        sequence = 0
        while not over.wait(0.25):
            us.sendto(encode(heartbeat(), 1, 1, sequence % 256), to)
            sequence += 1


@pytest.mark.long
@pytest.mark.timeout(120)
def test_hostile_datagrams_neither_silence_the_vehicle_nor_make_it_writable(tmp_path: Path) -> None:
    rng = random.Random(20_261_123)
    pool = [hostile(rng) for _ in range(KINDS)]
    to, over = ("127.0.0.1", free_udp_port()), threading.Event()
    with (
        service(f"udpin:127.0.0.1:{to[1]}", tmp_path / "data") as running,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as attacker,
    ):
        threading.Thread(target=speak, args=(to, over), daemon=True).start()
        while not any(v.system == 1 for v in running.client.list_vehicles()):
            time.sleep(0.1)
        before, slowest, sent, began = running.resident_bytes(), 0.0, 0, time.monotonic()
        while sent < COUNT:
            for _ in range(RATE // 10):
                attacker.sendto(pool[rng.randrange(KINDS)], to)
            sent += RATE // 10
            if sent % RATE == 0:
                asked = time.monotonic()
                running.client.list_links()
                slowest = max(slowest, time.monotonic() - asked)
            time.sleep(max(0.0, began + sent / RATE - time.monotonic()))
        grown = running.resident_bytes() - before
        time.sleep(1.0)
        (true,) = [v for v in running.client.list_vehicles() if v.system == 1]
        over.set()
    assert not true.silent
    assert not true.writable
    assert grown < MOST_BYTES
    assert slowest < MOST_ANSWER_S
