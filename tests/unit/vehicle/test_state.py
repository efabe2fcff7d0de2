from __future__ import annotations

import dataclasses
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.vehicle.state import (
    KEPT_TEXTS,
    SILENT_S,
    CalibrationSign,
    Landed,
    OnboardCalibration,
    Refusal,
    VehicleState,
    changed,
    expire,
    reduce,
    restarted,
    writable,
)
from tests.unit.vehicle.fake import heartbeat, landed


def told(*messages: Any, state: VehicleState | None = None, at: float = 100.0, step: float = 0.0) -> VehicleState:
    state = state or VehicleState()
    for k, message in enumerate(messages):
        state = reduce(state, message, at + k * step)
    return state


def throttle(percent: int) -> Any:
    return dialect.MAVLink_vfr_hud_message(0, 0, 0, percent, 0, 0)


def text(words: str | bytes, severity: int = 6, number: int = 0, chunk: int = 0) -> Any:
    raw = words.encode() if isinstance(words, str) else words
    return dialect.MAVLink_statustext_message(severity, raw, number, chunk)


READY = told(*[heartbeat()] * 4, landed(), step=1.0)  # the last heartbeat came at 103


def test_a_changed_state_is_what_replace_makes_and_the_one_before_stays() -> None:
    before = dataclasses.replace(READY)
    after = changed(READY, throttle=0.5, rebooted=2)
    assert after == dataclasses.replace(READY, throttle=0.5, rebooted=2)
    assert before == READY != after
    with pytest.raises(TypeError, match="throtle"):
        changed(READY, throtle=0.5)


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


def test_a_gap_between_heartbeats_is_silence_only_beyond_its_limit() -> None:
    """What was no silence while it lasted is none afterwards: the two seconds go on."""
    at_limit, beyond = 103.0 + SILENT_S, 103.0 + SILENT_S + 0.01  # the last heartbeat came at 103
    assert not READY.silent(at_limit)
    assert told(heartbeat(), state=READY, at=at_limit).disarmed_since == READY.disarmed_since
    assert READY.silent(beyond)
    assert told(heartbeat(), state=READY, at=beyond).disarmed_since == beyond


def test_what_came_and_went_between_two_looks_is_counted() -> None:
    assert (READY.armings, READY.silences, READY.calibrations) == (0, 0, 0)
    later = told(heartbeat(armed=True), heartbeat(), heartbeat(status=2), heartbeat(), state=READY, at=104.0, step=0.5)
    later = told(heartbeat(), state=later, at=109.0)
    assert (later.armings, later.silences, later.calibrations) == (1, 1, 1)
    again = restarted(later, 0.5)
    assert (again.armings, again.silences, again.calibrations) == (1, 1, 1)


def test_heartbeats_that_a_late_reader_took_together_are_no_silence() -> None:
    late = reduce(READY, heartbeat(), now=108.0, since=103.5)  # it came between the two
    assert late.silences == 0
    assert late.disarmed_since == READY.disarmed_since
    assert reduce(READY, heartbeat(), now=108.0, since=106.5).silences == 1


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


@pytest.mark.parametrize(
    ("sign", "stale_s"),
    [
        (CalibrationSign.HEARTBEAT, 3.0),
        (CalibrationSign.TEXT, 120.0),
        (CalibrationSign.POSE, 10.0),
        (CalibrationSign.MAG, 10.0),
        (CalibrationSign.REPORT, 3.0),
    ],
)
def test_how_long_after_its_last_sign_a_calibration_counts_as_running(sign: CalibrationSign, stale_s: float) -> None:
    """Three seconds for what is said again every second: longer would keep a write waiting for nothing."""
    running = OnboardCalibration(sign, "", since=1.0, last=5.0)
    assert not running.over(5.0 + stale_s)
    assert running.over(5.0 + stale_s + 0.1)


def test_px4s_report_after_a_parameter_change_is_no_calibration() -> None:
    assert told(mag_report(0.0, 0), state=READY, at=104).onboard_calibration is None


def test_texts_in_chunks_are_put_together_in_any_order() -> None:
    first, second = "A" * 50, "the end"
    state = told(text(second, number=7, chunk=1), text(first, number=7, chunk=0))
    assert [t.text for t in state.texts] == [first + second]


def test_a_character_that_lies_in_two_chunks_is_one_character() -> None:
    whole = ("a" * 49 + "°C is enough").encode()  # the first 50 bytes end in the middle of a character
    state = told(text(whole[:50], number=7, chunk=0), text(whole[50:], number=7, chunk=1))
    assert [one.text for one in state.texts] == [whole.decode()]


def test_a_full_chunk_is_told_by_its_bytes() -> None:
    first = "é" * 25
    state = told(text(first, number=7, chunk=0))
    assert state.texts == ()
    assert [one.text for one in told(text("!", number=7, chunk=1), state=state).texts] == [first + "!"]


@pytest.mark.parametrize("kept", [1, 2])
def test_a_character_that_the_vehicle_has_cut_off_is_left_out(kept: int) -> None:
    assert [one.text for one in told(text(b"85" + "€".encode()[:kept])).texts] == ["85"]
    assert [one.text for one in told(text(b"85\xff")).texts] == ["85\ufffd"]  # no UTF-8 at all


def test_a_text_with_a_lost_chunk_is_shown_with_its_gap() -> None:
    state = told(text("the end", number=7, chunk=1), text("other", number=8), at=100, step=6.0)
    assert {t.text for t in state.texts} == {"…the end", "other"}


def test_a_restart_takes_back_what_was_said_before() -> None:
    state = restarted(READY, 1.2)
    assert state.landed is Landed.UNDEFINED
    assert state.disarmed_since is None


def test_the_evidence_is_in_sentences() -> None:
    lines = told(throttle(0), state=READY, at=104).evidence(104.5)
    assert any("HEARTBEAT 1.5 s ago: disarmed" in line for line in lines)
    assert any("on_ground" in line for line in lines)


def test_every_limit_is_where_it_is_said_to_be() -> None:
    """Silence after 3 s, disarmed for 2 s, a landed state of at most 10 s ago: the limit itself still counts."""
    assert writable(READY, 106.0).ok
    assert writable(READY, 106.01).refusals[0] is Refusal.SILENT
    young = told(heartbeat(), landed())
    assert writable(young, 102.0).ok
    assert writable(young, 101.99).refusals == (Refusal.ARMED,)
    lately = told(*[heartbeat()] * 10, state=READY, at=105.0, step=1.0)  # landed was said at 104
    assert writable(lately, 114.0).ok
    assert writable(lately, 114.01).refusals == (Refusal.NOT_LANDED,)


def test_zero_throttle_counts_only_while_it_is_fresh_and_the_landed_state_is_unknown() -> None:
    idle = told(landed(0), throttle(0), state=READY, at=104)
    beating = told(*[heartbeat()] * 10, state=idle, at=106.0, step=1.0)  # the throttle was said at 104
    assert writable(beating, 114.0).ok
    assert writable(beating, 114.01).refusals == (Refusal.NOT_LANDED,)
    flying = told(landed(2), throttle(0), state=READY, at=104)
    assert writable(flying, 104.1).reasons == ("the vehicle is not on the ground (in_air)",)
    spinning = told(landed(0), throttle(5), state=READY, at=104)
    assert writable(spinning, 104.1).reasons == ("its landed state is unknown and the throttle is 5%",)


def test_each_reason_is_a_sentence_of_its_own() -> None:
    unheard = writable(VehicleState(), 100.0)
    assert unheard.refusals == (Refusal.SILENT, Refusal.ARMED, Refusal.NOT_LANDED)
    assert len(unheard.reasons) == 3
    assert "no heartbeat" in unheard.reasons[0]
    armed = writable(told(heartbeat(armed=True), state=READY, at=104), 104.1)
    assert armed.refusals == (Refusal.ARMED,)
    assert armed.reasons != unheard.reasons[1:2]
    silent = writable(READY, 110.0)
    assert silent.refusals[0] is Refusal.SILENT
    assert silent.reasons[0].endswith(" 7.0 s")
    answers = writable(told(landed(), state=READY, at=109.0), 110.0)
    assert answers.reasons[0].startswith(silent.reasons[0])
    assert "still answers" in answers.reasons[0]


def test_evidence_says_only_what_was_heard() -> None:
    assert VehicleState().evidence(100.0) == ("no HEARTBEAT heard yet",)
    state = told(heartbeat(armed=True), throttle(40))
    assert state.evidence(101.0) == ("HEARTBEAT 1.0 s ago: armed, status 3", "VFR_HUD 1.0 s ago: throttle 40%")
    calm = told(heartbeat(), landed(), throttle(0))
    assert calm.evidence(101.0) == (
        "HEARTBEAT 1.0 s ago: disarmed, status 3",
        "disarmed for 1.0 s",
        "EXTENDED_SYS_STATE 1.0 s ago: on_ground",
        "VFR_HUD 1.0 s ago: throttle 0%",
    )
    again = restarted(restarted(calm, 1.0), 1.0)
    assert again.evidence(101.0)[-1] == "restarted 2 times since it was found"
    assert not any("restarted" in line for line in calm.evidence(101.0))


def test_a_restart_keeps_what_the_vehicle_does_not_take_back() -> None:
    state = restarted(told(text("hello"), state=told(heartbeat(), landed(), throttle(3)), at=101.0), 2.5)
    assert (state.rebooted, state.boot_time, state.armed) == (1, 2.5, False)
    assert (state.last_heartbeat, state.last_heard, state.system_status) == (100.0, 101.0, 3)
    assert [one.text for one in state.texts] == ["hello"]
    assert (state.landed_at, state.throttle_at, state.disarmed_since) == (None, None, None)


def test_only_the_newest_texts_are_kept() -> None:
    state = told(*(text(f"line {k}") for k in range(KEPT_TEXTS + 3)))
    assert [one.text for one in state.texts] == [f"line {k}" for k in range(3, KEPT_TEXTS + 3)]


def test_a_calibration_that_was_not_heard_of_for_long_is_forgotten_and_nothing_else() -> None:
    assert expire(READY, 1e6) is READY
    state = told(heartbeat(status=2), state=READY, at=104)
    assert state.onboard_calibration is not None
    assert expire(state, 104.1) is state
    assert expire(state, 1e6).onboard_calibration is None


@pytest.mark.parametrize("words", ["[cal] pending: back front", "[cal] hold still", "EKF3 IMU0 started"])
def test_other_words_neither_begin_nor_end_a_calibration(words: str) -> None:
    assert told(text(words), state=READY, at=103.5).onboard_calibration is None
    running = told(text("[cal] calibration started: 2 accel"), state=READY, at=103.5)
    assert told(text(words), state=running, at=104.0).onboard_calibration == running.onboard_calibration


@pytest.mark.parametrize(
    "words", ["[cal] orientation detected: back", "[cal] back side done, rotate to a different side"]
)
def test_every_sign_of_a_calibration_counts(words: str) -> None:
    state = told(text(words), state=READY, at=103.5)
    assert state.onboard_calibration is not None
    assert state.onboard_calibration.text == f"it said '{words}'"


def test_the_end_of_a_compass_calibration_is_its_status_too() -> None:
    running = told(mag_progress(2), state=READY, at=103.5)
    assert told(mag_progress(4), state=running, at=104.0).onboard_calibration is None
    other = told(pose(1), state=READY, at=103.5)
    assert told(mag_progress(4), state=other, at=104.0).onboard_calibration == other.onboard_calibration


def test_a_calibration_of_its_own_is_part_of_the_evidence() -> None:
    state = told(text("[cal] calibration started: 2 accel"))
    assert state.onboard_calibration is not None
    assert state.onboard_calibration.text in state.evidence(101.0)
