"""Which channel of every instance is looked at."""

from __future__ import annotations

import numpy as np

from mavcal.calib.gap.reference.calibrated import TRIADS
from mavcal.calib.recording import Channel, Recording, Sensor, Stage

_CLOSE = 0.05
"""Share of a step by which time stamps of two instances may differ and still be one sample of both."""


def sensors_of(recording: Recording) -> list[Channel]:
    """One channel of every instance of the three sensors: the ones that can be compared, where there are several."""
    chosen: list[Channel] = []
    for sensor in TRIADS:
        together = comparable(recording, sensor)
        for instance in recording.instances(sensor):
            if len(together) > 1 and instance in together:
                chosen.append(together[instance])
            elif any(c.stage != Stage.DEBIASED for c in recording.find(sensor, instance)):
                chosen.append(recording.channel(sensor, instance))
    return chosen


def comparable(real: Recording, sensor: Sensor) -> dict[int, Channel]:
    """A channel of every instance, all of one source and stage; the source that most instances have, then the longest.

    Sources whose instances were sampled at different times are passed over: their difference would be movement.
    """
    sources: dict[tuple[str, Stage], dict[int, Channel]] = {}
    for channel in real.channels:
        if channel.sensor == sensor and channel.stage != Stage.DEBIASED and len(channel) >= 4:
            sources.setdefault(_kind(channel), {}).setdefault(channel.instance, channel)
    found = [{i: c for i, c in group.items() if _same_times(c, group[min(group)])} for group in sources.values()]
    return max(found, key=lambda group: (len(group), sum(len(c) for c in group.values())), default={})


def with_common_channels(real: Recording, other: Recording) -> tuple[Recording, Recording]:
    """Both without the channels of a sensor that have no counterpart, where every instance of `real` has one that does.

    What one stage of a sensor shows, before or behind the firmware's filter, says little of another.
    """
    dropped: set[tuple[Sensor, tuple[str, Stage]]] = set()
    for sensor in TRIADS:
        ours, theirs = ({_kind(c) for c in r.channels if c.sensor == sensor} for r in (real, other))
        common = ours & theirs
        covered = {c.instance for c in real.channels if c.sensor == sensor and _kind(c) in common}
        if covered == set(real.instances(sensor)):
            dropped |= {(sensor, kind) for kind in (ours | theirs) - common}
    common_channels = ([c for c in r.channels if (c.sensor, _kind(c)) not in dropped] for r in (real, other))
    first, second = (r.with_channels(channels) for r, channels in zip((real, other), common_channels, strict=True))
    return first, second


def _kind(channel: Channel) -> tuple[str, Stage]:
    """Where a channel comes from; older logs number their messages: IMU, IMU2, IMU3."""
    return channel.source.rstrip("0123456789"), channel.stage


def _same_times(a: Channel, b: Channel) -> bool:
    if a is b:
        return True
    shared = np.clip(np.searchsorted(b.t, a.t), 1, len(b) - 1)
    nearest = np.minimum(np.abs(b.t[shared] - a.t), np.abs(b.t[shared - 1] - a.t))
    return bool((nearest < _CLOSE * np.median(np.diff(b.t))).mean() > 0.9)
