"""Tones of an inertial sensor that are sampling jitter, not vibration.

A unit may be sampled at a rate that differs from its log rate. Its delay then varies with the difference of both rates.
Its error is the delay multiplied by the rate of change. The lines therefore grow, shrink and change sign with the
movement, in a simulator as on a vehicle. ArduPilot's simulated second unit has them at multiples of 40 Hz.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from mavcal.calib.gap.schema import FIRST, EffectEstimate
from mavcal.calib.recording import Channel, Recording, Sensor

Array = NDArray[np.float64]

_SEGMENT_S: Final = 2.0
"""Time, s, in which a tone keeps its phase. Chosen, not measured: vehicle movement reverses within it."""
_SMOOTH_S: Final = 0.05
"""Averaging time, s, for the rate of change of a reading. Chosen, not measured: two periods of 40 Hz."""
_FEWEST: Final = 20
"""Least samples for a rate of change. Chosen, not measured: a segment has far more."""
_BESIDE_HZ: Final = 4.0 / _SEGMENT_S
"""Distance, Hz, from a tone at which it is not visible. Source: four times the resolution of a segment."""


def is_sampling_jitter(effect: EffectEstimate, real: Recording) -> bool:
    """Whether a tone is proportional to the rate of change of its units' readings rather than constant in amplitude."""
    hz = next((p.value for p in effect.params if p.name == "frequency_hz"), None)
    if hz is None or effect.sensor not in (Sensor.ACCEL, Sensor.GYRO):
        return False
    units = [i - FIRST for i in effect.instances if i - FIRST in real.instances(effect.sensor)]
    return bool(units) and all(_follows_change(real.channel(effect.sensor, unit), hz) for unit in units)


def _follows_change(channel: Channel, hz: float) -> bool:
    """Whether a tone times the rate of change explains more of the reading than the tone itself."""
    seen = np.isfinite(channel.values).all(axis=1)
    t, values = channel.t[seen], channel.values[seen]
    if len(t) < _FEWEST:
        return False
    step = float(np.median(np.diff(t)))
    rows = round(_SEGMENT_S / step)
    count = len(t) // max(rows, 1)
    if count < 1:
        return False
    smooth = uniform_filter1d(values, max(round(_SMOOTH_S / step), 1), axis=0)
    change = np.gradient(smooth, step, axis=0)
    rest, change = (x[: count * rows].reshape(count, rows, 3) for x in (values - smooth, change))
    t = t[: count * rows].reshape(count, rows, 1)

    def excess(factor: Array) -> float:
        """Energy of the tone multiplied by `factor`, minus that of neighbouring frequencies."""
        at, *beside = (
            _explained(rest, factor * np.exp(2j * np.pi * f * t)) for f in (hz, hz - _BESIDE_HZ, hz + _BESIDE_HZ)
        )
        return at - float(np.mean(beside))

    return excess(change) > max(excess(np.ones_like(change)), 0.0)


def _explained(rest: Array, wave: NDArray[np.complex128]) -> float:
    """Energy of `rest` (S, N, 3) that the real and imaginary part of `wave` explain in each segment and axis."""
    parts = np.stack([wave.real, wave.imag])
    gram = np.einsum("isnc,jsnc->scij", parts, parts)
    moment = np.einsum("isnc,snc->sci", parts, rest)
    found = np.linalg.pinv(gram, hermitian=True) @ moment[..., None]
    return float((found[..., 0] * moment).sum())
