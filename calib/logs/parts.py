"""Joins separate recordings into one with a labelled segment for each."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.recording import Recording, Segment, join

PAUSE = 1.0
"""Pause, s, inserted between two parts, so that they are not taken as continuous."""


def of_parts(parts: Sequence[tuple[str, Recording]]) -> Recording:
    """One recording of `parts`, each with the label of its pose or turn.

    Times are shifted so that the parts follow each other; segments that a part had of its own are dropped.

    Raises
    ------
    InvalidInputError
        If there is no part, a label or a recording is empty, or the parts are of different vehicles or units.
    """
    if not parts:
        raise InvalidInputError("there is no part: give one recording a face")
    shifted, segments, clock = [], [], 0.0
    for label, recording in parts:
        start, end = recording.span
        if not label.strip() or not np.isfinite(start):
            raise InvalidInputError(
                f"the part {label!r} ({recording.source or 'a recording'}) has no label or no sample"
            )
        shifted.append(_later(recording, clock - start))
        stop = clock + (end - start) + 0.5 * PAUSE
        segments.append(Segment(label.strip(), clock, stop))
        clock = stop + 0.5 * PAUSE
    _check_alike(shifted)
    return dataclasses.replace(join(shifted), segments=tuple(segments))


def _later(recording: Recording, by: float) -> Recording:
    """The recording `by` seconds later, without its segments."""
    timeline = recording.parameters
    return dataclasses.replace(
        recording,
        channels=tuple(dataclasses.replace(c, t=c.t + by) for c in recording.channels),
        parameters=dataclasses.replace(
            timeline, entries=tuple(dataclasses.replace(e, t=e.t + by) for e in timeline.entries)
        ),
        events=tuple(dataclasses.replace(e, t=e.t + by) for e in recording.events),
        segments=(),
    )


def _check_alike(parts: Sequence[Recording]) -> None:
    vehicles = {p.identity.uid for p in parts if p.identity.uid is not None}
    if len(vehicles) > 1:
        raise InvalidInputError(f"the parts are of {len(vehicles)} different vehicles: calibrate one at a time")
    units: dict[tuple[str, int, str], set[tuple[str, str, float]]] = {}
    for part in parts:
        for channel in part.channels:
            units.setdefault(channel.key, set()).add((channel.unit, channel.stage.value, channel.quantum))
    mixed = sorted(f"{sensor}[{instance}]" for (sensor, instance, _), kinds in units.items() if len(kinds) > 1)
    if mixed:
        raise InvalidInputError(f"the parts disagree in unit, stage or resolution of {', '.join(mixed)}")
