from __future__ import annotations

from pathlib import Path

from bench.fleet.__main__ import drift_table, odd_table
from bench.fleet.drift import WANDERS, run

PAGE = Path(__file__).resolve().parents[3] / "docs" / "measured" / "accuracy.md"


def test_a_sensor_is_the_same_for_the_same_seed_and_another_for_the_next() -> None:
    assert run(WANDERS[0], 4, 1) == run(WANDERS[0], 4, 1)
    assert len({run(WANDERS[1], 6, seed) for seed in range(1, 9)}) > 1


def test_the_page_has_a_row_of_every_kind() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for wander in WANDERS:
        for n in (4, 6, 12):
            assert f"| {wander.name} | {n} |" in page


def test_tables_say_whether_what_is_stated_holds() -> None:
    table, _ = drift_table(3, 1)
    assert table.count("\n") == 1 + 3 * len(WANDERS)
    odd, rare = odd_table(200, 1)
    assert rare
    assert odd.startswith("| sensors |")
