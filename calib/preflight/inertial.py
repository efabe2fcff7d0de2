"""Gyroscopes and accelerometers at rest."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.earth import local_gravity
from mavcal.calib.preflight import limits
from mavcal.calib.preflight.check import Check, CheckId, Measure, judged, unknown
from mavcal.calib.preflight.rest import Mean, looked

_STILL = "Put the vehicle down, let nobody touch it, and check again."
_GYRO = "Calibrate the gyroscopes at rest: `mavcal preflight --fix gyro --apply`."
_ACCEL = "Calibrate the accelerometers; if one stays off by itself, it is damaged or loose."


def gyro_rest(gyros: Mapping[int, Mean], silent: tuple[str, ...], motion: str | None) -> Check:
    """The rate that every gyroscope shows while the vehicle stands still."""
    if not gyros:
        return unknown(CheckId.GYRO_REST, _nothing("gyroscope", silent), "Look at the link and at the sensor.")
    if motion is not None:
        return unknown(CheckId.GYRO_REST, f"The rest rate cannot be seen: {motion}.", _STILL)
    measures = list(rest_measures(gyros).values())
    good = f"All {len(measures)} gyroscopes read zero at rest, as far as that matters."
    return judged(CheckId.GYRO_REST, measures, good=good, remedy=_GYRO, notes=(*looked(gyros, "gyroscope"), *silent))


def rest_measures(gyros: Mapping[int, Mean]) -> dict[int, Measure]:
    """The rate of every gyroscope at rest, by instance."""
    limit = limits.GYRO_REST
    return {
        i: Measure(
            f"rate of gyroscope {i + 1} at rest",
            math.degrees(mean.norm),
            math.hypot(math.degrees(mean.norm_sd), limits.EARTH_RATE_DEG_S),
            limit.value,
            limit.unit,
        )
        for i, mean in sorted(gyros.items())
    }


def gyro_noise(gyros: Mapping[int, Mean], silent: tuple[str, ...], motion: str | None) -> Check:
    """The scatter of a single sample."""
    if not gyros:
        return unknown(CheckId.GYRO_NOISE, _nothing("gyroscope", silent), "Look at the link and at the sensor.")
    if motion is not None:
        return unknown(CheckId.GYRO_NOISE, f"Noise cannot be told from movement: {motion}.", _STILL)
    limit = limits.GYRO_NOISE
    measures = []
    for i, mean in sorted(gyros.items()):
        worst = math.degrees(float(mean.noise.max()))
        # a standard deviation from n samples is itself known to 1/sqrt(2n); at 50 Hz and 6 s that is 4 %
        measures.append(Measure(f"noise of gyroscope {i + 1}", worst, 0.05 * worst, limit.value, limit.unit))
    good = f"All {len(measures)} gyroscopes are quiet."
    remedy = "Stop motors and fans; if the noise stays, the gyroscope is failing."
    notes = (*looked(gyros, "gyroscope"), *silent)
    return judged(CheckId.GYRO_NOISE, measures, good=good, remedy=remedy, notes=notes)


def accel_force(
    accels: Mapping[int, Mean], silent: tuple[str, ...], motion: str | None, place: tuple[float, float] | None
) -> Check:
    """The specific force of every accelerometer against gravity, and against the other ones as a vector."""
    if not accels:
        return unknown(CheckId.ACCEL_FORCE, _nothing("accelerometer", silent), "Look at the link and at the sensor.")
    if motion is not None:
        return unknown(CheckId.ACCEL_FORCE, f"Gravity alone cannot be seen: {motion}.", _STILL)
    measures = [*force_measures(accels, place).values(), *_differences(accels)]
    notes = (*looked(accels, "accelerometer"), *silent)
    if len(accels) == 1:
        notes = (*notes, "its direction cannot be checked: there is no second accelerometer")
    good = (
        f"All {len(accels)} accelerometers read g."
        if len(accels) == 1
        else (f"All {len(accels)} accelerometers read g in the same direction.")
    )
    return judged(CheckId.ACCEL_FORCE, measures, good=good, remedy=_ACCEL, notes=notes)


def force_measures(accels: Mapping[int, Mean], place: tuple[float, float] | None) -> dict[int, Measure]:
    """How far the specific force of every accelerometer is from g, by instance; `place`: latitude and altitude."""
    local = STANDARD_GRAVITY if place is None else local_gravity(*place)
    low, high = sorted((STANDARD_GRAVITY, local))
    limit, found = limits.ACCEL_FORCE, {}
    for i, mean in sorted(accels.items()):
        off = max(low - mean.norm, mean.norm - high, 0.0)  # either g may be what it was calibrated to
        sd = math.hypot(mean.norm_sd, limits.ACCEL_SD)
        found[i] = Measure(f"|f| of accelerometer {i + 1} from g", off, sd, limit.value, limit.unit)
    return found


def _differences(accels: Mapping[int, Mean]) -> list[Measure]:
    """How far each accelerometer is from the middle of the other ones, as a vector."""
    limit, found = limits.ACCEL_FORCE, []
    for i, mean in sorted(accels.items()):
        others = [other for k, other in accels.items() if k != i]
        if not others:
            continue
        middle = np.median([other.value for other in others], axis=0)
        off = float(np.linalg.norm(mean.value - middle))
        noise = math.hypot(*mean.sd, *(float(x) for other in others for x in other.sd / len(others)))
        # a difference of two vectors is never below zero: along it only one axis of three counts
        sd = math.hypot(noise / math.sqrt(3.0), limits.ACCEL_SD)
        name = "the other one" if len(others) == 1 else "the others"
        found.append(Measure(f"vector of accelerometer {i + 1} from {name}", off, sd, limit.value, limit.unit))
    return found


def _nothing(what: str, silent: tuple[str, ...]) -> str:
    return f"No {what} could be seen: {'; '.join(silent)}." if silent else f"No {what} was heard."
