"""Prompts, progress, results and answers of a procedure, as data.

A procedure is fed chunks of raw recording (calibration in force undone) in the order of the vehicle's clock. It uses no
other clock, so a live job, a replayed .tlog and a test have the same code path.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from mavcal.calib.firmware.plan import LeftOut
from mavcal.calib.fit import FitResult


class Pose(StrEnum):
    """The six faces, in the order and meaning of MAVLink's ``ACCELCAL_VEHICLE_POS`` (1..6), and oblique poses."""

    LEVEL = "level"
    LEFT = "left"
    RIGHT = "right"
    NOSE_DOWN = "nose_down"
    NOSE_UP = "nose_up"
    BACK = "back"
    OBLIQUE = "oblique"


@dataclass(frozen=True)
class Number:
    """A number that the operator is asked for; the answer is the number as text."""

    name: str  # stable, for programs: rate, turns
    unit: str
    low: float
    """Least value, in `unit`."""
    high: float
    """Greatest value, in `unit`."""

    def read(self, value: str) -> float | None:
        """`value` as a number; None: not a number, or outside the limits."""
        try:
            number = float(value)
        except ValueError:
            return None
        return number if math.isfinite(number) and self.low <= number <= self.high else None


class PromptStep(StrEnum):
    """What a prompt is about, for programs: those of a capture, then those of a write."""

    HOLD_STILL = "hold_still"
    POSE = "pose"  # hold it in a pose
    PLACE = "place"  # put it down square on a face and let go
    ROTATE = "rotate"  # about all axes
    TURN = "turn"  # about `axis`, steadily
    WARM_UP = "warm_up"
    STATE = "state"  # a `number` is asked for
    PROVE = "prove"  # make the movement that proves the rest
    REBOOT = "reboot"  # restart the vehicle
    WAIT = "wait"  # nothing is asked: the vehicle, or what stands in the way, takes its time
    BUSY = "busy"  # the vehicle does something of its own; its data are not used meanwhile
    SILENT = "silent"  # the vehicle is not heard


@dataclass(frozen=True)
class Tilt:
    """An oblique pose that is asked for, or that was taken."""

    direction: tuple[float, float, float]
    """Body direction (front, right, down) that points down; a unit vector."""
    taken: bool


@dataclass(frozen=True)
class Silence:
    """For how long the vehicle has not been heard."""

    lasted: float
    """s"""
    limit: float
    """After so long the job gives up, s."""


@dataclass(frozen=True)
class Prompt:
    """Instruction to the operator, as data for a panel or a voice."""

    step: PromptStep
    text: str
    pose: Pose | None = None
    """The pose that is asked for; None: any, or none."""
    remaining: tuple[Pose, ...] = ()
    """Poses still missing; their order is free."""
    hold_s: float | None = None
    rotate: bool = False
    direction: tuple[float, float, float] | None = None
    """Where to turn next: the body direction (FRD) that should point down. None: no preference."""
    temperature: float | None = None
    """Bring the sensors to about this temperature, degC. None: it does not matter."""
    detected: Pose | None = None
    stable: bool = False
    answers: tuple[str, ...] = ()
    """Answers that this prompt accepts (``finish``, ``skip``); empty: the data answer."""
    axis: tuple[float, float, float] | None = None
    """Turn about this body axis (FRD), right-handed. None: no such turn is asked for."""
    turns: float | None = None
    """How many turns to make, then stop. None: go on until the prompt changes."""
    number: Number | None = None
    """A number that is asked for beside `answers`."""
    taken: bool = False
    """The detected pose is done already: the next one is waited for."""
    tilts: tuple[Tilt, ...] = ()
    """The oblique poses, those that were taken first, then in the order in which they are asked for."""
    unfinished: str = ""
    """A sentence that says what the answer ``finish`` would leave undetermined now; empty: nothing."""
    silence: Silence | None = None
    """The vehicle is not heard; the rest of the prompt is as before."""

    def accepts(self, value: str) -> bool:
        """Whether `value` is an answer to this prompt."""
        return value in self.answers or (self.number is not None and self.number.read(value) is not None)

    @property
    def choice(self) -> str:
        """Text of the accepted answers; empty: the data answer."""
        choices = list(self.answers)
        if self.number is not None:
            unit = f" {self.number.unit}" if self.number.unit else ""
            choices.append(f"a number from {self.number.low:g} to {self.number.high:g}{unit}")
        return ", ".join(choices)


@dataclass(frozen=True)
class Progress:
    """Progress of a job. `eta` in seconds of the vehicle's clock; None: not known yet."""

    current: float
    target: float
    unit: str
    text: str
    eta: float | None = None
    detail: Mapping[str, Any] | None = None
    """Numbers for the panel: field strength against the model, coverage mask, residual, temperature."""


@dataclass(frozen=True)
class Done:
    """The requested uncertainty is reached, or the operator ended it: one fit a sensor instance."""

    results: tuple[FitResult, ...]
    because: str
    left_out: tuple[LeftOut, ...] = ()
    """Sensors that should have taken part and could not, also those that only help."""


@dataclass(frozen=True)
class GaveUp:
    """The procedure cannot reach its goal with these data."""

    cause: str
    remedy: str


Step = Prompt | Progress | Done | GaveUp
