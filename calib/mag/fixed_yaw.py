"""Compass offset from one reading at a known heading, for vehicles that cannot be turned.

The corrected compass must read the field of the place, rotated into the vehicle by its tilt and true heading. The
matrix in force is kept, so the offset is the remainder: ``b = m - C^-1 R_body_ned F``. One reading has no residual.
Errors of the heading, the field, the tilt or the matrix are part of the uncertainty instead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Unpack

import numpy as np

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitResult, parameter_names
from mavcal.calib.mag.heading import heading_sd_deg
from mavcal.calib.mag.orientation import rotation_matrix
from mavcal.calib.mag.result import CompassFit, MagContext, MagFacts, compass_result
from mavcal.calib.triad import Array, TriadModel

METHOD = "mag-fixed-yaw"

MOVEMENT = "for those turn the vehicle through all directions (job mag), or fly it with turns (mag-flight)"

TILT_SD = math.radians(0.3)
"""Standard deviation of roll and pitch by a calibrated accelerometer, rad. Chosen, not measured: 0.05 m/s2
horizontally."""
KEPT_SD = 0.02
"""Standard deviation of the entries of a fitted matrix. Chosen, not measured: the effect of different batteries."""
NEVER_FITTED_SD = 0.05
"""The same for a matrix that was never fitted: soft iron is 3 to 9 % of the field (:mod:`calib.mag.simple_fits`)."""

# Error model of WMM2025, one sigma, crustal field included (its technical report): nT in the horizontal field.
_DECLINATION_SD = 0.26, 5417.0
_INCLINATION_SD = math.radians(0.20)
_WORST_HEADING_DEG = 10.0  # of the heading, anywhere: an offset that is known worse is none


@dataclass(frozen=True)
class KnownAttitude:
    """Attitude at rest, rad: tilt by the accelerometer, heading of the nose from true north, and its sd."""

    roll: float
    pitch: float
    heading: float
    heading_sd: float

    def body_from_ned(self) -> Array:
        """Rotation (3, 3)."""
        return rotation_matrix(*np.degrees([self.roll, self.pitch, self.heading])).T


def fit_fixed_yaw(
    reading: Array,
    reading_covariance: Array,
    count: int,
    in_force: TriadModel,
    standing: KnownAttitude,
    **facts: Unpack[MagFacts],
) -> FitResult:
    """The offset of a compass from one `reading` at a known attitude.

    Parameters
    ----------
    reading, reading_covariance : shapes (3,), (3, 3)
        Mean of raw samples at rest, and its covariance.
    count
        Number of these samples.
    in_force
        Raw to corrected body: its matrix is kept.
    standing
        Tilt and heading of the vehicle.
    **facts
        :class:`calib.mag.result.MagContext`; `field` is needed, `body_from_sensor` is the stated mounting.

    Raises
    ------
    InvalidInputError
        If the field of the place is not given, or the numbers are not finite.
    """
    context = MagContext(**facts)
    field = context.field
    if field is None:
        raise InvalidInputError("a compass at one heading needs the Earth's field of the place: give the position")
    if not (np.isfinite(reading).all() and np.isfinite(reading_covariance).all()):
        raise InvalidInputError("the mean of a compass must be finite")
    mounting = np.eye(3) if context.body_from_sensor is None else context.body_from_sensor
    expected = standing.body_from_ned() @ field.north_east_down
    back = np.linalg.inv(in_force.matrix)
    model = TriadModel(offset=reading - back @ expected, matrix=mounting.T @ in_force.matrix)
    kept = KEPT_SD if _was_fitted(model.matrix) else NEVER_FITTED_SD
    full = _covariance(model, mounting, expected, _field_covariance(context, standing), reading_covariance, kept)
    worst = heading_sd_deg(model, full, field.norm, field.inclination, mounting)
    here = math.degrees(math.hypot(standing.heading_sd, declination_sd(field.horizontal)))
    moved = float(np.linalg.norm(model.offset - in_force.offset))
    quality = {
        "heading_sd_deg": worst,
        "heading_here_sd_deg": here,
        "heading_dip_deg": math.degrees(field.inclination),
        "radius": field.norm,
        "field_ratio": None,
        "soft_iron_kept": True,
        "soft_iron_sd_before": kept,
        "offset_moved": moved,
    }
    if worst > _WORST_HEADING_DEG:
        return context.made(METHOD, count, MOVEMENT).refused(
            f"one heading tells the others to {worst:.0f} deg only: the heading is known to {here:.1f} deg, and the "
            f"horizontal field is {field.horizontal:.0f} uT here",
            quality=quality,
        )
    return compass_result(
        CompassFit(
            METHOD,
            model,
            full,
            n_samples=count,
            n_used=count,
            message=f"heading good to {here:.1f} deg as it stands, to {worst:.1f} deg at the worst other heading",
            residual_rms=0.0,
            condition_number=1.0,
            quality=quality,
            warnings=_warnings(kept, moved, field.norm),
            undetermined=dict.fromkeys((n for n in parameter_names() if n.startswith("matrix")), MOVEMENT),
        ),
        context,
    )


def declination_sd(horizontal: float) -> float:
    """One-sigma error of the model's declination, rad, where the horizontal field is `horizontal` (uT)."""
    base, by_field = _DECLINATION_SD
    return math.radians(math.hypot(base, by_field / (1000.0 * horizontal)))


def _was_fitted(matrix: Array) -> bool:
    """Whether the matrix is more than a rotation and a scale."""
    gram = matrix.T @ matrix
    return float(np.abs(gram / np.trace(gram) - np.eye(3) / 3.0).max()) > 1e-6


def _field_covariance(context: MagContext, standing: KnownAttitude) -> Array:
    """Covariance (3, 3) of the field in the vehicle: strength, dip, heading and tilt."""
    field = context.field
    assert field is not None
    ned = field.north_east_down
    level = np.array([ned[0], ned[1], 0.0]) / field.horizontal
    dipped = -math.sin(field.inclination) * level + np.array([0.0, 0.0, math.cos(field.inclination)])
    yaw_sd = math.hypot(standing.heading_sd, declination_sd(field.horizontal))
    parts = [
        field.norm_sd * ned / field.norm,
        _INCLINATION_SD * field.norm * dipped,
        yaw_sd * np.cross([0.0, 0.0, 1.0], ned),
    ]
    turn = standing.body_from_ned()
    columns = [turn @ part for part in parts]
    columns += [TILT_SD * np.cross(axis, turn @ ned) for axis in (np.eye(3)[0], np.eye(3)[1])]
    stacked = np.column_stack(columns)
    return np.asarray(stacked @ stacked.T)


def _covariance(
    model: TriadModel, mounting: Array, expected: Array, field: Array, reading: Array, matrix_sd: float
) -> Array:
    """Covariance (12, 12) of offset and matrix: ``db = dm - C^-1 dF + C^-1 dC C^-1 F``, all in the sensor's axes."""
    back = np.linalg.inv(model.matrix)
    of_field = back @ mounting.T
    inner = of_field @ expected
    rows = np.zeros((12, 9))
    rows[3:] = matrix_sd * np.eye(9)
    for entry in range(9):
        rows[:3, entry] = matrix_sd * back[:, entry // 3] * inner[entry % 3]
    covariance = rows @ rows.T
    covariance[:3, :3] += reading + of_field @ field @ of_field.T
    return np.asarray(covariance)


def _warnings(kept: float, moved: float, strength: float) -> tuple[str, ...]:
    found = ["one reading cannot show steel or magnets nearby: stand outdoors, away from cars and reinforced concrete"]
    if kept == NEVER_FITTED_SD:
        found.append(
            "its soft iron was never calibrated: other headings may be off by degrees; fly it with turns, then fit"
        )
    if moved > strength:
        found.append(f"the offset moves by {moved:.0f} uT, more than the field of {strength:.0f} uT: check the heading")
    return tuple(found)
