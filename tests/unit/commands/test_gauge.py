from __future__ import annotations

import io

from mavcal.calib.gap import GapProgress, GapStage
from mavcal.service.commands.gap_options import Gauge, Line, sentence

HALF = GapProgress(GapStage.SELECTION, 0.5, 20.4)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_the_sentence_says_what_is_done_how_far_and_how_long() -> None:
    half, beginning = sentence(HALF), sentence(GapProgress(GapStage.REFERENCE, 0.0, None))
    assert all(token in half for token in ("selecting effects", " 50 %", " 20 s"))
    assert "reference" in beginning
    assert " 0 %" in beginning
    assert " s left" not in beginning
    assert " 1 s" in sentence(GapProgress(GapStage.REPORT, 0.99, 0.01))


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


def test_without_a_terminal_long_work_says_a_line_now_and_then() -> None:
    stream = io.StringIO()
    with Line(stream, quiet_s=60.0) as line:
        line.write("round 0, flying: 1 % done")
        line.write("round 0, flying: 2 % done")
        line.clear()
    assert stream.getvalue() == "round 0, flying: 1 % done\n"
