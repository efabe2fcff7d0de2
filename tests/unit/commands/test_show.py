"""What the command line shows of a job: integers as integers, every prompt once, cause and remedy as sentences."""

from __future__ import annotations

import pytest

from mavcal.calib.firmware.options import to_confirm
from mavcal.calib.firmware.plan import Change, Fingerprint, ParameterKind, WritePlan
from mavcal.service.commands.place import CommandPlace
from mavcal.service.commands.review import show_end, show_plan
from mavcal.service.commands.screen import Screen
from mavcal.service.jobs.core.model import Failure, Job
from mavcal.service.jobs.core.states import JobState


def test_an_id_is_shown_with_all_its_digits(capsys: pytest.CaptureFixture[str]) -> None:
    change = Change("CAL_GYRO0_ID", 0, 2147483647, ParameterKind.INT32, "")
    plan = WritePlan(Fingerprint("px4", "u", "1", ()), "0" * 64, (change,), warnings=("said first",))
    show_plan(plan, Screen())
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "    note: said first"
    assert lines[1].split() == ["CAL_GYRO0_ID", "0", "->", "2147483647"]


def test_cause_and_remedy_are_two_sentences() -> None:
    failure = Failure("x", "the vehicle streams no gyro samples", "check that the sensor is there")
    assert f"{failure.cause} {failure.remedy}" == (
        "the vehicle streams no gyro samples. Check that the sensor is there."
    )
    assert Failure("x", "It stopped.", "").cause == "It stopped."


MOUNTED = f"compass 1 is mounted turned by yaw 270. {to_confirm('confirm_mounting')}"


@pytest.mark.parametrize(
    ("blockers", "said"),
    [
        (("too far",), "blocked: nothing was written"),
        ((MOUNTED, "too far"), "blocked: nothing was written"),
        ((MOUNTED,), "`mavcal accept j --confirm-mounting --connect tcp:v:1` writes it"),
        ((), "`mavcal accept j --connect tcp:v:1` writes it"),
    ],
)
def test_nobody_is_told_to_apply_a_plan_that_is_blocked(
    capsys: pytest.CaptureFixture[str], blockers: tuple[str, ...], said: str
) -> None:
    plan = WritePlan(Fingerprint("px4", "u", "1", ()), "0" * 64, (), blockers=blockers)
    screen = Screen(CommandPlace("tcp:v:1"))
    show_end(Job("j", "v", "gyro", {}, JobState.REVIEW, 0.0, 0.0, plan=plan), screen, written=False)
    assert said in capsys.readouterr().err
