"""A fit in the form of another program: those of :mod:`calib.conventions`, and the parameters of autopilots.

==========  ===========================================================================================================
ardupilot   compass ``M s (m + OFS)``, the offset *added*, mGauss; ``ACCSCAL o (m - ACCOFFS)``; ``m - GYROFFS``
px4         magnetometer ``S (m - OFF)``, Gauss; ``SCALE o (m - OFF)``; ``m - OFF``
==========  ===========================================================================================================

Firmwares hold less than a matrix; what a form cannot hold is said with it. Parameters are those of a sensor whose axes
are the body's: :mod:`calib.firmware.compose.plan` turns them into the mounting of a real vehicle, and is what writes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from mavcal.calib.c_array import c_array, homogeneous
from mavcal.calib.conventions import accelcal_from_model, imu_tk_from_model, kalibr_from_model, magcal_from_model
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware import names
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.names import Role
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.firmware.rotations import rotation_angle
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.recording import Array, Sensor
from mavcal.calib.triad import TriadModel

_EXACT = 1e-9  # rad, or of a matrix of the order of one


class Convention(StrEnum):
    """Whose form."""

    MATLAB = "matlab"  # magcal for magnetometers, accelcal for the others
    ARDUPILOT = "ardupilot"
    PX4 = "px4"
    IMU_TK = "imu_tk"
    KALIBR = "kalibr"


@dataclass(frozen=True, eq=False)
class Converted:
    """Values by name, and in sentences what the form cannot hold."""

    convention: Convention
    form: str
    values: Mapping[str, Any]
    lost: tuple[str, ...] = ()


def ardupilot_from_model(model: TriadModel, sensor: Sensor, instance: int = 0) -> dict[str, float]:
    """Parameters of an ArduPilot whose sensor has the body's axes; a rotation and what else it cannot hold is left out.

    The strength of the field goes into the matrix, so COMPASS_SCALE is 1.
    """
    symmetric = model.symmetric().matrix
    if sensor == Sensor.MAG:
        roles = names.ardupilot_compass_names(instance, instance)
        offset = -model.offset / ardupilot.UT_PER_MGAUSS
        return {**_rows(roles, offset, symmetric, cross=True), roles[Role.FIELD_SCALE]: 1.0}
    return _rows(names.ardupilot_imu_names(sensor, instance), model.offset, symmetric, cross=False)


def model_from_ardupilot(parameters: Mapping[str, float], sensor: Sensor, instance: int = 0) -> TriadModel:
    """The model of the parameters of an ArduPilot, for a sensor with the body's axes and no drift with temperature."""
    neutral: dict[str, float] = {names.BOARD_ROTATION["ardupilot"]: 0}
    if sensor == Sensor.MAG:
        neutral[names.ardupilot_compass_names(instance, instance)[Role.EXTERNAL]] = 0
    return ardupilot.calibration_in_force({**parameters, **neutral}, sensor, instance)


def px4_from_model(model: TriadModel, sensor: Sensor, instance: int = 0) -> dict[str, float]:
    """Parameters of a PX4 whose sensor has the body's axes; a rotation and what else it cannot hold is left out.

    PX4 ignores vectors within 0.01 of neutral (offsets of a magnetometer 0.005):
    see :mod:`calib.firmware.compose.px4_memory`.
    """
    roles = names.px4_names(sensor, instance)
    unit = px4.UT_PER_GAUSS if sensor == Sensor.MAG else 1.0
    return _rows(roles, model.offset / unit, model.symmetric().matrix, cross=sensor == Sensor.MAG)


def model_from_px4(parameters: Mapping[str, float], sensor: Sensor, instance: int = 0) -> TriadModel:
    """The model of the parameters of a PX4, for a sensor with the body's axes; its thresholds are ignored."""
    roles = names.px4_names(sensor, instance)
    memory = px4.Px4Calibration(
        sensor,
        instance,
        offset=_values(parameters, roles, names.OFFSET, 0.0),
        scale=_values(parameters, roles, names.SCALE, 1.0),
        cross=_values(parameters, roles, names.CROSS, 0.0),
        loaded=True,
    )
    level = dict.fromkeys((*names.PX4_LEVEL, names.BOARD_ROTATION["px4"]), 0)
    filled = {names.px4_names(sensor, slot)[Role.ID]: slot + 1 for slot in range(instance + 1)}  # rows count by order
    frame = {**filled, roles[Role.ROTATION]: -1, **level}
    return px4.calibration_in_force({**parameters, **frame}, sensor, instance, memory)


def converted(fit: FitResult, convention: Convention | str) -> Converted:
    """A fit in the form of `convention`.

    Raises
    ------
    InvalidInputError
        If the fit is refused, or the convention knows no such sensor, unit or name.
    """
    chosen = Convention(convention)
    if fit.status == FitStatus.REFUSED:
        raise InvalidInputError(f"a refused fit has no form of {chosen.value}: {fit.message}")
    if fit.sensor not in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG):
        raise InvalidInputError(f"{chosen.value} has no form for the {fit.sensor}")
    form, values, lost = _FORMS[chosen](fit)
    if fit.undetermined:
        lost += (f"{', '.join(fit.undetermined)}: not determined, neutral values stand in",)
    if fit.model.polynomial is not None:
        lost += (f"the drift with temperature; this holds at {fit.model.polynomial.t_ref:g} degC",)
    return Converted(chosen, form, values, lost)


def c_header(fits: Sequence[FitResult]) -> str:
    """A header of C with the correction of every fit as a homogeneous 4 x 4 array, ``mag_0`` for the first compass.

    Raises
    ------
    InvalidInputError
        If a fit is refused, leaves part of its model open, or depends on temperature: a constant array would hide it.
    """
    pieces = ["/* corrected = H [x y z 1], row by row; from mavcal */\n"]
    for fit in fits:
        name = f"{fit.sensor.value}_{fit.instance}"
        if fit.status != FitStatus.OK or fit.undetermined or fit.model.polynomial is not None:
            raise InvalidInputError(
                f"{name} is not exported as an array: it is {fit.status.value}"
                f"{', with a drift with temperature' if fit.model.polynomial is not None else ''}. {fit.message}"
            )
        relative = ", relative to the calibration in force when it was recorded" if fit.relative else ""
        pieces.append(f"/* {fit.method}, {fit.unit}{relative} */")
        pieces.append(f"{c_array(name, homogeneous(fit.model.matrix, fit.model.offset))}\n")
    return "\n".join(pieces)


_Form = tuple[str, dict[str, Any], tuple[str, ...]]


def _matlab(fit: FitResult) -> _Form:
    if fit.sensor == Sensor.MAG:
        radius = fit.quality.get("radius")
        strength = 1.0 if radius is None else float(radius) * float(np.cbrt(np.linalg.det(fit.model.matrix)))
        form = magcal_from_model(fit.model, strength)
        expmfs = None if radius is None else form.expmfs
        return "C = (D - b) A by rows", {"A": form.A.tolist(), "b": form.b.tolist(), "expmfs": expmfs}, ()
    A, b = accelcal_from_model(fit.model)
    return "C = U A + b by rows", {"A": A.tolist(), "b": b.tolist()}, ()


def _ardupilot(fit: FitResult) -> _Form:
    _check_unit(fit, "ArduPilot")
    values = ardupilot_from_model(fit.model, fit.sensor, fit.instance)
    kept = model_from_ardupilot(values, fit.sensor, fit.instance)
    return "parameters, for a sensor with the axes of the body", dict(values), _lost(fit, kept)


def _px4(fit: FitResult) -> _Form:
    _check_unit(fit, "PX4")
    values = px4_from_model(fit.model, fit.sensor, fit.instance)
    kept = model_from_px4(values, fit.sensor, fit.instance)
    return "parameters, for a sensor with the axes of the body", dict(values), _lost(fit, kept)


def _imu_tk(fit: FitResult) -> _Form:
    T, K, B = imu_tk_from_model(fit.model)
    return "corrected = T K (m - B)", {"T": T.tolist(), "K": K.tolist(), "B": B.tolist()}, ()


def _kalibr(fit: FitResult) -> _Form:
    M, rotation, b = kalibr_from_model(fit.model)
    values: dict[str, Any] = {"M": M.tolist(), "b": b.tolist()}
    lost: tuple[str, ...] = ()
    if fit.sensor == Sensor.GYRO:
        values["C_gyro_i"] = rotation.tolist()
        if "K" in fit.native:  # rad/s per m/s2 in the body: A C_i = K
            values["A"] = (np.array(fit.native["K"]) @ rotation.T).tolist()
    elif rotation_angle(rotation) > _EXACT:
        values["C_i"] = rotation.tolist()
        lost = (f"Kalibr has no rotation for the {fit.sensor}: C_i, {math.degrees(rotation_angle(rotation)):.3g} deg",)
    return "m = M C_i truth + A C_i accel + b", values, lost


_FORMS = {
    Convention.MATLAB: _matlab,
    Convention.ARDUPILOT: _ardupilot,
    Convention.PX4: _px4,
    Convention.IMU_TK: _imu_tk,
    Convention.KALIBR: _kalibr,
}


def _rows(roles: Mapping[Role, str], offset: Array, symmetric: Array, *, cross: bool) -> dict[str, float]:
    """Parameters of an offset and as much of a symmetric matrix as there are names for."""
    found = {roles[role]: float(value) for role, value in zip(names.OFFSET, offset, strict=True)}
    if names.SCALE[0] in roles:
        found |= {roles[role]: float(v) for role, v in zip(names.SCALE, np.diag(symmetric), strict=True)}
    if cross:
        pairs = symmetric[[0, 0, 1], [1, 2, 2]]
        found |= {roles[role]: float(value) for role, value in zip(names.CROSS, pairs, strict=True)}
    return found


def _values(parameters: Mapping[str, float], roles: Mapping[Role, str], triple: names.Triple, default: float) -> Array:
    if triple[0] not in roles:
        return np.full(3, default)
    return np.array([float(parameters[roles[role]]) for role in triple])


def _check_unit(fit: FitResult, whose: str) -> None:
    if fit.unit == "counts":
        raise InvalidInputError(f"{whose}'s parameters are in physical units, and this fit is in counts")


def _lost(fit: FitResult, kept: TriadModel) -> tuple[str, ...]:
    """What the parameters do not hold of the matrix: the rotation, and the rest of the symmetric part."""
    found = []
    angle = math.degrees(rotation_angle(fit.model.rotation))
    if math.radians(angle) > _EXACT:
        found.append(f"the rotation of {angle:.3g} deg in the matrix")
    left = float(np.abs(kept.matrix - fit.model.symmetric().matrix).max())
    if left > _EXACT:
        found.append(f"entries of the matrix up to {left:.3g}: only offsets (and a diagonal) are stored")
    return tuple(found)
