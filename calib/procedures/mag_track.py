"""One compass of a magnetometer procedure: its samples with the motion at their times, and its fit."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from mavcal.calib.earth import EarthField
from mavcal.calib.errors import CalibError, UndeterminedError
from mavcal.calib.fit import FitBuilder, FitResult, FitStatus
from mavcal.calib.mag.accumulator import EllipsoidAccumulator, directions_of
from mavcal.calib.mag.blur import Rates
from mavcal.calib.mag.blur_fit import fit_ellipsoid_deblurred
from mavcal.calib.mag.coverage import Coverage
from mavcal.calib.mag.free_rotation import angle_between
from mavcal.calib.mag.heading import DEFAULT_INCLINATION
from mavcal.calib.mag.orientation import (
    RIGHT_ANGLES,
    FittedRotation,
    Mounting,
    MountingVerdict,
    OrientationResult,
    find_orientation,
)
from mavcal.calib.recording import Array, Sensor
from mavcal.calib.triad import TriadModel

LEAST = 60
"""Least number of sharp samples for a fit: fewer do not determine their noise."""

LEAST_NOISE = 1e-4
"""Least noise of one axis, relative to the field strength."""


@dataclass(frozen=True, eq=False)
class BodyMotion:
    """Motion of the body at the times of compass samples: rates over their window, specific force, and rate."""

    rates: Rates
    force: Array  # (N, 3) corrected specific force, body
    turning: Array  # (N, 3) rad/s, body


class MagTrack:
    """One compass.

    Parameters
    ----------
    in_force
        Correction that the vehicle applies (raw to body); None: not known.
    body
        Stated mounting, body from raw, (3, 3).
    quantum, relative
        Properties of the stream.
    """

    def __init__(
        self,
        instance: int,
        field: EarthField | None,
        in_force: TriadModel | None,
        body: Array,
        *,
        quantum: float,
        relative: bool,
    ) -> None:
        self.instance = instance
        self.field = field
        self.in_force = in_force
        self.body = body
        self.fit: FitResult | None = None
        self.coverage = Coverage.empty()
        self.noise = 0.01
        """Noise of one axis over the field strength, from the residuals of the rough shape."""
        self.predicted = math.inf
        """Predicted heading error from the collected samples, degrees."""
        self.strength = math.nan
        """Length of the field with the calibration in force, over the last tick, uT."""
        self.nearest = math.inf
        """Smallest raw length so far, uT."""
        self.blurred = 0
        self._relative = relative
        self._quantum = quantum
        self._shape = EllipsoidAccumulator()
        self._rates: list[Rates] = []
        self._force: list[Array] = []
        self._turning: list[Array] = []

    def __len__(self) -> int:
        return len(self._shape)

    def add(self, samples: Array, motion: BodyMotion) -> None:
        """Take samples (N, 3) with the motion at their times; blurred ones are left out."""
        if self.in_force is not None:
            self.strength = float(np.linalg.norm(self.in_force.apply(samples), axis=1).mean())
        self.nearest = min(self.nearest, float(np.linalg.norm(samples, axis=1).min()))
        sharp = motion.rates.sharp()
        self.blurred += int(np.count_nonzero(~sharp))
        if sharp.any():
            self._shape.add(samples[sharp])
            self._rates.append(motion.rates.take(sharp))
            self._force.append(motion.force[sharp])
            self._turning.append(motion.turning[sharp])

    def update(self) -> None:
        """Update coverage and the predicted heading error."""
        shape = self._shape.rough()
        if shape is None:
            return
        directions = directions_of(self._shape.samples, shape)
        self.coverage = Coverage.of(directions @ self.body.T)
        self.noise = max(float(np.linalg.norm(directions, axis=1).std()), LEAST_NOISE)
        self.predicted = self.coverage.heading_sd_deg(self.noise, self.inclination)

    @property
    def inclination(self) -> float:
        """Dip, rad."""
        return DEFAULT_INCLINATION if self.field is None else self.field.inclination

    @property
    def heading_sd(self) -> float:
        """Heading error of the fit, degrees; infinite without one."""
        if self.fit is None or self.fit.status == FitStatus.REFUSED:
            return math.inf
        return float(self.fit.quality["heading_sd_deg"])

    def refit(self) -> None:
        """Fit everything so far; :attr:`fit` stays None while there is too little."""
        if len(self) < LEAST:
            return
        try:
            self.fit = fit_ellipsoid_deblurred(
                self._shape.samples,
                self._joined_rates(),
                instance=self.instance,
                quantum=self._quantum,
                field=self.field,
                body_from_sensor=self.body,
                relative=self._relative,
            )
        except CalibError:
            self.fit = None

    def mounting(self, sine: float | None = None) -> OrientationResult | None:
        """Mounting that explains the compass; None: the movement does not determine it, or there is no fit.

        `sine`: sine of the dip from other compasses of the vehicle, used where the place is not known.
        """
        dip = math.asin(max(-1.0, min(1.0, sine))) if sine is not None else None
        if self.fit is None or self.fit.status == FitStatus.REFUSED:
            return None
        try:
            return find_orientation(
                self.fit.model.apply(self._shape.samples) @ self.body.T,
                np.vstack(self._force),
                gyro=np.vstack(self._turning),
                inclination=dip if self.field is None else self.field.inclination,
                stated=self.body,
            )
        except UndeterminedError:
            return None

    def result(self, mounting: OrientationResult | None) -> FitResult:
        """The fit with the mounting; refused if no mounting explains the compass."""
        assert self.fit is not None
        known = None if mounting is None else _as_quality(mounting)
        quality = {**self.fit.quality, "orientation": known, "blurred": self.blurred}
        if mounting is not None and mounting.verdict in (MountingVerdict.UNEXPLAINED, MountingVerdict.MIRRORED):
            made = FitBuilder(self.fit.method, Sensor.MAG, self.instance, self.fit.unit, self.fit.n_samples)
            return made.refused(mounting.message, quality=quality)
        warnings = self.fit.warnings
        if mounting is None or mounting.verdict == MountingVerdict.AMBIGUOUS:
            text = "the mounting of the compass could not be checked against the accelerometer"
            warnings += (text if mounting is None else mounting.message,)
        elif mounting.verdict in (MountingVerdict.ROTATED, MountingVerdict.BY_ANGLES):
            warnings += (mounting.message,)
        return dataclasses.replace(self.fit, quality=quality, warnings=warnings)

    def _joined_rates(self) -> Rates:
        if len(self._rates) > 1:
            self._rates = [self._rates[0].followed_by(*self._rates[1:])]
        return self._rates[0]


def _as_quality(mounting: OrientationResult) -> dict[str, Any]:
    """The mounting as JSON; `matrix` rotates the body frame of the stated mounting into the body frame."""
    found = mounting_quality(mounting.verdict, mounting.best, mounting.fitted, mounting.message)
    return {
        **found,
        "log_likelihood_margin": float(mounting.log_likelihood_margin),
        "rms": next(iter(mounting.rms.values())),
        "misalignment_deg": mounting.misalignment_deg,
        "misalignment_sd_deg": mounting.misalignment_sd_deg,
        "lag": mounting.lag,
    }


def mounting_quality(
    verdict: MountingVerdict, best: Mounting, fitted: FittedRotation | None, message: str
) -> dict[str, Any]:
    """A mounting as ``quality["orientation"]`` of a fit has it: what the composers of plans read.

    `matrix` and the angles rotate the body frame of the stated mounting into the body frame. Right-angle rotations are
    exact and have no standard deviation. `askew_deg` is the angle between the fitted rotation and the nearest by right
    angles (`nearest`); None: the movement does not tell.
    """
    by_angles = verdict == MountingVerdict.BY_ANGLES and fitted is not None
    euler = fitted.euler if by_angles and fitted is not None else None
    nearest = best if fitted is None else max(RIGHT_ANGLES, key=lambda m: float(np.trace(m.matrix.T @ fitted.matrix)))
    return {
        "verdict": verdict.value,
        "name": best.name if euler is None else str(euler),
        "roll": best.roll if euler is None else euler.roll,
        "pitch": best.pitch if euler is None else euler.pitch,
        "yaw": best.yaw if euler is None else euler.yaw,
        "sd_deg": None if euler is None else euler.sd,
        "matrix": (best.matrix if fitted is None or euler is None else fitted.matrix).tolist(),
        "covariance": None if fitted is None or euler is None else fitted.covariance.tolist(),
        "nearest": nearest.name,
        "askew_deg": None if fitted is None else math.degrees(angle_between(nearest.matrix, fitted.matrix)),
        "message": message,
    }
