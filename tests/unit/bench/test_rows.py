from __future__ import annotations

import math

from bench.rows import Row, Section, milliseconds, percentile, table


def test_percentile_is_one_of_the_values() -> None:
    values = [0.004, 0.001, 0.003, 0.002]
    assert percentile(values, 0.5) == 0.002
    assert percentile(values, 0.99) == 0.004
    assert math.isnan(percentile([], 0.5))


def test_one_slow_answer_in_a_hundred_is_the_largest_not_the_99th() -> None:
    values = [0.001] * 99 + [1.0]
    assert milliseconds(values) == "median 1.00, p99 1.00, max 1000.00 ms"


def test_a_missed_target_counts_and_a_figure_without_one_does_not() -> None:
    known, met, missed = Row("a", "", "1"), Row("b", "< 2", "1", met=True), Row("c", "< 2", "3", met=False)
    assert Section("t", (known, met)).met
    assert not Section("t", (known, met, missed)).met


def test_table_lines_up_and_names_what_is_missed() -> None:
    lines = table(
        [Row("speed", "< 2 ms", "1 ms", met=True), Row("memory", "", "12 MiB"), Row("x", "1", "2", met=False)]
    )
    rows = lines.splitlines()
    assert len({len(row) for row in rows}) == 1
    assert rows[2].split("|")[4].strip() == "yes"
    assert rows[3].split("|")[4].strip() == ""
    assert rows[4].split("|")[4].strip() == "**no**"
