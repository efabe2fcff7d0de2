"""Losses and refusals common to both autopilots."""

from __future__ import annotations

import numpy as np
import scipy

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.firmware import losses
from mavcal.calib.firmware.compose.draft import Draft, Subject
from mavcal.calib.firmware.compose.fitted import keeps_matrix
from mavcal.calib.firmware.limits import COMPASS_SCALE_WINDOW
from mavcal.calib.firmware.rotations import rotation_angle
from mavcal.calib.fit import AXES, FitResult
from mavcal.calib.recording import Array, Sensor

ALIGNED = 1e-9
"""Angle, rad, below which a rotation is rounding."""
ROUNDED = 0.02
"""Angle, degrees, below which a rotation comes from angles written with two decimals."""
SINGLE_PRECISION = 1e-5
"""Error, m/s2, of a scale stored as float32, which is not worth a message."""
_BY_CHANCE = 0.05
"""Probability at which truly zero terms count as significant."""
_ONE_SIDED = 1.645
"""Standard deviations of a one-sided 95 % bound."""


def offsets_usable(draft: Draft, about: Subject, fit: FitResult, *, thermal: bool) -> bool:
    """Whether undetermined offsets, if any, may be kept beside the others.

    `thermal`: a polynomial is in force that this fit does not replace. An offset may then not be kept if its reference
    temperature changes.
    """
    missing = [a for a in AXES if not fit.determined(f"offset_{a}")]
    if not missing:
        return True
    which = f"{about}: the offset of {', '.join(missing)} is not determined"
    if about.sensor == Sensor.ACCEL or thermal:
        draft.block(f"{which}, and the others do not hold without it. {fit.message}", about)
        return False
    draft.warn(f"{which} and stays as it is. {fit.message}")
    return True


def scale_usable(draft: Draft, about: Subject, fit: FitResult, in_force: Array) -> bool:
    """Whether the fit determines the scales; assumed ones must equal those in force (`in_force`, (3,))."""
    if not np.any(np.diag(fit.covariance)[losses.MATRIX]):
        if not np.allclose(fit.model.matrix, np.diag(in_force), rtol=0, atol=1e-6):
            draft.block(
                f"{about}: this fit assumes scales of {np.diag(fit.model.matrix).tolist()}, but those in force are "
                f"{in_force.tolist()}; an offset taken that way does not fit to them. Calibrate with six poses",
                about,
            )
        return False
    undetermined = [n for n in ("matrix_xx", "matrix_yy", "matrix_zz") if not fit.determined(n)]
    if undetermined:
        draft.block(f"{about}: {', '.join(undetermined)} are not determined. {fit.message}", about)
        return False
    return True


def compass_usable(draft: Draft, about: Subject, fit: FitResult, stored: str) -> bool:
    """Whether a compass fit is in uT and whole; `stored` says in which unit the firmware has its offsets."""
    if fit.unit != "uT":
        draft.block(f"{about}: the fit is in {fit.unit}; {stored}", about)
        return False
    if fit.undetermined and not keeps_matrix(fit):
        draft.block(f"{about}: {', '.join(fit.undetermined)} are not determined. {fit.message}", about)
        return False
    return True


def field_plausible(draft: Draft, about: Subject, fit: FitResult, parts: losses.Parts, limit: str = "") -> bool:
    """Whether the compass measures about the Earth's field, where that is known; `limit`: the firmware's, in words."""
    factor = float(np.cbrt(np.linalg.det(parts.symmetric)))
    low, high = COMPASS_SCALE_WINDOW
    if fit.quality.get("field_ratio") is None or low <= factor <= high:
        return True
    draft.block(
        f"{about} measures {1.0 / factor:.2f} times the Earth's field{limit}: steel, a magnet or a current is near, or "
        "the sensor is damaged. Move away and repeat",
        about,
    )
    return False


def lose_accel(draft: Draft, about: Subject, parts: losses.Parts, stored: Array, body_from_sensor: Array) -> None:
    """Announce the part of an accelerometer's matrix that is lost if its scales are `stored` (3,)."""
    cost = losses.largest_error(np.diag(stored), parts.symmetric, STANDARD_GRAVITY)
    if cost > SINGLE_PRECISION:
        cross = ", ".join(f"{c:.5f}" for c in parts.cross)
        what, text = "cross terms", f"cross-axis terms (xy xz yz: {cross}) cannot be stored"
        if not np.allclose(stored, parts.diagonal, rtol=0, atol=1e-6):
            what, text = "scale and cross terms", f"scales so near to 1 never reach PX4's memory, and {text}"
        draft.lose(about, what, cost, "m/s2", f"{about}: {text}; {_left(parts, stored, cost)}")
    angle = min(rotation_angle(parts.rotation), rotation_angle(body_from_sensor.T @ parts.rotation))
    if angle > ALIGNED:
        draft.lose(
            about,
            "mounting",
            2.0 * STANDARD_GRAVITY * np.sin(0.5 * angle),
            "m/s2",
            f"{about}: turned by {np.degrees(angle):.3f} deg in its mounting; there is no parameter for one sensor. "
            "What is common to all sensors goes into the level trim: run the level job",
        )


def _left(parts: losses.Parts, stored: Array, cost: float) -> str:
    """Text on the lost part of a matrix with its uncertainty, or with a bound if the fit has none."""
    left = np.concatenate((parts.diagonal - stored, parts.cross))
    covariance = parts.covariance[3:, 3:]
    if not (np.diag(covariance)[3:] > 0.0).all():
        return f"up to {cost:.4f} m/s2 stay, depending on the attitude"
    kept = np.abs(left) > SINGLE_PRECISION  # a scale that is stored leaves nothing
    kept[3:] = True
    change = covariance[np.ix_(kept, kept)]
    squares = float(left[kept] @ np.linalg.pinv(change, hermitian=True) @ left[kept])
    sd = STANDARD_GRAVITY * losses.largest_sd(parts, stored)
    if squares <= scipy.special.chdtri(int(kept.sum()), _BY_CHANCE):
        return f"they agree with zero: at most {cost + _ONE_SIDED * sd:.4f} m/s2 stay (95 %), perhaps nothing"
    return f"up to {cost:.4f} ± {sd:.4f} m/s2 stay, depending on the attitude"


def lose_gyro_matrix(draft: Draft, about: Subject, fit: FitResult) -> None:
    """Announce a gyroscope's scale and misalignment, which neither firmware can store."""
    cost = losses.largest_error(np.eye(3), fit.model.matrix, 1.0)
    if cost > 0.0:
        draft.lose(
            about,
            "scale and misalignment",
            cost,
            "rad/s at 1 rad/s",
            f"{about}: scale and misalignment cannot be stored; up to {100.0 * cost:.3f} % of the rate stay",
        )


def lose_compass_mounting(draft: Draft, about: Subject, fit: FitResult, old: Array, new: Array) -> None:
    """Announce the mounting error of a magnetometer that the plan leaves.

    `old` and `new` (3, 3) take the sensor to the body, as stated now and by the plan. The whole correction is ``old Q S
    (m - b)``; ``new S (m - b)`` is stored, so ``old Q new^T`` is left. A fit of lengths has no Q: gravity may have
    shown a rotation T by other than right angles, and ``T old new^T`` is left.
    """
    rotation = losses.split(fit).rotation
    orientation = fit.quality.get("orientation") or {}
    if rotation_angle(rotation) > ALIGNED:
        left = old @ rotation @ new.T
    elif orientation.get("covariance") is not None:
        left = np.array(orientation["matrix"], dtype=np.float64) @ old @ new.T
    else:
        return
    angle = np.degrees(rotation_angle(left))
    if angle > ROUNDED:
        draft.lose(
            about,
            "mounting",
            angle,
            "deg",
            f"{about}: mounted {angle:.2f} deg askew, which is not written: the heading is off by about as much",
        )


def lose_drift(draft: Draft, about: Subject, fit: FitResult, why: str) -> None:
    """Announce a temperature drift that is not written."""
    polynomial = fit.model.polynomial
    assert polynomial is not None
    over = polynomial(np.linspace(polynomial.t_min, polynomial.t_max, 101))
    cost = float(np.linalg.norm(np.ptp(over, axis=0)))
    unit = "m/s2" if about.sensor == Sensor.ACCEL else "rad/s"
    text = f"{about}: its drift is not written, because {why}"
    draft.lose(about, "temperature drift", cost, unit, text)
    draft.drop(about, text)
