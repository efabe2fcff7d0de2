from __future__ import annotations

import asyncio

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.firmware.plan import Movement
from mavcal.calib.firmware.proof.verify import FACES
from mavcal.calib.procedures.protocol import Pose
from mavcal.calib.wire.codec import encode, raw_message
from mavcal.calib.wire.frames import FrameParser
from mavcal.service.errors import CaptureEnded
from mavcal.service.jobs.write.stream_check import POLL_S, Window, proving
from tests.unit.jobs.conftest import QUICK
from tests.unit.jobs.fakes import FakeVehicle


def test_every_face_that_a_movement_can_name_is_a_pose() -> None:
    assert {face for face, _, _ in FACES} == {pose.value for pose in Pose} - {"oblique"}


def test_a_movement_becomes_a_prompt_that_a_panel_can_draw() -> None:
    prompt = proving(Movement("Hold it", faces=("left", "nose_down"), temperature=25.0), 1)
    assert prompt.remaining == (Pose.LEFT, Pose.NOSE_DOWN)
    assert not prompt.rotate
    assert prompt.temperature == 25.0
    assert prompt.answers == ("finish",)
    turning = proving(Movement("Turn it", turn=True), 1)
    assert turning.rotate
    assert turning.remaining == ()


class Rest:
    """A vehicle at rest that sends RAW_IMU with time stamps of its own."""

    def __init__(self) -> None:
        self.vehicle = FakeVehicle({})
        self.parser = FrameParser()

    def send(self, *seconds: float) -> None:
        for t in seconds:
            message = dialect.MAVLink_raw_imu_message(round(1e6 * t), 0, 0, -1000, 0, 0, 0, 1, 2, 3, 0, 2500)
            self.vehicle.deliver(tuple(self.parser.feed(encode(raw_message(message), 1, 1, 0))))


async def test_a_window_is_as_long_as_the_vehicles_clock_says_and_grows() -> None:
    rest = Rest()
    with Window(rest.vehicle, QUICK) as window:
        first = asyncio.create_task(window.extend(1.0))
        await asyncio.sleep(0)
        rest.send(10.0, 10.5)
        await asyncio.sleep(3 * POLL_S)
        assert not first.done()
        rest.send(11.0)
        assert (await first).span == (10.0, 11.0)
        second = asyncio.create_task(window.extend(1.0))
        await asyncio.sleep(0)
        rest.send(12.0, 12.9)
        await asyncio.sleep(3 * POLL_S)
        assert not second.done()
        rest.send(13.0)
        assert (await second).span == (10.0, 13.0)
    assert rest.vehicle._frames == []


async def test_a_window_without_inertial_data_is_given_up_after_its_time() -> None:
    now = [0.0]
    with Window(FakeVehicle({}), QUICK, lambda: now[0]) as window:
        waiting = asyncio.create_task(window.extend(1.0))
        await asyncio.sleep(0)
        now[0] = QUICK.window_timeout_s
        await asyncio.sleep(3 * POLL_S)
        assert not waiting.done()
        now[0] += 0.1
        with pytest.raises(CaptureEnded, match="sends no inertial data"):
            await waiting
