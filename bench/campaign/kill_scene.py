"""What a SIGKILL run does: a scene that leads the journal through a step, and where the process is killed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from mavcal.service.jobs.journal import Step

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
    off_by: Mapping[str, float] = field(default_factory=dict)
    """Parameters that somebody has changed by so much before the job: there is something to write."""


_BARE = {"INS_GYR_CAL": 0.0}
"""No calibration of its own at boot: there is something to calibrate."""

SCENES: Mapping[str, Scene] = {
    "gyro": Scene("ardupilot", "gyro", None, _BARE),
    # PX4 has calibrated its gyros by itself: what is left is below its thresholds, and acts after a restart only.
    "restart": Scene("px4", "gyro", off_by={"CAL_GYRO0_XOFF": 0.004}),
    "commands": Scene("ardupilot", "accel", None, _BARE),
    "not applied": Scene("ardupilot", "gyro", {"kind": "not_applied", "share": 0.5}, _BARE),
    "third party": Scene("ardupilot", "gyro", {"kind": "foreign_write", "share": 0.99, "value": 0.0321}, _BARE),
    "armed": Scene("ardupilot", "gyro", {"kind": "arm", "share": 0.6}, _BARE),
    "capture": Scene("px4", "gyro", None, {"IMU_GYRO_CAL_EN": 0.0}),
}

_LEADS: Mapping[str, tuple[Step, ...]] = {
    "gyro": (
        Step.ACCEPTED,
        Step.STREAMS,
        Step.SNAPSHOT,
        Step.SEND,
        Step.ECHO,
        Step.READ_BACK,
        Step.VERIFIED,
        Step.STREAMS_RESTORED,
        Step.CLOSED,
    ),
    "restart": (Step.REBOOT, Step.REBOOTED, Step.RESTORE, Step.RESTORED),
    "commands": (Step.COMMAND, Step.COMMANDED),
    "not applied": (Step.ROLL_BACK, Step.UNDO, Step.UNDONE),
    "third party": (Step.LEFT,),
    "armed": (Step.STOPPED,),
    "capture": (Step.STREAMS,),
}
"""Which scene leads through which steps."""


@dataclass(frozen=True)
class Kill:
    """One run: kill at the `occurrence`-th row of `step` after the accept (in the scene ``capture``: at all)."""

    index: int
    seed: int
    scene: str
    step: Step
    occurrence: int
    again: Step | None = None
    """Killed a second time, at the first row of this step that the restarted service writes."""
    scenery: Scene = field(repr=False, default=SCENES["gyro"])


def kills(seed: int) -> tuple[Kill, ...]:
    """Every step of the journal, `REPEATS` times, at different occurrences; and some services that are killed twice."""
    planned: list[tuple[str, Step, int, Step | None]] = [
        (scene, step, _occurrence(step, repeat), None)
        for repeat in range(REPEATS)
        for scene, steps in _LEADS.items()
        for step in steps
    ]
    planned += [
        ("gyro", Step.SEND, 6, Step.UNDO),
        ("gyro", Step.ECHO, 3, Step.ROLL_BACK),
        ("gyro", Step.READ_BACK, 1, Step.VERIFIED),
        ("restart", Step.REBOOT, 1, Step.REBOOTED),
        ("not applied", Step.UNDO, 2, Step.UNDONE),
    ]
    return tuple(Kill(i, seed, s, step, n, again, SCENES[s]) for i, (s, step, n, again) in enumerate(planned))


def repetition(kill: Kill, number: int) -> Kill:
    """The same once more, for a step that was not struck often enough."""
    return replace(kill, index=kill.index % SERIES + number * SERIES, again=None)


def kill_of(seed: int, index: int) -> Kill:
    """The kill of that index, be it a repetition. Raises IndexError if there is none."""
    kill = kills(seed)[index % SERIES]
    return kill if index < SERIES else repetition(kill, index // SERIES)


def _occurrence(step: Step, repeat: int) -> int:
    """The first, one in the middle, one near the end; the other steps come once."""
    many = {Step.SEND: (1, 5, 12), Step.ECHO: (1, 7, 12), Step.UNDO: (1, 4, 9), Step.UNDONE: (1, 5, 11)}
    return many.get(step, (1, 1, 1))[repeat]
