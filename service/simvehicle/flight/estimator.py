"""What the estimator believes of the vehicle: the truth with slow errors. No filter is run."""

from __future__ import annotations

import math

from mavcal.service.simvehicle.flight.air import Noise
from mavcal.service.simvehicle.flight.airframe import Airframe, Quaternion, euler_of

VELOCITY_ERROR, PLACE_ERROR, TILT_ERROR, HEADING_ERROR = 0.02, 0.1, 0.0007, 0.004
"""Standard deviations of the estimate, m/s, m, rad. Chosen: those of SITL's estimator in calm flight, where its
velocity is 0.02 to 0.05 m/s off."""
_ERROR_TAU = 4.0
"""How fast these errors wander, s. Chosen, not measured."""


class Wander:
    """A slow error: first-order coloured noise, one number an axis."""

    def __init__(self, sd: tuple[float, ...], noise: Noise) -> None:
        self._sd, self._noise = sd, noise
        self.value = [0.0] * len(sd)

    def advance(self, dt: float) -> None:
        """Advance by `dt` seconds."""
        keep = math.exp(-dt / _ERROR_TAU)
        fresh = math.sqrt(1.0 - keep * keep)
        for k, sd in enumerate(self._sd):
            self.value[k] = keep * self.value[k] + fresh * sd * self._noise()


class Estimate:
    """Attitude, velocity and place of `airframe` as the estimator has them. World north east down, body to world."""

    def __init__(self, airframe: Airframe, noise: Noise) -> None:
        self._airframe = airframe
        sd = (*(VELOCITY_ERROR,) * 3, *(PLACE_ERROR,) * 3, TILT_ERROR, TILT_ERROR, HEADING_ERROR)
        self._errors = Wander(sd, noise)
        self.follow(resting=True)

    def wander(self, dt: float) -> None:
        """Advance the errors of attitude, velocity and position."""
        self._errors.advance(dt)

    def follow(self, *, resting: bool) -> None:
        """Take over the true state plus the errors; a vehicle at rest has none in velocity."""
        e, frame = self._errors.value, self._airframe
        share = 0.0 if resting else 1.0
        v, p = frame.velocity, frame.place
        self.velocity = [v[0] + share * e[0], v[1] + share * e[1], v[2] + share * e[2]]
        self.place = [p[0] + e[3], p[1] + e[4], p[2] + e[5]]
        w, x, y, z = frame.q
        a, b, c = 0.5 * e[6], 0.5 * e[7], 0.5 * e[8]
        self.q: Quaternion = (
            w - a * x - b * y - c * z,
            x + a * w + b * z - c * y,
            y + b * w + c * x - a * z,
            z + c * w + a * y - b * x,
        )
        self.euler = euler_of(self.q)


_METRES_PER_DEGREE = 111_319.5


def degrees_from_metres(latitude: float, longitude: float, north: float, east: float) -> tuple[float, float]:
    """Latitude and longitude so far north and east of a place; flat, as far as one flies here."""
    return (
        latitude + north / _METRES_PER_DEGREE,
        longitude + east / (_METRES_PER_DEGREE * math.cos(math.radians(latitude))),
    )


def metres_from_degrees(latitude: float, longitude: float, there: float, beside: float) -> tuple[float, float]:
    """How far north and east of a place latitude `there` and longitude `beside` are; the inverse."""
    return (
        (there - latitude) * _METRES_PER_DEGREE,
        (beside - longitude) * _METRES_PER_DEGREE * math.cos(math.radians(latitude)),
    )
