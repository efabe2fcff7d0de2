"""Removes samples of accelerometers and compasses that are exactly zero: these come from dead sensors only."""

from __future__ import annotations

from typing import Final

import numpy as np

from mavcal.calib.recording import Channel, Event, Oddity, OddSamples, Sensor

_NEVER_ZERO: Final = (Sensor.ACCEL, Sensor.MAG)
"""A gyroscope may read 0, 0, 0 at rest."""


def without_zeros(channel: Channel, events: list[Event]) -> Channel:
    """`channel` without such samples; `events` are told how many. A channel that holds nothing else is kept."""
    if channel.sensor not in _NEVER_ZERO or channel.unit == "counts":
        return channel
    zero = ~np.asarray(channel.values.any(axis=1))
    if not zero.any() or zero.all():
        return channel
    when, count = channel.t[zero], int(zero.sum())
    odd = OddSamples(Oddity.ZERO, channel.sensor, channel.instance, count, len(zero), until=float(when[-1]))
    text = f"{count} of {len(zero)} samples of {channel.source} are exactly 0, 0, 0, which such a sensor never reads"
    message = f"{channel.sensor} {channel.instance + 1}: {text}; left out"
    events.append(Event(float(when[0]), "damage", message, odd))
    return channel.take(~zero)
