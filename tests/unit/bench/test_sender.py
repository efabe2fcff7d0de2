from __future__ import annotations

from bench.sender import COMPONENT, MARKER, SYSTEM, Spec, frame, number_of, numbers_of
from mavcal.calib.wire import FrameParser


def test_a_frame_carries_its_number_and_its_sequence() -> None:
    raws = [frame(number) for number in (0, 255, 256, 70_000)]
    parsed = FrameParser().feed(b"".join(raws))
    assert [(f.system, f.component, f.sequence) for f in parsed] == [
        (SYSTEM, COMPONENT, sequence) for sequence in (0, 255, 0, 70_000 & 0xFF)
    ]
    assert all(f.known for f in parsed)
    assert [number_of(f.raw) for f in parsed] == [0, 255, 256, 70_000]
    assert numbers_of(raws) == b"".join(n.to_bytes(8, "little") for n in (0, 255, 256, 70_000))


def test_the_marker_counts_the_frames() -> None:
    assert b"".join(frame(number) for number in range(1000)).count(MARKER) == 1000


def test_everything_is_sent_and_one_more() -> None:
    assert Spec("udp", 5, 0.0).sent() == [0, 1, 2, 3, 4, 5]


def test_silences_and_losses_are_left_out_but_never_the_ends() -> None:
    silent = Spec("udp", 1000, 0.0, gaps=((100, 300),)).sent()
    assert set(range(1001)) - set(silent) == set(range(100, 400))
    lossy = Spec("udp", 20_000, 0.0, loss=0.5, seed=3)
    sent = lossy.sent()
    assert sent == lossy.sent()
    assert (sent[0], sent[-1]) == (0, 20_000)
    assert 0.48 < len(sent) / 20_001 < 0.52
    assert sent != Spec("udp", 20_000, 0.0, loss=0.5, seed=4).sent()
