"""Whatever a ground station sends, the simulated vehicle lives on."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle.wire import Packer, Splitter, split_datagram

ODD = [0.0, 1.0, -1.0, 76.0, 2.0, 65536.0, 1e9, -1e9, 1e38, math.inf, -math.inf, math.nan, 0.5]
COMMANDS = [241, 245, 246, 400, 401, 510, 511, 512, 520, 42424, 42425, 42426, 42006, 0, 65535]


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_odd_commands_end_nothing(bench: Any, autopilot: str) -> None:
    b = bench(autopilot, boot_s=0.1)
    rng = random.Random(5)
    for _ in range(400):
        b.command(rng.choice(COMMANDS), *(rng.choice([*ODD, *map(float, COMMANDS), 26.0, 105.0]) for _ in range(7)))
        b.run(0.01)
    b.vehicle.reboot()
    b.run(5.0)
    assert b.take("HEARTBEAT")


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_odd_parameter_messages_end_nothing(bench: Any, autopilot: str) -> None:
    b = bench(autopilot)
    rng = random.Random(6)
    names = [p.name for p in b.vehicle.table]
    for _ in range(600):
        name = rng.choice([*names, "", "NO", "X" * 16]).encode()
        b.send(dialect.MAVLink_param_set_message(1, 1, name, rng.choice(ODD), rng.choice([2, 4, 5, 6, 9, 0, 255])))
        b.read(name.decode(), rng.choice([-1, 0, 7, 32767, -32768]))
        b.run(0.003)
    for message_id in (26, 27, 105, 30, 129):
        b.command(511, message_id, 20000)
    b.run(2.0)
    assert b.vehicle.alive


def test_random_bytes_and_cut_frames_give_no_message_and_hide_none() -> None:
    rng = random.Random(7)
    packer = Packer(250)
    good = packer.pack(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    for _ in range(300):
        noise = rng.randbytes(rng.randrange(1, 60))
        assert [r.name for r in split_datagram(noise + good)] == ["HEARTBEAT"]
        assert split_datagram(noise) == []
        assert split_datagram(good[: rng.randrange(len(good))]) == []


def test_a_stream_cut_anywhere_gives_every_message_once() -> None:
    rng = random.Random(8)
    packer = Packer(250)
    sent = [packer.pack(dialect.MAVLink_param_request_read_message(1, 1, b"INS_USE", i)) for i in range(50)]
    data, splitter, got = b"".join(sent), Splitter(), []
    while data:
        cut = rng.randrange(1, 40)
        got += [r.message.param_index for r in splitter.feed(data[:cut])]
        data = data[cut:]
    assert got == list(range(50))


def test_one_flipped_bit_is_never_believed() -> None:
    frame = Packer(250).pack(dialect.MAVLink_param_set_message(1, 1, b"INS_ACCOFFS_X", 0.5, 9))
    for bit in range(len(frame) * 8):
        damaged = bytearray(frame)
        damaged[bit // 8] ^= 1 << bit % 8
        for received in split_datagram(bytes(damaged)):
            # The sequence number and the sender are inside the checksum too: nothing may pass.
            raise AssertionError((bit, received))


def test_messages_for_others_are_ignored(bench: Any) -> None:
    b = bench("ardupilot")
    b.send(dialect.MAVLink_param_set_message(2, 1, b"INS_ACCOFFS_X", 0.5, 9))
    b.send(dialect.MAVLink_param_set_message(1, 100, b"INS_ACCOFFS_X", 0.5, 9))
    b.run(0.1)
    assert b.vehicle.table["INS_ACCOFFS_X"].value == 0.0
    b.send(dialect.MAVLink_param_set_message(0, 0, b"INS_ACCOFFS_X", 0.5, 9))
    b.run(0.1)
    assert b.vehicle.table["INS_ACCOFFS_X"].value == 0.5


def test_integers_beyond_a_double_survive_packing() -> None:
    body = b"\xff\xff\xff\xff" + bytes(21)
    received = split_datagram(Packer(1).pack_payload(dialect.MAVLink_param_value_message, body))
    assert received[0].payload[:4] == b"\xff\xff\xff\xff"
