from __future__ import annotations

from dataclasses import replace

import pytest

from bench.ingest import Case, cases, gaps, link_rows, peer_row
from bench.latency import Watched
from bench.memory import Reading, growth
from bench.page import page
from bench.receivers import Received
from bench.rows import Row, Section
from bench.running import resident_bytes
from bench.sender import Spec

SPEC = Spec("udp", 99_999, 20_000.0)
CLEAN = Received(
    offered=100_000,
    missing_on_the_way=0,
    arrived=100_000,
    missing=0,
    own_lost=0,
    own_inferred=0,
    recorded=100_000,
    sending_s=5.0,
    receiving_s=5.0,
    cpu_us=7.0,
    handoff_s=(0.001,),
)


def verdicts(case: Case, received: Received) -> list[bool | None]:
    return [row.met for row in link_rows(case, received)]


def test_a_clean_run_meets_every_target() -> None:
    assert verdicts(Case("clean", SPEC, 0.0), CLEAN) == [True, True, True]


def test_every_way_to_miss_is_seen() -> None:
    lost = replace(CLEAN, arrived=99_900, missing=100, own_lost=100, recorded=99_900)
    assert verdicts(Case("lost", SPEC, 0.0), lost) == [False, True, True]
    assert verdicts(Case("a thousandth may be lost", SPEC, 0.001), lost) == [True, True, True]
    assert verdicts(Case("miscounted", SPEC, 0.001), replace(lost, own_lost=99)) == [True, False, True]
    assert verdicts(Case("not recorded", SPEC, 0.001), replace(lost, recorded=99_899)) == [True, True, False]


def test_what_is_left_out_on_the_way_is_missing_but_not_lost_here() -> None:
    seeded = replace(
        CLEAN, offered=99_000, missing_on_the_way=1000, arrived=99_000, missing=1000, own_lost=1000, recorded=99_000
    )
    assert seeded.dropped == 0
    assert verdicts(Case("seeded", SPEC, 0.0), seeded) == [True, True, True]


def test_a_sender_that_lags_is_named() -> None:
    row = link_rows(Case("slow", SPEC, 0.0), replace(CLEAN, sending_s=10.0))[0]
    assert "the sender did not reach its rate" in row.measured
    assert "did not reach" not in link_rows(Case("slow", SPEC, 0.0), CLEAN)[0].measured


def test_the_peer_stands_beside_it_as_a_ratio() -> None:
    peer = replace(CLEAN, arrived=50_000, missing=50_000, own_lost=1234, recorded=None, cpu_us=14.0)
    row = peer_row(Case("peer", SPEC, 0.0), CLEAN, peer)
    assert row.met is None
    assert "arrived 2.00, processor time each 0.50" in row.measured


@pytest.mark.parametrize("rate", [2000.0, 20_000.0])
def test_silences_are_longer_than_a_sequence_and_lie_inside_the_run(rate: float) -> None:
    spec = next(case.spec for case in cases() if case.spec.gaps == gaps(rate))
    assert all(length > 256 for _, length in spec.gaps)
    assert all(first + length < spec.count for first, length in spec.gaps)
    assert len(spec.sent()) == spec.count + 1 - sum(length for _, length in spec.gaps)


def test_growth_is_the_slope_after_the_start() -> None:
    readings = [Reading(float(t), float(t), 1000 + (5000 if t else 0) + 3 * t, 0) for t in range(0, 400, 10)]
    assert growth(readings) == pytest.approx(3.0)
    assert growth([replace(r, resident=7) for r in readings]) == pytest.approx(0.0, abs=1e-9)


def test_resident_memory_is_read_in_kibibytes() -> None:
    assert resident_bytes("Name:\tpython\nVmPeak:\t  9 kB\nVmRSS:\t   1234 kB\n") == 1234 * 1024


def test_stages_of_a_job_and_a_state_that_never_came() -> None:
    watched = Watched(0.0, [("queued", 1.0), ("running", 1.5), ("review", 4.0)])
    assert watched.stages() == [("queued", 0.5), ("running", 2.5)]
    assert watched.at("review") == 4.0
    with pytest.raises(KeyError, match="succeeded"):
        watched.at("succeeded")


def test_the_page_holds_every_section() -> None:
    text = page([Section("One", (Row("a", "", "1"),), ("why",)), Section("Two", ())], "before", "after", 3.2)
    assert "## One" in text
    assert "## Two" in text
    assert "why" in text
    assert "after 3 minutes" in text
