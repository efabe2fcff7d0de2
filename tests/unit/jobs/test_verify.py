from __future__ import annotations

from calib.firmware.movement import FACES
from calib.firmware.plan import Movement
from calib.procedures.protocol import Pose
from service.jobs.verify import proving


def test_every_face_that_a_movement_can_name_is_a_pose() -> None:
    assert {face for face, _, _ in FACES} == {pose.value for pose in Pose} - {"oblique"}


def test_a_movement_becomes_a_prompt_that_a_panel_can_draw() -> None:
    prompt = proving(Movement("Hold it", faces=("left", "nose_down"), temperature=25.0))
    assert prompt.remaining == (Pose.LEFT, Pose.NOSE_DOWN)
    assert not prompt.rotate
    assert prompt.temperature == 25.0
    assert prompt.answers == ("finish",)
    turning = proving(Movement("Turn it", turn=True))
    assert turning.rotate
    assert turning.remaining == ()
