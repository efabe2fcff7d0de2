"""Methods for the gyroscope."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.fit import FitResult
from calib.gyro import fit_gyro_rest
from calib.methods.method import INSTANCE, Method, Options, mean_or_none
from calib.methods.source import Source
from calib.recording import Sensor

Array = NDArray[np.float64]


def gyro_rest(source: Source, options: Options) -> list[FitResult]:
    """The longest rest, with accelerometer and compass as witnesses."""
    fits = []
    for gyro in source.channels(Sensor.GYRO):
        part = source.longest_rest(gyro)
        span = (part.t[0], np.nextafter(part.t[-1], np.inf))
        accel, mag = source.maybe(Sensor.ACCEL, gyro.instance), source.maybe(Sensor.MAG, 0)
        temperature = source.temperature(gyro.instance)
        fits.append(
            fit_gyro_rest(
                part,
                accel=accel.between(*span) if accel is not None else None,
                mag=mag.between(*span) if mag is not None and mag.unit == "uT" else None,
                temperature=mean_or_none(temperature.between(*span).values[:, 0]) if temperature is not None else None,
                relative=source.relative(gyro),
            )
        )
    return fits


METHODS = (Method("gyro-rest", "Gyroscope offset at rest", "five seconds at rest", (INSTANCE,), gyro_rest),)
"""In the order of the command line."""
