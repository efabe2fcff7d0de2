from __future__ import annotations

import io
import json

import pytest

from mavcal.service.commands import screen as module
from mavcal.service.commands.output import wants_json, write_json
from mavcal.service.commands.screen import Screen
from tests.unit.commands.test_gauge import Terminal


def progress(current, target=4.0, *, unit="poses", eta=None):
    return {"current": current, "target": target, "unit": unit, "text": "recording", "eta": eta}


@pytest.fixture
def shown(monkeypatch):
    """What a screen on such a stream has written."""

    def on(stream, show, **options):
        monkeypatch.setattr(module.sys, "stderr", stream)
        show(Screen(**options))
        return stream.getvalue()

    return on


def test_without_a_terminal_a_quarter_is_a_line(shown):
    def show(screen):
        for step in range(9):
            screen.progress(progress(step / 2))

    lines = shown(io.StringIO(), show).splitlines()
    assert [line.split()[0] for line in lines] == ["0%", "25%", "50%", "75%", "100%"]


def test_without_a_terminal_ten_silent_seconds_end_in_a_line(shown):
    now = [0.0]

    def show(screen):
        for _ in range(60):  # at 100 %, for five minutes
            screen.progress(progress(4.0))
            now[0] += 5.0

    assert len(shown(io.StringIO(), show, clock=lambda: now[0]).splitlines()) == 30


def test_another_unit_begins_again(shown):
    def show(screen):
        screen.progress(progress(1.0, unit="poses"))
        screen.progress(progress(1.0, unit="poses"))
        screen.progress(progress(1.0, unit="s"))

    assert len(shown(io.StringIO(), show).splitlines()) == 2


@pytest.mark.parametrize(("current", "target", "share"), [(9.0, 4.0, "100%"), (-1.0, 4.0, "0%"), (0.5, 0.0, "50%")])
def test_a_share_stays_between_nothing_and_all(shown, current, target, share):
    text = shown(io.StringIO(), lambda screen: screen.progress(progress(current, target)))
    assert text.split()[0] == share


def test_a_terminal_redraws_one_line_until_another_one_comes(shown):
    def show(screen):
        screen.progress(progress(1.0, eta=12.4))
        screen.progress(progress(2.0))
        screen.line("done")
        screen.line("really")

    text = shown(Terminal(), show)
    assert text.count("\n") == 3  # the end of the bar, and two lines
    first, second = text.split("\n")[0].split("\r")[1:]
    assert ("12 s left" in first, "s left" in second) == (True, False)
    assert first.count("#") * 2 == second.count("#")
    assert len(first) == len(second)  # the shorter text leaves nothing of the longer one


def test_a_prompt_is_said_again_after_another_one(shown):
    def show(screen):
        for text in ("a", "a", "b", "a"):
            screen.prompt(text)

    assert [line.split()[-1] for line in shown(io.StringIO(), show).splitlines()] == ["a", "b", "a"]


@pytest.mark.parametrize("stream", [io.StringIO, Terminal])
def test_a_quiet_screen_shows_nothing(shown, stream):
    def show(screen):
        screen.line("x")
        screen.prompt("y")
        screen.progress(progress(1.0))

    assert shown(stream(), show, quiet=True) == ""


def test_an_answer_is_one_line_of_json_without_what_is_not_finite(capsys):
    write_json({"a": float("nan"), "b": [1.0, float("inf")], "c": (2,)})
    (line,) = capsys.readouterr().out.splitlines()
    assert json.loads(line) == {"a": None, "b": [1.0, None], "c": [2]}


def test_json_is_wanted_where_it_is_said():
    assert wants_json(["gap", "--json"])
    assert not wants_json(["gap", "json"])
