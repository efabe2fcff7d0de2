from __future__ import annotations

from calib.firmware.movement import FACES
from calib.procedures.protocol import Pose
from service.jobs.verify import POSES, proving


def test_every_face_that_a_movement_can_name_is_a_pose() -> None:
    assert set(POSES) == {label for label, _ in FACES}


def test_a_movement_becomes_a_prompt_that_a_panel_can_draw() -> None:
    prompt = proving("Hold it still on its left side, then nose down")
    assert prompt.remaining == (Pose.LEFT, Pose.NOSE_DOWN)
    assert not prompt.rotate
    assert prompt.answers == ("finish",)
    turning = proving("Turn the vehicle slowly through all directions")
    assert turning.rotate
    assert turning.remaining == ()
