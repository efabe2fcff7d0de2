from __future__ import annotations

from typing import Any

import pytest

from mavcal.calib.firmware.plan import Change, Fingerprint, ParameterKind, Value, WritePlan
from mavcal.service.jobs.core.journal import JournalStep, Next, decide, fold, same
from mavcal.service.store.rows import JournalRow

REAL = ParameterKind.REAL32


def plan(*, session: bool = False, reboot: bool = False) -> WritePlan:
    changes = (
        Change("S", 1, 0, ParameterKind.INT32, "off", session=True),
        Change("A", 0.0, 0.5, REAL, "offset", needs_reboot=reboot),
        Change("B", 0.0, 0.25, REAL, "offset"),
    )
    return WritePlan(Fingerprint("px4", "u", "1", ()), "0" * 64, changes if session else changes[1:])


def rows(*steps: tuple[JournalStep, dict[str, Any]]) -> list[JournalRow]:
    return [JournalRow(i, "j", 0.0, step.value, data) for i, (step, data) in enumerate(steps)]


def send(name: str, new: Value = 0.5, old: Value = 0.0, *, session: bool = False) -> tuple[JournalStep, dict[str, Any]]:
    kind = "int32" if session else "real32"
    return JournalStep.SEND, {"name": name, "old": old, "new": new, "kind": kind, "session": session}


def echo(name: str, value: Value = 0.5) -> tuple[JournalStep, dict[str, Any]]:
    return JournalStep.ECHO, {"name": name, "value": value}


ACCEPTED: tuple[JournalStep, dict[str, Any]] = (JournalStep.ACCEPTED, {})
ALL = (ACCEPTED, send("A"), echo("A"), send("B", 0.25), echo("B", 0.25))
NEW = {"A": 0.5, "B": 0.25}


@pytest.mark.parametrize(
    ("steps", "values", "expected"),
    [
        ((ACCEPTED,), {}, Next.NOTHING_SENT),
        ((ACCEPTED, (JournalStep.SNAPSHOT, {"sha256": "0"})), {}, Next.NOTHING_SENT),
        ((ACCEPTED, send("A")), {"A": 0.0}, Next.ROLL_BACK),
        ((ACCEPTED, send("A")), {"A": 0.5}, Next.ROLL_BACK),  # B was never sent
        (ALL, NEW, Next.VERIFY),
        (ALL[:-1], NEW, Next.VERIFY),  # the echo was lost with the crash; the vehicle says it is there
        (ALL, {"A": 0.5, "B": 0.0}, Next.ROLL_BACK),
        (ALL, {"A": 0.5, "B": 0.7}, Next.ROLL_BACK),  # somebody else's value
        ((*ALL, (JournalStep.ROLL_BACK, {"because": "x"})), NEW, Next.ROLL_BACK),  # never forward again
        ((*ALL, (JournalStep.VERIFIED, {})), NEW, Next.FINISH),
        ((*ALL, (JournalStep.VERIFIED, {})), {"A": 0.5, "B": 0.7}, Next.ROLL_BACK),
    ],
)
def test_what_follows(
    steps: tuple[tuple[JournalStep, dict[str, Any]], ...], values: dict[str, Value], expected: Next
) -> None:
    assert decide(fold(rows(*steps)), plan(), values) == expected


def test_a_reboot_is_asked_for_once() -> None:
    assert decide(fold(rows(*ALL)), plan(reboot=True), NEW) == Next.REBOOT
    assert decide(fold(rows(*ALL, (JournalStep.REBOOT, {}))), plan(reboot=True), NEW) == Next.REBOOT
    assert (
        decide(fold(rows(*ALL, (JournalStep.REBOOT, {}), (JournalStep.REBOOTED, {}))), plan(reboot=True), NEW)
        == Next.VERIFY
    )


def test_a_session_setting_may_be_back_once_the_write_is_verified() -> None:
    steps = (ACCEPTED, send("S", 0, 1, session=True), echo("S", 0), *ALL[1:])
    back = {**NEW, "S": 1}
    assert decide(fold(rows(*steps)), plan(session=True), back) == Next.ROLL_BACK
    assert decide(fold(rows(*steps, (JournalStep.VERIFIED, {}))), plan(session=True), back) == Next.FINISH
    third = fold(rows(*steps, (JournalStep.VERIFIED, {}), (JournalStep.RESTORED, {"name": "S", "value": 7})))
    assert decide(third, plan(session=True), {**NEW, "S": 7}) == Next.FINISH


def test_a_new_accept_begins_anew_but_owes_the_message_rates() -> None:
    record = fold(
        rows((JournalStep.STREAMS, {"intervals": {"26": 0}}), *ALL, (JournalStep.ROLL_BACK, {"because": "x"}), ACCEPTED)
    )
    assert (record.sent, record.rolling_back) == ((), None)
    assert record.intervals == {26: 0}


def test_the_first_rates_are_the_ones_to_restore() -> None:
    record = fold(
        rows(
            (JournalStep.STREAMS, {"intervals": {"26": 0}}),
            (JournalStep.STREAMS, {"intervals": {"26": 20000, "27": -1}}),
        )
    )
    assert record.intervals == {26: 0, 27: -1}
    assert (
        fold(rows((JournalStep.STREAMS, {"intervals": {"26": 0}}), (JournalStep.STREAMS_RESTORED, {}))).intervals == {}
    )


def test_the_first_reason_of_a_stop_stays_but_silence_was_a_restart() -> None:
    silent = (JournalStep.STOPPED, {"reason": "silent", "silent": True})
    restarted = (JournalStep.STOPPED, {"reason": "restarted", "restarted": True})
    armed = (JournalStep.STOPPED, {"reason": "armed", "restarted": False})
    assert fold(rows(*ALL, silent, restarted, armed)).stopped == "restarted"
    assert fold(rows(*ALL, armed, restarted)).stopped == "armed"
    assert fold(rows(*ALL, armed, restarted)).restarted
    assert fold(rows(*ALL, restarted, silent)).stopped == "restarted"
    assert fold(rows(*ALL, restarted, ACCEPTED)).stopped is None


def test_values_are_compared_as_they_are_on_the_wire() -> None:
    assert same(0.1, 0.10000000149011612, REAL)
    assert not same(0.1, 0.10000001639127731, REAL)  # the next float32
    assert same(-8388000, -8388000, ParameterKind.INT32)
    assert not same(16777217, 16777216, ParameterKind.INT32)


def test_a_value_that_is_sent_again_is_one_entry_and_waits_for_its_echo_again() -> None:
    record = fold(rows(ACCEPTED, send("A"), echo("A"), send("B", 0.25), send("A")))
    assert [sent.name for sent in record.sent] == ["A", "B"]
    assert [sent.confirmed for sent in record.sent] == [None, None]


@pytest.mark.parametrize("step", JournalStep)
def test_every_step_is_understood_by_recovery(step: JournalStep) -> None:
    """What is only announced, and needs no deed of recovery, changes nothing."""
    _, said = send("A")
    said |= {
        "value": 0.5,
        "intervals": {"27": 1},
        "at": 1.0,
        "boot_time": 2.0,
        "index": 0,
        "because": "b",
        "reason": "r",
    }
    begun = (ACCEPTED, send("A"), echo("A", 0.25), (JournalStep.STREAMS, {"intervals": {"30": 2}}))
    before, after = fold(rows(*begun)), fold(rows(*begun, (step, said)))
    assert (after == before) == (step in {JournalStep.SNAPSHOT, JournalStep.COMMAND})


@pytest.mark.parametrize("step", [JournalStep.SEND, JournalStep.ECHO, JournalStep.RESTORED, JournalStep.LEFT])
def test_a_row_that_names_no_parameter_is_damaged(step: JournalStep) -> None:
    with pytest.raises(KeyError):
        fold(rows((step, {"value": 1.0})))
