from __future__ import annotations

import asyncio

import pytest

from mavcal.service.commands import keyboard as module
from mavcal.service.commands.keyboard import Keyboard, keyboard


@pytest.fixture
def answers():
    return []


@pytest.fixture
def answer(answers):
    async def take(line):
        answers.append(line)

    return take


async def test_a_line_goes_to_the_job_unless_a_question_waits(answers, answer):
    typed = Keyboard(there=True)
    await typed._typed("finish", answer)
    question = asyncio.ensure_future(typed.asked())
    await asyncio.sleep(0)
    await typed._typed("yes", answer)
    assert await question == "yes"
    await typed._typed("12.5", answer)
    assert answers == ["finish", "12.5"]


async def test_a_bare_enter_answers_a_question_and_no_job(answers, answer):
    typed = Keyboard(there=True)
    await typed._typed("", answer)
    question = asyncio.ensure_future(typed.asked())
    await asyncio.sleep(0)
    await typed._typed("", answer)
    assert (await question, answers) == ("", [])


async def test_a_script_is_not_asked():
    assert await Keyboard(there=False).asked() == ""


async def test_a_second_line_before_the_question_is_gone_is_lost_and_breaks_nothing(answer):
    typed = Keyboard(there=True)
    question = asyncio.ensure_future(typed.asked())
    await asyncio.sleep(0)
    await typed._typed("yes", answer)
    await typed._typed("no", answer)
    assert await question == "yes"


class Terminal:
    """A standard input; `lines` are read from it one after the other, and then it is closed."""

    def __init__(self, monkeypatch, *lines, there=True, closed=True):
        self.there = there
        monkeypatch.setattr(module.sys, "stdin", self)

        async def connected(_loop, make, _pipe):
            reader = make()._stream_reader
            for line in lines:
                reader.feed_data(line)
            if closed:
                reader.feed_eof()

        monkeypatch.setattr(asyncio.BaseEventLoop, "connect_read_pipe", connected)

    def isatty(self):
        return self.there


async def test_lines_are_read_until_the_terminal_is_closed(monkeypatch, answers, answer):
    Terminal(monkeypatch, b" finish \n", b"\n", b"\xff2\n")
    typed = Keyboard(there=True)
    await typed.listen(answer)
    assert answers == ["finish", "\ufffd2"]
    assert not typed.there


async def test_a_question_that_nobody_will_answer_is_answered_empty(monkeypatch, answer):
    Terminal(monkeypatch)
    typed = Keyboard(there=True)
    question = asyncio.ensure_future(typed.asked())
    await asyncio.sleep(0)
    await typed.listen(answer)
    assert await question == ""


async def test_the_keyboard_listens_while_a_job_runs(monkeypatch, answers, answer):
    Terminal(monkeypatch, b"finish\n")
    async with keyboard(answer) as typed:
        assert typed.there
        while typed.there:  # noqa: ASYNC110 - until the end of what is typed
            await asyncio.sleep(0)
    assert answers == ["finish"]


async def test_no_terminal_is_not_read(monkeypatch, answers, answer):
    Terminal(monkeypatch, b"finish\n", there=False)
    async with keyboard(answer) as typed:
        await asyncio.sleep(0)
        assert not typed.there
    assert answers == []


async def test_nobody_listens_once_the_job_has_ended(monkeypatch, answer):
    Terminal(monkeypatch, closed=False)
    async with keyboard(answer):
        await asyncio.sleep(0)
        assert len(asyncio.all_tasks()) == 2
    assert asyncio.all_tasks() == {asyncio.current_task()}
