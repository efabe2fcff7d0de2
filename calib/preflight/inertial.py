"""Checks gyroscopes and accelerometers at rest, vibration, and the attitude against the accelerometers.

After new accelerometer offsets the estimators of both firmwares keep their old bias for minutes, or until a restart.
The vehicle would fly with that attitude.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.earth import local_gravity
from mavcal.calib.firmware.compose.trim import AHRS_TRIM
from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.rotations import euler_matrix
from mavcal.calib.preflight import limits
from mavcal.calib.preflight.check import (
    SURE,
    Check,
    CheckId,
    Measure,
    Snapshot,
    Subject,
    counted,
    judged,
    unknown,
)
from mavcal.calib.preflight.rest import Mean, evidence_lines
from mavcal.calib.recording import Array, Channel, Sensor
from mavcal.calib.stats.windows import finite_rows

_STILL = "Put the vehicle down, let nobody touch it, and check again."
_GYRO = "Calibrate the gyroscopes at rest."
_ACCEL = "Calibrate the accelerometers; if one stays off by itself, it is damaged or loose."

_RESTART = (
    "Restart the vehicle: its estimator remembers offsets that are in force no more. If that does not help, calibrate "
    "the level."
)
_TOLD = "The accelerometers agree with gravity, and the attitude does not agree with them."


def gyro_rest(gyros: Mapping[int, Mean], silent: tuple[str, ...], motion: str | None, *, installed: int = 0) -> Check:
    """Rate of every gyroscope at rest; `installed`: 0 for as many as were received."""
    if not gyros:
        return unknown(CheckId.GYRO_REST, _no_data("gyroscope", silent), "Look at the link and at the sensor.")
    if motion is not None:
        return unknown(CheckId.GYRO_REST, f"The rest rate cannot be seen: {motion}.", _STILL)
    measures = list(rest_measures(gyros).values())
    who = counted(len(measures), installed, "gyroscope", "gyroscopes")
    good = f"{who} read{_s(who)} zero at rest, as far as that matters."
    return judged(
        CheckId.GYRO_REST, measures, good=good, remedy=_GYRO, notes=(*evidence_lines(gyros, "gyroscope"), *silent)
    )


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
            (f"gyroscope {i + 1}",),
        )
        for i, mean in sorted(gyros.items())
    }


def gyro_noise(gyros: Mapping[int, Mean], silent: tuple[str, ...], motion: str | None, *, installed: int = 0) -> Check:
    """Check of the scatter of single samples."""
    if not gyros:
        return unknown(CheckId.GYRO_NOISE, _no_data("gyroscope", silent), "Look at the link and at the sensor.")
    if motion is not None:
        return unknown(CheckId.GYRO_NOISE, f"Noise cannot be told from movement: {motion}.", _STILL)
    limit = limits.GYRO_NOISE
    measures = []
    for i, mean in sorted(gyros.items()):
        worst = math.degrees(float(mean.noise.max()))
        # a standard deviation from n samples is itself known to 1/sqrt(2n); at 50 Hz and 6 s that is 4 %
        name = f"gyroscope {i + 1}"
        measures.append(Measure(f"noise of {name}", worst, 0.05 * worst, limit.value, limit.unit, (name,)))
    who = counted(len(measures), installed, "gyroscope", "gyroscopes")
    good = f"{who} {'is' if _s(who) else 'are'} quiet."
    remedy = "Stop motors and fans; if the noise stays, the gyroscope is failing."
    notes = (*evidence_lines(gyros, "gyroscope"), *silent)
    return judged(CheckId.GYRO_NOISE, measures, good=good, remedy=remedy, notes=notes)


def accel_force(
    accels: Mapping[int, Mean],
    silent: tuple[str, ...],
    motion: str | None,
    place: tuple[float, float] | None,
    *,
    installed: int = 0,
) -> Check:
    """Check of every accelerometer's specific force against gravity, and as a vector against the others."""
    if not accels:
        return unknown(CheckId.ACCEL_FORCE, _no_data("accelerometer", silent), "Look at the link and at the sensor.")
    if motion is not None:
        return unknown(CheckId.ACCEL_FORCE, f"Gravity alone cannot be seen: {motion}.", _STILL)
    norms = force_measures(accels, place)
    measures = [*norms.values(), *_differences(accels, norms)]
    notes = (*evidence_lines(accels, "accelerometer"), *silent)
    if len(accels) == 1:
        notes = (*notes, "its direction cannot be checked: there is no second accelerometer")
    who = counted(len(accels), installed, "accelerometer", "accelerometers")
    good = f"{who} read{_s(who)} g{'' if len(accels) == 1 else ' in the same direction'}."
    return judged(CheckId.ACCEL_FORCE, measures, good=good, remedy=_ACCEL, notes=notes)


def force_measures(accels: Mapping[int, Mean], place: tuple[float, float] | None) -> dict[int, Measure]:
    """Error of every accelerometer's specific force against g, by instance; `place`: latitude and altitude."""
    local = STANDARD_GRAVITY if place is None else local_gravity(*place)
    low, high = sorted((STANDARD_GRAVITY, local))
    limit, found = limits.ACCEL_FORCE, {}
    for i, mean in sorted(accels.items()):
        off = max(low - mean.norm, mean.norm - high, 0.0)  # either g may be what it was calibrated to
        sd = math.hypot(mean.norm_sd, limits.ACCEL_SD)
        name = f"accelerometer {i + 1}"
        found[i] = Measure(f"|f| of {name} from g", off, sd, limit.value, limit.unit, (name,))
    return found


def _differences(accels: Mapping[int, Mean], norms: Mapping[int, Measure]) -> list[Measure]:
    """Vector differences of the accelerometers; of two, both are suspects, of three, the odd one."""
    if len(accels) == 2:
        return [_between(accels, norms)]
    limit, found = limits.ACCEL_FORCE, []
    for i, mean in sorted(accels.items()):
        others = [other for k, other in accels.items() if k != i]
        if not others:
            continue
        middle = np.median([other.value for other in others], axis=0)
        off = float(np.linalg.norm(mean.value - middle))
        noise = math.hypot(*mean.sd, *(float(x) for other in others for x in other.sd / len(others)))
        name, agree = f"accelerometer {i + 1}", "The others agree with each other."
        found.append(
            Measure(
                f"vector of {name} from the others", off, _vector_sd(noise), limit.value, limit.unit, (name,), agree
            )
        )
    return found


def _between(accels: Mapping[int, Mean], norms: Mapping[int, Measure]) -> Measure:
    """Difference of two accelerometers; gravity decides which one is wrong, unless both read g."""
    (i, one), (k, other) = sorted(accels.items())
    off = float(np.linalg.norm(one.value - other.value))
    sd = _vector_sd(math.hypot(*one.sd, *other.sd))
    both = (f"accelerometer {i + 1}", f"accelerometer {k + 1}")
    limit = limits.ACCEL_FORCE
    of = f"difference of accelerometers {i + 1} and {k + 1}"
    apart = norms[k].value - norms[i].value
    if abs(apart) > SURE * math.hypot(one.norm_sd, other.norm_sd, limits.ACCEL_SD):
        bad, good = (k, i) if apart > 0.0 else (i, k)
        explanation = (
            f"Gravity tells which: accelerometer {bad + 1} is {norms[bad].value:.2f} m/s2 from g, the other one "
        )
        explanation += f"{norms[good].value:.2f}."
        return Measure(of, off, sd, limit.value, limit.unit, (f"accelerometer {bad + 1}",), explanation)
    explanation = "Both read g here, so nothing tells which of them is off."
    remedy = f"Put the vehicle on another side and check again: the one that leaves g there is off. {_ACCEL}"
    return Measure(of, off, sd, limit.value, limit.unit, both, explanation, remedy)


def _vector_sd(noise: float) -> float:
    """Standard deviation of the length of a vector difference, which is never negative: only one axis lies along it."""
    return math.hypot(noise / math.sqrt(3.0), limits.ACCEL_SD)


def _s(subject: str) -> str:
    return "s" if subject.startswith("The only") else ""


def _no_data(what: str, silent: tuple[str, ...]) -> str:
    return f"No {what} could be seen: {'; '.join(silent)}." if silent else f"No {what} was heard."


def attitude(snapshot: Snapshot, accels: Mapping[int, Mean], motion: str | None) -> Check:
    """Angle between the verticals of the attitude and of the accelerometers, deg."""
    of = CheckId.ATTITUDE
    recording, autopilot, parameters = snapshot.recording, snapshot.identity.autopilot or "", snapshot.parameters
    channel = next((c for c in recording.find(Sensor.ATTITUDE) if finite_rows(c.values).any()), None)
    if channel is None:
        return unknown(of, "The vehicle did not say its attitude (ATTITUDE).", "Check again over a better link.")
    if motion is not None or not accels:
        why = motion or "no accelerometer shows where down is"
        return unknown(of, f"The vertical cannot be seen: {why}.", "Put the vehicle down and check again.")
    if autopilot == "ardupilot" and not snapshot.complete and any(name not in parameters for name in AHRS_TRIM):
        return unknown(of, "AHRS_TRIM_X and _Y could not be read in time.", "Check again over a better link.")
    trim = level_trim(autopilot, parameters)
    force = np.median([mean.value for mean in accels.values()], axis=0)
    there = trim @ (-force / np.linalg.norm(force))
    off = math.degrees(math.acos(float(np.clip(there @ down(channel), -1.0, 1.0))))
    noise = max(float(np.linalg.norm(mean.sd)) for mean in accels.values()) / float(np.linalg.norm(force))
    sd = math.degrees(math.hypot(limits.TILT_SD, noise))
    limit = limits.ATTITUDE
    name = "vertical of the vehicle's attitude from that of its accelerometers"
    measure = Measure(name, off, sd, limit.value, limit.unit, ("the vehicle's estimator",), _TOLD, _RESTART)
    good = "The vehicle's own attitude agrees with its accelerometers."
    notes = (f"ATTITUDE: {len(channel)} samples over {channel.t[-1] - channel.t[0]:.1f} s",)
    return judged(of, [measure], good=good, remedy=_RESTART, notes=notes)


def level_trim(autopilot: str, parameters: Mapping[str, Value]) -> Array:
    """``R_vehicle_from_board`` (3, 3): ArduPilot's level trim applies to the attitude, not to inertial messages."""
    if autopilot != "ardupilot":
        return np.eye(3)
    roll, pitch = (math.degrees(float(parameters.get(name, 0.0))) for name in AHRS_TRIM)
    return euler_matrix(roll, pitch, 0.0)


def down(channel: Channel) -> Array:
    """Down in the vehicle's frame (3,), the median of an attitude's samples."""
    w, x, y, z = channel.values[finite_rows(channel.values)].T
    downs = np.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)], axis=1)
    middle = np.median(downs, axis=0)
    return np.asarray(middle / np.linalg.norm(middle))


def vibration(snapshot: Snapshot) -> Check:
    """Level now, and clips since the start."""
    shaking = snapshot.shaking
    if shaking is None:
        return unknown(CheckId.VIBRATION, "The vehicle does not say how it vibrates (VIBRATION).")
    level, clips = limits.VIBRATION, limits.CLIPPING
    worst = max(shaking.levels, default=0.0)
    measures = [Measure("vibration", worst, 0.05 * worst, level.value, level.unit)]
    for i, count in enumerate(shaking.clips):
        measures.append(Measure(f"clips of accelerometer {i + 1} since the start", count, 0.0, clips.value, clips.unit))
    good = "The vehicle is quiet, and its accelerometers have hardly clipped since the start."
    remedy = "Balance propellers and fasten or damp the autopilot; restart it to clear the counters."
    heard = ("the newest VIBRATION message; its clips count since the start of the vehicle",)
    return judged(CheckId.VIBRATION, measures, good=good, remedy=remedy, notes=heard)


SUBJECT = Subject((vibration,), {"ardupilot": AHRS_TRIM})
