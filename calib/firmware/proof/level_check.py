"""The level after a level job: whether its trim takes effect, and whether the vehicle reads level.

PX4 turns every sensor by its trim: SCALED_IMU shows it, and :mod:`calib.firmware.proof.check` proves it. ArduPilot
turns the attitude, behind all sensors (FLIGHT_CONTROLLERS 2.2: AHRS_TRIM is in no IMU message), so only ATTITUDE
shows it: with ``E = from_euler(trim)``, vehicle from board, "down" in the vehicle is ``E d``, ``d`` that in the board.
From one trim to the next it is turned by ``E_new E_old^T``, whatever the estimator's own error.

The accelerometer, with the parameters in force, decides whether the vehicle reads level. ArduPilot's attitude cannot
refute that. On the ground EKF3 learns only the bias of an axis within 37 deg of the vertical
(``NavEKF3_core::CovariancePrediction``) and holds the others. Biases learned with older offsets therefore stay in the
attitude while the vehicle is at rest (2.2 deg, captured for 34 s, did not change by 0.01 deg). A restart begins without
biases. A difference between attitude and accelerometer is reported.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from typing import Final

import numpy as np

from mavcal.calib.firmware.compose.draft import Subject
from mavcal.calib.firmware.compose.trim import AHRS_TRIM, force_when_level
from mavcal.calib.firmware.plan import (
    Change,
    ParameterVerdict,
    ProofVerdict,
    SensorCheck,
    SensorCheckId,
    SensorVerdict,
    WritePlan,
)
from mavcal.calib.firmware.proof.check import ALL_APPLIED, Corrections
from mavcal.calib.firmware.proof.evidence import StillMean, StreamEvidence
from mavcal.calib.firmware.proof.force import Force
from mavcal.calib.firmware.proof.hypotheses import Hypothesis, judge
from mavcal.calib.firmware.rotations import euler_matrix
from mavcal.calib.fit import FitResult
from mavcal.calib.recording import Array, Recording, Sensor

HALF_S: Final = 1.0
"""Time, s, of attitude used on either side of a reading at rest."""
ESTIMATOR_SD: Final = np.radians(0.1)
"""Wander of an estimator's attitude at rest from one capture to the next."""
SAME_POSE: Final = np.radians(0.3)
"""Angle, rad, within which the vehicle still has the pose of the level measurement."""
LEAST: Final = 4
"""Least number of attitudes in a mean."""
LEVEL_WITHIN: Final = float(np.radians(0.2))
"""Largest angle from level, rad, of the accelerometer in the pose of the level measurement."""
ATTITUDE_WITHIN: Final = float(np.radians(0.5))
"""Largest angle, rad, between ArduPilot's attitude and its accelerometer at rest: the error of an estimator without old
biases."""


def level_checks(
    plan: WritePlan,
    levels: Sequence[FitResult],
    force: Force,
    *,
    before: Recording | None,
    after: Recording,
    then: StreamEvidence,
    now: StreamEvidence,
) -> tuple[dict[str, ParameterVerdict], tuple[SensorCheck, ...]]:
    """Verdicts on ArduPilot's trim from ATTITUDE, by parameter name, and whether the vehicle reads level."""
    if not levels:
        return {}, ()
    fit = min(levels, key=lambda f: f.instance)
    about = Subject(Sensor.ACCEL, fit.instance)
    corrections = Corrections(force, about)
    readings = corrections.readable(now.readings.get(about, ()))
    if not all(corrections.possible(h, readings) for h in (ALL_APPLIED, corrections.every)):
        return {}, (_level(about, (), fit),)
    earlier = corrections.readable(then.readings.get(about, ()))[-1:]
    there = [r for r in readings if _same_pose(corrections, fit, r)]
    if force.autopilot != "ardupilot":
        return {}, (_level(about, [_down(r) for r in there], fit),)
    names = [c for c in plan.changes if c.name in AHRS_TRIM]
    verdicts: dict[str, ParameterVerdict] = {}
    if names and before is not None:
        later = _unmoved(corrections, earlier, now, about)
        verdicts = _trims(force, names, _downs(before, earlier), _downs(after, later))
    trimmed = _vehicle_from_board(force, names, frozenset())
    level = _level(about, [trimmed @ _down(r) for r in there], fit)
    return verdicts, (level, *_attitude(about, trimmed, after, there))


def _down(reading: StillMean) -> Array:
    """Direction of down in the board, (3,), by the accelerometer at rest."""
    return np.asarray(-reading.mean / np.linalg.norm(reading.mean))


def _attitude(
    about: Subject, trimmed: Array, after: Recording, readings: Sequence[StillMean]
) -> tuple[SensorCheck, ...]:
    """Whether the attitude agrees with the accelerometer under the trim in force; the verdict is never "wrong"."""
    apart = [angle_between(seen, trimmed @ _down(r)) for r in readings for seen in _downs(after, (r,))]
    if not apart:
        return ()
    off = min(apart)
    right = off <= ATTITUDE_WITHIN
    degrees = f"{math.degrees(off):.2f} deg"
    text = f"the vehicle's attitude is within {degrees} of {about}"
    if not right:
        text = (
            f"the vehicle's attitude is {degrees} off {about}: its estimator remembers an earlier calibration, and at "
            "rest it does not forget; restart the vehicle"
        )
    verdict = SensorVerdict.RIGHT if right else SensorVerdict.NOT_OBSERVABLE
    sd = float(ESTIMATOR_SD)
    return (
        SensorCheck(
            SensorCheckId.ATTITUDE, about.sensor, about.instance, off, ATTITUDE_WITHIN, "rad", sd, verdict, text
        ),
    )


def _same_pose(corrections: Corrections, fit: FitResult, reading: StillMean) -> bool:
    """Whether the vehicle has the attitude of the `fit`: with the old trim it would read the same."""
    if not reading.mean.any():
        return False  # a sensor that streams zeros stands nowhere
    raw = corrections.raw(ALL_APPLIED, (reading,))
    old = corrections.stream(corrections.every, raw, (reading,))[0]
    return bool(
        angle_between(old, force_when_level(float(fit.native["roll"]), float(fit.native["pitch"]))) <= SAME_POSE
    )


def _unmoved(
    corrections: Corrections, earlier: Sequence[StillMean], now: StreamEvidence, about: Subject
) -> tuple[StillMean, ...]:
    """Readings after the write in the pose of the one before."""
    if not earlier:
        return ()
    raw = corrections.raw(corrections.every, earlier)[0]
    later = corrections.readable(now.readings.get(about, ()))
    return tuple(r for r in later if angle_between(corrections.raw(ALL_APPLIED, (r,))[0], raw) <= SAME_POSE)


def _downs(recording: Recording, readings: Sequence[StillMean]) -> list[Array]:
    """Mean direction of down in the vehicle, (3,), beside each of `readings`."""
    found = []
    for channel in recording.find(Sensor.ATTITUDE, 0)[:1]:
        for reading in readings:
            part = channel.between(reading.t - HALF_S, reading.t + HALF_S)
            if len(part) >= LEAST:
                w, x, y, z = part.values.T  # the last row of the rotation from the body to north, east, down
                rows = np.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)], axis=1)
                mean = rows.mean(axis=0)
                found.append(mean / np.linalg.norm(mean))
    return found


def _trims(
    force: Force, changes: Sequence[Change], before: Sequence[Array], after: Sequence[Array]
) -> dict[str, ParameterVerdict]:
    """Each trim by how "down" has turned between the captures."""
    if not before or not after:
        return {}
    board = _vehicle_from_board(force, changes, frozenset(c.name for c in changes)).T @ before[-1]
    seen = np.mean(after, axis=0)

    def whitened(refused: Hypothesis) -> Array:
        return np.asarray((_vehicle_from_board(force, changes, refused) @ board - seen)[:2] / ESTIMATOR_SD)

    judgement = judge([c.name for c in changes], whitened)
    found = {}
    for change in changes:
        effect = abs(float(change.new) - float(change.old or 0.0))
        verdict = judgement.verdicts[change.name]
        if not judgement.explained:
            verdict, text = (
                ProofVerdict.NOT_OBSERVABLE,
                "the attitude also changed for another reason: the trim cannot be checked",
            )
        else:
            text = _WORDS[verdict]
        found[change.name] = ParameterVerdict(change.name, verdict, effect, float(ESTIMATOR_SD), "rad", text)
    return found


_WORDS: Final[Mapping[ProofVerdict, str]] = {
    ProofVerdict.PROVED: "the attitude has turned by the change of the trim",
    ProofVerdict.CONSISTENT: "the attitude agrees with the new value, but also with the old one",
    ProofVerdict.NOT_OBSERVABLE: "its change is below 3 standard deviations of the attitude",
    ProofVerdict.CONTRADICTED: "the attitude behaves as if the old value were still in force",
}


def _vehicle_from_board(force: Force, changes: Sequence[Change], refused: Set[str]) -> Array:
    values = {name: float(force.parameters.get(name, 0.0)) for name in AHRS_TRIM}
    values |= {c.name: float((c.old or 0.0) if c.name in refused else c.new) for c in changes}
    roll, pitch = (float(np.degrees(values[name])) for name in AHRS_TRIM)
    return euler_matrix(roll, pitch, 0.0)


def _level(about: Subject, downs: Sequence[Array], fit: FitResult) -> SensorCheck:
    sd = math.hypot(float(fit.native["roll_sd"]), float(fit.native["pitch_sd"]))
    if not downs:
        text = "the vehicle stands otherwise than when its level was measured, or was not at rest"
        return SensorCheck(
            SensorCheckId.LEVEL,
            about.sensor,
            about.instance,
            None,
            None,
            "rad",
            None,
            SensorVerdict.NOT_OBSERVABLE,
            text,
        )
    off = min(angle_between(d, np.array([0.0, 0.0, 1.0])) for d in downs)
    limit = LEVEL_WITHIN + 5.0 * sd
    wrong = off > limit
    text = f"the vehicle reads {math.degrees(off):.2f} deg off level where its level was measured"
    text += f"; {'at most' if wrong else 'the limit is'} {math.degrees(limit):.2f} deg"
    verdict = SensorVerdict.WRONG if wrong else SensorVerdict.RIGHT
    return SensorCheck(SensorCheckId.LEVEL, about.sensor, about.instance, off, limit, "rad", sd, verdict, text)


def angle_between(a: Array, b: Array) -> float:
    """Angle between two directions (3,), rad."""
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
