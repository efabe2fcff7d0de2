from __future__ import annotations

import pytest

from mavcal.service.told import ToldProgress, line_of, read_line


@pytest.mark.parametrize(
    "told",
    [
        ToldProgress("reading"),
        ToldProgress("selecting effects", 0.25, 90.0),
        ToldProgress("selecting effects [of the compass]", 1.0, None),
        ToldProgress("", 0.0, 0.0),
    ],
)
def test_what_is_told_is_read_back(told: ToldProgress) -> None:
    assert read_line(line_of(told)) == told


def test_numbers_out_of_range_are_brought_into_it() -> None:
    assert read_line(line_of(ToldProgress("a", 1.2, -3.0))) == ToldProgress("a", 1.0, 0.0)


@pytest.mark.parametrize("line", ["", "a [1]", "a [0.5 3]", "a [0.500 3", "a [2.000 3]", "a [0.500 x]"])
def test_any_other_text_stands_for_itself(line: str) -> None:
    assert read_line(line) == ToldProgress(line)
