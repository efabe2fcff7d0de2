"""Correction of a recording by the sensor errors that a report names."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from mavcal.calib.airframe.diagnose import LIKELY
from mavcal.calib.gap.effects.traits import SensorTerm
from mavcal.calib.gap.export.sensor_errors import sensors_with, term_of
from mavcal.calib.gap.schema import FIRST, GapReport
from mavcal.calib.recording import Channel, Recording, Sensor

_MATRIX: Final = (SensorTerm.SCALE, SensorTerm.MISALIGNMENT, SensorTerm.ROTATION)
_INERTIAL: Final = (Sensor.ACCEL, Sensor.GYRO)


def without_matrix_errors(real: Recording, report: GapReport) -> Recording | None:
    """`real` without scale, misalignment and rotation of its inertial sensors; None if none of these is certain.

    A gyroscope that reads 6 % too little makes every inertia 6 % larger. Offsets stay: the fit of a flight has its own.
    """
    sure = [e for e in report.effects if e.evidence.probability >= LIKELY]
    named = [e for e in sure if e.sensor in _INERTIAL and term_of(e) in _MATRIX]
    if not named:
        return None
    errors = sensors_with(named).errors

    def read_right(channel: Channel) -> Channel:
        error = errors.get((channel.sensor, channel.instance + FIRST))
        return channel if error is None else replace(channel, values=channel.values @ np.linalg.inv(error.matrix).T)

    return replace(real, channels=tuple(map(read_right, real.channels)), dynamics=tuple(map(read_right, real.dynamics)))
