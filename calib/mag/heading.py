"""Heading error that follows from the covariance of a magnetometer model."""

from __future__ import annotations

import math

import numpy as np

from mavcal.calib.triad import Array, TriadModel

DEFAULT_INCLINATION = math.radians(60.0)
"""Dip that is assumed where the place is unknown: middle latitudes, rad."""

STEEPEST = math.radians(89.0)
"""Largest dip, rad, at which a compass has a heading; steeper ones are replaced by it."""

TILT = math.radians(30.0)
"""Roll and pitch at which a heading must still be valid, rad: that of a multicopter in flight. A level turn alone is
not enough: it determines neither the vertical offset nor its couplings."""

_HEADINGS = np.arange(0.0, 2.0 * math.pi, math.pi / 18.0)


def heading_sd_deg(
    model: TriadModel,
    covariance: Array,
    strength: float,
    inclination: float,
    body_from_sensor: Array | None = None,
    tilt: float = TILT,
) -> float:
    """Standard deviation of the heading that `model` gives, in degrees, at the worst heading and tilt.

    ``heading = atan2(-c_y, c_x)`` of the corrected field c, turned level by the known attitude;
    ``dc = dC C^-1 c - C db``.

    Parameters
    ----------
    model
        Offset and matrix; no thermal part.
    covariance : shape (12, 12)
        Of offset and matrix, in the order of :func:`calib.fit.parameter_names`.
    strength
        Length of the corrected field.
    inclination
        Dip of the field, rad.
    body_from_sensor : shape (3, 3) or None
        Mounting rotation; None: the sensor's axes are those of the vehicle.
    tilt
        Roll and pitch, to either side, that are evaluated in addition to level, rad; 0: level only.
    """
    dip = math.copysign(min(abs(inclination), STEEPEST), inclination)
    horizontal = strength * math.cos(dip)
    rotation = np.eye(3) if body_from_sensor is None else body_from_sensor
    zero = np.zeros_like(_HEADINGS)
    x, y = horizontal * np.cos(_HEADINGS), -horizontal * np.sin(_HEADINGS)
    level_field = np.stack([x, y, zero + strength * math.sin(dip)], axis=1)
    level_gradient = np.stack([y, -x, zero], axis=1) / horizontal**2
    attitudes = np.array([level_from_body @ rotation for level_from_body in heading_tilts(tilt)])
    field = np.einsum("ni,aij->anj", level_field, attitudes).reshape(-1, 3)
    gradient = np.einsum("ni,aij->anj", level_gradient, attitudes).reshape(-1, 3)
    inner = field @ np.linalg.inv(model.matrix).T
    by_matrix = (gradient[:, :, None] * inner[:, None, :]).reshape(-1, 9)
    rows = np.concatenate([-gradient @ model.matrix, by_matrix], axis=1)
    variance = np.einsum("ij,jk,ik->i", rows, covariance, rows)
    return math.degrees(math.sqrt(max(float(variance.max()), 0.0)))


def heading_tilts(tilt: float) -> list[Array]:
    """Level, and rolled and pitched by `tilt` to either side: ``level_from_body``."""
    if tilt == 0.0:
        return [np.eye(3)]
    c, s = math.cos(tilt), math.sin(tilt)
    found = [np.eye(3)]
    for sine in (s, -s):
        found.append(np.array([[1.0, 0.0, 0.0], [0.0, c, -sine], [0.0, sine, c]]))
        found.append(np.array([[c, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, c]]))
    return found
