"""The level trim: converted to a new accelerometer calibration, or measured again.

Both firmwares describe the tilt of the board in the vehicle with two angles. ArduPilot turns the attitude, behind all
streams (``AP_AHRS::update_trim_rotation_matrices``: vehicle from board is ``from_euler(trim)``); PX4 turns every sensor
(``L = Euler(SENS_BOARD_X/Y/Z_OFF)``). In a level vehicle the board's accelerometer reads ``v = L^T (0, 0, -g)``. That
is -g times the third row of L, ``-g (-sin y, sin x cos y, cos x cos y)``, for any yaw. So

``x = atan2(-v_y, -v_z)``, ``y = atan2(v_x, sqrt(v_y^2 + v_z^2))``:

the trim is the roll and pitch that the board reads when the vehicle is level, on both. The old calibration turned the
raw reading of the measured level into ``v_old``. The new one turns the same raw reading into ``v_new``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware import names
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.compose.draft import Draft, Rank, Subject
from mavcal.calib.firmware.in_force.fingerprint import SENSOR_IDS
from mavcal.calib.firmware.limits import TRIM_MAX_RAD
from mavcal.calib.firmware.plan import Agreement, Change, Value
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.firmware.rotations import euler_matrix
from mavcal.calib.firmware.significance import level_agreement
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.recording import Array, Sensor
from mavcal.calib.triad import TriadModel

AHRS_TRIM: Final = ("AHRS_TRIM_X", "AHRS_TRIM_Y")
NOTICEABLE: Final = 1e-4
"""Least change of the level that is written, rad."""

NOTED: Final = 0.2
"""Change of the level, deg, above which a warning is given: a sensor changed since the level was measured makes it
wrong."""

UNMEASURED: Final = 1e-6
"""rad; PX4's start scripts set SENS_BOARD_X_OFF to 1e-6 deg to mark a board as levelled that never was."""

LEVEL_METHOD: Final = "level"


def trim_from_force(force: Array) -> tuple[float, float]:
    """Roll and pitch (rad) that a board reads whose accelerometer reads `force` (3,) at rest."""
    x, y, z = (float(c) for c in force)
    return float(np.arctan2(-y, -z)), float(np.arctan2(x, np.hypot(y, z)))


def force_when_level(roll: float, pitch: float) -> Array:
    """Specific force, m/s2 (3,), that a board mounted at `roll` and `pitch` (rad) reads in a level vehicle."""
    return -STANDARD_GRAVITY * np.array([-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)])


def trim_under(roll: float, pitch: float, old: TriadModel, new: TriadModel, temperature: float | None) -> Array:
    """The trim (roll, pitch) that keeps the same attitude level when the accelerometer correction changes to `new`.

    Both models take the raw sensor frame to the board frame.
    """
    raw = old.invert(force_when_level(roll, pitch), temperature)
    return np.array(trim_from_force(new.apply(raw, temperature)))


def adjust_trim(draft: Draft, autopilot: str, fits: Sequence[FitResult]) -> None:
    """Plan the change of trim that the draft's accelerometer calibration asks for.

    The firmware levels by the first accelerometer. A trim of zero was never measured: there is no level to
    carry over, and the level job is recommended.
    """
    fitted = [f.instance for f in fits if f.sensor == Sensor.ACCEL and f.model.polynomial is None]
    known = [i for (sensor, i) in SENSOR_IDS[autopilot](draft.parameters) if sensor == Sensor.ACCEL]
    first = min(known or fitted, default=-1)
    changes = [c for c in _accel_changes(draft) if c.instance == first]
    if first not in fitted or not changes or not draft.options.adjust_level:
        return
    name_x, name_y, _, per_rad = _trim_parameters(autopilot)
    if name_x not in draft.parameters or name_y not in draft.parameters:
        return
    old = np.array([float(draft.parameters[n]) / per_rad for n in (name_x, name_y)])
    if np.abs(old).max() < UNMEASURED:
        draft.warn("the vehicle's level was never measured; run the level job after this calibration")
        return
    about = Subject(Sensor.ACCEL, first)
    fit = next(f for f in fits if f.sensor == Sensor.ACCEL and f.instance == about.instance)
    try:
        before, after = (_board_model(autopilot, p, about) for p in (draft.parameters, draft.predicted))
    except FirmwareError as error:  # a slot with scale 0 had no calibration to carry a level over from
        draft.warn(f"the level trim cannot be carried over ({error}); run the level job after this calibration")
        return
    temperature = fit.temperature
    if temperature is None and (before.polynomial is not None or after.polynomial is not None):
        draft.warn("the level trim cannot be carried over without a temperature; run the level job")
        return
    new = trim_under(float(old[0]), float(old[1]), before, after, temperature)
    if np.abs(new - old).max() < NOTICEABLE:
        return
    if np.abs(new).max() > TRIM_MAX_RAD:
        draft.warn("the level trim would exceed 10 deg with the new calibration and is left alone; run the level job")
        return
    turned = float(np.degrees(np.linalg.norm(new - old)))
    if turned >= NOTED:
        draft.warn(
            f"the level trim is turned by {turned:.1f} deg with the new calibration of {about}. That keeps what was "
            "level before; if the sensor has changed since its level was measured, run the level job"
        )
    sd = float(np.sqrt(np.diag(fit.covariance)[:2].max())) / STANDARD_GRAVITY
    why = f"the same attitude stays level ({np.degrees(new - old).round(2).tolist()} deg, from the new calibration)"
    _set_trim(draft, autopilot, new, np.array([sd, sd]), why)


def compose_level(draft: Draft, autopilot: str, fits: Sequence[FitResult]) -> Agreement | None:
    """Plan the trim that makes the attitude of a level job level.

    `fits` are results of the level procedure: roll, pitch and their sd in ``native`` (rad), read in the streams' body
    frame. The firmware levels by the first accelerometer, so the first result counts. A trim that differs from the
    one in force by less than its uncertainty is not planned but returned.
    """
    usable = sorted((f for f in fits if f.status != FitStatus.REFUSED), key=lambda f: f.instance)
    if not usable:
        return None
    native = usable[0].native
    force = force_when_level(float(native["roll"]), float(native["pitch"]))
    if autopilot == "px4":  # the stream was turned by the present trim already
        force = _level_matrix(draft.parameters).T @ force
    sd = np.array([float(native["roll_sd"]), float(native["pitch_sd"])])
    trim = np.array(trim_from_force(force))
    name_x, name_y, _, per_rad = _trim_parameters(autopilot)
    held = np.array([float(draft.parameters.get(n, np.nan)) / per_rad for n in (name_x, name_y)])
    if np.abs(held).max() >= UNMEASURED:
        agrees = level_agreement(trim - held, sd)
        if agrees is not None:
            return agrees
    _set_trim(draft, autopilot, trim, sd, "the attitude that was measured is level")
    return None


def is_level(fit: FitResult) -> bool:
    """Whether `fit` is the result of a level job."""
    return fit.method == LEVEL_METHOD


def _trim_parameters(autopilot: str) -> tuple[str, str, str, float]:
    if autopilot == "ardupilot":
        return *AHRS_TRIM, "rad", 1.0
    return *names.PX4_LEVEL[:2], "deg", float(np.degrees(1.0))


def _set_trim(draft: Draft, autopilot: str, trim: Array, sd: Array, why: str) -> None:
    if np.abs(trim).max() > TRIM_MAX_RAD:
        draft.block(
            f"the board would stand at roll {np.degrees(trim[0]):.1f}, pitch {np.degrees(trim[1]):.1f} deg in the "
            "vehicle, more than 10 deg: mount it level or set its orientation, then run the level job"
        )
        return
    *both, unit, per_rad = _trim_parameters(autopilot)
    for name, value, spread, word in zip(both, trim, sd, ("roll", "pitch"), strict=True):
        draft.set_real(
            str(name),
            float(value) * per_rad,
            Rank.LEVEL,
            f"level trim, {word}: {why}",
            about=None,
            sd=float(spread) * per_rad or None,
            unit=unit,
        )


def _accel_changes(draft: Draft) -> tuple[Change, ...]:
    changes = draft.planned(tuple(draft.predicted))
    return tuple(c for c in changes if c.sensor == Sensor.ACCEL)


def _board_model(autopilot: str, parameters: Mapping[str, Value], about: Subject) -> TriadModel:
    """The correction from the raw sensor frame to the board frame, before any trim."""
    if autopilot == "ardupilot":
        return ardupilot.calibration_in_force(parameters, about.sensor, about.instance)
    model = px4.calibration_in_force(parameters, about.sensor, about.instance)
    return TriadModel(model.offset, _level_matrix(parameters).T @ model.matrix, model.polynomial)


def _level_matrix(parameters: Mapping[str, Value]) -> Array:
    return euler_matrix(*(float(parameters[name]) for name in names.PX4_LEVEL))
