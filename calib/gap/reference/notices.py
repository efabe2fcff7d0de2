"""What the report says of recordings and references beside the traces.

The notices name what was not compared, given twice, or is too coarse to be compared. A reference is useless if its
trajectory bends to any reading, so that effects which are measured along it are made by it. Then only the differences
of instances are left, which need no attitude; the notices say what would make the reference better.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from mavcal.calib.gap.problem import ReferenceInfo, ReferenceKind
from mavcal.calib.gap.reference.align import SAME, aligned, aligned_in_any_frame, same_digits
from mavcal.calib.gap.reference.calibrated import TRIADS
from mavcal.calib.gap.reference.channels import comparable, sensors_of
from mavcal.calib.gap.reference.checks import Refusal
from mavcal.calib.gap.reference.ideal import Ideal
from mavcal.calib.gap.reference.signals import LONGEST_HOLE_S
from mavcal.calib.gap.schema import REFERENCE_NEED, USELESS_DEG
from mavcal.calib.recording import Recording, Sensor

_SLOWER = 0.5
"""Ratio of rates from which a reference leaves out what the sensor sees."""
_REPEATED = 0.1
"""Share of samples with the stamp of another from which it is said."""


def notices(real: Recording, sim: Recording | None, nominal: Sequence[Recording], ideal: Ideal) -> Iterator[str]:
    """Sentences for the report."""
    if sim is not None and sim is not real and same_digits(real, sim):
        yield (
            "the simulator's recording holds the same samples as the real one: what they show counts as the "
            "simulator's own, and no gap can be seen"
        )
    if any(same_digits(real, n) for n in nominal):
        yield (
            "a nominal recording holds the same samples as the real one: what they show counts as noise; give one of "
            "another time"
        )
    yield from _not_compared(real, ideal)
    yield from _too_slow(real, ideal)
    yield from _one_stamp(real)
    yield from _in_parts(real)


def _not_compared(real: Recording, ideal: Ideal) -> Iterator[str]:
    there = {c.sensor for c in sensors_of(real)}
    for sensor in TRIADS:
        if sensor in ideal.readings and sensor not in there:
            if any(c.sensor == sensor for c in real.reference):
                yield f"{sensor.value} has a reference and no sample with all three axes: are its columns empty?"
        elif sensor in there and sensor not in ideal.readings and len(comparable(real, sensor)) < 2:
            why = ""
            if sensor == Sensor.MAG and ideal.info.kind == ReferenceKind.POSE:
                why = ": along the pose it fits no field in its own frame, and in several others one"
            yield f"{sensor.value} has no reference and was not compared{why}"


def _too_slow(real: Recording, ideal: Ideal) -> Iterator[str]:
    if ideal.info.kind not in {ReferenceKind.SIM, ReferenceKind.POSE} or math.isfinite(ideal.info.bandwidth_hz):
        return  # of no recording: how fast it is, is known
    for channel in sensors_of(real):
        signal = ideal.readings.get(channel.sensor)
        times = np.unique(channel.t)
        if signal is None or len(times) < 2:
            continue
        theirs, ours = (1.0 / float(np.median(np.diff(t))) for t in (signal.t, times))
        if theirs < _SLOWER * ours:
            yield (
                f"the reference of {channel.sensor.value} has {theirs:.3g} samples a second and the sensor {ours:.3g}: "
                f"above {0.5 * theirs:.3g} Hz whatever the sensor reads is a gap"
            )


def _one_stamp(real: Recording) -> Iterator[str]:
    for channel in sensors_of(real):
        lost = 1.0 - len(np.unique(channel.t)) / max(len(channel), 1)
        if lost > _REPEATED:
            name = f"{channel.sensor.value} of instance {channel.instance + 1}"
            yield f"{100.0 * lost:.0f} % of the samples of {name} have the time of another and were left out"


def _in_parts(real: Recording) -> Iterator[str]:
    longest = max((float(np.diff(c.t).max()) for c in sensors_of(real) if len(c) > 1), default=0.0)
    if longest > LONGEST_HOLE_S:
        yield (
            f"the recording has a hole of {longest:.0f} s: only its longest part was compared; cut it there and give "
            "each part by itself"
        )


def why_no_reference(real: Recording, sim: Recording) -> str:
    """Why the simulator's recording is no reference for the real one, and what would be."""
    if same_digits(real, sim):
        return "the simulator's recording holds the same samples as the real one: was one file given twice?"
    ours, theirs = ({c.sensor for c in sensors_of(r)} for r in (real, sim))
    if not ours & theirs:
        return (
            f"the recordings have no sensor in common: the real one has {_names(ours)}, the simulator's "
            f"{_names(theirs)}"
        )
    found = [a.correlation for a in (aligned(real, sim), aligned_in_any_frame(real, sim)) if a is not None]
    best = f"correlation {max(found):.2f} at best, {SAME} is needed" if found else "too little moves in both to tell"
    return (
        f"the simulator's recording is of another movement ({best}), and nothing else says what an ideal sensor would "
        "have read: give a simulation of this very trajectory with time in seconds, or ref_* or q_* columns"
    )


def _names(sensors: set[Sensor]) -> str:
    return ", ".join(s.value for s in TRIADS if s in sensors) or "none"


def refusals(info: ReferenceInfo, sensors: Iterable[Sensor]) -> tuple[Refusal, ...]:
    """Why the `sensors` of a recording are not judged by its reference `info`, one line each."""
    reason = f"{uselessness(info)}: no single {{}} is compared with it"
    return tuple((s.value, reason.format(s.value), REFERENCE_NEED) for s in dict.fromkeys(sensors))


def uselessness(info: ReferenceInfo) -> str:
    """How badly the attitude of a useless reference is known, and the limit."""
    if math.isinf(info.att_sigma_deg):
        return "the trajectory that was estimated contradicts its own inertial unit all the time"
    return (
        f"the attitude of the reference is known to {info.att_sigma_deg:.1f} deg only, {USELESS_DEG:g} deg are needed"
    )


def not_learned(info: ReferenceInfo) -> str:
    """The same of another recording, from which noise was to be learned."""
    return (
        f"nothing was learned of single sensors from the simulator's or a nominal recording: {uselessness(info)}; "
        f"it takes {REFERENCE_NEED}"
    )
