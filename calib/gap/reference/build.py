"""Which references apply, and the traces that they make."""

from __future__ import annotations

from collections.abc import Sequence

from calib.errors import InvalidInputError
from calib.gap.problem import Problem, Trace
from calib.gap.reference.ideal import Ideal, trace_of
from calib.gap.reference.noise import Noise, learned, with_noise
from calib.gap.reference.recorded import TRIADS, recorded, simulated
from calib.recording import Channel, Recording, Sensor, Stage


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
    channels = sensors_of(real)
    if not channels:
        raise InvalidInputError("the recording has no accelerometer, gyroscope or magnetometer: nothing to compare")
    ideal = recorded(real) or (None if sim is None else recorded(sim) or simulated(sim))
    if ideal is None:
        raise InvalidInputError("nothing says what an ideal sensor would have read: add ref_* columns or give --sim")
    traces = single_traces(real, channels, ideal)
    if not traces:
        raise InvalidInputError("the recording and its reference have no sensor in common, or do not overlap in time")
    noise = declared_noise(real, sim, ideal)
    traces = tuple(with_noise(trace, noise[trace.sensor]) if trace.sensor in noise else trace for trace in traces)
    return Problem(traces, ideal.info, max(float(t.t[-1] - t.t[0]) for t in traces), warnings=ideal.warnings)


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


def declared_noise(real: Recording, sim: Recording | None, ideal: Ideal) -> dict[Sensor, Noise]:
    """A simulator's own noise, where its recording has both its readings and what an ideal sensor read."""
    if sim is None:
        return {}
    own = recorded(sim) or (recorded(real) and ideal)
    if not own:
        return {}
    found: dict[Sensor, Noise] = {}
    for trace in single_traces(sim, sensors_of(sim), own):
        if trace.sensor not in found and (noise := learned(trace)) is not None:
            found[trace.sensor] = noise
    return found
