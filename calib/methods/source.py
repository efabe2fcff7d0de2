"""Input of a method: a recording with the calibration in force undone, and the requested instances."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from mavcal.calib.firmware.in_force.undo import undo
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.flight.rest import grounded
from mavcal.calib.logs.tables import NO_TIME
from mavcal.calib.recording import Channel, Recording, Sensor, Stage
from mavcal.calib.stats.still_limits import HELD, HOLD_S, MANY_MORE, RESTING, SHORTER, held_for, too_short
from mavcal.calib.stats.stillness import Still, find_still

_TURNED_COS = 0.5
"""Cosine of 60 degrees: no vehicle turns by more at every sample, so such rows are poses."""


@dataclass(frozen=True, eq=False)
class Source:
    """A recording with the calibration in force undone, and the requested instances."""

    recording: Recording
    instance: int | None
    streamed: Recording
    """The recording as read; an auxiliary sensor is best used with its own calibration in force."""

    @classmethod
    def of(cls, recording: Recording, instance: int | None) -> Source:
        """`recording` with the calibration in force undone; `instance` None: every instance."""
        known = recording.identity.autopilot in {"ardupilot", "px4"}
        return cls(undo(recording) if known else recording, instance, recording)

    def channels(self, sensor: Sensor) -> tuple[Channel, ...]:
        """The channel of every requested instance."""
        have = self.recording.instances(sensor)
        wanted = have if self.instance is None else (self.instance,)
        usable = [i for i in wanted if self._usable(sensor, i)] or [wanted[0] if wanted else 0]
        return tuple(self.recording.channel(sensor, i) for i in usable)

    def maybe(self, sensor: Sensor, instance: int) -> Channel | None:
        """The channel of that sensor and instance; None: the recording has none."""
        return self.recording.channel(sensor, instance) if self._usable(sensor, instance) else None

    def companion(self, sensor: Sensor, instance: int) -> Channel | None:
        """The channel of the same instance, else the first one of its kind: on a rigid body any of them shows motion.

        PX4 counts accelerometers and gyroscopes by their own calibration rows, so one unit may have two numbers.
        """
        others = self.recording.instances(sensor)
        return self.maybe(sensor, instance) or (self.maybe(sensor, others[0]) if others else None)

    def temperature(self, instance: int) -> Channel | None:
        """The thermometer of that instance, or the only one there is."""
        return self.maybe(Sensor.TEMPERATURE, instance) or self.maybe(Sensor.TEMPERATURE, 0)

    def relative(self, channel: Channel) -> bool:
        """Whether the calibration in force is unknown, or could not be undone."""
        return not self.recording.parameters or channel.stage != Stage.RAW

    @property
    def timed(self) -> bool:
        """Whether the time stamps are real; a table without them has row numbers."""
        return not any(event.kind == NO_TIME for event in self.recording.events)

    def readings(self, channel: Channel) -> bool:
        """Whether every row of `channel` is a single reading of a face, a pose or a turn.

        Rows of a table without time are. Timed rows are if the shortest rest would have fewer than two of them, or if
        the orientation changes in every row.
        """
        if self.of_vehicle or self.recording.segments or len(channel) < 2:
            return not self.timed
        apart = float(np.median(np.diff(channel.t)))
        return not self.timed or 2.0 * apart > HELD.shortest or _rows_are_poses(channel)

    @property
    def of_vehicle(self) -> bool:
        """Whether it was streamed by a vehicle."""
        return self.recording.identity.autopilot is not None

    def stills(self, instance: int, *, held: bool, min_still: float = HOLD_S) -> tuple[Still, ...]:
        """Labelled segments, else the still spans of the recording; none in a table without time.

        A vehicle's spans count only with the motors off, since a good hover looks still. Poses are held for `min_still`
        seconds at least.
        """
        if self.recording.segments:
            return tuple(Still(s.start, s.end, None, None) for s in self.recording.segments)
        if not self.timed:
            return ()
        limits = held_for(HELD if held else RESTING, min_still)
        found = find_still(self.recording, instance=instance, limits=limits)
        return grounded(self.recording, found, limits.shortest) if self.of_vehicle else found

    def held_too_short(self, fit: FitResult, instance: int, min_still: float) -> FitResult:
        """`fit` with a hint on the hold time if it was refused and more poses were held for less than `min_still` s."""
        if fit.status != FitStatus.REFUSED or self.recording.segments or not self.timed:
            return fit
        found = len(self.stills(instance, held=True, min_still=min_still))
        for part in SHORTER:
            asked = part * min_still
            shorter = self.stills(instance, held=True, min_still=asked)
            if len(shorter) >= MANY_MORE * (found + 1):
                held = [s.duration + asked * HELD.window / HOLD_S for s in shorter]
                return dataclasses.replace(fit, message=fit.message + too_short(held, min_still, asked))
        return fit

    def flown_throughout(self, instance: int) -> bool:
        """Whether the vehicle was armed and never at rest, so that the whole recording is not a rest either."""
        armed = any(event.kind == "armed" for event in self.recording.events)
        return self.of_vehicle and armed and not self.stills(instance, held=False)

    def longest_rest(self, channel: Channel) -> Channel:
        """The samples of the longest still span, or all of them where no span is found."""
        stills = self.stills(channel.instance, held=False)
        if not stills:
            return channel
        longest = max(stills, key=lambda still: still.duration)
        return channel.between(longest.start, longest.end)

    def annotated(self, fit: FitResult) -> FitResult:
        """The fit with the warnings that concern the recording as a whole."""
        about = f"{fit.sensor} {fit.instance + 1} of "
        warnings = [
            event.text
            for event in self.recording.events
            if event.kind == "damage" or (event.kind == "undo" and event.text.startswith(about))
        ]
        if self.recording.parameters and not self.recording.parameters.end_observed:
            warnings.append("the parameters were not read again at the end: a change in the middle would be unseen")
        return dataclasses.replace(fit, warnings=(*fit.warnings, *warnings))

    def _usable(self, sensor: Sensor, instance: int) -> bool:
        return any(c.stage != Stage.DEBIASED for c in self.recording.find(sensor, instance))


def _rows_are_poses(channel: Channel) -> bool:
    """Whether the vector of `channel` turned by 60 degrees and more from most rows to the next."""
    lengths = np.linalg.norm(channel.values, axis=1)
    cosines = np.einsum("ni,ni->n", channel.values[1:], channel.values[:-1])
    return bool(np.median(cosines - _TURNED_COS * lengths[1:] * lengths[:-1]) < 0.0)
