"""Which channel of every instance is compared, and at which stage: at the sensor, against the calibration in force.

A correction in force has the form ``corrected = L (sensor - offset - p(T))``. The offset that it removes is not a gap:
it is exact for an ideal sensor. Its scaling is undone, so that an effect has the size at the sensor, as simulators
expect. The reading is ``R L^-1 corrected``, with ``R`` the mounting, in body axes. A simulator's log with the same
calibration is treated in the same way; its offset from the ideal belongs to the simulator.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import FirmwareError, InvalidInputError
from mavcal.calib.firmware import body_from_sensor, calibration_in_force
from mavcal.calib.firmware.in_force.rewritten import compass_offset_changes
from mavcal.calib.recording import Channel, Recording, Sensor, Stage
from mavcal.calib.triad import TriadModel

Array = NDArray[np.float64]

TRIADS = (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG)
SAME_RATE = 0.02
"""Relative difference up to which two rates are equal. Chosen, not measured: clocks and lost samples make less than 2
%."""
SAME_SAMPLE = 0.05
"""Time difference of two instances, as a fraction of a step, up to which their samples are simultaneous; beyond, their
difference is movement. Chosen, not measured: a twentieth of a step of usual movement is less than noise."""
TELLING_CURRENT = 0.5
"""Least standard deviation of the current, A, to tell the field of the motors from an offset. Chosen, not measured:
0.05 uT/A then show 0.025 uT, a twentieth of a sensor's noise."""
FASTER = 1.5
"""Ratio of two units' rates above which the faster one is evaluated at the sample times of the slower. Chosen, not
measured: between one rate and twice the rate."""
_BEFORE_S, _AFTER_S = 0.5, 0.2
"""Time, s, left out around a change of an offset: the autopilot logs it late, and averages contain both values. Chosen,
not measured: a log states a parameter within tenths of a second."""
_FILTERS = {Sensor.ACCEL: "INS_ACCEL_FILTER", Sensor.GYRO: "INS_GYRO_FILTER"}


def corrected(recording: Recording) -> Recording:
    """`recording` with raw sensors of a known calibration corrected, in body axes.

    Tables, vehicles without a known calibration, and sensors with a thermal correction stay as they are. A compass
    whose offset in force changed is cut to the longest time with one offset.
    """
    if not _has_calibration(recording):
        return recording
    changes = compass_offset_changes(recording)
    return recording.with_channels(
        _corrected(c, recording)
        if c.sensor in TRIADS and c.stage == Stage.RAW and len(c)
        else _with_constant_offset(c, changes)
        for c in recording.channels
    )


def offset_changed(channels: Sequence[Channel], recording: Recording) -> tuple[str, ...]:
    """A warning for each compass that was cut because its offset in force changed."""
    changes = compass_offset_changes(recording) if _has_calibration(recording) else {}
    said = []
    for channel in channels:
        if channel.sensor is Sensor.MAG and channel.stage != Stage.RAW and (moments := changes.get(channel.instance)):
            when = ", ".join(f"{t:.1f} s" for t in moments)
            said.append(
                f"the autopilot changed the offset of compass {channel.instance + 1} at {when}: it is looked at from "
                f"{channel.t[0]:.1f} to {channel.t[-1]:.1f} s"
            )
    return tuple(said)


def _with_constant_offset(channel: Channel, changes: Mapping[int, Sequence[float]]) -> Channel:
    """A corrected compass, cut to its longest time with one offset."""
    moments = changes.get(channel.instance, ()) if channel.sensor is Sensor.MAG else ()
    if channel.stage == Stage.RAW or not moments or not len(channel):
        return channel
    edges = [-math.inf, *moments, math.inf]
    parts = [channel.between(low + _AFTER_S, high - _BEFORE_S) for low, high in itertools.pairwise(edges)]
    return max(parts, key=len)


def sensor_from_corrected(channel: Channel, recording: Recording) -> Array:
    """``R L^-1`` (3, 3), from corrected to sensor readings in body axes; the identity if not corrected or unknown."""
    about = _calibration(channel, recording) if channel.stage != Stage.RAW else None
    if about is None:
        return np.eye(3)
    model, mounting = about
    return np.asarray(mounting @ np.linalg.inv(model.matrix), dtype=np.float64)


def not_undone(channels: Sequence[Channel], recording: Recording) -> tuple[str, ...]:
    """A warning if a correction in force on any of `channels` is unknown."""
    unknown = [c for c in channels if c.stage != Stage.RAW and _calibration(c, recording) is None]
    if not unknown:
        return ()
    names = ", ".join(f"{c.sensor.value} {c.instance + 1}" for c in unknown)
    return (f"the calibration in force on {names} is not known: what is found there is stated as it was logged",)


def _has_calibration(recording: Recording) -> bool:
    return recording.identity.autopilot in {"ardupilot", "px4"} and bool(recording.parameters)


def _corrected(channel: Channel, recording: Recording) -> Channel:
    about = _calibration(channel, recording)
    if about is None or about[0].polynomial is not None:
        return channel
    return dataclasses.replace(channel, values=about[0].apply(channel.values), stage=Stage.CORRECTED)


def _calibration(channel: Channel, recording: Recording) -> tuple[TriadModel, Array] | None:
    if not _has_calibration(recording) or channel.sensor not in TRIADS:
        return None
    parameters = recording.parameters.at(float(channel.t[len(channel) // 2]))
    autopilot = recording.identity.autopilot
    try:
        model = calibration_in_force(autopilot, parameters, channel.sensor, channel.instance)
        mounting = body_from_sensor(autopilot, parameters, channel.sensor, channel.instance)
    except (FirmwareError, InvalidInputError):
        return None
    return (model, mounting) if abs(np.linalg.det(model.matrix)) > 1e-6 else None


def filter_in_force(channel: Channel, recording: Recording) -> float | None:
    """Cut-off, Hz, of ArduPilot's two-pole filter on a filtered channel; None if none or unknown."""
    name = _FILTERS.get(channel.sensor)
    if channel.stage != Stage.FILTERED or recording.identity.autopilot != "ardupilot" or name is None:
        return None
    cutoff = float(recording.parameters.final().get(name, 0.0))
    return cutoff if cutoff > 0.0 else None


def filter_delay(cutoff: float | None) -> float:
    """Delay of that filter at low frequencies, s, ``sqrt(2) / (2 pi cutoff)``; 0 without one."""
    return 0.0 if cutoff is None else math.sqrt(2.0) / (2.0 * math.pi * cutoff)


def filter_gain(hz: Array, cutoff: float | None) -> Array:
    """Amplitude gain of a two-pole Butterworth filter at `hz`; 1 without one."""
    if cutoff is None:
        return np.ones_like(hz)
    return np.asarray(1.0 / np.sqrt(1.0 + (hz / cutoff) ** 4))


def sensors_of(recording: Recording) -> list[Channel]:
    """One channel for every instance of the three sensors; several instances get comparable channels."""
    chosen: list[Channel] = []
    for sensor in TRIADS:
        together = comparable_channels(recording, sensor)
        for instance in recording.instances(sensor):
            if len(together) > 1 and instance in together:
                chosen.append(together[instance])
            elif any(c.stage != Stage.DEBIASED for c in recording.find(sensor, instance)):
                chosen.append(recording.channel(sensor, instance))
    return chosen


def comparable_channels(real: Recording, sensor: Sensor) -> dict[int, Channel]:
    """A channel of every instance from one source and stage: the one with most instances, then the longest.

    Sources whose instances were sampled at different times are omitted: their difference would be movement.
    """
    sources: dict[tuple[str, Stage], dict[int, Channel]] = {}
    for channel in real.channels:
        if channel.sensor == sensor and channel.stage != Stage.DEBIASED and len(channel) >= 4:
            sources.setdefault(_source_and_stage(channel), {}).setdefault(channel.instance, channel)
    found = [{i: c for i, c in group.items() if _same_times(c, group[min(group)])} for group in sources.values()]
    return max(found, key=lambda group: (len(group), sum(len(c) for c in group.values())), default={})


def as_slow_as(companion: Recording, real: Recording) -> Recording:
    """`companion` with each unit decimated to the rate of the same unit of `real`, where that is lower.

    A logger that writes every tenth sample aliases fast movement and noise. The companion must be aliased in the same
    way.
    """
    rates = {(s, i): rate_of(c) for s in TRIADS for i, c in comparable_channels(real, s).items()}
    return companion.with_channels(_picked(c, rates.get((c.sensor, c.instance))) for c in companion.channels)


def as_uneven_as(real: Recording, sim: Recording) -> Recording:
    """`real` with units decimated like the simulator's, if only some of that sensor's units are decimated there.

    Where only the simulator's unit is aliased, the difference of two units would show a vibration common to both.
    """
    slow: dict[tuple[Sensor, int], float] = {}
    for sensor in TRIADS:
        rates = {i: rate_of(c) for i, c in comparable_channels(sim, sensor).items()}
        slow |= {(sensor, i): hz for i, hz in rates.items() if FASTER * hz < max(rates.values())}
    return real.with_channels(_picked(c, slow.get((c.sensor, c.instance))) for c in real.channels)


def _picked(channel: Channel, rate: float | None) -> Channel:
    """The samples nearest to a grid of `rate` Hz; all if the channel is not faster, or `rate` is not known."""
    if rate is None or len(channel) < 4 or rate_of(channel) < FASTER * rate:
        return channel
    grid = np.arange(channel.t[0], channel.t[-1], 1.0 / rate)
    return channel.take(np.unique(np.clip(np.searchsorted(channel.t, grid), 0, len(channel) - 1)))


def rate_of(channel: Channel) -> float:
    """Samples per second, from the median time step."""
    return 1.0 / max(float(np.median(np.diff(channel.t))), 1e-9)


def with_common_channels(real: Recording, other: Recording) -> tuple[Recording, Recording]:
    """Both recordings without sources that only one has, if every instance of `real` keeps a channel.

    Samples before the firmware's filter tell little about those after it.
    """
    dropped: set[tuple[Sensor, tuple[str, Stage]]] = set()
    for sensor in TRIADS:
        ours, theirs = ({_source_and_stage(c) for c in r.channels if c.sensor == sensor} for r in (real, other))
        common = ours & theirs
        covered = {c.instance for c in real.channels if c.sensor == sensor and _source_and_stage(c) in common}
        if covered == set(real.instances(sensor)):
            dropped |= {(sensor, kind) for kind in (ours | theirs) - common}
    common_channels = (
        [c for c in r.channels if (c.sensor, _source_and_stage(c)) not in dropped] for r in (real, other)
    )
    first, second = (r.with_channels(channels) for r, channels in zip((real, other), common_channels, strict=True))
    return first, second


def _source_and_stage(channel: Channel) -> tuple[str, Stage]:
    """Source and stage of a channel; older logs number their messages: IMU, IMU2, IMU3."""
    return channel.source.rstrip("0123456789"), channel.stage


def _same_times(a: Channel, b: Channel) -> bool:
    if a is b:
        return True
    shared = np.clip(np.searchsorted(b.t, a.t), 1, len(b) - 1)
    nearest = np.minimum(np.abs(b.t[shared] - a.t), np.abs(b.t[shared - 1] - a.t))
    return bool((nearest < SAME_SAMPLE * np.median(np.diff(b.t))).mean() > 0.9)
