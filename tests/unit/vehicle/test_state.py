from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from service.vehicle.calibration import CalibrationSign
from service.vehicle.state import Landed, Refusal, VehicleState, note_boot_time, reduce, writable
from tests.unit.vehicle.fake import heartbeat, landed


def told(*messages: Any, state: VehicleState | None = None, at: float = 100.0, step: float = 0.0) -> VehicleState:
    state = state or VehicleState()
    for k, message in enumerate(messages):
        state = reduce(state, message, at + k * step)
    return state


def throttle(percent: int) -> Any:
    return dialect.MAVLink_vfr_hud_message(0, 0, 0, percent, 0, 0)


def text(words: str, severity: int = 6, number: int = 0, chunk: int = 0) -> Any:
    return dialect.MAVLink_statustext_message(severity, words.encode(), number, chunk)


READY = told(*[heartbeat()] * 4, landed(), step=1.0)  # the last heartbeat came at 103


def test_a_vehicle_that_is_disarmed_landed_and_alive_is_writable() -> None:
    assert writable(READY, 104.5).ok


@pytest.mark.parametrize(
    ("state", "now", "why"),
    [
        (VehicleState(), 100.0, Refusal.SILENT),
        (READY, 106.1, Refusal.SILENT),
        (told(heartbeat(armed=True), state=READY, at=104), 104.1, Refusal.ARMED),
        (told(heartbeat(armed=True), heartbeat(), state=READY, at=104, step=1), 106.9, Refusal.ARMED),
        (told(heartbeat(), landed()), 101.9, Refusal.ARMED),
        (told(landed(2), state=READY, at=104), 104.1, Refusal.NOT_LANDED),
        (told(landed(3), state=READY, at=104), 104.1, Refusal.NOT_LANDED),
        (told(landed(0), state=READY, at=104), 104.1, Refusal.NOT_LANDED),
        (told(landed(0), throttle(5), state=READY, at=104), 104.1, Refusal.NOT_LANDED),
        (told(heartbeat(), heartbeat(), heartbeat(), heartbeat(), step=1.0), 103.5, Refusal.NOT_LANDED),
        (told(heartbeat(status=2), state=READY, at=104), 104.1, Refusal.CALIBRATING),
    ],
)
def test_every_single_doubt_forbids_writing(state: VehicleState, now: float, why: Refusal) -> None:
    found = writable(state, now)
    assert not found.ok
    assert found.refusals == (why,) or (why in found.refusals and state == VehicleState())
    assert found.reasons


def test_an_unknown_landed_state_with_zero_throttle_is_on_the_ground() -> None:
    assert writable(told(landed(0), throttle(0), state=READY, at=104), 104.1).ok


def test_a_landed_state_of_long_ago_says_nothing() -> None:
    state = told(*[heartbeat()] * 20, state=READY, at=104, step=1.0)
    assert writable(state, 123.5).refusals == (Refusal.NOT_LANDED,)


def test_silence_starts_the_two_seconds_again() -> None:
    state = told(heartbeat(), landed(), state=READY, at=110.0)
    assert writable(state, 111.9).refusals == (Refusal.ARMED,)
    state = told(heartbeat(), state=state, at=111.0)
    assert writable(state, 112.1).ok


def test_a_frozen_vehicle_that_still_answers_is_silent() -> None:
    state = told(throttle(0), state=READY, at=109.0)
    found = writable(state, 109.5)
    assert Refusal.SILENT in found.refusals
    assert any("frozen" in reason for reason in found.reasons)


def mag_progress(status: int) -> Any:
    return dialect.MAVLink_mag_cal_progress_message(0, 1, status, 1, 30, [0] * 10, 0.0, 0.0, 0.0)


def mag_report(fitness: float, autosaved: int) -> Any:
    return dialect.MAVLink_mag_cal_report_message(0, 1, 4, autosaved, fitness, *[0.0] * 9)


def pose(value: float) -> Any:
    return dialect.MAVLink_command_long_message(253, 190, 42429, 0, value, *[0.0] * 6)


@pytest.mark.parametrize(
    ("begins", "ends", "sign"),
    [
        (heartbeat(status=2), heartbeat(), CalibrationSign.HEARTBEAT),
        (text("[cal] calibration started: 2 accel"), text("[cal] calibration done: accel"), CalibrationSign.TEXT),
        (text("[cal] progress <10>"), text("[cal] calibration failed: timeout"), CalibrationSign.TEXT),
        (pose(1), pose(16777215), CalibrationSign.POSE),
        (pose(6), pose(16777216), CalibrationSign.POSE),
        (mag_progress(2), mag_report(8.0, 1), CalibrationSign.MAG),
        (mag_report(8.0, 0), mag_report(8.0, 1), CalibrationSign.REPORT),
    ],
)
def test_an_onboard_calibration_is_seen_to_begin_and_to_end(begins: Any, ends: Any, sign: CalibrationSign) -> None:
    state = told(begins, state=READY, at=103.5)
    assert state.onboard_calibration is not None
    assert state.onboard_calibration.sign is sign
    assert writable(state, 104.0).refusals == (Refusal.CALIBRATING,)
    assert writable(told(ends, state=state, at=104.0), 104.1).ok


def test_a_calibration_whose_end_was_lost_does_not_last_for_ever() -> None:
    state = told(pose(2), state=READY, at=104)
    state = told(*[heartbeat(), landed()] * 12, state=state, at=104.0, step=0.5)
    assert writable(state, 115.9).ok
    state = told(text("[cal] calibration started: 2 gyro"), state=READY, at=104)
    assert told(heartbeat(), state=state, at=105).onboard_calibration is not None
    assert told(heartbeat(), state=state, at=108).onboard_calibration is None


def test_px4s_report_after_a_parameter_change_is_no_calibration() -> None:
    assert told(mag_report(0.0, 0), state=READY, at=104).onboard_calibration is None


def test_texts_in_chunks_are_put_together_in_any_order() -> None:
    first, second = "A" * 50, "the end"
    state = told(text(second, number=7, chunk=1), text(first, number=7, chunk=0))
    assert [t.text for t in state.texts] == [first + second]


def test_a_text_with_a_lost_chunk_is_shown_with_its_gap() -> None:
    state = told(text("the end", number=7, chunk=1), text("other", number=8), at=100, step=6.0)
    assert {t.text for t in state.texts} == {"…the end", "other"}


def test_only_several_messages_from_before_are_a_restart() -> None:
    state = note_boot_time(note_boot_time(VehicleState(), 50.0), 60.0)
    late = note_boot_time(note_boot_time(state, 40.0), 60.1)
    assert late.rebooted == 0
    assert note_boot_time(note_boot_time(late, 58.0), 60.2).rebooted == 0
    again = state
    for stamp in (1.0, 1.1, 1.2, 1.3):
        again = note_boot_time(again, stamp)
    assert again.rebooted == 1
    assert again.boot_time == 1.3


def test_a_restart_takes_back_what_was_said_before() -> None:
    state = READY
    for stamp in (100.0, 1.0, 1.1, 1.2):
        state = note_boot_time(state, stamp)
    assert state.landed is Landed.UNDEFINED
    assert state.disarmed_since is None


def test_the_evidence_is_in_sentences() -> None:
    lines = told(throttle(0), state=READY, at=104).evidence(104.5)
    assert any("HEARTBEAT 1.5 s ago: disarmed" in line for line in lines)
    assert any("on_ground" in line for line in lines)
