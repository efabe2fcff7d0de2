"""The states of a job, and the table of allowed transitions."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType


class JobState(StrEnum):
    """Where a job is."""

    QUEUED = "queued"
    RUNNING = "running"
    WAITING_FOR_OPERATOR = "waiting_for_operator"
    FITTING = "fitting"
    REVIEW = "review"
    APPLYING = "applying"
    WAITING_FOR_REBOOT = "waiting_for_reboot"
    VERIFYING = "verifying"
    SUCCEEDED = "succeeded"
    ROLLING_BACK = "rolling_back"
    REVERTED = "reverted"
    IN_DOUBT = "in_doubt"
    FAILED = "failed"
    CANCELLED = "cancelled"
    INTERRUPTED = "interrupted"


S = JobState
_ENDS = {S.FAILED, S.CANCELLED, S.INTERRUPTED}
TRANSITIONS: Mapping[JobState, frozenset[JobState]] = MappingProxyType(
    {
        S.QUEUED: frozenset({S.RUNNING, S.FITTING} | _ENDS),  # fitting: a computation on uploads
        S.RUNNING: frozenset({S.WAITING_FOR_OPERATOR, S.FITTING, S.SUCCEEDED} | _ENDS),  # succeeded: a campaign
        S.WAITING_FOR_OPERATOR: frozenset({S.RUNNING, S.FITTING} | _ENDS),
        # Succeeded: the vehicle holds the result already, or there is none. Queued: the service was stopped meanwhile.
        S.FITTING: frozenset({S.REVIEW, S.SUCCEEDED, S.QUEUED} | _ENDS),
        S.REVIEW: frozenset({S.APPLYING, S.CANCELLED}),
        # Back to review only while nothing was sent; from the first PARAM_SET on the way out leads through the vehicle.
        S.APPLYING: frozenset({S.REVIEW, S.WAITING_FOR_REBOOT, S.VERIFYING, S.ROLLING_BACK, S.IN_DOUBT}),
        S.WAITING_FOR_REBOOT: frozenset({S.VERIFYING, S.ROLLING_BACK, S.IN_DOUBT}),
        S.VERIFYING: frozenset({S.SUCCEEDED, S.ROLLING_BACK, S.IN_DOUBT}),
        S.SUCCEEDED: frozenset({S.ROLLING_BACK}),
        S.ROLLING_BACK: frozenset({S.REVERTED, S.IN_DOUBT}),
        S.IN_DOUBT: frozenset({S.REVIEW, S.WAITING_FOR_REBOOT, S.VERIFYING, S.ROLLING_BACK}),
        S.REVERTED: frozenset(),
        S.FAILED: frozenset(),
        S.CANCELLED: frozenset(),
        S.INTERRUPTED: frozenset({S.FITTING, S.RUNNING}),  # its data are kept: fitted later; a campaign goes on
    }
)
CAPTURING = frozenset({S.QUEUED, S.RUNNING, S.WAITING_FOR_OPERATOR})
"""States in which a job listens to the vehicle and can be cancelled without a trace."""
CANCELLABLE = CAPTURING | {S.FITTING, S.REVIEW}
"""States in which nothing has been written."""
WRITING = frozenset({S.APPLYING, S.WAITING_FOR_REBOOT, S.VERIFYING, S.ROLLING_BACK, S.IN_DOUBT})
"""States in which the vehicle may hold parameters of the job; the journal says which."""
PHYSICAL = CAPTURING | {S.FITTING} | WRITING
"""States in which a job claims its vehicle."""
ENDED = frozenset({S.SUCCEEDED, S.REVERTED, S.FAILED, S.CANCELLED, S.INTERRUPTED})
"""States in which the job waits for a person or has ended."""


def may_follow(state: JobState, to: JobState) -> bool:
    """Whether the table has the step from `state` to `to`."""
    return to in TRANSITIONS[state]
