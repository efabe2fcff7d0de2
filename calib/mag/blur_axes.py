"""How the axes of a gyro lie to those of a compass, from the field that turns in the one as the other says."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.mag.blur import Rates

Array = NDArray[np.float64]

_AS_STATED = math.radians(10.0)
"""Angle within which axes count as the stated ones: that mixes the blur of two axes by a sixth, and blur is small."""

_KNOWN_TO = 0.1  # rad, standard deviation up to which the axes found are believed
_EXPLAINED = 0.3  # of the change of the field, rms, that the turn may leave
_LEAST = 10  # changes of the field


def axes_of_gyro(directions: Array, rates: Rates) -> Array:
    """Rotation (3, 3) from the gyro's axes to the compass's; the unit matrix where they lie as stated, or is not seen.

    From sample to sample the field turns by ``du = u x (R phi)``, which is linear in R.

    Parameters
    ----------
    directions : shape (N, 3)
        Of the field in the compass's axes, of about unit length.
    rates
        Of the same N samples.
    """
    if len(directions) < _LEAST + 2:
        return np.eye(3)
    apart = rates.ends[2:] - rates.ends[:-2]
    near = (apart > 0.0) & (apart <= 3.0 * rates.window)
    if np.count_nonzero(near) < _LEAST:
        return np.eye(3)
    change = ((directions[2:] - directions[:-2]) * (rates.window / np.where(near, apart, 1.0))[:, None])[near]
    u, phi = directions[1:-1][near], rates.turn[1:-1][near]
    cross = np.zeros((len(u), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -u[:, 2], u[:, 1], -u[:, 0]
    cross -= np.transpose(cross, (0, 2, 1))
    design = (cross[:, :, :, None] * phi[:, None, None, :]).reshape(-1, 9)
    normal = design.T @ design
    if not np.linalg.eigvalsh(normal)[0] > 1e-9 * max(float(np.trace(normal)), 1e-300):
        return np.eye(3)
    general = np.linalg.solve(normal, design.T @ change.ravel())
    left, _, right = np.linalg.svd(general.reshape(3, 3))
    rotation = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    misfit = change.ravel() - design @ rotation.ravel()
    variance = float(misfit @ misfit) / len(misfit)
    known = math.sqrt(variance / float(np.linalg.eigvalsh(normal)[0])) < _KNOWN_TO
    explained = variance < _EXPLAINED**2 * float(np.mean(change**2))
    angle = math.acos(min(1.0, max(-1.0, 0.5 * (float(np.trace(rotation)) - 1.0))))
    return np.asarray(rotation) if known and explained and angle > _AS_STATED else np.eye(3)
