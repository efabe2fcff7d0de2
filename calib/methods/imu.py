"""Methods for accelerometer and gyroscope together."""

from __future__ import annotations

import numpy as np

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitResult
from mavcal.calib.imu import fit_imu
from mavcal.calib.methods.method import GRAVITY, INSTANCE, MIN_STILL, Method, Options, mean_or_none
from mavcal.calib.methods.source import Source
from mavcal.calib.option import Option
from mavcal.calib.recording import Sensor


def imu_multi(source: Source, options: Options) -> list[FitResult]:
    """Every inertial unit that has both sensors; labelled segments are its poses, else still ones are found."""
    if not source.timed:
        raise InvalidInputError("movements are integrated over time: the table has none; give --rate, or a column t")
    fits: list[FitResult] = []
    segments = source.recording.segments
    for accel in source.channels(Sensor.ACCEL):
        gyro = source.maybe(Sensor.GYRO, accel.instance)
        if gyro is None:
            continue
        temperature = source.temperature(accel.instance)
        fits.extend(
            fit_imu(
                accel,
                gyro,
                gravity=options["gravity"] or STANDARD_GRAVITY,
                cross_sd=options["cross_sd"],
                form=options["form"],
                spans=np.array([[s.start, s.end] for s in segments]) if segments else None,
                min_still=options["min_still"],
                temperature=mean_or_none(temperature.values[:, 0]) if temperature is not None else None,
                relative=source.relative(accel) or source.relative(gyro),
            )
        )
    if not fits:
        source.channels(Sensor.GYRO)  # says what the recording has instead
        raise InvalidInputError("no inertial unit has both an accelerometer and a gyroscope here")
    return fits


METHODS = (
    Method(
        "imu-multi",
        "twelve or more still poses of two seconds, and the movements from each to the next",
        (
            INSTANCE,
            GRAVITY,
            MIN_STILL,
            Option("cross_sd", float, 0.01, "what misalignments usually are, rad; what is not known better stays open"),
            Option("form", ("symmetric", "upper"), "symmetric", "canonical form of the accelerometer's matrix"),
        ),
        imu_multi,
    ),
)
"""In the order of the command line."""
