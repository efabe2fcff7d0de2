"""The draft of a plan, into which every autopilot's composer writes in any order."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np

from mavcal.calib.firmware.in_force.fingerprint import rests_on
from mavcal.calib.firmware.limits import limit_of
from mavcal.calib.firmware.options import ComposeOptions
from mavcal.calib.firmware.plan import (
    AfterWrite,
    Agreement,
    Change,
    Fingerprint,
    LeftOut,
    Loss,
    ParameterKind,
    Value,
    WritePlan,
    sensors_of,
    snapshot_sha256,
)
from mavcal.calib.firmware.values import retained
from mavcal.calib.recording import Sensor

INTEGERS: Final[Mapping[str, ParameterKind]] = {"ardupilot": ParameterKind.INT8, "px4": ParameterKind.INT32}
"""Type of the flags and numbers that are planned, by autopilot."""
LARGEST = float(np.finfo(np.float32).max)


class Rank(IntEnum):
    """Safe order of writing (FLIGHT_CONTROLLERS 3.2): references before what refers to them, scale and ids last.

    In another order an offset without its temperature, or a polynomial that is not yet complete, would act until the
    rest is written.
    """

    SESSION = 0  # silence the firmware's own writers first
    TEMPERATURE = 1
    THERMAL = 2
    THERMAL_ENABLE = 3
    ROTATION = 4
    OFFSET = 5
    CROSS = 6
    SCALE = 7
    FIELD_SCALE = 8
    LEVEL = 9
    SETTING = 10
    ID = 11


@dataclass(frozen=True)
class Subject:
    """The sensor that a part of a plan is about."""

    sensor: Sensor
    instance: int

    def __str__(self) -> str:
        return f"{self.sensor} {self.instance + 1}"


class Draft:
    """Collects changes, losses, warnings and blockers against one snapshot of the vehicle's parameters.

    `integers` is the type of flags and numbers, one of :data:`INTEGERS`.
    """

    def __init__(self, parameters: Mapping[str, Value], options: ComposeOptions, integers: ParameterKind) -> None:
        self.parameters = parameters
        self.options = options
        self._integers = integers
        self._changes: dict[str, tuple[int, int, Change]] = {}
        self._losses: list[Loss] = []
        self._after: list[AfterWrite] = []
        self._warnings: list[str] = []
        self._blockers: list[str] = []
        self._refused: dict[Subject, list[str]] = {}
        self._dropped: dict[Subject, str] = {}
        self._needless: set[Subject] = set()

    def get(self, name: str, default: float) -> float:
        """The value that will be in the vehicle once the draft is written."""
        if name in self._changes:
            return float(self._changes[name][2].new)
        return float(self.parameters.get(name, default))

    @property
    def predicted(self) -> dict[str, Value]:
        """Every parameter as it will be once the draft is written."""
        return {**self.parameters, **{name: change.new for name, (_, _, change) in self._changes.items()}}

    def set_real(
        self,
        name: str,
        value: float,
        rank: Rank,
        why: str,
        *,
        about: Subject | None,
        sd: float | None = None,
        unit: str = "",
        needs_reboot: bool = False,
        hidden: bool = False,
    ) -> None:
        """Plan a float parameter, rounded as the vehicle stores it; no change if it holds that value already.

        `hidden`: the firmware does not list the name but takes it (members of a group that is switched off).
        """
        if not abs(value) <= LARGEST:
            self.block(f"{name} would be {value}: not a finite number. Repeat the calibration", about)
            return
        if not self._known(name, about, hidden=hidden):
            return
        new = retained(name, value)
        limit = limit_of(name)
        if limit is not None and not limit.low <= new <= limit.high:
            self.block(limit.refusal(name, new), about)
            return
        old = self.parameters.get(name)
        if old is not None and not math.isfinite(old):
            self.block(f"{name} is {old}, which could not be put back: write a number there first", about)
            return
        if old is not None and np.float32(old) == np.float32(new):
            self._changes.pop(name, None)
            return
        sensor, instance = (about.sensor, about.instance) if about else (None, 0)
        change = Change(
            name,
            None if old is None else float(old),
            new,
            ParameterKind.REAL32,
            why,
            sd,
            unit,
            sensor,
            instance,
            needs_reboot,
        )
        self._changes[name] = (rank, len(self._changes), change)

    def set_integer(
        self,
        name: str,
        value: int,
        rank: Rank,
        why: str,
        *,
        kind: ParameterKind | None = None,
        about: Subject | None = None,
        needs_reboot: bool = False,
        session: bool = False,
        hidden: bool = False,
    ) -> None:
        """Plan a flag, a number of a rotation or an id; `kind`: another type than the draft's."""
        if not self._known(name, about, hidden=hidden):
            return
        old = self.parameters.get(name)
        if old is not None and int(old) == value:
            self._changes.pop(name, None)
            return
        sensor, instance = (about.sensor, about.instance) if about else (None, 0)
        change = Change(
            name,
            None if old is None else int(old),
            value,
            kind or self._integers,
            why,
            sensor=sensor,
            instance=instance,
            needs_reboot=needs_reboot,
            session=session,
        )
        self._changes[name] = (rank, len(self._changes), change)

    def reorder(self, names: Sequence[str]) -> None:
        """Write `names`, which have one rank, in this order."""
        places = sorted(self._changes[n][1] for n in names if n in self._changes)
        for name, place in zip((n for n in names if n in self._changes), places, strict=True):
            rank, _, change = self._changes[name]
            self._changes[name] = (rank, place, change)

    def ranks(self, about: Subject) -> set[int]:
        """Ranks of the changes about one sensor."""
        return {
            rank
            for rank, _, change in self._changes.values()
            if (change.sensor, change.instance) == (about.sensor, about.instance)
        }

    def planned(self, names: Sequence[str]) -> tuple[Change, ...]:
        """The changes among `names`."""
        return tuple(self._changes[n][2] for n in names if n in self._changes)

    def lose(self, about: Subject, what: str, cost: float, unit: str, text: str) -> None:
        """Announce a part of a fit that cannot be stored."""
        self._losses.append(Loss(about.sensor, about.instance, what, float(cost), unit, text))

    def after(self, command: int, params: tuple[float, float, float, float, float, float, float], why: str) -> None:
        """Send a command when everything has been read back."""
        self._after.append(AfterWrite(command, params, why))

    def drop(self, about: Subject, text: str, *, needless: bool = False) -> None:
        """Note that what was fitted of `about` is not written, which :meth:`lose` has announced with its cost.

        `needless`: there is nothing that would have to be written.
        """
        self._dropped.setdefault(about, text)
        if needless:
            self._needless.add(about)

    def warn(self, text: str, *, first: bool = False) -> None:
        """Add a warning; `first`: before all others."""
        if text not in self._warnings:
            self._warnings.insert(0 if first else len(self._warnings), text)

    def block(self, text: str, about: Subject | None = None) -> None:
        """Forbid the write of one sensor, or of all (None)."""
        reasons = self._blockers if about is None else self._refused.setdefault(about, [])
        if text not in reasons:
            reasons.append(text)

    @property
    def refused(self) -> dict[Subject, tuple[str, ...]]:
        """The sensors that cannot be written, and why."""
        return {about: tuple(texts) for about, texts in self._refused.items()}

    @property
    def dropped(self) -> dict[Subject, str]:
        """Sensors that are written in part only, and why."""
        return dict(self._dropped)

    @property
    def left_out(self) -> dict[Subject, str]:
        """Sensors of :attr:`dropped` that are missing a part of their calibration."""
        return {about: text for about, text in self._dropped.items() if about not in self._needless}

    @property
    def losses(self) -> tuple[Loss, ...]:
        """The losses announced so far."""
        return tuple(self._losses)

    def losses_of(self, losses: Sequence[Loss]) -> None:
        """Add losses that an earlier draft has announced for sensors that are now left out."""
        self._losses += [loss for loss in losses if loss not in self._losses]

    @property
    def changes(self) -> tuple[Change, ...]:
        """The changes in the order of writing; none if there are only settings of the session to protect them."""
        ordered = [change for _, _, change in sorted(self._changes.values(), key=lambda item: item[:2])]
        return () if all(change.session for change in ordered) else tuple(ordered)

    def plan(
        self, fingerprint: Fingerprint, agreements: Sequence[Agreement] = (), left_out: Sequence[LeftOut] = ()
    ) -> WritePlan:
        """The finished plan, in the order of writing. A sensor that is still refused forbids everything."""
        return WritePlan(
            fingerprint,
            snapshot_sha256(rests_on(self.parameters, sensors_of(self.changes, agreements))),
            self.changes,
            tuple(self._losses),
            tuple(self._after),
            tuple(self._warnings),
            (*self._blockers, *(text for texts in self._refused.values() for text in texts)),
            tuple(agreements),
            tuple(left_out),
        )

    def _known(self, name: str, about: Subject | None, *, hidden: bool) -> bool:
        if hidden or name in self.parameters:
            return True
        self.block(
            f"the vehicle does not list {name}, so it would not take it: this firmware or board does not have it. "
            "Read the parameters again, or leave this sensor out",
            about,
        )
        return False
