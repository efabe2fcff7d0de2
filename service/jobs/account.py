"""Outcome and standing of a job after a write, both made from the same readings of its vehicle.

No other module makes either, so a sentence never claims more than was read. All functions are pure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mavcal.calib.firmware.in_force.fingerprint import REWRITTEN_AT_REST
from mavcal.calib.firmware.plan import ParameterKind, Value, Verification, WritePlan
from mavcal.calib.firmware.values import shown
from mavcal.service.errors import WriteFailed
from mavcal.service.jobs.journal import BY_OPERATOR, WriteRecord, same
from mavcal.service.jobs.model import Failure, Holds, Outcome, Result, Standing, Unwritten
from mavcal.service.jobs.proof import Proof, ProofLevel, proof_of
from mavcal.service.jobs.states import JobState

NAMED = 3
"""So many parameters are named in a sentence; `standing` lists them all."""

SOMEBODY = "somebody else"
EITHER = "the vehicle itself or somebody else"

RESOLVE = "Disarm the vehicle and keep it on the ground and in reach: this is then finished or taken back by itself."
READ_BACK_ONLY = Proof(ProofLevel.NONE, "The old values were read back; no stream was checked.")


@dataclass(frozen=True)
class Account:
    """The state that a write has come to, and what is said of it."""

    state: JobState
    outcome: Outcome
    standing: tuple[Standing, ...] = ()
    sent: int = 0
    """Parameters for which a PARAM_SET may have left."""


def holding(value: Value | None, old: Value, new: Value, kind: ParameterKind) -> Holds:
    """Which value a parameter holds; `old` where both are one."""
    if value is None:
        return Holds.UNKNOWN
    if same(value, old, kind):
        return Holds.OLD
    return Holds.NEW if same(value, new, kind) else Holds.OTHER


def nothing_sent(code: str, cause: str, remedy: str = "Nothing was written.") -> Account:
    """The write ended before its first PARAM_SET: the vehicle is as it was."""
    return Account(JobState.REVIEW, Unwritten(code, cause, remedy))


def in_doubt(known: Sequence[Standing], cause: str) -> Account:
    """The write stopped; `known` is every parameter that was sent, or may have been."""
    return Account(JobState.IN_DOUBT, Failure("in-doubt", cause, RESOLVE), tuple(known), len(known))


def reverted(read: Sequence[Standing], cause: str | None, who: str, sent: int) -> Account:
    """The write was taken back and every parameter of the plan read; a `cause` of None: the operator asked for it.

    Raises
    ------
    WriteFailed
        If a parameter holds our value still, or was not read: then nothing was taken back.
    """
    ours = [s.name for s in read if s.holds in (Holds.NEW, Holds.UNKNOWN)]
    if ours:
        raise WriteFailed(f"these parameters still hold the new value: {', '.join(ours)}")
    away = tuple(s for s in read if s.holds == Holds.OTHER)
    if not away:
        text = "The old values are back, read and verified."
    elif len(away) == len(read):
        text = f"No old value is back: {_changed(away, who)}."
    else:
        text = f"The old values are back, read and verified, except {_changed(away, who)}."
    if cause is None:
        proof = READ_BACK_ONLY
        return Account(JobState.REVERTED, Result(text, proof.level, proof.reason), away, sent)
    remedy = f"{text} Start a new job."
    return Account(JobState.REVERTED, Failure("reverted", cause, remedy), away, sent)


def succeeded(read: Sequence[Standing], plan: WritePlan, verification: Verification | None, who: str) -> Account:
    """Every parameter of the plan was read at the end; only session settings may have been left to others.

    Raises
    ------
    WriteFailed
        If a parameter does not hold its new value: then it is no success.
    """
    session = {change.name for change in plan.changes if change.session}
    wrong = [s for s in read if s.name not in session and s.holds != Holds.NEW and s.value != s.new]
    if wrong:
        named = ", ".join(f"{s.name} holds {_number(s.value)} instead of {_number(s.new)}" for s in wrong)
        raise WriteFailed(f"the read-back differs: {named}")
    away = tuple(s for s in read if s.name in session and s.holds != Holds.OLD)
    proof = proof_of(verification)
    text = f"Every parameter was written and read back. {proof.reason}"
    if away:
        text += f" The settings of this session are back, except {_changed(away, who)}."
    return Account(JobState.SUCCEEDED, Result(text, proof.level, proof.reason, proof.unproved), away, len(read))


def _changed(away: Sequence[Standing], who: str) -> str:
    """``X, which somebody else set to 0.1 (0.2 before)``; several with their values in brackets."""
    if len(away) == 1:
        only = away[0]
        return f"{only.name}, which {who} set to {_number(only.value)} ({_number(only.old)} before)"
    named = [f"{s.name} (now {_number(s.value)}, {_number(s.old)} before)" for s in away[:NAMED]]
    more = len(away) - len(named)
    listed = ", ".join(named) + (f" and {more} more" if more else "")
    return f"{listed}, which {who} set"


def _number(value: Value | None) -> str:
    return "unknown" if value is None else shown(value)


# --- readings


def as_read(plan: WritePlan, old: Mapping[str, Value], values: Mapping[str, Value], who: str) -> tuple[Standing, ...]:
    """Every parameter of a plan as it was freshly read, `old` being what it held before the write."""
    found = []
    for change in plan.changes:
        name, value, before = change.name, values.get(change.name), old[change.name]
        holds = holding(value, before, change.new, change.kind)
        note = f"set by {who}; it is left so" if holds == Holds.OTHER else ""
        found.append(Standing(name, before, change.new, value, value is not None, note, holds))
    return tuple(found)


def as_heard(record: WriteRecord, heard: Mapping[str, Value], doubt: str | None = None) -> tuple[Standing, ...]:
    """Every parameter that may have been touched, as it was last heard.

    `heard` are values heard since the last PARAM_SET of each name. One that was not also confirmed as the answer to
    that PARAM_SET is no proof: it may be a late echo from before. With a `doubt` nothing is certain, and once a session
    setting was put back the vehicle may calibrate by itself again.
    """
    found = []
    freed = [s.name for s in record.sent if s.session and s.name in record.undone | record.restored]
    for sent in record.sent:
        value = heard.get(sent.name, sent.confirmed)
        confirmed = sent.confirmed is not None and value is not None and same(value, sent.confirmed, sent.kind)
        note = f"set by {who_sets(sent.name)}" if sent.name in record.left else doubt or ""
        if freed and not sent.session and sent.name not in record.left:
            note = "; ".join(filter(None, (note, f"the vehicle may change it since {freed[0]} was put back")))
        certain = confirmed and doubt is None and (sent.session or not freed)
        holds = holding(value, sent.old, sent.new, sent.kind) if certain else Holds.UNKNOWN
        found.append(Standing(sent.name, sent.old, sent.new, value, certain, note, holds))
    return tuple(found)


def who_sets(name: str) -> str:
    """Return who may have changed this parameter while the vehicle ran. PX4 rewrites its gyro offsets at rest."""
    return EITHER if name in REWRITTEN_AT_REST else SOMEBODY


def who_else(record: WriteRecord, plan: WritePlan) -> str:
    """Who may have set a value that is neither old nor new.

    PX4 rewrites its gyro offsets at rest. After a restart the vehicle may have calibrated itself, also once a session
    setting was put back that kept it from that. Nobody listened while the service was away.
    """
    freed = any(s.session and s.name in record.undone | record.restored for s in record.sent)
    later = record.interrupted or record.rolling_back == BY_OPERATOR
    alone = later or record.restarted or record.reboot_announced or record.rebooted
    at_rest = any(change.name in REWRITTEN_AT_REST for change in plan.changes)
    return EITHER if freed or alone or at_rest else SOMEBODY
