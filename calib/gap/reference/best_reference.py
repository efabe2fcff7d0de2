"""The best reference of a recording and its nominal companions, and notices about it.

The notices name sensors without a reference, repeated recordings and slow references. A reference is useless if its
trajectory could fit any reading, so that effects along it may be its own errors. Only differences of instances then
remain, which need no attitude.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.gap.problem import ReferenceInfo, ReferenceKind
from mavcal.calib.gap.reference.align import (
    SAME,
    SAME_LOG,
    clock_alignment,
    clock_alignment_in_any_frame,
    have_same_samples,
    have_same_times,
    have_unrelated_movement,
)
from mavcal.calib.gap.reference.channels import TRIADS, comparable_channels, sensors_of
from mavcal.calib.gap.reference.checks import Refusal, check_times
from mavcal.calib.gap.reference.ideal import Ideal, recorded_reference, simulator_reference, true_attitude
from mavcal.calib.gap.reference.posed import Array, Cutoffs, PoseTrajectory, earth_field_of, ideal_along, pose_of
from mavcal.calib.gap.reference.re_estimated import re_estimated
from mavcal.calib.gap.reference.signals import LONGEST_HOLE_S
from mavcal.calib.gap.schema import REFERENCE_NEED, USELESS_DEG
from mavcal.calib.recording import Recording, Sensor

_SLOWER = 0.5
"""Ratio of the sensor's rate to the reference's, above which the reference is too slow. Chosen, not measured: an octave
of the sensor's band is then missing."""
_REPEATED = 0.1
"""Fraction of samples with a repeated time stamp above which a notice is given. Chosen, not measured: single duplicates
occur in any log."""


def notices(real: Recording, sim: Recording | None, nominal: Sequence[Recording], ideal: Ideal) -> Iterator[str]:
    """Notices for the report."""
    if sim is not None and sim is not real and have_same_samples(real, sim):
        yield (
            "the simulator's recording holds the same samples as the real one: what they show counts as the "
            "simulator's own, and no gap can be seen"
        )
    if any(have_same_samples(real, n) for n in nominal):
        yield (
            "a nominal recording holds the same samples as the real one: what they show counts as noise; give one of "
            "another time"
        )
    yield from _uncompared_notices(real, ideal)
    yield from _slow_reference_notices(real, ideal)
    yield from _repeated_stamp_notices(real)
    yield from _hole_notice(real)


def _uncompared_notices(real: Recording, ideal: Ideal) -> Iterator[str]:
    there = {c.sensor for c in sensors_of(real)}
    for sensor in TRIADS:
        if sensor in ideal.readings and sensor not in there:
            if any(c.sensor == sensor for c in real.reference):
                yield f"{sensor.value} has a reference and no sample with all three axes: are its columns empty?"
        elif sensor in there and sensor not in ideal.readings and len(comparable_channels(real, sensor)) < 2:
            why = ""
            if sensor == Sensor.MAG and ideal.info.kind == ReferenceKind.POSE:
                why = ": along the pose it fits no field in its own frame, and in several others one"
            yield f"{sensor.value} has no reference and was not compared{why}"


def _slow_reference_notices(real: Recording, ideal: Ideal) -> Iterator[str]:
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


def _repeated_stamp_notices(real: Recording) -> Iterator[str]:
    for channel in sensors_of(real):
        lost = 1.0 - len(np.unique(channel.t)) / max(len(channel), 1)
        if lost > _REPEATED:
            name = f"{channel.sensor.value} of instance {channel.instance + 1}"
            yield f"{100.0 * lost:.0f} % of the samples of {name} have the time of another and were left out"


def _hole_notice(real: Recording) -> Iterator[str]:
    longest = max((float(np.diff(c.t).max()) for c in sensors_of(real) if len(c) > 1), default=0.0)
    if longest > LONGEST_HOLE_S:
        yield (
            f"the recording has a hole of {longest:.0f} s: only its longest part was compared; cut it there and give "
            "each part by itself"
        )


def why_no_reference(real: Recording, sim: Recording) -> str:
    """Why the simulator's recording is not a reference, and what would be one."""
    if have_same_samples(real, sim):
        return "the simulator's recording holds the same samples as the real one: was one file given twice?"
    ours, theirs = ({c.sensor for c in sensors_of(r)} for r in (real, sim))
    if not ours & theirs:
        return (
            f"the recordings have no sensor in common: the real one has {_names(ours)}, the simulator's "
            f"{_names(theirs)}"
        )
    found = [
        a.correlation for a in (clock_alignment(real, sim), clock_alignment_in_any_frame(real, sim)) if a is not None
    ]
    best = f"correlation {max(found):.2f} at best, {SAME} is needed" if found else "too little moves in both to tell"
    return (
        f"the simulator's recording is of another movement ({best}), and nothing else says what an ideal sensor would "
        "have read: give a simulation of this very trajectory with time in seconds, or ref_* or q_* columns"
    )


def _names(sensors: set[Sensor]) -> str:
    return ", ".join(s.value for s in TRIADS if s in sensors) or "none"


def refusals(info: ReferenceInfo, sensors: Iterable[Sensor]) -> tuple[Refusal, ...]:
    """Why the `sensors` of a recording are not judged by its reference."""
    reason = f"{uselessness(info)}: no single {{}} is compared with it"
    return tuple((s.value, reason.format(s.value), REFERENCE_NEED) for s in dict.fromkeys(sensors))


def uselessness(info: ReferenceInfo) -> str:
    """Text on the inaccuracy of a useless reference's attitude."""
    if math.isinf(info.att_sigma_deg):
        return "the trajectory that was estimated contradicts its own inertial unit all the time"
    return (
        f"the attitude of the reference is known to {info.att_sigma_deg:.1f} deg only, {USELESS_DEG:g} deg are needed"
    )


def not_learned(info: ReferenceInfo) -> str:
    """Notice about a recording with a useless reference, from which noise was to be learned."""
    return (
        f"nothing was learned of single sensors from the simulator's or a nominal recording: {uselessness(info)}; "
        f"it takes {REFERENCE_NEED}"
    )


DOUBTFUL_DEG = 0.5
"""Standard deviation of a reference's attitude, deg, above which a warning is given. Chosen, not measured: such a tilt
reads like 0.09 m/s2."""


@dataclass(frozen=True, eq=False)
class BestReferences:
    """The reference of the real recording, and the nominal recordings with their own; None without one."""

    ideal: Ideal
    nominal: tuple[tuple[Recording, Ideal | None], ...]


def best_references(real: Recording, sim: Recording | None, nominal: Sequence[Recording]) -> BestReferences | None:
    """The best available reference (GAP 3.5b); None: only other instances.

    Raises
    ------
    InvalidInputError
        If time is not in seconds, or the only candidate is a simulator's recording that is not a reference.
    """
    check_times((real, *nominal, *(() if sim is None else (sim,))))
    chosen = _best_available(real, sim, nominal)
    if chosen is not None:
        said = (*notices(real, sim, nominal, chosen.ideal), *_not_learned(chosen))
        warned = dataclasses.replace(chosen.ideal, warnings=(*chosen.ideal.warnings, *said))
        return BestReferences(warned, tuple((n, _unless_useless(its)) for n, its in chosen.nominal))
    if sim is not None and sim is not real and not any(len(comparable_channels(real, s)) > 1 for s in TRIADS):
        raise InvalidInputError(why_no_reference(real, sim))
    return None


def _best_available(real: Recording, sim: Recording | None, nominal: Sequence[Recording]) -> BestReferences | None:
    clean = [*nominal, *(() if sim is None else (sim,))]
    ideal = recorded_reference(real)
    if ideal is not None:
        return BestReferences(
            _with_missing_sensors(ideal, real), tuple((n, _nominal_reference(n, real, ideal)) for n in clean)
        )
    if sim is not None and (ideal := same_trajectory_reference(real, sim)) is not None:
        return BestReferences(
            ideal, tuple((n, recorded_reference(n) or (ideal if n is sim and ideal.noise else None)) for n in clean)
        )
    logged = real.identity.autopilot is not None  # of a vehicle: a simulator's truth is there too slow for a gyroscope
    truth = all(true_attitude(r) is not None for r in (real, *clean))
    if logged and (ideal := re_estimated(real, with_truth=truth)) is not None:
        others = ((n, ideal if n is real else re_estimated(n, with_truth=truth)) for n in clean)
        return BestReferences(_with_attitude_warning(ideal), tuple(others))
    if (pose := pose_of(real)) is not None:
        poses = [(n, pose_of(n)) for n in clean]
        if any(p is not None and p.cutoffs != pose.cutoffs for _, p in poses):
            common = functools.reduce(Cutoffs.lower, (p.cutoffs for _, p in poses if p is not None), pose.cutoffs)
            pose, poses = pose_of(real, common) or pose, [(n, pose_of(n, common)) for n in clean]
        earth = earth_field_along([(n, p) for n, p in poses if p is not None] or [(real, pose)])
        made = tuple((n, None if p is None else ideal_along(p, earth)) for n, p in poses)
        return BestReferences(ideal_along(pose, earth), made)
    if not logged and (ideal := re_estimated(real)) is not None:
        return BestReferences(_with_attitude_warning(ideal), tuple((n, re_estimated(n)) for n in clean))
    return None


def _unless_useless(ideal: Ideal | None) -> Ideal | None:
    return None if ideal is None or ideal.info.useless else ideal


def _not_learned(chosen: BestReferences) -> tuple[str, ...]:
    poor = (its.info for _, its in chosen.nominal if its is not None and its.info.useless)
    return tuple(dict.fromkeys(map(not_learned, poor)))


def same_trajectory_reference(real: Recording, sim: Recording) -> Ideal | None:
    """The readings of `sim` on the clock of `real`; None if it flew another trajectory.

    A simulated autopilot closes the loop through its own sensors, so its log must agree more closely.
    """
    ideal = recorded_reference(sim) or simulator_reference(sim)
    if ideal is None or have_same_samples(real, sim):
        return None
    shift = clock_alignment(real, sim)
    table = sim.identity.autopilot is None
    if table and (shift is None or shift.correlation < SAME):
        shift = clock_alignment_in_any_frame(real, sim) or shift
    if have_same_times(real, sim) and (
        not have_unrelated_movement(real, sim) if table else shift is not None and shift.near(0.0, SAME_LOG)
    ):
        return ideal
    if shift is None or shift.correlation < (SAME if table else SAME_LOG):
        return None
    said = f"the simulator's clock was set {shift.lag:+.4f} s: a delay common to all sensors cannot be told from it"
    return dataclasses.replace(ideal.shifted(shift.lag), warnings=(*ideal.warnings, said))


def is_another_flight(real: Recording, sim: Recording) -> bool:
    """Whether `sim` is the log of a simulated vehicle on another flight, to be compared with its own ideal reading."""
    table = sim.identity.autopilot is None or real.identity.autopilot is None
    return not table and recorded_reference(real) is None and same_trajectory_reference(real, sim) is None


def companion_with_pose(real: Recording, nominal: Sequence[Recording]) -> Recording | None:
    """The first of the `nominal` recordings with a pose, if `real` is compared with a pose too."""
    if real.identity.autopilot is not None or recorded_reference(real) is not None or true_attitude(real) is None:
        return None
    return next((n for n in nominal if recorded_reference(n) is None and true_attitude(n) is not None), None)


def have_separate_poses(real: Recording, sim: Recording) -> bool:
    """Whether two tables are of two flights with a pose each."""
    return companion_with_pose(real, [sim]) is not None and same_trajectory_reference(real, sim) is None


def earth_field_along(posed: Sequence[tuple[Recording, PoseTrajectory]]) -> Array | None:
    """The field that the magnetometers of the first of `posed` measured."""
    for recording, pose in posed:
        if magnetometers := [c for c in sensors_of(recording) if c.sensor == Sensor.MAG]:
            return earth_field_of(magnetometers, pose)
    return None


def _with_attitude_warning(ideal: Ideal) -> Ideal:
    """With a warning if the attitude is so inaccurate that it imitates an effect."""
    if ideal.info.att_sigma_deg < DOUBTFUL_DEG or ideal.info.useless:  # that ends the diagnosis
        return ideal
    said = (
        f"the re-estimated attitude is known to {ideal.info.att_sigma_deg:.1f} deg only: a bias below "
        f"{0.34 * ideal.info.att_sigma_deg:.2f} m/s2 that all accelerometers share, or an offset of all compasses, "
        "cannot be told from a tilt; turn the vehicle through all headings"
    )
    return dataclasses.replace(ideal, warnings=(*ideal.warnings, said))


def _with_missing_sensors(ideal: Ideal, real: Recording) -> Ideal:
    """With readings from a pose for the sensors whose ideal reading was not recorded."""
    sensors = {c.sensor for c in sensors_of(real)} - set(ideal.readings)
    pose = pose_of(real) if sensors else None
    if pose is None:
        return ideal
    other = ideal_along(pose, earth_field_along([(real, pose)]))
    added = {sensor: signal for sensor, signal in other.readings.items() if sensor in sensors}
    return dataclasses.replace(ideal, readings={**ideal.readings, **added}) if added else ideal


def _nominal_reference(nominal: Recording, real: Recording, ideal: Ideal) -> Ideal | None:
    """The nominal recording's own reference, or the real one's if both are from one run."""
    own = recorded_reference(nominal)
    return own if own is not None else (ideal if have_same_times(real, nominal) else None)
