from __future__ import annotations

from dataclasses import replace

from bench.rows import Row, Section, beside, milliseconds, table
from bench.running import resident_bytes
from bench.speed.ingest import Case, Received, link_rows, peer_row
from bench.speed.sender import MARKER, Spec, frame, numbers_of

SPEC = Spec("udp", 99_999, 20_000.0)
CLEAN = Received(100_000, 0, 100_000, 0, 0, 100_000, 5.0, 5.0, 7.0, (0.001,))


def verdicts(case: Case, received: Received) -> list[bool | None]:
    return [row.met for row in link_rows(case, received)]


def test_every_way_to_miss_is_seen() -> None:
    lost = replace(CLEAN, arrived=99_900, missing=100, own_lost=100, recorded=99_900)
    assert verdicts(Case("clean", SPEC, 0.0), CLEAN) == [True, True, True]
    assert verdicts(Case("lost", SPEC, 0.0), lost) == [False, True, True]
    assert verdicts(Case("a thousandth may be lost", SPEC, 0.001), lost) == [True, True, True]
    assert verdicts(Case("miscounted", SPEC, 0.001), replace(lost, own_lost=99)) == [True, False, True]
    assert verdicts(Case("not recorded", SPEC, 0.001), replace(lost, recorded=99_899)) == [True, True, False]
    left_out = replace(lost, offered=99_900, missing_on_the_way=100)
    assert verdicts(Case("left out on the way", SPEC, 0.0), left_out) == [True, True, True]


def test_a_sender_that_lags_is_named_and_the_peer_stands_beside_as_a_ratio() -> None:
    assert "did not reach its rate" in link_rows(Case("slow", SPEC, 0.0), replace(CLEAN, sending_s=10.0))[0].measured
    assert "did not reach" not in link_rows(Case("slow", SPEC, 0.0), CLEAN)[0].measured
    peer = replace(CLEAN, arrived=50_000, missing=50_000, own_lost=1234, cpu_us=14.0)
    assert "arrived 2.00, processor time each 0.50" in peer_row(CLEAN, peer).measured


def test_frames_carry_their_numbers_and_losses_leave_the_ends() -> None:
    raws = [frame(number) for number in (0, 255, 256, 70_000)]
    assert numbers_of(raws) == b"".join(n.to_bytes(8, "little") for n in (0, 255, 256, 70_000))
    assert b"".join(raws).count(MARKER) == 4
    sent = Spec("udp", 20_000, 0.0, loss=0.5, seed=3).sent()
    assert (sent[0], sent[-1]) == (0, 20_000)
    assert 0.48 < len(sent) / 20_001 < 0.52


def test_a_missed_target_counts_and_a_figure_without_one_does_not() -> None:
    known, met, missed = Row("a", "", "1"), Row("b", "< 2", "1", met=True), Row("c", "< 2", "3", met=False)
    assert Section("t", (known, met)).met
    assert not Section("t", (known, met, missed)).met
    lines = table([known, met, missed]).splitlines()
    assert len({len(line) for line in lines}) == 1
    assert [line.split("|")[4].strip() for line in lines[2:]] == ["", "yes", "**no**"]


def test_a_peer_that_is_faster_misses_the_target() -> None:
    assert beside("x", lambda: sum(range(200_000)), lambda: None, 1.0).met is False
    assert milliseconds([0.001] * 99 + [1.0]) == "median 1.00, p99 1.00, max 1000.00 ms"
    assert resident_bytes("Name:\tpython\nVmPeak:\t  9 kB\nVmRSS:\t   1234 kB\n") == 1234 * 1024
