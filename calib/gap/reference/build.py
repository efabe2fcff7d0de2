"""Which references apply, and the traces that they make."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from calib.errors import InvalidInputError
from calib.gap.problem import Problem, ReferenceInfo, ReferenceKind, Trace
from calib.gap.reference.align import CLOSED, SAME, aligned, one_clock, same_digits
from calib.gap.reference.calibrated import TRIADS, corrected
from calib.gap.reference.ideal import Ideal, trace_of
from calib.gap.reference.noise import Noise, learned, with_noise
from calib.gap.reference.recorded import recorded, simulated
from calib.gap.reference.redundant import differences
from calib.recording import Channel, Recording, Sensor, Stage

Role = tuple[Sensor, bool]
"""Sensor, and whether it is held against another instance: traces of one role have the same noise."""
_REDUNDANT = "The instances of the vehicle are held against each other."


def build(real: Recording, sim: Recording | None = None, nominal: Sequence[Recording] = ()) -> Problem:
    """Every sensor of `real` beside its best reference.

    Parameters
    ----------
    real
        The recording whose gap is asked for.
    sim
        A simulator's recording of the same trajectory.
    nominal
        Recordings without an effect, from which the noise is learned.

    Raises
    ------
    InvalidInputError
        If the recordings have nothing in common, or `real` has no sensor.
    """
    real, sim = corrected(real), None if sim is None else corrected(sim)
    channels = sensors_of(real)
    if not channels:
        raise InvalidInputError("the recording has no accelerometer, gyroscope or magnetometer: nothing to compare")
    ideal = recorded(real) or (None if sim is None else of_same_trajectory(real, sim))
    single = () if ideal is None else single_traces(real, channels, ideal)
    traces = single + differences(real, ideal, single)
    if not traces:
        raise InvalidInputError("nothing says what an ideal sensor would have read: add ref_* columns or give --sim")
    noise = declared_noise(real, sim, ideal)
    traces = tuple(with_noise(trace, noise[key]) if (key := _role(trace)) in noise else trace for trace in traces)
    info = ideal.info if ideal is not None else ReferenceInfo(ReferenceKind.REDUNDANT, text=_REDUNDANT)
    warnings = () if ideal is None else ideal.warnings
    return Problem(traces, info, max(float(t.t[-1] - t.t[0]) for t in traces), warnings=warnings)


def of_same_trajectory(real: Recording, sim: Recording) -> Ideal | None:
    """What `sim` says of the trajectory of `real`, on the clock of `real`; None if it flew another one.

    A log of a simulated autopilot closes the loop through its own sensors: it counts only if it moves as one.
    """
    ideal = recorded(sim) or simulated(sim)
    if ideal is None or same_digits(real, sim):
        return None
    shift = aligned(real, sim)
    if one_clock(real, sim) and (sim.identity.autopilot is None or (shift is not None and shift.near(0.0, CLOSED))):
        return ideal
    if shift is None or shift.correlation < (SAME if sim.identity.autopilot is None else CLOSED):
        return None
    said = f"the simulator's clock was set {shift.lag:+.4f} s: a delay common to all sensors cannot be told from it"
    return dataclasses.replace(ideal.shifted(shift.lag), warnings=(*ideal.warnings, said))


def sensors_of(recording: Recording) -> list[Channel]:
    """The best channel of every instance of the three sensors."""
    return [
        recording.channel(sensor, instance)
        for sensor in TRIADS
        for instance in recording.instances(sensor)
        if any(c.stage != Stage.DEBIASED for c in recording.find(sensor, instance))
    ]


def single_traces(real: Recording, channels: list[Channel], ideal: Ideal) -> tuple[Trace, ...]:
    """Each of `channels` beside what an ideal sensor of its kind read, where that is known."""
    made = [trace_of(c, ideal.readings[c.sensor], ideal, real) for c in channels if c.sensor in ideal.readings]
    return tuple(trace for trace in made if trace.observed.sum() > 1)


def declared_noise(real: Recording, sim: Recording | None, ideal: Ideal | None) -> dict[Role, Noise]:
    """A simulator's own noise, where its recording has both its readings and what an ideal sensor read."""
    if sim is None:
        return {}
    own = recorded(sim) or (ideal if recorded(real) else None)
    single = () if own is None else single_traces(sim, sensors_of(sim), own)
    found: dict[Role, Noise] = {}
    for trace in single + differences(sim, own, single):
        if _role(trace) not in found and (noise := learned(trace)) is not None:
            found[_role(trace)] = noise
    return found


def _role(trace: Trace) -> Role:
    return trace.sensor, trace.against is not None
