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
"""Where gusts push a small multicopter. Source: AIRFRAME 2, 0.1 to 1 m/s2 rms below 2 Hz."""
_ACROSS: Final = slice(0, 2)
"""Axes in which gusts are looked for. Along the third, commands that were logged too slowly leave as much open."""
_FLOOR: Final = 0.02
"""m/s2 below which a flight's open force is not called turbulence. Source: the estimator's velocity error of 0.02 to
0.05 m/s through a drag of 0.25 /s leaves 0.01 (AIRFRAME 5.3)."""
_LOUDER: Final = 2.0
"""Times as much open force as in the simulated flight from which on the air is named. Chosen, not measured."""
_SHARED: Final = 0.5
"""Correlation of two units' open forces from which on both feel the same. Source: equal parts of common and own."""
JUMP: Final = 0.35
_TIMES: Final = 8.0
"""m/s by which the estimator's velocity may differ from the integrated force over :data:`_OVER_S`, and times its median
in the flight, before it counts as a jump. Measured: a real quad of 2013 stays below 0.32, simulated ones below 0.06."""
_GLITCH_M: Final = 3.0
"""m by which a place may differ from the one before and the velocity. Source: receivers without correction wander by a
metre a second at most."""
_HOLE_S: Final = 1.5
"""Longest step between places of the GPS, s, that is no hole of the log. Source: slow receivers send every second."""
_FEWEST: Final = 10
_OVER_S: Final = 0.4
_AT_ONCE_S: Final = 0.2
_MOST: Final = 0.7
"""s within which a reset is over, and part of a jump that must be over by then. Chosen, not measured: two samples at 10
Hz. An estimator that corrects its heading in a fast start errs by as much, and takes a second."""
AROUND_S: Final = 1.5
GLITCHED_S: Final = 5.0
"""s around a jump of the estimator and of the GPS that are left out. Chosen, not measured: an estimator follows a wrong
place for some seconds."""


@dataclass(frozen=True)
class Turbulence:
    """Root mean square of the open force across the rotors' axis in :data:`BAND_HZ`, m/s2.

    `shared` is the correlation of two units; None: there is one.
    """

    real: float
    sim: float
    shared: float | None

    @property
    def louder(self) -> bool:
        """Whether the real flight's open force is the louder one, and more than the model leaves open in calm air."""
        return self.real > max(self.sim, _FLOOR)

    @property
    def of_air(self) -> bool:
        """Whether the real flight's air is the louder one by far, as far as units can tell."""
        return self.louder and self.real > _LOUDER * self.sim and (self.shared is None or self.shared > _SHARED)


def turbulence(flight: FlownFlight, open_force: Array, sim_flight: FlownFlight, sim_open_force: Array) -> Turbulence:
    """Of the forces (N, 3) that the model leaves open in the real and the simulated flight; nan rows are left out."""
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

    `sudden`: within two samples, as by a reset; else the estimator drifted, and these samples are only left out.
    """

    t: float
    size: float
    sudden: bool = True


def jumps(flight: FlownFlight, body: Array) -> tuple[Jump, ...]:
    """Where velocity and integrated force part: resets of the estimator, glitches of the GPS.

    Not across a hole of the log, where neither is known.
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
    """Where places of the GPS part from its own velocity; `size` in m.

    Its velocity comes from the carriers' frequency and knows nothing of an error of the place.
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
    """Places (N, 2) in m north and east of the first, from latitude and longitude (N, 3)."""
    north, east = np.radians(degrees[:, :2] - degrees[:1, :2]).T * SEMI_MAJOR_AXIS_M
    return np.column_stack([north, east * np.cos(np.radians(degrees[0, 0]))])


def outside(flight: FlownFlight, found: tuple[Jump, ...], around_s: float = AROUND_S) -> Mask:
    """Rows (N,) away from every jump."""
    kept = np.ones(len(flight.t), dtype=bool)
    for jump in found:
        kept &= np.abs(flight.t - jump.t) > around_s
    return kept
