"""Reads the journal of a write: what has happened, what must follow, and what each parameter holds.

All functions are pure. A running transaction, and recovery after a crash or after an armed or silent vehicle, decide by
this alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np

from mavcal.calib.firmware.in_force.fingerprint import REWRITTEN_AT_REST
from mavcal.calib.firmware.plan import Change, ParameterKind, Value, WritePlan
from mavcal.service.jobs.core.model import Holds, Standing
from mavcal.service.store.rows import JournalRow

BY_OPERATOR = "the operator asked for it"
"""Why a finished write is taken back, if nothing went wrong."""
SOMEBODY = "somebody else"
EITHER = "the vehicle itself or somebody else"
RESTART_MARGIN_S = 5.0
RESTART_MARGIN = 0.05
"""Shortfall of a vehicle's time since boot behind the elapsed time that means a restart: s, and as a share."""


class JournalStep(StrEnum):
    """Kind of a journal row. An announcement is written before the act, any other row after it."""

    ACCEPTED = "accepted"  # the operator's accept; begins a transaction
    STREAMS = "streams"  # announces changed message intervals, with the old ones
    STREAMS_RESTORED = "streams_restored"
    SNAPSHOT = "snapshot"  # old values are on the disk
    SEND = "send"  # announces PARAM_SET
    ECHO = "echo"  # the vehicle confirmed this value
    READ_BACK = "read_back"  # every parameter holds its new value
    REBOOT = "reboot"  # announces a restart of the vehicle
    REBOOTED = "rebooted"
    VERIFIED = "verified"  # the stream does not contradict: from here on only forward
    COMMAND = "command"  # announces a command of the plan
    COMMANDED = "commanded"
    RESTORE = "restore"  # announces that a session setting is put back
    RESTORED = "restored"
    ROLL_BACK = "roll_back"  # from here on only backward
    UNDO = "undo"  # announces that an old value is put back
    UNDONE = "undone"
    LEFT = "left"  # somebody else's value is left alone
    STOPPED = "stopped"  # armed, silent, restarted, in conflict or interrupted: nothing more is written
    CLOSED = "closed"


@dataclass(frozen=True)
class Sent:
    """A parameter for which at least one PARAM_SET may have left."""

    name: str
    old: Value
    new: Value
    kind: ParameterKind
    session: bool
    confirmed: Value | None = None
    """The value that the vehicle last confirmed after our last PARAM_SET; None: it has not."""


@dataclass(frozen=True)
class Saved:
    """When every new value was last read back: by our wall clock, and by the vehicle's time since its start, s."""

    at: float
    boot_time: float

    def restarted_since(self, now: float, boot_time: float) -> bool:
        """Whether a vehicle that has run for `boot_time` seconds at `now` must have restarted meanwhile.

        True only if it has run for less time than before, or certainly started after that moment. The margin covers two
        clocks that differ, and a vehicle that starts its clock late.
        """
        passed = now - self.at
        return boot_time < self.boot_time or boot_time < passed - max(RESTART_MARGIN_S, RESTART_MARGIN * passed)


@dataclass(frozen=True)
class WriteRecord:
    """What the journal says of the latest transaction of a job."""

    accepted: bool = False
    sent: tuple[Sent, ...] = ()
    read_back: bool = False
    saved: Saved | None = None
    """The last read-back before a restart; None: there was none, or the vehicle told no time."""
    reboot_announced: bool = False
    rebooted: bool = False
    verified: bool = False
    commanded: frozenset[int] = frozenset()
    restored: frozenset[str] = frozenset()
    rolling_back: str | None = None
    undone: frozenset[str] = frozenset()
    left: Mapping[str, Value] = field(default_factory=dict)
    closed: bool = False
    stopped: str | None = None
    """Why the write stopped first; what came of that later does not replace it."""
    silent: bool = False
    """Whether only the vehicle's silence was known then, as during a restart."""
    restarted: bool = False
    """Whether the vehicle was seen to restart during the write, not by our command."""
    interrupted: bool = False
    """Whether the service itself ended during the write, so that nobody listened for a while."""
    intervals: Mapping[int, int] = field(default_factory=dict)
    """Message intervals to be restored, microseconds by message id."""

    def of(self, name: str) -> Sent | None:
        """The parameter of that name, if it was sent."""
        return next((s for s in self.sent if s.name == name), None)


class Next(StrEnum):
    """The next step of a recovery."""

    NOTHING_SENT = "nothing_sent"  # the vehicle is as it was
    REBOOT = "reboot"
    VERIFY = "verify"
    FINISH = "finish"  # verified: commands and session settings remain
    ROLL_BACK = "roll_back"


def fold(rows: Iterable[JournalRow]) -> WriteRecord:
    """The state of a write after these journal rows, oldest first."""
    record = WriteRecord()
    for row in rows:
        record = _after(record, JournalStep(row.step), row.data)
    return record


def _after(record: WriteRecord, step: JournalStep, data: Mapping[str, Any]) -> WriteRecord:
    """The record after one more row; a snapshot or an announced command changes nothing in it."""
    match step:
        case JournalStep.ACCEPTED:  # a new transaction; the message rates of the one before may be owed still
            return WriteRecord(accepted=True, intervals=record.intervals)
        case JournalStep.STREAMS:  # the first announcement holds the intervals as they were before us
            before = {int(key): int(interval) for key, interval in data["intervals"].items()}
            return replace(record, intervals={**before, **record.intervals})
        case JournalStep.STREAMS_RESTORED:
            return replace(record, intervals={})
        case JournalStep.READ_BACK:
            known = data.get("boot_time") is not None
            saved = Saved(float(data["at"]), float(data["boot_time"])) if known else record.saved
            return replace(record, read_back=True, saved=saved)
        case JournalStep.COMMANDED:
            return replace(record, commanded=record.commanded | {int(data["index"])})
        case JournalStep.ROLL_BACK:
            return replace(record, rolling_back=record.rolling_back or str(data["because"]), closed=False)
        case JournalStep.STOPPED:
            return _stopped(record, data)
    if step in _FLAGS:
        return replace(record, **_FLAGS[step])
    return record if step in {JournalStep.SNAPSHOT, JournalStep.COMMAND} else _of_parameter(record, step, data)


_FLAGS: Mapping[JournalStep, dict[str, Any]] = {
    JournalStep.REBOOT: {"reboot_announced": True},
    JournalStep.REBOOTED: {"rebooted": True},
    JournalStep.VERIFIED: {"verified": True},
    JournalStep.CLOSED: {"closed": True},
}


def _of_parameter(record: WriteRecord, step: JournalStep, data: Mapping[str, Any]) -> WriteRecord:
    """The record after a step that names a parameter."""
    name = data["name"]
    if step is JournalStep.SEND and record.of(name) is None:
        sent = Sent(name, data["old"], data["new"], ParameterKind(data["kind"]), data["session"])
        return replace(record, sent=(*record.sent, sent))
    announced = step in {JournalStep.SEND, JournalStep.RESTORE, JournalStep.UNDO}
    record = replace(record, sent=_confirmed(record, name, None if announced else data["value"]))
    match step:
        case JournalStep.RESTORED:
            return replace(record, restored=record.restored | {name})
        case JournalStep.UNDONE:
            return replace(record, undone=record.undone | {name})
        case JournalStep.LEFT:
            return replace(record, left={**record.left, name: data["value"]})
    return record


def _confirmed(record: WriteRecord, name: str, value: Value | None) -> tuple[Sent, ...]:
    return tuple(replace(sent, confirmed=value) if sent.name == name else sent for sent in record.sent)


def _stopped(record: WriteRecord, data: Mapping[str, Any]) -> WriteRecord:
    restarted = bool(data.get("restarted"))
    first = record.stopped is None or (record.silent and restarted)
    return replace(
        record,
        stopped=str(data["reason"]) if first else record.stopped,
        silent=bool(data.get("silent")) if first else record.silent,
        restarted=record.restarted or restarted,
        interrupted=record.interrupted or bool(data.get("interrupted")),
    )


def decide(record: WriteRecord, plan: WritePlan, values: Mapping[str, Value]) -> Next:
    """The next step, from the journal and from fresh values of every parameter that was sent."""
    if record.rolling_back is not None:
        return Next.ROLL_BACK
    if not record.sent:
        return Next.NOTHING_SENT
    if not all(_in_place(change, record, values) for change in plan.changes):
        return Next.ROLL_BACK
    if record.verified:
        return Next.FINISH
    return Next.REBOOT if plan.needs_reboot and not record.rebooted else Next.VERIFY


def _in_place(change: Change, record: WriteRecord, values: Mapping[str, Value]) -> bool:
    sent = record.of(change.name)
    if sent is None:
        return False
    if change.session and (change.name in record.restored or (record.verified and holds(sent, values, "old"))):
        return True
    return holds(sent, values, "new")


def holds(sent: Sent, values: Mapping[str, Value], which: str) -> bool:
    """Whether the vehicle holds the value that `which` names: the ``new`` or the ``old`` one."""
    return sent.name in values and same(values[sent.name], sent.new if which == "new" else sent.old, sent.kind)


def same(a: Value, b: Value, kind: ParameterKind) -> bool:
    """Whether two values are equal on the wire."""
    return bool(np.float32(a) == np.float32(b)) if kind == ParameterKind.REAL32 else a == b


# --- parameters that a write touched


def holding(value: Value | None, old: Value, new: Value, kind: ParameterKind) -> Holds:
    """Whether a parameter holds the old, the new or another value; `old` where old and new are equal."""
    if value is None:
        return Holds.UNKNOWN
    if same(value, old, kind):
        return Holds.OLD
    return Holds.NEW if same(value, new, kind) else Holds.OTHER


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
    """A phrase for who may have set a value that is neither the old nor the new one.

    PX4 rewrites its gyro offsets at rest. After a restart the vehicle may have calibrated itself, also once a session
    setting was put back that kept it from that. Nobody listened while the service was away.
    """
    freed = any(s.session and s.name in record.undone | record.restored for s in record.sent)
    later = record.interrupted or record.rolling_back == BY_OPERATOR
    alone = later or record.restarted or record.reboot_announced or record.rebooted
    at_rest = any(change.name in REWRITTEN_AT_REST for change in plan.changes)
    return EITHER if freed or alone or at_rest else SOMEBODY
