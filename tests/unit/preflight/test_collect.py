"""Frames of a vehicle to what a preflight looks at."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.preflight.collect import (
    PREARM,
    SYS_STATUS,
    VIBRATION,
    collect,
    gathered,
    preflight_streams,
    wanted_messages,
)
from mavcal.calib.recording import Identity, Sensor, Stage
from mavcal.calib.wire.frames import Frame, FrameParser

ARDUPILOT = Identity("ardupilot", system=1, component=1)
PX4 = Identity("px4", system=1, component=1)


def frames(*messages: Any) -> list[Frame]:
    packer = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    parser = FrameParser()
    return [frame for message in messages for frame in parser.feed(message.pack(packer))]


def status(present: int, health: int, current: int = 10) -> Any:
    return dialect.MAVLink_sys_status_message(present, present, health, 0, 12000, current, 90, 0, 0, 0, 0, 0, 0, 0, 0)


@pytest.mark.parametrize(
    ("present", "health", "expected"),
    [(PREARM, PREARM, (True, True)), (PREARM, 0, (True, False)), (0, PREARM, (False, None))],
)
def test_the_bit_of_the_arming_checks(present: int, health: int, expected: tuple[bool, bool | None]) -> None:
    view = collect(frames(status(present, health)), ARDUPILOT, {}, asked=True).view
    assert (view.present, view.ready) == expected


def heartbeat(state: int) -> Any:
    return dialect.MAVLink_heartbeat_message(2, 12, 29, 0, state, 3)


@pytest.mark.parametrize(
    ("health", "state", "ready"),
    [(PREARM, 3, True), (PREARM, None, True), (0, 0, False), (0, 3, True), (0, 4, None), (0, None, None)],
)
def test_px4_says_that_it_is_ready_by_its_health_or_its_heartbeat(
    health: int, state: int | None, ready: bool | None
) -> None:
    """It sets the bit among what is healthy alone; a vehicle that stands by has passed its checks."""
    said = [status(0, health)] + ([] if state is None else [heartbeat(state)])
    view = collect(frames(*said), PX4, {}, asked=True).view
    assert (view.present, view.ready) == (False, ready)


def test_what_the_vehicle_calls_unhealthy_is_kept_by_kind() -> None:
    gyro, accel = dialect.MAV_SYS_STATUS_SENSOR_3D_GYRO, dialect.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    found = collect(frames(status(PREARM | gyro | accel, PREARM | accel)), ARDUPILOT, {}, asked=True)
    assert found.view.ill == {Sensor.GYRO}


def imu(t_ms: int, instance: int = 0) -> Any:
    kind = (dialect.MAVLink_scaled_imu_message, dialect.MAVLink_scaled_imu2_message)[instance]
    return kind(t_ms, 0, 0, -1000, 0, 0, 0, 300, 0, 400, 2500)


def test_samples_are_waited_for_until_every_stream_that_comes_has_enough() -> None:
    assert not gathered([], "px4").enough
    slow = [imu(1000 * k, 1) for k in range(16)]
    fast = [imu(100 * k) for k in range(160)]
    found = gathered(frames(*fast, *slow), "px4")
    assert (found.messages, found.enough) == ({0: 160, 1: 16}, False)
    assert "16 messages" in found.text
    assert gathered(frames(*fast, *[imu(1000 * k, 1) for k in range(30)]), "px4").enough
    assert gathered(frames(*fast), "px4").enough  # a unit that never sends is not waited for
    assert not gathered(frames(*[imu(20 * k) for k in range(60)]), "px4").enough  # a second: too short for a compass


def field(instance: int, *fields: int, every_ms: int = 100) -> list[Any]:
    kind = (dialect.MAVLink_scaled_imu_message, dialect.MAVLink_scaled_imu2_message)[instance]
    return [kind(every_ms * k, 0, 0, -1000, 0, 0, 0, x, 0, 400, 2500) for k, x in enumerate(fields)]


def test_a_compass_that_shows_no_step_is_watched_unless_no_other_shows_one() -> None:
    still, moving = [300] * 40, [300, 301] * 20
    assert gathered(frames(*field(0, *still), *field(1, *moving)), "px4").still == {0}
    assert gathered(frames(*field(0, *still)), "px4").still == {0}
    assert not gathered(frames(*field(0, *moving), *field(1, *moving)), "px4").still
    assert not gathered(frames(*field(0, *still), *field(1, *still)), "px4").still  # no time would tell


def test_a_finer_message_shows_what_a_rounded_one_hides() -> None:
    rounded = [dialect.MAVLink_raw_imu_message(100_000 * k, 0, 0, -1000, 0, 0, 0, 300, 0, 400) for k in range(40)]
    fine = [
        dialect.MAVLink_highres_imu_message(
            100_000 * k, 0, 0, -9.8, 0, 0, 0, 0.3 + 1e-5 * k, 0, 0.4, 0, 0, 0, 20, 0x1FF
        )
        for k in range(40)
    ]
    assert gathered(frames(*rounded), "ardupilot").still == {0}
    assert not gathered(frames(*rounded, *fine), "ardupilot").still


def test_texts_against_arming_are_kept_whole_and_once() -> None:
    text = dialect.MAVLink_statustext_message(2, b"PreArm: uncalibrated", 0, 0)
    other = dialect.MAVLink_statustext_message(6, b"ArduCopter V4.6.0", 0, 0)
    found = collect(frames(text, other, text), ARDUPILOT, {}, asked=True)
    assert found.view.texts == ("PreArm: uncalibrated",)


def test_vibration_of_px4_is_its_z_alone() -> None:
    message = dialect.MAVLink_vibration_message(0, 7.0, 8.0, 9.0, 1, 2, 3)
    assert collect(frames(message), ARDUPILOT, {}, asked=True).shaking.levels == (7.0, 8.0, 9.0)
    found = collect(frames(message), PX4, {}, asked=True).shaking
    assert found is not None
    assert (found.levels, found.clips) == ((9.0,), (1, 2, 3))


def test_whether_a_current_is_measured() -> None:
    assert collect(frames(status(0, 0, -1)), ARDUPILOT, {}, asked=True).current_known is False
    assert collect(frames(status(0, 0, 0)), ARDUPILOT, {}, asked=True).current_known is True
    assert collect([], ARDUPILOT, {}, asked=True).current_known is None


def test_a_raw_compass_of_px4_is_corrected() -> None:
    parameters: dict[str, float | int] = {"SENS_BOARD_ROT": 0, "CAL_MAG0_ID": 5, "CAL_MAG0_ROT": -1}
    parameters |= {f"SENS_BOARD_{axis}_OFF": 0.0 for axis in "XYZ"}
    parameters |= {f"CAL_MAG0_{axis}{what}": value for axis in "XYZ" for what, value in
                   (("OFF", 0.1), ("SCALE", 1.0), ("ODIAG", 0.0), ("COMP", 0.0))}  # fmt: skip
    parameters |= {f"CAL_MAG{k}_ID": 0 for k in (1, 2, 3)} | {"CAL_MAG0_PRIO": 50, "CAL_MAG_COMP_TYP": 0}
    parameters |= {f"CAL_MAG0_{angle}": 0.0 for angle in ("ROLL", "PITCH", "YAW")}
    message = dialect.MAVLink_scaled_imu_message(100, 0, 0, -1000, 0, 0, 0, 300, 0, 400, 2500)
    channel = collect(frames(message), PX4, parameters, asked=True).recording.find(Sensor.MAG)[0]
    assert channel.stage == Stage.CORRECTED
    np.testing.assert_allclose(channel.values[0], [20.05, -10.0, 30.05], atol=1e-6)


@pytest.mark.parametrize("identity", [ARDUPILOT, PX4])
def test_what_is_asked_for_is_listened_to(identity: Identity) -> None:
    assert {VIBRATION, SYS_STATUS} <= preflight_streams(identity.autopilot or "").keys()
    heard = wanted_messages(identity)
    silent = {dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE}  # of the vehicle's state, which listens by itself
    assert preflight_streams(identity.autopilot or "").keys() - silent <= heard
