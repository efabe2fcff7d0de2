"""Frames by the letter of MAVLink's serialisation: checksums, signatures, headers, and what is no frame."""

from __future__ import annotations

import hashlib
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.wire import frames
from mavcal.calib.wire.codec import RawMessage, decode, encode, padded_payload
from mavcal.calib.wire.frames import CRC_EXTRA, MAGIC_V1, MAGIC_V2, SIGNED, FrameParser, cut, next_magic
from mavcal.calib.wire.signing import SignatureState, Signing, sign, signing_time
from mavcal.calib.wire.tlog import TlogReader, iter_tlog, tlog_record
from tests.examples import examples

KEY = bytes(range(32))
UNKNOWN = 10_000


def heartbeat(autopilot=3):
    return dialect.MAVLink_heartbeat_message(2, autopilot, 81, 0, 3, 3)


def encoded(message=None, sequence=0, system=1, **kw):
    return encode(heartbeat() if message is None else message, system, 1, sequence, **kw)


def unknown(payload=b"abc", *, system=1, flags=0, message_id=UNKNOWN):
    header = struct.pack("<BBBBBBBHB", MAGIC_V2, len(payload), flags, 0, 9, system, 1, message_id & 0xFFFF, 0)
    return header + payload + b"\x00\x00" + (bytes(13) if flags & SIGNED else b"")


def read(data, **kw):
    parser = FrameParser()
    found = parser.feed(data, **kw) + parser.finish(**kw)
    return found, parser


def test_the_checksum_is_that_of_the_catalogue_of_checksums():
    """CRC-16/MCRF4XX of "123456789" is 0x6F91 (reveng, catalogue of CRC algorithms)."""
    assert frames.crc(b"123456789") == 0x6F91
    assert frames._crc_uncompiled(b"123456789") == 0x6F91


@given(data=st.binary(max_size=60), more=st.binary(max_size=10))
def test_a_checksum_goes_on_where_it_stopped_compiled_or_not(data, more):
    assert frames.crc(more, frames.crc(data)) == frames.crc(data + more)
    assert frames._crc_uncompiled(more, frames.crc(data)) == frames.crc(data + more)


@given(
    message_id=st.sampled_from(sorted(dialect.mavlink_map)),
    payload=st.binary(min_size=1, max_size=255),
    sequence=st.integers(0, 1000),
    system=st.integers(1, 255),
    component=st.integers(0, 255),
)
def test_what_is_encoded_is_read_back_with_its_header(message_id, payload, sequence, system, component):
    made = encode(RawMessage(message_id, payload), system, component, sequence)
    (frame,), parser = read(made)
    assert (frame.system, frame.component, frame.message_id) == (system, component, message_id)
    assert frame.sequence == sequence % 256
    assert frame.payload == (payload.rstrip(b"\x00") or payload[:1])
    assert padded_payload(frame, len(payload)) == payload
    assert (frame.version, frame.known, frame.signature) == (2, True, None)
    assert (parser.skipped_bytes, parser.crc_errors) == (0, 0)


def test_a_payload_of_zeros_keeps_its_first_byte():
    (frame,), _ = read(encode(RawMessage(0, bytes(9)), 1, 1, 0))
    assert frame.payload == b"\x00"


@settings(max_examples=examples(40))
@given(at=st.integers(1, 20), bit=st.integers(0, 7))
def test_any_bit_that_flips_in_a_frame_is_noticed(at, bit):
    data = bytearray(encoded())
    assert len(data) == 21
    data[at] ^= 1 << bit
    found, parser = read(bytes(data))
    assert not [f for f in found if f.known]
    assert parser.skipped_bytes + sum(len(f.raw) for f in found) == len(data)


def test_an_incompatible_flag_that_is_not_known_makes_it_no_frame():
    data = unknown(flags=0x02)
    assert cut(data, 0, len(data)) == frames._NO_FRAME
    assert cut(data[:5], 0, 5) == frames._NO_FRAME
    assert cut(data[:2], 0, 2) == frames._INCOMPLETE
    assert cut(unknown()[:5], 0, 5) == frames._INCOMPLETE
    assert cut(b"\x00" + data, 0, len(data)) == frames._NO_FRAME


def test_a_signed_frame_is_complete_with_its_thirteen_bytes_only():
    made = encoded(signing=Signing(KEY, 5, 7))
    assert len(made) == 21 + 13
    assert cut(made[:-1], 0, len(made) - 1) == frames._INCOMPLETE
    frame = cut(made, 0, len(made))
    assert frame.incompat_flags == SIGNED
    assert frame.signature == made[-13:]


def test_a_message_of_the_first_version_that_is_not_known_is_no_frame():
    """Ten bytes would be enough for one in any garbage; nothing vouches for it."""
    foreign = next(i for i in range(256) if i not in CRC_EXTRA)
    found, parser = read(bytes([MAGIC_V1, 3, 0, 1, 1, foreign]) + b"abc\x00\x00")
    assert found == []
    assert parser.unknown == 0


@pytest.mark.parametrize(("system", "kept"), [(0, False), (1, True), (255, True)])
def test_an_unknown_message_is_from_a_real_system(system, kept):
    found, parser = read(unknown(system=system) + encoded())
    assert [f.known for f in found] == ([False, True] if kept else [True])
    assert parser.unknown == int(kept)


def test_an_unknown_message_at_the_end_of_the_stream_counts():
    found, _ = read(encoded() + unknown())
    assert [f.known for f in found] == [True, False]
    found, _ = read(encoded() + unknown() + b"\x01\x02")
    assert [f.known for f in found] == [True]


def test_messages_that_are_not_kept_are_counted_and_stepped_over():
    stream = encoded(sequence=1) + unknown() + encoded(sequence=2)
    found, parser = read(stream, keep_ids=frozenset({UNKNOWN}))
    assert [f.message_id for f in found] == [UNKNOWN]
    assert (parser.unknown, parser.skipped_bytes) == (1, 0)
    assert read(stream, keep_ids=frozenset())[0] == []
    assert FrameParser().feed_datagram(encoded(), frozenset({1})) == []


def test_a_reset_counts_what_it_forgets_and_keeps_its_counters():
    parser = FrameParser()
    parser.feed(b"\x00\x00" + encoded()[:7])
    assert (parser.pending, parser.skipped_bytes) == (7, 2)
    parser.reset()
    assert (parser.pending, parser.skipped_bytes) == (0, 9)
    assert parser.finish() == []
    assert [f.message_id for f in parser.feed(encoded())] == [0]


def test_a_datagram_takes_nothing_of_the_stream_before_it():
    parser = FrameParser()
    parser.feed(encoded()[:7])
    assert len(parser.feed_datagram(encoded())) == 1
    assert parser.skipped_bytes == 7
    assert parser.feed_datagram(b"") == []
    assert [f.sequence for f in parser.feed_datagram(encoded(sequence=3) + encoded(sequence=4))] == [3, 4]
    assert parser.feed_datagram(b"\x01" + encoded(sequence=5))[0].sequence == 5


@given(data=st.lists(st.sampled_from([0, 1, MAGIC_V1, MAGIC_V2]), max_size=30).map(bytes), start=st.integers(0, 30))
def test_the_next_magic_byte_is_the_nearest_of_both(data, start):
    expected = next((i for i in range(start, len(data)) if data[i] in (MAGIC_V1, MAGIC_V2)), len(data))
    assert next_magic(data, start, len(data)) == expected


def test_a_signature_is_the_first_six_bytes_of_sha_256_over_key_and_frame():
    made = encoded(signing=Signing(KEY, 9, 0x0102030405))
    plain, block = made[:-13], made[-13:]
    assert block[:1] == b"\x09"
    assert block[1:7] == bytes([5, 4, 3, 2, 1, 0])
    assert block[7:] == hashlib.sha256(KEY + plain + block[:7]).digest()[:6]
    assert sign(plain, KEY, 9, 0x0102030405) == made


@pytest.mark.parametrize(
    ("unix_s", "units"), [(1_420_070_400.0, 0), (1_420_070_401.0, 100_000), (1_420_070_400.00001, 1)]
)
def test_time_of_signatures_begins_in_2015_in_units_of_ten_microseconds(unix_s, units):
    assert signing_time(unix_s) == pytest.approx(units, abs=1)


def signed(timestamp, *, link_id=1, system=1, component=1):
    made = encode(heartbeat(), system, component, 0, Signing(KEY, link_id, timestamp))
    (frame,) = FrameParser().feed(made)
    return frame


@pytest.mark.parametrize("other", [{"link_id": 2}, {"system": 2}, {"component": 2}])
def test_each_link_system_and_component_has_a_time_of_its_own(other):
    state = SignatureState(KEY, 1_000_000_000)
    assert state.accept(signed(1_000_000_100))
    assert not state.accept(signed(1_000_000_050))
    assert state.accept(signed(1_000_000_050, **other))
    assert not state.accept(signed(1_000_000_050, **other))
    assert (state.accepted, state.rejected, state.timestamp) == (2, 2, 1_000_000_100)


def test_a_stream_that_is_new_may_be_a_minute_behind_and_an_old_one_not():
    state = SignatureState(KEY, 1_000_000_000)
    assert not state.accept(signed(1_000_000_000 - 6_000_001))
    assert state.accept(signed(1_000_000_000 - 6_000_000))
    assert state.timestamp == 1_000_000_000
    assert state.next_signing(3, 5) == Signing(KEY, 3, 1_000_000_001)


def test_an_unsigned_frame_is_rejected_and_counted():
    state = SignatureState(KEY)
    (frame,) = FrameParser().feed(encoded())
    assert not state.accept(frame)
    assert (state.accepted, state.rejected) == (0, 1)


def test_a_message_that_nobody_knows_is_neither_sent_nor_decoded():
    with pytest.raises(InvalidInputError, match="message id 10000 is not in the dialect and cannot be sent"):
        encode(RawMessage(UNKNOWN, b"x"), 1, 1, 0)
    foreign = next(i for i in CRC_EXTRA if i not in dialect.mavlink_map)
    (frame,), _ = read(encode(RawMessage(foreign, b"abc"), 1, 1, 0))
    assert frame.known
    with pytest.raises(InvalidInputError, match=f"message id {foreign} is not in the dialect; filter by id first"):
        decode(frame)


def records(*raws, start=1_700_000_000_000_000):
    return b"".join(tlog_record(start + k, raw) for k, raw in enumerate(raws))


def test_a_log_is_read_the_same_each_time_and_counts_afresh():
    reader = TlogReader(records(encoded(sequence=1), unknown(), encoded(sequence=2)) + b"\x01\x02\x03")
    first, again = list(reader), list(reader)
    assert first == again
    assert (reader.records, reader.unknown, reader.skipped_bytes) == (3, 1, 3)


def test_an_unknown_message_of_a_log_needs_another_record_or_the_end_behind_it():
    whole = records(encoded(sequence=1), unknown())
    assert [f.known for _, f in iter_tlog(whole)] == [True, False]
    broken = records(encoded(sequence=1), unknown() + b"\x00", encoded(sequence=2))
    assert [f.sequence for _, f in iter_tlog(broken)] == [1, 2]


@pytest.mark.parametrize("data", [b"", b"\x00" * 8, b"\xfd" * 9])
def test_a_log_without_a_record_has_none(data):
    reader = TlogReader(data)
    assert list(reader) == []
    assert reader.skipped_bytes == len(data)
