"""Reference vectors of accelerometer and magnetometer at rest, and the attitude (METHODS S5).

The means of a hundred samples serve as reference vectors. Down is against the specific force, east is across down and
field: two vectors, one attitude (the triad). It calibrates nothing: the offsets of both sensors are part of the answer.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from mavcal.calib.earth import EarthField
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitBuilder, FitResult, parameter_names
from mavcal.calib.recording import Array, Channel
from mavcal.calib.stats.quantisation import QuantisedMean, mean_of
from mavcal.calib.stats.residuals import residual_statistics
from mavcal.calib.stats.windows import finite_rows
from mavcal.calib.triad import TriadModel

METHOD = "rest-reference"
SAMPLES = 100
"""Number of samples that a reference vector is averaged over."""

NO_CALIBRATION = "a rest shows no offset and no matrix: turn the vehicle, with accel-multi and mag-ellipsoid"

_MOVED = 0.05  # of gravity, scatter of a sensor that does not rest
_STEEPEST = 0.02  # cosine of the pitch, or horizontal part of the field, below which heading and roll say nothing
_STEP = 1e-6


@dataclass(frozen=True, eq=False)
class SensorTolerances:
    """Standard deviation of each sensor's remaining offset per axis, in its own unit; noise is not included."""

    accel_sd: float = 0.0
    mag_sd: float = 0.0


NOISE_ALONE = SensorTolerances()


def attitude_from_vectors(accel: Array, mag: Array | None) -> Array:
    """``R_nb`` (3, 3) by the triad of specific force (3,) and field (3,); its north is magnetic.

    Without a field, north is the horizontal direction nearest to the nose.

    >>> attitude_from_vectors(np.array([0.0, 0.0, -9.8]), np.array([0.0, -20.0, 45.0])).round(6) + 0.0
    array([[ 0., -1.,  0.],
           [ 1.,  0.,  0.],
           [ 0.,  0.,  1.]])
    """
    down = -accel / np.linalg.norm(accel)
    if mag is None:
        mag = np.array([1.0, 0.0, 0.0]) if abs(down[0]) < 1.0 - _STEEPEST else -np.sign(down[0]) * np.eye(3)[2]
    east = np.cross(down, mag)
    east = east / np.linalg.norm(east)
    return np.stack([np.cross(east, down), east, down])


def angles_of(attitude: Array) -> Array:
    """Roll, pitch and yaw (3,) of ``R_nb``, rad."""
    R = attitude
    return np.array(
        [math.atan2(R[2, 1], R[2, 2]), math.atan2(-R[2, 0], math.hypot(R[2, 1], R[2, 2])), math.atan2(R[1, 0], R[0, 0])]
    )


def fit_rest_reference(
    accel: Channel,
    mag: Channel | None,
    *,
    samples: int = SAMPLES,
    sensors: SensorTolerances = NOISE_ALONE,
    field: EarthField | None = None,
    relative: bool = False,
) -> FitResult:
    """Reference vectors of a rest, and roll, pitch and heading with their uncertainty.

    Parameters
    ----------
    accel
        Samples at rest, any unit.
    mag
        At the same time, in the same axes, any unit. None: roll and pitch only.
    samples
        Number of samples that each vector is averaged over, from the first one.
    sensors
        Offsets that the calibration of the sensors leaves; they are part of the uncertainty.
    field
        Its declination turns the magnetic heading into a true one. None: the heading is magnetic.
    relative
        Passed on to the result.

    Returns
    -------
    FitResult
        ``native`` holds the vectors and the attitude. The model is neutral and entirely undetermined: nothing is
        written to a vehicle.

    Raises
    ------
    InvalidInputError
        If `samples` is less than two, or a standard deviation is negative.
    """
    if samples < 2 or not (sensors.accel_sd >= 0.0 and sensors.mag_sd >= 0.0):
        raise InvalidInputError(
            f"a mean takes two samples or more, not {samples}; standard deviations are {sensors.accel_sd} and "
            f"{sensors.mag_sd}, and not negative"
        )
    parts = [_first(channel, samples) for channel in (accel, mag) if channel is not None]
    problem = next((text for text in (_why_not(part, samples) for part in parts) if text), "")
    made = FitBuilder.of(METHOD, accel, relative=relative)
    if problem:
        return made.refused(problem, movement=problem)
    means = [mean_of(part) for part in parts]
    native, quality = _implied(means, sensors, field)
    residual = parts[0].values - means[0].mean
    scatter = residual[:, ~np.array(means[0].constant)]
    quality |= residual_statistics(scatter if scatter.size else residual, 3 * (samples - 1), None)
    return made.fitted(
        TriadModel(),
        np.zeros((12, 12)),
        message=_message(native, quality),
        n_used=samples,
        residual_rms=float(np.sqrt((residual**2).mean())),
        condition_number=quality["condition"],
        undetermined=dict.fromkeys(parameter_names(), NO_CALIBRATION),
        warnings=_warnings(native, sensors, mag),
        quality=MappingProxyType(quality),
        native=MappingProxyType({**native, "unit_mag": None if mag is None else mag.unit, "samples": samples}),
    )


def _first(channel: Channel, samples: int) -> Channel:
    return channel.take(finite_rows(channel.values)).take(slice(0, samples))


def _why_not(part: Channel, samples: int) -> str:
    """Why the vector of `part` is no reference; empty if it is one."""
    if len(part) < samples:
        return f"{len(part)} finite samples of the {part.sensor} at rest: {samples} are averaged; rest longer"
    size = float(np.linalg.norm(part.values.mean(axis=0)))
    scatter = float(part.values.std(axis=0, ddof=1).max())
    if not size > 0.0:
        return f"the {part.sensor} reads nothing: it is not connected, or broken"
    if scatter > _MOVED * size:
        return f"the {part.sensor} scatters by {scatter:.3g} {part.unit} about {size:.3g}: it moved, keep it still"
    return ""


def _implied(
    means: list[QuantisedMean], sensors: SensorTolerances, field: EarthField | None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Attitude of the mean vectors, for ``native``, and its uncertainty, for ``quality``."""
    vector = np.concatenate([m.mean for m in means])
    spread = np.zeros((len(vector), len(vector)))
    for i, (mean, left) in enumerate(zip(means, (sensors.accel_sd, sensors.mag_sd), strict=False)):
        spread[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = mean.covariance + left**2 * np.eye(3)
    attitude = _attitude(vector)
    turn = _jacobian(vector, lambda v: Rotation.from_matrix(_attitude(v) @ attitude.T).as_rotvec())
    rotation = turn @ spread @ turn.T
    down = -vector[:3] / np.linalg.norm(vector[:3])
    steep = math.hypot(down[1], down[2]) < _STEEPEST
    with_field = len(means) > 1
    dip, horizontal = _dip(vector) if with_field else (None, 0.0)
    heading_known = with_field and not steep and horizontal > _STEEPEST
    angles = angles_of(attitude)
    sd = np.zeros(3)
    if not steep:
        by = _jacobian(vector, lambda v: _wrapped(angles_of(_attitude(v)) - angles))
        sd = np.degrees(np.sqrt(np.clip(np.diag(by @ spread @ by.T), 0.0, None)))
    yaw = math.degrees(angles[2]) + (0.0 if field is None else math.degrees(field.declination))
    native = {
        "accel": vector[:3].tolist(),
        "accel_sd": np.sqrt(np.diag(means[0].covariance)).tolist(),
        "mag": vector[3:].tolist() if with_field else None,
        "mag_sd": np.sqrt(np.diag(means[1].covariance)).tolist() if with_field else None,
        "roll_deg": None if steep else math.degrees(angles[0]),
        "pitch_deg": math.degrees(angles[1]),
        "heading_deg": yaw % 360.0 if heading_known else None,
        "north": "magnetic" if field is None else "true",
        "dip_deg": dip,
        "R_nb": attitude.tolist() if horizontal > _STEEPEST else None,
        "q_nb": Rotation.from_matrix(attitude).as_quat(scalar_first=True).tolist() if horizontal > _STEEPEST else None,
    }
    worst = rotation if with_field else rotation[:2, :2]
    quality = {
        "attitude_sd_deg": math.degrees(math.sqrt(max(float(np.linalg.eigvalsh(worst)[-1]), 0.0))),
        "roll_sd_deg": None if steep else float(sd[0]),
        "pitch_sd_deg": None if steep else float(sd[1]),
        "heading_sd_deg": float(sd[2]) if heading_known else None,
        "condition": 1.0 / horizontal if horizontal > 0.0 else 1.0,
    }
    return native, quality


def _wrapped(angles: Array) -> Array:
    return np.asarray(np.remainder(angles + math.pi, 2.0 * math.pi) - math.pi)


def _attitude(vector: Array) -> Array:
    return attitude_from_vectors(vector[:3], vector[3:] if len(vector) > 3 else None)


def _jacobian(vector: Array, function: Callable[[Array], Array]) -> Array:
    """Central-difference derivative at `vector`; the step of each half is relative to its length."""
    sizes = np.repeat([np.linalg.norm(half) for half in vector.reshape(-1, 3)], 3)
    steps = _STEP * np.diag(sizes)
    columns = [
        (function(vector + s) - function(vector - s)) / (2.0 * _STEP * size)
        for s, size in zip(steps, sizes, strict=True)
    ]
    return np.array(columns).T


def _dip(vector: Array) -> tuple[float, float]:
    """Dip of the field, degrees, and its horizontal fraction."""
    down = -vector[:3] / np.linalg.norm(vector[:3])
    field = vector[3:] / np.linalg.norm(vector[3:])
    horizontal = float(np.linalg.norm(np.cross(down, field)))
    return math.degrees(math.atan2(float(down @ field), horizontal)), horizontal


def _message(native: dict[str, Any], quality: dict[str, Any]) -> str:
    def value_text(name: str, value: float | None, sd: float | None) -> str:
        return f"{name} open" if value is None or sd is None else f"{name} {value + 0.0:.2f} +- {sd:.2g} deg"

    return ", ".join(
        (
            value_text("roll", native["roll_deg"], quality["roll_sd_deg"]),
            value_text("pitch", native["pitch_deg"], quality["pitch_sd_deg"]),
            value_text("heading", native["heading_deg"], quality["heading_sd_deg"]),
        )
    )


def _warnings(native: dict[str, Any], sensors: SensorTolerances, mag: Channel | None) -> tuple[str, ...]:
    found = []
    if mag is None:
        found.append("no magnetometer was recorded: the heading is open")
    elif native["heading_deg"] is None:
        found.append("the nose or the field points straight up or down: the heading is open")
    if not sensors.accel_sd or (mag is not None and not sensors.mag_sd):
        found.append(
            "the stated errors are those of noise: 0.17 m/s2 of offset are another degree of tilt, and offsets of the "
            "magnetometer turn the heading; state --accel-sd and --mag-sd"
        )
    return tuple(found)
