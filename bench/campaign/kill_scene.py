"""What a SIGKILL run does: a scene that leads the journal through a step, and where the process is killed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from mavcal.service.jobs.journal import JournalStep

REPEATS = 3
"""Every step of the journal is struck at least so often."""
SERIES = 1000
"""Repetition n of a kill has its index plus n times this."""


@dataclass(frozen=True)
class Scene:
    """How the vehicle and the job are set up."""

    autopilot: str
    job: str
    fault: Mapping[str, Any] | None = None
    """Let loose when the plan is accepted; `share` places it among the plan's parameters."""
    parameters: Mapping[str, float] = field(default_factory=dict)
    """Settings of the vehicle."""
    moves: bool = False
    """The vehicle is on two links; the service that takes the write up knows only the second."""
    gyro_off_by: float = 0.0
    """How far from its truth somebody has set PX4's first gyro along x before the job, rad/s: it is to be written."""


_BARE = {"INS_GYR_CAL": 0.0}
"""No calibration of its own at boot: there is something to calibrate."""

SCENES: Mapping[str, Scene] = {
    "gyro": Scene("ardupilot", "gyro", None, _BARE),
    # IMU_GYRO_CAL_EN 1 let PX4 correct gyro_off_by itself once in 76 runs: nothing was left to write.
    "restart": Scene("px4", "gyro", None, {"IMU_GYRO_CAL_EN": 0.0}, gyro_off_by=0.004),
    "commands": Scene("ardupilot", "accel", None, _BARE),
    "not applied": Scene("ardupilot", "gyro", {"kind": "not_applied", "share": 0.5}, _BARE),
    "third party": Scene("ardupilot", "gyro", {"kind": "foreign_write", "share": 0.99, "value": 0.0321}, _BARE),
    "armed": Scene("ardupilot", "gyro", {"kind": "arm", "share": 0.6}, _BARE),
    "other link": Scene("ardupilot", "gyro", None, _BARE, moves=True),
    "capture": Scene("px4", "gyro", None, {"IMU_GYRO_CAL_EN": 0.0}),
}

_LEADS: Mapping[str, tuple[JournalStep, ...]] = {
    "gyro": (
        JournalStep.ACCEPTED,
        JournalStep.STREAMS,
        JournalStep.SNAPSHOT,
        JournalStep.SEND,
        JournalStep.ECHO,
        JournalStep.READ_BACK,
        JournalStep.VERIFIED,
        JournalStep.STREAMS_RESTORED,
        JournalStep.CLOSED,
    ),
    "restart": (JournalStep.REBOOT, JournalStep.REBOOTED, JournalStep.RESTORE, JournalStep.RESTORED),
    "commands": (JournalStep.COMMAND, JournalStep.COMMANDED),
    "not applied": (JournalStep.ROLL_BACK, JournalStep.UNDO, JournalStep.UNDONE),
    "third party": (JournalStep.LEFT,),
    "armed": (JournalStep.STOPPED,),
    "other link": (JournalStep.SEND, JournalStep.ECHO),
    "capture": (JournalStep.STREAMS,),
}
"""Which scene leads through which steps."""


@dataclass(frozen=True)
class Kill:
    """One run: kill at the `occurrence`-th row of `step` after the accept (in the scene ``capture``: at all)."""

    index: int
    seed: int
    scene: str
    step: JournalStep
    occurrence: int
    again: JournalStep | None = None
    """Killed a second time, at the first row of this step that the restarted service writes."""
    scenery: Scene = field(repr=False, default=SCENES["gyro"])


def kills(seed: int) -> tuple[Kill, ...]:
    """Every step of the journal, `REPEATS` times, at different occurrences; and some services that are killed twice."""
    planned: list[tuple[str, JournalStep, int, JournalStep | None]] = [
        (scene, step, _occurrence(step, repeat), None)
        for repeat in range(REPEATS)
        for scene, steps in _LEADS.items()
        for step in steps
    ]
    planned += [
        ("gyro", JournalStep.SEND, 6, JournalStep.UNDO),
        ("gyro", JournalStep.ECHO, 3, JournalStep.ROLL_BACK),
        ("gyro", JournalStep.READ_BACK, 1, JournalStep.VERIFIED),
        ("restart", JournalStep.REBOOT, 1, JournalStep.REBOOTED),
        ("not applied", JournalStep.UNDO, 2, JournalStep.UNDONE),
    ]
    return tuple(Kill(i, seed, s, step, n, again, SCENES[s]) for i, (s, step, n, again) in enumerate(planned))


def repetition(kill: Kill, number: int) -> Kill:
    """The same once more, for a step that was not struck often enough."""
    return replace(kill, index=kill.index % SERIES + number * SERIES, again=None)


def kill_of(seed: int, index: int) -> Kill:
    """The kill of that index, be it a repetition. Raises IndexError if there is none."""
    kill = kills(seed)[index % SERIES]
    return kill if index < SERIES else repetition(kill, index // SERIES)


def _occurrence(step: JournalStep, repeat: int) -> int:
    """The first, one in the middle, one near the end; the other steps come once."""
    many = {
        JournalStep.SEND: (1, 5, 12),
        JournalStep.ECHO: (1, 7, 12),
        JournalStep.UNDO: (1, 4, 9),
        JournalStep.UNDONE: (1, 5, 11),
    }
    return many.get(step, (1, 1, 1))[repeat]
