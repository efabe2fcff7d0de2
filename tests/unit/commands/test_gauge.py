from __future__ import annotations

import io

from mavcal.calib.gap import GapProgress, GapStage
from mavcal.service.commands.gauge import Gauge, sentence

HALF = GapProgress(GapStage.SELECTION, 0.5, 20.4)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_the_sentence_says_what_is_done_how_far_and_how_long() -> None:
    assert sentence(HALF) == "selecting effects: 50 % done, about 20 s left"
    assert sentence(GapProgress(GapStage.REFERENCE, 0.0, None)) == "making the reference: 0 % done"
    assert sentence(GapProgress(GapStage.REPORT, 0.99, 0.01)).endswith("about 1 s left")


def test_a_terminal_has_one_line_that_is_empty_in_the_end() -> None:
    terminal = Terminal()
    with Gauge(terminal) as gauge:
        gauge.show(HALF)
        gauge.show(HALF)
    written = terminal.getvalue()
    assert written.count("selecting effects") == 1
    assert "\n" not in written
    assert written.rstrip("\r").rpartition("\r")[2].strip() == ""


def test_what_is_no_terminal_stays_empty() -> None:
    stream = io.StringIO()
    with Gauge(stream) as gauge:
        gauge.show(HALF)
    assert stream.getvalue() == ""
