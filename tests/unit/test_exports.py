"""The result of a job as a page: everything of it is there, and nothing of it becomes markup."""

from __future__ import annotations

import dataclasses
import re

from mavcal.calib.firmware.plan import Change, Loss, ParameterKind, WritePlan
from mavcal.calib.recording import Sensor
from mavcal.service.exports import export
from mavcal.service.jobs.model import Job
from mavcal.service.jobs.states import JobState
from tests.unit.jobs.test_codec import FINGERPRINT, VERIFICATION

EVIL = '<script>alert("x")</script>'


def reviewed(word: str) -> Job:
    """A job with `word` wherever a name or a text goes."""
    change = Change("X", None, 0.5, ParameterKind.REAL32, word, sd=0.1, unit=word, sensor=Sensor.GYRO)
    plan = WritePlan(
        dataclasses.replace(FINGERPRINT, firmware=word), "0" * 64, (change,),
        (Loss(Sensor.GYRO, 0, word, 0.25, word, word),),
    )  # fmt: skip
    return Job(word, word, word, {}, JobState.REVIEW, 1.5, 2.5, plan=plan, verification=VERIFICATION)


def test_the_page_tells_every_change_and_every_loss() -> None:
    page = export(reviewed("word"), "html")
    cells = re.findall(r"<td>(.*?)</td>", page, flags=re.DOTALL)
    assert cells == ["X", "–", "0.5", "0.1", "word", "consistent", "word"]
    assert "<li>word (0.25 word)</li>" in page
    assert "<li>nothing</li>" not in page
    assert "<h1>word calibration of word</h1>" in page


def test_nothing_becomes_markup_and_nothing_is_fetched() -> None:
    page = export(reviewed(EVIL), "html")
    assert "<script" not in page
    assert page.count("&lt;script&gt;") == 10
    assert not re.search(r"(src|href)\s*=|url\(|@import|https?:", page)


def test_a_plan_that_loses_nothing_says_so() -> None:
    job = reviewed("word")
    assert job.plan is not None
    page = export(dataclasses.replace(job, plan=dataclasses.replace(job.plan, losses=()), verification=None), "html")
    assert "<li>nothing</li>" in page
