from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.firmware.plan import (
    Change,
    Fingerprint,
    ParameterKind,
    ParameterVerdict,
    ProofVerdict,
    Value,
    Verification,
    WritePlan,
)
from mavcal.service.errors import WriteFailed
from mavcal.service.jobs.core.journal import (
    BY_OPERATOR,
    EITHER,
    SOMEBODY,
    JournalStep,
    as_heard,
    as_read,
    fold,
    who_else,
    who_sets,
)
from mavcal.service.jobs.core.model import Failure, Holds, Result
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.write.outcome import WriteOutcome, in_doubt, reverted, succeeded
from tests.unit.jobs.core.test_journal import ACCEPTED, echo, rows, send

REAL = ParameterKind.REAL32
BACK = "The old values are back, read and verified."
READINGS = st.lists(st.sampled_from(["old", "new", "other"]), min_size=1, max_size=9)
VALUES = {"old": 0.25, "new": 0.5, "other": 0.125}


def plan_of(count: int, *, session: bool = False) -> WritePlan:
    changes = tuple(
        Change(f"P{i}", 0.25, 0.5, REAL, "offset", session=session and i == 0, sd=1e-4) for i in range(count)
    )
    return WritePlan(Fingerprint("px4", "u", "1", ()), "0" * 64, changes)


def read(kinds: list[str], plan: WritePlan, who: str) -> Any:
    old: dict[str, Value] = {c.name: 0.25 for c in plan.changes}
    return as_read(plan, old, {f"P{i}": VALUES[kind] for i, kind in enumerate(kinds)}, who)


def text_of(told: WriteOutcome) -> str:
    return told.outcome.text if isinstance(told.outcome, Result) else f"{told.outcome.cause} {told.outcome.remedy}"


def check_named(told: WriteOutcome) -> None:
    """Every parameter of the list is in the sentence with its value, or counted there; and no other is."""
    text = text_of(told)
    for known in told.standing[:3]:
        assert f"{known.name}, which" in text or f"{known.name} (now {known.value}" in text
    for other in {f"P{i}" for i in range(9)} - {s.name for s in told.standing}:
        assert other not in text
    assert (f"and {len(told.standing) - 3} more" in text) == (len(told.standing) > 3)


@given(kinds=READINGS, asked=st.booleans(), who=st.sampled_from([SOMEBODY, EITHER]))
def test_what_is_said_of_a_rollback_and_its_list_never_contradict(kinds: list[str], asked: bool, who: str) -> None:
    plan = plan_of(len(kinds))
    cause = None if asked else "accepted but without effect on the stream"
    if "new" in kinds:
        with pytest.raises(WriteFailed):  # ours is still there: no sentence may say that it was taken back
            reverted(read(kinds, plan, who), cause, who, len(kinds))
        return
    told = reverted(read(kinds, plan, who), cause, who, len(kinds))
    away = {f"P{i}" for i, kind in enumerate(kinds) if kind == "other"}
    assert {s.name for s in told.standing} == away
    assert (BACK in text_of(told)) == (not away)
    assert ("No old value is back" in text_of(told)) == (len(away) == len(kinds))
    assert (who in text_of(told)) == bool(away)
    check_named(told)
    if cause is not None:
        assert isinstance(told.outcome, Failure)
        assert told.outcome.cause == "accepted but without effect on the stream."


@given(kinds=READINGS, who=st.sampled_from([SOMEBODY, EITHER]), verdict=st.sampled_from([*ProofVerdict, None]))
def test_what_is_said_of_a_success_and_its_list_never_contradict(
    kinds: list[str], who: str, verdict: ProofVerdict | None
) -> None:
    plan = plan_of(len(kinds), session=True)
    checked = None if verdict is None else Verification((ParameterVerdict("P0", verdict, 1.0, 0.1, "", "why"),))
    if set(kinds[1:]) - {"new"}:
        with pytest.raises(WriteFailed):
            succeeded(read(kinds, plan, who), plan, checked, who)
        return
    told = succeeded(read(kinds, plan, who), plan, checked, who)
    assert isinstance(told.outcome, Result)
    assert {s.name for s in told.standing} == ({"P0"} if kinds[0] != "old" else set())
    assert (told.outcome.proof == "full") == (verdict == ProofVerdict.PROVED)
    assert told.outcome.proof_reason in told.outcome.text


@given(sent=st.lists(st.booleans(), min_size=1, max_size=5), doubt=st.sampled_from([None, "before it fell silent"]))
def test_a_doubt_lists_what_was_sent_and_claims_nothing(sent: list[bool], doubt: str | None) -> None:
    steps: list[tuple[JournalStep, dict[str, Any]]] = [ACCEPTED]
    for i, confirmed in enumerate(sent):
        steps += [send(f"P{i}"), echo(f"P{i}")] if confirmed else [send(f"P{i}")]
    told = in_doubt(as_heard(fold(rows(*steps)), {}, doubt), "the vehicle is armed")
    assert told.state == JobState.IN_DOUBT
    assert [s.name for s in told.standing] == [f"P{i}" for i in range(len(sent))]
    assert [s.certain for s in told.standing] == [confirmed and doubt is None for confirmed in sent]
    assert all((s.holds == Holds.UNKNOWN) == (not s.certain) for s in told.standing)
    assert "back" not in text_of(told).replace("taken back by itself", "")


STOPPED, BACKWARD = JournalStep.STOPPED, JournalStep.ROLL_BACK


@pytest.mark.parametrize(
    ("steps", "who"),
    [
        ((), SOMEBODY),
        (((BACKWARD, {"because": "no effect"}),), SOMEBODY),
        (((STOPPED, {"reason": "armed", "restarted": False, "interrupted": False}),), SOMEBODY),
        (((STOPPED, {"reason": "restarted", "restarted": True}),), EITHER),
        (((STOPPED, {"reason": "interrupted", "interrupted": True}),), EITHER),
        (((JournalStep.REBOOTED, {}),), EITHER),
        (((BACKWARD, {"because": BY_OPERATOR}),), EITHER),  # it may have restarted any number of times since
        ((send("S", 0, 1, session=True), (JournalStep.UNDONE, {"name": "S", "value": 1})), EITHER),
    ],
)
def test_who_may_have_set_a_value(steps: tuple[tuple[JournalStep, dict[str, Any]], ...], who: str) -> None:
    assert who_else(fold(rows(ACCEPTED, send("A"), echo("A"), *steps)), plan_of(2)) == who


@pytest.mark.parametrize(
    ("name", "who"), [("CAL_GYRO2_YOFF", EITHER), ("INS_GYR2OFFS_Y", SOMEBODY), ("CAL_ACC2_YOFF", SOMEBODY)]
)
def test_px4_rewrites_its_gyro_offsets_at_rest(name: str, who: str) -> None:
    plan = WritePlan(Fingerprint("px4", "u", "1", ()), "0" * 64, (Change(name, 0.25, 0.5, REAL, "offset", sd=1e-4),))
    record = fold(rows(ACCEPTED, send(name), (JournalStep.LEFT, {"name": name, "value": 0.125})))
    assert (who_sets(name), who_else(record, plan)) == (who, who)
    assert as_heard(record, {name: 0.125})[0].note == f"set by {who}"


def test_standing_is_certain_only_where_the_vehicle_confirmed_and_nothing_else_was_heard() -> None:
    record = fold(rows(ACCEPTED, send("A"), echo("A"), send("B", 0.25)))
    by_name = {s.name: s for s in as_heard(record, {})}
    assert (by_name["A"].value, by_name["A"].certain) == (0.5, True)
    assert (by_name["B"].value, by_name["B"].certain) == (None, False)
    late = {s.name: s for s in as_heard(record, {"A": 0.9, "B": 0.0})}
    assert (late["A"].value, late["A"].certain) == (0.9, False)
    assert (late["B"].value, late["B"].certain) == (0.0, False)  # may be an echo from before the PARAM_SET


def test_nothing_is_certain_once_the_vehicle_may_calibrate_by_itself_again() -> None:
    steps = (ACCEPTED, send("S", 0, 1, session=True), echo("S", 0), send("A"), echo("A"))
    assert {s.name: s.certain for s in as_heard(fold(rows(*steps)), {})} == {"S": True, "A": True}
    back = fold(rows(*steps, (JournalStep.UNDONE, {"name": "S", "value": 1})))
    by_name = {s.name: s for s in as_heard(back, {})}
    assert (by_name["S"].certain, by_name["A"].certain) == (True, False)
    assert "since S was put back" in by_name["A"].note


def test_a_parameter_is_certain_only_where_it_was_read() -> None:
    plan = WritePlan(
        Fingerprint("px4", "u", "1", ()),
        "0" * 64,
        tuple(Change(name, 9.0, 1.0, ParameterKind.REAL32, "") for name in ("OLD", "NEW", "OTHER", "UNREAD")),
    )
    old = dict.fromkeys(("OLD", "NEW", "OTHER", "UNREAD"), 0.5)
    found = {s.name: s for s in as_read(plan, old, {"OLD": 0.5, "NEW": 1.0, "OTHER": 2.0}, SOMEBODY)}
    assert [s.certain for s in found.values()] == [True, True, True, False]
    assert [s.holds for s in found.values()] == [Holds.OLD, Holds.NEW, Holds.OTHER, Holds.UNKNOWN]
    assert [s.note for s in found.values()] == ["", "", f"set by {SOMEBODY}; it is left so", ""]
    assert [(s.old, s.new) for s in found.values()] == [(0.5, 1.0)] * 4  # old is what it held, not what the plan says
    assert found["OTHER"].value == 2.0
    assert found["UNREAD"].value is None
