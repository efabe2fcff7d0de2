"""Disturbances of the day: turbulence that every accelerometer feels, and jumps of the estimator or of the GPS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from mavcal.calib.airframe.flown import FlownFlight
from mavcal.calib.earth import SEMI_MAJOR_AXIS_M
from mavcal.calib.recording import Recording, Sensor

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

BAND_HZ: Final = (0.1, 2.0)
"""Frequency band, Hz, of gusts on a small multicopter. Source: AIRFRAME 2, 0.1 to 1 m/s2 rms below 2 Hz."""
_ACROSS: Final = slice(0, 2)
"""Axes in which gusts are sought. Along the third, slowly logged commands leave a residual force of the same size."""
_FLOOR: Final = 0.02
"""Residual force, m/s2, below which it is not called turbulence. Source: an estimator velocity error of 0.02 to 0.05
m/s times a drag of 0.25 /s leaves 0.01 (AIRFRAME 5.3)."""
_LOUDER: Final = 2.0
"""Ratio of the residual forces, real to simulated, above which turbulence is named. Chosen, not measured."""
_SHARED: Final = 0.5
"""Correlation of two units' residual forces above which they are a common force. Source: equal common and own parts."""
JUMP: Final = 0.35
_TIMES: Final = 8.0
"""Difference between the estimator's velocity change and the integrated force over :data:`_OVER_S` that is a jump: m/s,
and multiples of its median in the flight. Measured: a real quad of 2013 stays below 0.32, simulated ones below 0.06."""
_GLITCH_M: Final = 3.0
"""Difference, m, of a position from the previous one extrapolated by the velocity, above which it is a glitch. Source:
receivers without correction wander by a metre a second at most."""
_HOLE_S: Final = 1.5
"""Longest step between GPS positions, s; a longer one is a gap of the log. Source: slow receivers send every second."""
_FEWEST: Final = 10
_OVER_S: Final = 0.4
_AT_ONCE_S: Final = 0.2
_MOST: Final = 0.7
"""Duration of a reset, s, and fraction of a jump that must happen within it. Chosen, not measured: two samples at 10
Hz. An estimator that corrects its heading during a fast start errs by as much, but over a second."""
AROUND_S: Final = 1.5
GLITCHED_S: Final = 5.0
"""Time, s, on either side of a jump of the estimator, and of a glitch of the GPS, that is left out. Chosen, not
measured: an estimator follows a wrong position for some seconds."""


@dataclass(frozen=True)
class Turbulence:
    """Rms residual force perpendicular to the rotors' axis in :data:`BAND_HZ`, m/s2.

    `shared` is the correlation of two units; None: there is only one.
    """

    real: float
    sim: float
    shared: float | None

    @property
    def louder(self) -> bool:
        """Whether the real flight's residual force is the larger one, and exceeds that of the model in calm air."""
        return self.real > max(self.sim, _FLOOR)

    @property
    def of_air(self) -> bool:
        """Whether the real flight's air is far more turbulent; two units, where there are, must agree."""
        return self.louder and self.real > _LOUDER * self.sim and (self.shared is None or self.shared > _SHARED)


def turbulence(flight: FlownFlight, open_force: Array, sim_flight: FlownFlight, sim_open_force: Array) -> Turbulence:
    """Turbulence from the model's residual forces (N, 3) in the real and the simulated flight, without nan rows."""
    real = _banded(flight, open_force)[:, _ACROSS]
    shared = None
    for other in flight.others.values():
        beside = _banded(flight, open_force + (other - flight.force))[:, _ACROSS]
        a, b = (x[flight.usable].ravel() for x in (real, beside))
        shared = float(np.corrcoef(a, b)[0, 1]) if a.std() > 0.0 and b.std() > 0.0 else None
        break
    return Turbulence(
        _rms(real, flight.usable), _rms(_banded(sim_flight, sim_open_force)[:, _ACROSS], sim_flight.usable), shared
    )


def _banded(flight: FlownFlight, force: Array) -> Array:
    sos = butter(2, BAND_HZ, "bandpass", fs=flight.fs, output="sos")
    return np.asarray(sosfiltfilt(sos, np.nan_to_num(force), axis=0))


def _rms(values: Array, rows: Mask) -> float:
    return float(np.sqrt((values[rows] ** 2).mean()))


@dataclass(frozen=True)
class Jump:
    """The estimator's velocity changed by `size` m/s at `t` s, and no accelerometer felt it.

    `sudden`: within two samples, as in a reset; else the estimator drifted, and the samples are only left out.
    """

    t: float
    size: float
    sudden: bool = True


def jumps(flight: FlownFlight, body: Array) -> tuple[Jump, ...]:
    """Jumps where velocity and integrated force diverge: resets of the estimator, glitches of the GPS.

    Gaps of the log are skipped, since neither is known there.
    """
    local = np.einsum("nji,nj->ni", body, flight.force) + np.array([0.0, 0.0, flight.gravity])
    speed = np.cumsum(local, axis=0) / flight.fs
    apart = flight.velocity - speed
    steps, few = (round(seconds * flight.fs) for seconds in (_OVER_S, _AT_ONCE_S))
    size, quick = (np.linalg.norm(apart[n:] - apart[:-n], axis=1) for n in (steps, few))
    holes = np.concatenate([[0], np.cumsum(~(flight.usable | flight.limited))])
    size[holes[steps + 1 :] > holes[: -steps - 1]] = 0.0
    found: list[Jump] = []
    least = max(JUMP, _TIMES * float(np.median(size)))
    while size.max(initial=0.0) > least and len(found) < 20:
        at = int(size.argmax())
        sudden = flight.estimated and bool(quick[at : at + steps - few + 1].max() > _MOST * size[at])
        found.append(Jump(float(flight.t[at + steps // 2]), float(size[at]), sudden))
        around = round(AROUND_S * flight.fs)
        size[max(at - around, 0) : at + around] = 0.0
    return tuple(sorted(found, key=lambda j: j.t))


def glitches(recording: Recording, since: float, until: float) -> tuple[Jump, ...]:
    """Jumps where GPS positions diverge from the GPS velocity; `size` in m.

    The velocity comes from the carriers' Doppler shift, independent of position errors.
    """
    found: list[Jump] = []
    for place in (c for c in recording.channels if c.sensor == Sensor.POSITION):
        same = (c for c in recording.channels if (c.sensor, c.source) == (Sensor.VELOCITY, place.source))
        speed = next((c for c in same if c.instance == place.instance), None)
        inside = (place.t >= since) & (place.t <= until)
        if speed is None or inside.sum() < _FEWEST or len(speed) < _FEWEST:
            continue
        t, local = place.t[inside], _metres(place.values[inside])
        velocity = np.column_stack([np.interp(t, speed.t, speed.values[:, k]) for k in range(2)])
        gone = np.diff(local, axis=0) - 0.5 * (velocity[1:] + velocity[:-1]) * np.diff(t)[:, None]
        size = np.linalg.norm(gone, axis=1)
        least = max(_GLITCH_M, _TIMES * float(np.median(size)))
        wrong = (size > least) & (np.diff(t) < _HOLE_S)
        found += [Jump(float(t[k + 1]), float(size[k])) for k in np.flatnonzero(wrong)]
    return tuple(sorted(found, key=lambda j: j.t))


def _metres(degrees: Array) -> Array:
    """Positions (N, 2) in m north and east of the first, from latitude and longitude (N, 3)."""
    north, east = np.radians(degrees[:, :2] - degrees[:1, :2]).T * SEMI_MAJOR_AXIS_M
    return np.column_stack([north, east * np.cos(np.radians(degrees[0, 0]))])


def outside(flight: FlownFlight, found: tuple[Jump, ...], around_s: float = AROUND_S) -> Mask:
    """Rows (N,) away from every jump."""
    kept = np.ones(len(flight.t), dtype=bool)
    for jump in found:
        kept &= np.abs(flight.t - jump.t) > around_s
    return kept
