"""Reads the journal of a write: what is known to have happened, and what must follow.

All functions are pure. A running transaction, and recovery after a crash or after an armed or silent vehicle, decide by
this alone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from mavcal.calib.firmware.plan import Change, ParameterKind, Value, WritePlan
from mavcal.service.store.rows import JournalRow

BY_OPERATOR = "the operator asked for it"
"""Why a finished write is taken back, if nothing went wrong."""


RESTART_MARGIN_S = 5.0


RESTART_MARGIN = 0.05
"""By so much, in seconds and as a share, a vehicle must have run for less time than has passed to have restarted."""


class JournalStep(StrEnum):
    """What a journal row says. Rows that announce are written before the act, the others after it."""

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

        It says so only if it has run for less than before, or began after that moment for sure: the margin is for two
        clocks that differ, and for a vehicle that starts its clock late.
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
    left: Mapping[str, Value] = dataclasses.field(default_factory=dict)
    closed: bool = False
    stopped: str | None = None
    """Why the write stopped first; what came of that later does not replace it."""
    silent: bool = False
    """All that was known then is that the vehicle was silent, as it is while it restarts."""
    restarted: bool = False
    """The vehicle was seen to restart in the middle, not by us."""
    interrupted: bool = False
    """The service itself ended in the middle, and nobody listened for a while."""
    intervals: Mapping[int, int] = dataclasses.field(default_factory=dict)
    """Message intervals to be restored, microseconds by message id."""

    def of(self, name: str) -> Sent | None:
        """The parameter of that name, if it was sent."""
        return next((s for s in self.sent if s.name == name), None)


class Next(StrEnum):
    """What must follow."""

    NOTHING_SENT = "nothing_sent"  # the vehicle is as it was
    REBOOT = "reboot"
    VERIFY = "verify"
    FINISH = "finish"  # verified: commands and session settings remain
    ROLL_BACK = "roll_back"


def fold(rows: Iterable[JournalRow]) -> WriteRecord:
    """What the rows of a job say, oldest first."""
    record = WriteRecord()
    for row in rows:
        record = _FOLDS[JournalStep(row.step)](record, row.data)
    return record


def decide(record: WriteRecord, plan: WritePlan, values: Mapping[str, Value]) -> Next:
    """What follows from the journal and from values that were freshly read (every sent parameter must be there)."""
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
    """Whether the vehicle holds our ``new`` or the ``old`` value."""
    return sent.name in values and same(values[sent.name], sent.new if which == "new" else sent.old, sent.kind)


def same(a: Value, b: Value, kind: ParameterKind) -> bool:
    """Whether two values are one on the wire."""
    return bool(np.float32(a) == np.float32(b)) if kind == ParameterKind.REAL32 else a == b


def _replace_sent(record: WriteRecord, name: str, confirmed: Value | None) -> tuple[Sent, ...]:
    return tuple(dataclasses.replace(s, confirmed=confirmed) if s.name == name else s for s in record.sent)


def _accepted(record: WriteRecord, _: Mapping[str, Any]) -> WriteRecord:
    return WriteRecord(accepted=True, intervals=record.intervals)


def _send(record: WriteRecord, data: Mapping[str, Any]) -> WriteRecord:
    if record.of(data["name"]) is not None:
        return dataclasses.replace(record, sent=_replace_sent(record, data["name"], None))
    sent = Sent(data["name"], data["old"], data["new"], ParameterKind(data["kind"]), data["session"])
    return dataclasses.replace(record, sent=(*record.sent, sent))


def _confirmed(record: WriteRecord, data: Mapping[str, Any]) -> WriteRecord:
    return dataclasses.replace(record, sent=_replace_sent(record, data["name"], data["value"]))


def _unconfirmed(record: WriteRecord, data: Mapping[str, Any]) -> WriteRecord:
    return dataclasses.replace(record, sent=_replace_sent(record, data["name"], None))


def _undone(record: WriteRecord, data: Mapping[str, Any]) -> WriteRecord:
    done = _confirmed(record, data)
    return dataclasses.replace(done, undone=record.undone | {data["name"]})


def _restored(record: WriteRecord, data: Mapping[str, Any]) -> WriteRecord:
    done = _confirmed(record, data)
    return dataclasses.replace(done, restored=record.restored | {data["name"]})


def _left(record: WriteRecord, data: Mapping[str, Any]) -> WriteRecord:
    done = _confirmed(record, data)
    return dataclasses.replace(done, left={**record.left, data["name"]: data["value"]})


def _streams(record: WriteRecord, data: Mapping[str, Any]) -> WriteRecord:
    # The first announcement holds the intervals as they were before us.
    new = {int(k): int(v) for k, v in data["intervals"].items()}
    return dataclasses.replace(record, intervals={**new, **record.intervals})


def _roll_back(record: WriteRecord, data: Mapping[str, Any]) -> WriteRecord:
    return dataclasses.replace(record, rolling_back=record.rolling_back or str(data["because"]), closed=False)


def _stopped(record: WriteRecord, data: Mapping[str, Any]) -> WriteRecord:
    restarted = bool(data.get("restarted"))
    first = record.stopped is None or (record.silent and restarted)
    return dataclasses.replace(
        record,
        stopped=str(data["reason"]) if first else record.stopped,
        silent=bool(data.get("silent")) if first else record.silent,
        restarted=record.restarted or restarted,
        interrupted=record.interrupted or bool(data.get("interrupted")),
    )


def _commanded(record: WriteRecord, data: Mapping[str, Any]) -> WriteRecord:
    return dataclasses.replace(record, commanded=record.commanded | {int(data["index"])})


def _read_back(record: WriteRecord, data: Mapping[str, Any]) -> WriteRecord:
    known = data.get("boot_time") is not None
    saved = Saved(float(data["at"]), float(data["boot_time"])) if known else record.saved
    return dataclasses.replace(record, read_back=True, saved=saved)


def _flag(**flags: Any) -> Any:
    return lambda record, _: dataclasses.replace(record, **flags)


_FOLDS: Mapping[JournalStep, Any] = {
    JournalStep.ACCEPTED: _accepted,
    JournalStep.STREAMS: _streams,
    JournalStep.STREAMS_RESTORED: _flag(intervals={}),
    JournalStep.SNAPSHOT: _flag(),
    JournalStep.SEND: _send,
    JournalStep.ECHO: _confirmed,
    JournalStep.READ_BACK: _read_back,
    JournalStep.REBOOT: _flag(reboot_announced=True),
    JournalStep.REBOOTED: _flag(rebooted=True),
    JournalStep.VERIFIED: _flag(verified=True),
    JournalStep.COMMAND: _flag(),
    JournalStep.COMMANDED: _commanded,
    JournalStep.RESTORE: _unconfirmed,
    JournalStep.RESTORED: _restored,
    JournalStep.ROLL_BACK: _roll_back,
    JournalStep.UNDO: _unconfirmed,
    JournalStep.UNDONE: _undone,
    JournalStep.LEFT: _left,
    JournalStep.STOPPED: _stopped,
    JournalStep.CLOSED: _flag(closed=True),
}
