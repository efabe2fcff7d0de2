from __future__ import annotations

import pytest

from mavcal.service.progress_line import ProgressLine, format_line, parse_line


@pytest.mark.parametrize(
    "progress",
    [
        ProgressLine("reading"),
        ProgressLine("selecting effects", 0.25, 90.0),
        ProgressLine("selecting effects [of the compass]", 1.0, None),
        ProgressLine("", 0.0, 0.0),
    ],
)
def test_a_line_is_parsed_as_it_was_formatted(progress: ProgressLine) -> None:
    assert parse_line(format_line(progress)) == progress


def test_numbers_out_of_range_are_brought_into_it() -> None:
    assert parse_line(format_line(ProgressLine("a", 1.2, -3.0))) == ProgressLine("a", 1.0, 0.0)


@pytest.mark.parametrize("line", ["", "a [1]", "a [0.5 3]", "a [0.500 3", "a [2.000 3]", "a [0.500 x]"])
def test_any_other_text_stands_for_itself(line: str) -> None:
    assert parse_line(line) == ProgressLine(line)
