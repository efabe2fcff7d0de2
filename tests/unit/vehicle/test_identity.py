from __future__ import annotations

from pathlib import Path

import pytest

from mavcal.calib.wire.codec import decode
from mavcal.calib.wire.parameters import ParameterEncoding
from mavcal.calib.wire.tlog import iter_tlog
from mavcal.service.vehicle.identity import Autopilot, VehicleIdentity, identity_from_heartbeat, identity_from_version
from tests.unit.vehicle.fake import AP_CAPABILITIES, PX4_CAPABILITIES, heartbeat, version


@pytest.mark.parametrize(("number", "autopilot"), [(3, Autopilot.ARDUPILOT), (12, Autopilot.PX4), (0, Autopilot.OTHER)])
def test_the_heartbeat_tells_the_family(number: int, autopilot: Autopilot) -> None:
    assert identity_from_heartbeat(heartbeat(number)).autopilot is autopilot
    assert not identity_from_heartbeat(heartbeat(number)).known


def test_the_version_tells_the_rest() -> None:
    identity = identity_from_version(identity_from_heartbeat(heartbeat()), version(uid2=b"\x0a\x00\xff"))
    assert identity.version == (4, 7, 0)
    assert identity.version_text == "4.7.0-dev (abcdef12)"
    assert identity.uid2 == "0a00ff"
    assert identity.known


def test_a_unique_id_of_zeros_is_none() -> None:
    assert identity_from_version(identity_from_heartbeat(heartbeat()), version(uid2=b"")).uid2 is None


@pytest.mark.parametrize(
    ("autopilot", "capabilities", "encoding"),
    [
        (Autopilot.PX4, PX4_CAPABILITIES, ParameterEncoding.BYTEWISE),
        (Autopilot.ARDUPILOT, AP_CAPABILITIES, ParameterEncoding.CAST),
        (Autopilot.ARDUPILOT, 2 | 16, ParameterEncoding.BYTEWISE),  # a newer ArduPilot that opted in
        (Autopilot.PX4, 131072, ParameterEncoding.CAST),
        (Autopilot.PX4, 16 | 131072, ParameterEncoding.BYTEWISE),
        (Autopilot.PX4, 2, ParameterEncoding.BYTEWISE),  # neither encoding is named: the autopilot's own
        (Autopilot.PX4, 0, ParameterEncoding.BYTEWISE),
        (Autopilot.ARDUPILOT, 0, ParameterEncoding.CAST),
        (Autopilot.OTHER, 0, ParameterEncoding.CAST),
        (Autopilot.PX4, None, ParameterEncoding.BYTEWISE),
        (Autopilot.OTHER, None, ParameterEncoding.CAST),
    ],
)
def test_the_encoding_follows_the_capabilities_first(
    autopilot: Autopilot, capabilities: int | None, encoding: ParameterEncoding
) -> None:
    assert VehicleIdentity(autopilot, 2, capabilities=capabilities).encoding is encoding


@pytest.mark.parametrize(
    ("autopilot", "uid2", "uid", "found"),
    [
        (3, b"\x09", 0, "09"),
        (3, b"\xff" * 18, 0, None),
        (3, b"", 0, None),
        (12, b"\x12\x34" * 9, 7, "1234" * 9),
        (12, b"", 5283920058631409231, None),  # PX4's simulator
        (12, b"\x09", 5283920058631409240, None),  # the same as system 10
        (12, b"", 0x30303044_30303030, None),  # every Raspberry Pi
        (12, b"", 0x1234, "0000000000001234"),
    ],
)
def test_what_every_vehicle_of_a_kind_says_is_no_unique_id(
    autopilot: int, uid2: bytes, uid: int, found: str | None
) -> None:
    message = version(uid2=uid2)
    message.uid = uid
    assert identity_from_version(identity_from_heartbeat(heartbeat(autopilot)), message).uid2 == found


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "autopilot", "text", "uid2"),
    [
        ("sitl_captures", 3, "4.7.0-dev (90700977)", "656431323139633763346335343034616100"[:34]),
        ("px4_captures", 12, "1.17.0-alpha (a91678c841000000)", None),
    ],
)
def test_real_firmwares_are_recognised(
    shared_data: Path, name: str, autopilot: int, text: str, uid2: str | None
) -> None:
    log = (shared_data / name / "params.tlog").read_bytes()
    message = next(decode(frame) for _, frame in iter_tlog(log) if frame.message_id == 148)
    identity = identity_from_version(identity_from_heartbeat(heartbeat(autopilot)), message)
    assert identity.version_text == text
    assert identity.uid2 == uid2
    assert identity.encoding is (ParameterEncoding.CAST if autopilot == 3 else ParameterEncoding.BYTEWISE)


@pytest.mark.parametrize(
    ("kind", "words"), [(0, "-dev"), (64, "-alpha"), (128, "-beta"), (192, "-rc"), (255, ""), (7, "-7")]
)
def test_the_kind_of_release_is_part_of_the_version(kind: int, words: str) -> None:
    message = version()
    message.flight_sw_version = 4 << 24 | 6 << 16 | 3 << 8 | kind
    identity = identity_from_version(identity_from_heartbeat(heartbeat()), message)
    assert identity.version == (4, 6, 3)
    assert identity.version_text.split(" ")[0] == f"4.6.3{words}"
