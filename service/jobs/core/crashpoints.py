"""Named points at which a test may stop or kill the process.

The engine is given a :data:`CrashPoint` at its construction. It calls it with a name wherever a crash would leave
vehicle and journal in another relation. In the service the call does nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum


class At(StrEnum):
    """Points at which a test can crash the process."""

    CAPTURE_STARTED = "capture_started"
    CAPTURE_RUNNING = "capture_running"  # after every batch of frames
    CAPTURE_CLOSED = "capture_closed"
    FITTED = "fitted"
    ACCEPTED = "accepted"
    SNAPSHOT_KEPT = "snapshot_kept"
    BEFORE_SEND = "before_send"  # the journal says "send", nothing left
    AFTER_ECHO = "after_echo"  # the vehicle confirmed, the journal does not know
    ECHO_KEPT = "echo_kept"
    READ_BACK = "read_back"
    REBOOT_SENT = "reboot_sent"
    REBOOTED = "rebooted"
    VERIFIED = "verified"
    BEFORE_COMMAND = "before_command"
    AFTER_COMMAND = "after_command"
    BEFORE_RESTORE = "before_restore"
    ROLLBACK_BEGUN = "rollback_begun"
    BEFORE_UNDO = "before_undo"
    AFTER_UNDO = "after_undo"
    CLOSED = "closed"


CrashPoint = Callable[[At], None]


def no_crash(_: At) -> None:
    """Do nothing."""
