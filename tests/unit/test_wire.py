from __future__ import annotations

import struct
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.wire.codec import (
    Message,
    ParamValue,
    RawMessage,
    decode,
    decode_param_value,
    encode,
    param_bytes,
    param_set,
    raw_message,
)
from mavcal.calib.wire.frames import Frame, FrameParser
from mavcal.calib.wire.signing import SignatureState, Signing, check_signature
from mavcal.calib.wire.tlog import TlogReader, iter_tlog, tlog_record
from tests.examples import examples

KEY = bytes(range(32))
NOW = 500_000_000_000


def heartbeat(autopilot: int = 3) -> Message:
    return dialect.MAVLink_heartbeat_message(2, autopilot, 81, 0, 3, 3)


def imu(x: int = 1, y: int = -2) -> Message:
    return dialect.MAVLink_raw_imu_message(10**6, x, y, -1000, 4, 5, 6, 7, 8, 9, 0, 3500)


def encoded(message: Message, sequence: int = 0, system: int = 1, **kw: object) -> bytes:
    return encode(message, system, 1, sequence, **kw)  # type: ignore[arg-type]


def pymavlink_packed(message: Message, *, version1: bool = False) -> bytes:
    mav = dialect.MAVLink(None, 1, 1)
    mav.seq = 7
    return bytes(message.pack(mav, force_mavlink1=version1))


def test_encodes_the_bytes_that_pymavlink_encodes() -> None:
    for message in (heartbeat(), imu(), dialect.MAVLink_statustext_message(6, b"[cal] started", 0, 0)):
        assert encode(message, 1, 1, 7) == pymavlink_packed(message)


@pytest.mark.parametrize("version1", [False, True])
def test_decodes_what_pymavlink_encodes_in_either_version(version1: bool) -> None:
    (frame,) = FrameParser().feed(pymavlink_packed(imu(x=-321), version1=version1))
    assert (frame.version, frame.sequence, frame.system, frame.component) == (1 if version1 else 2, 7, 1, 1)
    message = decode(frame)
    assert (message.get_type(), message.xacc, message.zacc, message.temperature) == ("RAW_IMU", -321, -1000, 3500)


def test_decodes_arrays_and_strings() -> None:
    progress = dialect.MAVLink_mag_cal_progress_message(0, 1, 2, 3, 40, list(range(10)), 0.0, 0.0, 0.0)
    (frame,) = FrameParser().feed(encoded(progress))
    assert list(decode(frame).completion_mask) == list(range(10))
    (frame,) = FrameParser().feed(encoded(dialect.MAVLink_statustext_message(4, b"PreArm: x")))
    assert decode(frame).text == "PreArm: x"


def test_frames_come_out_whatever_the_pieces() -> None:
    stream = b"".join(encoded(imu(x=k), k) for k in range(20))
    for size in (1, 7, 64, 5000):
        parser = FrameParser()
        frames = [f for at in range(0, len(stream), size) for f in parser.feed(stream[at : at + size])]
        assert [f.sequence for f in frames] == list(range(20))
        assert parser.skipped_bytes == parser.crc_errors == parser.pending == 0


def test_keep_ids_leaves_out_other_messages_but_steps_over_them() -> None:
    stream = encoded(heartbeat()) + encoded(imu(), 1) + encoded(heartbeat(), 2)
    frames = FrameParser().feed(stream, frozenset({0}))
    assert [f.sequence for f in frames] == [0, 2]


def test_a_flipped_bit_costs_that_frame_only_and_is_counted() -> None:
    good, bad = encoded(imu(), 1), bytearray(encoded(imu(), 2))
    bad[14] ^= 0x10
    parser = FrameParser()
    frames = parser.feed(good + bytes(bad) + encoded(imu(), 3)) + parser.finish()
    assert [f.sequence for f in frames] == [1, 3]
    assert parser.crc_errors == 1
    assert parser.skipped_bytes == len(bad)


def test_a_torn_datagram_does_not_touch_the_next() -> None:
    parser = FrameParser()
    assert parser.feed_datagram(encoded(imu(), 1)[:-5]) == []
    assert [f.sequence for f in parser.feed_datagram(encoded(imu(), 2))] == [2]


def test_a_torn_frame_in_a_stream_gives_way_when_the_stream_rests() -> None:
    parser = FrameParser()
    torn = encoded(imu(), 1)[:12]
    assert parser.feed(torn + encoded(heartbeat(), 2)) == []
    assert parser.pending == 12 + 21
    assert [f.sequence for f in parser.finish()] == [2]
    assert parser.skipped_bytes == 12


def unknown_frame(payload: bytes = b"abc", system: int = 1) -> bytes:
    return bytes([0xFD, len(payload), 0, 0, 9, system, 1, 0x10, 0x27, 0]) + payload + b"\x00\x00"


def test_an_unknown_message_is_kept_only_in_step_with_the_stream() -> None:
    parser = FrameParser()
    frames = parser.feed(unknown_frame() + encoded(imu(), 1))
    assert [f.known for f in frames] == [False, True]
    assert parser.unknown == 1
    parser = FrameParser()
    assert [f.known for f in parser.feed(unknown_frame() + b"\x00" + encoded(imu(), 1))] == [True]
    with pytest.raises(InvalidInputError, match="10000"):
        decode(frames[0])


def test_an_unknown_message_cannot_swallow_an_intact_frame() -> None:
    inner = encoded(imu(), 5)
    frames = FrameParser().feed_datagram(unknown_frame(inner))
    assert [(f.known, f.sequence) for f in frames] == [(True, 5)]


def test_hostile_bytes_cost_linear_time() -> None:
    # 64 kB of headers that all claim long unknown messages: quadratic searching would take minutes
    parser = FrameParser()
    data = b"\xfd\xff\x00\x00\x01\x01\x01\x10\x27\x00" * 6000
    frames = parser.feed_datagram(data)
    assert sum(len(f.raw) for f in frames) + parser.skipped_bytes == len(data)


@given(data=st.binary(max_size=600), pieces=st.lists(st.integers(1, 90), max_size=8))
def test_arbitrary_bytes_never_raise_and_are_all_accounted_for(data: bytes, pieces: list[int]) -> None:
    parser, at, taken = FrameParser(), 0, 0
    for size in [*pieces, len(data)]:
        taken += sum(len(f.raw) for f in parser.feed(data[at : at + size]))
        at += size
    taken += sum(len(f.raw) for f in parser.finish())
    assert taken + parser.skipped_bytes == len(data)


junk = st.binary(max_size=40).map(lambda b: b.replace(b"\xfd", b"\x00").replace(b"\xfe", b"\x00"))


@given(gaps=st.lists(junk | st.sampled_from([b"\xfd", b"\xfe", b"\xfd\xff\x00", b"\xfe\x05"]), min_size=1, max_size=6))
def test_intact_frames_among_garbage_come_back(gaps: list[bytes]) -> None:
    stream = b"".join(gap + encoded(imu(x=k), k) for k, gap in enumerate(gaps))
    parser = FrameParser()
    frames = parser.feed(stream) + parser.finish()
    assert [f.sequence for f in frames if f.known] == list(range(len(gaps)))


@settings(max_examples=examples(50))
@given(cut=st.integers(1, 40), data=st.binary(max_size=20))
def test_truncated_signed_and_damaged_frames_never_raise(cut: int, data: bytes) -> None:
    signed = encoded(imu(), 1, signing=Signing(KEY, 1, NOW))
    parser = FrameParser()
    parser.feed(signed[:-cut] + data)
    parser.finish()
    list(iter_tlog(b"\x00" * 8 + signed[:-cut] + data))


def test_a_message_of_more_bytes_than_the_dialect_knows_is_decoded() -> None:
    longer = RawMessage(0, raw_message(heartbeat()).payload + b"\x09\x09")
    (frame,) = FrameParser().feed(encode(longer, 1, 1, 0))
    assert decode(frame).autopilot == 3


@pytest.mark.parametrize("value", [-1, 1310988, 16777217, -8388000, -8388607, -4194305])
def test_bytewise_integers_survive_both_ways(value: int) -> None:
    bits = struct.pack("<i", value)
    (frame,) = FrameParser().feed(encoded(param_set(1, 1, "CAL_ACC0_ID", bits, 6)))
    assert param_bytes(frame) == bits
    payload = struct.pack("<4sHH16sB", bits, 905, 12, b"CAL_ACC0_ID", 6)
    (frame,) = FrameParser().feed(encoded(RawMessage(22, payload)))
    assert decode_param_value(frame) == ParamValue("CAL_ACC0_ID", bits, 6, 905, 12)


def test_a_name_of_sixteen_characters_has_no_terminator() -> None:
    payload = struct.pack("<4sHH16sB", b"\x00\x00\x80\x3f", 1, 0, b"ABCDEFGHIJKLMNOP", 9)
    (frame,) = FrameParser().feed(encoded(RawMessage(22, payload)))
    assert decode_param_value(frame).name == "ABCDEFGHIJKLMNOP"
    with pytest.raises(InvalidInputError, match="16"):
        param_set(1, 1, "ABCDEFGHIJKLMNOPQ", b"\x00" * 4, 9)


def test_a_value_that_does_not_fit_its_field_is_refused_by_name() -> None:
    with pytest.raises(InvalidInputError, match="RAW_IMU"):
        raw_message(imu(x=40000))


def signed_frame(timestamp: int, key: bytes = KEY, link_id: int = 3, message: Message = None) -> Frame:
    data = encoded(message or imu(), 1, signing=Signing(key, link_id, timestamp))
    (frame,) = FrameParser().feed(data)
    return frame


def test_signs_the_bytes_that_pymavlink_accepts() -> None:
    mav = dialect.MAVLink(None, 2, 2)
    mav.signing.secret_key = KEY
    message = mav.parse_char(encoded(imu(), 1, signing=Signing(KEY, 3, NOW)))
    assert message.get_signed()
    assert message.get_link_id() == 3


def test_a_signature_is_right_only_with_its_key_and_untouched() -> None:
    frame = signed_frame(NOW)
    assert check_signature(frame, KEY)
    assert not check_signature(frame, bytes(32))
    touched = frame._replace(raw=frame.raw[:-1] + bytes([frame.raw[-1] ^ 1]))
    assert not check_signature(touched, KEY)
    (unsigned,) = FrameParser().feed(encoded(imu()))
    assert not check_signature(unsigned, KEY)


def test_a_forged_frame_from_the_future_does_not_lock_the_vehicle_out() -> None:
    state = SignatureState(KEY, NOW)
    assert state.accept(signed_frame(NOW + 1))
    assert not state.accept(signed_frame(NOW + 10**9, key=bytes(32)))
    assert state.timestamp == NOW + 1
    assert state.accept(signed_frame(NOW + 2))
    assert (state.accepted, state.rejected) == (2, 1)


def test_a_replayed_or_old_frame_is_refused() -> None:
    state = SignatureState(KEY, NOW)
    frame = signed_frame(NOW + 5)
    assert state.accept(frame)
    assert not state.accept(frame)
    assert not state.accept(signed_frame(NOW + 4))
    assert not SignatureState(KEY, NOW).accept(signed_frame(NOW - 6_000_001))
    assert SignatureState(KEY, NOW).accept(signed_frame(NOW - 5_999_999))


def test_outgoing_time_stamps_always_grow() -> None:
    state = SignatureState(KEY, NOW)
    assert [state.next_signing(0, t).timestamp for t in (5, NOW + 100, NOW + 100)] == [NOW + 1, NOW + 100, NOW + 101]


def test_a_key_of_wrong_length_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="32 bytes"):
        SignatureState(b"short")


def test_tlog_records_come_back_with_their_times() -> None:
    log = b"".join(tlog_record(1_700_000_000_000_000 + k, encoded(imu(), k)) for k in range(5))
    assert [(t - 1_700_000_000_000_000, f.sequence) for t, f in iter_tlog(log)] == [(k, k) for k in range(5)]


def test_tlog_damage_costs_only_what_was_hit() -> None:
    records = [tlog_record(1_700_000_000_000_000 + k, encoded(imu(), k)) for k in range(6)]
    log = bytearray(b"".join(records))
    size = len(records[0])
    del log[2 * size + 3 : 2 * size + 30]
    log[4 * size] ^= 0xFF  # somewhere inside the fifth
    reader = TlogReader(memoryview(log))
    got = [f.sequence for _, f in reader]
    assert {0, 1, 3, 5} <= set(got)
    assert len(got) == reader.records
    assert reader.skipped_bytes == len(log) - sum(8 + len(records[0]) - 8 for _ in got)


def test_a_tlog_cut_in_its_last_record_says_how_much_was_lost() -> None:
    log = tlog_record(1, encoded(imu(), 1)) + tlog_record(2, encoded(imu(), 2))[:-4]
    reader = TlogReader(log)
    assert [f.sequence for _, f in reader] == [1]
    assert reader.skipped_bytes == len(log) // 2 - 2


@pytest.mark.shared
def test_real_captures_are_read_without_a_byte_skipped(shared_data: Path) -> None:
    for name, count in {"sitl_captures/params.tlog": 1383, "px4_captures/params.tlog": 7317}.items():
        reader = TlogReader((shared_data / name).read_bytes())
        assert sum(1 for _ in reader) == count
        assert (reader.skipped_bytes, reader.unknown) == (0, 0)
