"""The result of a job as a page: everything of it is there, and nothing of it becomes markup."""

from __future__ import annotations

import dataclasses
import re

from mavcal.calib.firmware.compose.plan import compose
from mavcal.calib.firmware.plan import Change, Loss, ParameterKind, WritePlan
from mavcal.calib.recording import Sensor
from mavcal.calib.review.effect import effects_of, headline_of
from mavcal.calib.review.picture import picture_of
from mavcal.service.exports import export
from mavcal.service.jobs.core.codec import row_from_job
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.store.rows import SnapshotPurpose
from tests.stores import new_store
from tests.unit.firmware.conftest import *  # noqa: F403 - the parameters and fits of the firmware's tests
from tests.unit.jobs.core.test_codec import FINGERPRINT, VERIFICATION

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
    page = export(reviewed("word"), "html", new_store())
    cells = re.findall(r"<td>(.*?)</td>", page, flags=re.DOTALL)
    assert cells == ["X", "–", "0.5", "0.1", "word", "consistent", "word"]
    assert "<li>word (0.25 word)</li>" in page
    assert "<li>nothing</li>" not in page
    assert "<h1>word calibration of word</h1>" in page


def test_nothing_becomes_markup_and_nothing_is_fetched() -> None:
    page = export(reviewed(EVIL), "html", new_store())
    assert "<script" not in page
    assert page.count("&lt;script&gt;") == 10
    assert not re.search(r"(src|href)\s*=|url\(|@import|https?:", page)


def test_a_plan_that_loses_nothing_says_so() -> None:
    job = reviewed("word")
    assert job.plan is not None
    bare = dataclasses.replace(job, plan=dataclasses.replace(job.plan, losses=()), verification=None)
    page = export(bare, "html", new_store())
    assert "<li>nothing</li>" in page


def test_the_page_has_the_picture_before_and_after(ardupilot_parameters, ardupilot_fingerprint, make_fit) -> None:
    parameters = {**ardupilot_parameters, "INS_GYROFFS_X": 0.0, "INS_GYROFFS_Y": 0.0, "INS_GYROFFS_Z": 0.0}
    fit = make_fit(Sensor.GYRO, 0, offset=[0.01, -0.02, 0.005])
    plan = compose([fit], parameters, ardupilot_fingerprint)
    job = Job("j", "v", "gyro", {}, JobState.REVIEW, 1.5, 2.5, plan=plan, results=(fit,))
    store = new_store()
    store.save_job(row_from_job(job))
    store.add_snapshot(job.id, 2.0, SnapshotPurpose.COMPOSED_ON, plan.snapshot_sha256, parameters)
    page = export(job, "html", store)
    effects = effects_of([fit], plan, parameters)
    assert str(picture_of(effects, headline_of(effects))).strip() in page
    assert "Rate at rest is wrong by up to 1.1 deg/s" in page
    assert "every parameter is determined" in page
    assert "<script" not in page
