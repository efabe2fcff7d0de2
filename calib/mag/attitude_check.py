"""Tells a wrong attitude from a wrong compass where the two disagree in flight."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.mag.context import MagContext
from mavcal.calib.mag.flight_fit import FlightEstimate
from mavcal.calib.mag.flight_input import FlightInput
from mavcal.calib.mag.motor_hidden import by_log
from mavcal.calib.triad import TriadModel

Array = NDArray[np.float64]

_ROUGHEST = 0.15  # of the field, that a compass departs from the attitude's
_STEADY = 0.05  # of the field: a length that is no worse belongs to a sound compass
_BY_ATTITUDE = 5.0  # times the spread of the length that an attitude has to miss by
_ALL = 2.0  # of the field: no direction is wrong by more
_NORMAL = 1.4826  # sd of a normal variable over its median deviation


def unusable_attitude(data: FlightInput, found: FlightEstimate, in_force: TriadModel, context: MagContext) -> str:
    """A sentence that blames the logged attitude instead of the compass; empty: the attitude is usable.

    The Earth's field is as long in any attitude: a compass that reads one length is sound, and its correction too.
    """
    strength = float(np.linalg.norm(found.x[found.layout.field]))
    steady = _steadiness(data, in_force)
    rough = float(np.median(np.linalg.norm(found.solved.residuals, axis=1))) / strength
    if data.turning.gyro is None:  # the estimate bends an attitude that nothing carries to the compass
        gain = in_force.matrix @ data.sensor_from_body
        trusting = by_log(data, None, np.zeros((0, 3)), gain, context)
        rough = rough if trusting is None else max(rough, trusting.rms / strength)
    if rough < _ROUGHEST or steady > _STEADY or rough < _BY_ATTITUDE * steady:
        return ""
    others = "--attitude log" if data.turning.attitude is None else "--attitude gyro"
    return (
        f"the attitude is unusable: the compass reads a field steady to {100.0 * steady:.2g} %, but the attitude would "
        f"turn it by {100.0 * min(rough, _ALL):.0f} % of it. Check the gyroscope's offset and the axes, or try the "
        f"other attitude ({others})"
    )


def _steadiness(data: FlightInput, in_force: TriadModel) -> float:
    """Spread of the length that the compass reads through the correction in force, relative; robust."""
    lengths = np.linalg.norm(in_force.apply(data.mag.values), axis=1)
    middle = float(np.median(lengths))
    return _NORMAL * float(np.median(np.abs(lengths - middle))) / middle if middle > 0.0 else math.inf
