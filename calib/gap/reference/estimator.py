"""Errors of the vehicle's own estimator: its velocity and attitude beside the smoothed trajectory.

An on-board estimator uses only past data, and one that is tuned for a quieter sensor follows the noise. The controller
responds to these errors, so that they look like drag and a different thrust curve. The smoother uses the whole flight.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from mavcal.calib.airframe.flown import EstimatorError, state_of
from mavcal.calib.gap.reference.channels import rate_of
from mavcal.calib.gap.reference.ideal import continuous
from mavcal.calib.gap.reference.posed import rotation
from mavcal.calib.gap.reference.re_estimated import plain_trajectory
from mavcal.calib.gap.reference.signals import interpolated
from mavcal.calib.recording import Channel, Recording, Sensor, Stage

Array = NDArray[np.float64]

_OFF: Final = 0.1
"""Slow difference between the velocities of estimator and GPS, m/s, above which the estimator is checked. Source:
measured; 0.02 to 0.04 with ArduPilot's simulator, 0.05 in slow and 0.16 to 0.3 in lively flights of PX4's SIH."""
_CLOSER: Final = 0.5
"""Largest ratio of that difference with a better velocity to that with the estimator's. Chosen, not measured: both
follow the same GPS."""
_SLOW_S: Final = 1.0
"""Seconds over which a difference is averaged, so that the GPS's noise averages out. Source: its noise of SIH is 0.16
m/s along the vertical, at 8 Hz."""
_SLOWER_HZ: Final = 20.0
"""Rate that an inertial unit needs. Source: half of it bounds the turns that can be integrated."""


def estimator_error(recording: Recording) -> EstimatorError | None:
    """Error of the vehicle estimator's velocity and attitude; None where nothing better is known."""
    velocity, attitude = (state_of(recording, s) for s in (Sensor.VELOCITY, Sensor.ATTITUDE))
    gps = next(iter(recording.find(Sensor.VELOCITY)), None)
    unit = _fastest_unit(recording)
    if gps is None or velocity is None or attitude is None or unit is None:
        return None
    rest = (c for c in recording.channels if c.sensor not in (Sensor.ACCEL, Sensor.GYRO))
    found = plain_trajectory(recording.with_channels((*unit, *rest)))
    if found is None:
        return None
    t, late = found.t, found.late_gps
    told = interpolated(velocity.t, velocity.values, t)
    before, after = (_slow_difference(gps, t, v, late) for v in (told, found.velocity))
    if before < _OFF or after > _CLOSER * before:
        return None
    turn = found.attitude * rotation(interpolated(attitude.t, continuous(attitude.values), t)).inv()
    return EstimatorError(t, told - found.velocity, -turn.as_rotvec())


def _fastest_unit(recording: Recording) -> tuple[Channel, Channel] | None:
    """Accelerometer and gyroscope of the fastest unit, filtered streams included."""
    # a bare stream of a driver carries no calibration
    bare = recording.identity.autopilot is not None
    every = (*recording.channels, *recording.dynamics)
    streams = [c for c in every if len(c) > 1 and not (bare and c.stage == Stage.RAW)]
    found = []
    for unit in sorted({c.instance for c in streams if c.sensor is Sensor.ACCEL}):
        own = [[c for c in streams if c.sensor is s and c.instance == unit] for s in (Sensor.ACCEL, Sensor.GYRO)]
        if all(own):
            accel, gyro = (max(o, key=rate_of) for o in own)
            found.append((min(rate_of(accel), rate_of(gyro)), accel, gyro))
    best = max(found, key=lambda f: f[0], default=None)
    return None if best is None or best[0] < _SLOWER_HZ else (best[1], best[2])


def _slow_difference(gps: Channel, t: Array, velocity: Array, late: float) -> float:
    """Robust rms of GPS minus `velocity` (K, 3) at `t`, averaged over `_SLOW_S`, m/s, on the worse horizontal axis."""
    seen = (gps.t - late > t[0]) & (gps.t - late < t[-1])
    apart = gps.values[seen, :2] - interpolated(t, velocity[:, :2], gps.t[seen] - late)
    slow = uniform_filter1d(apart, max(1, round(_SLOW_S * rate_of(gps))), axis=0)
    return float(1.4826 * np.median(np.abs(slow), axis=0).max())
