"""Compares the calibration in a vehicle with the truth: per sensor, and all together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.firmware import calibration_in_force
from mavcal.calib.firmware.compose.px4_held import held_drift
from mavcal.calib.fit import FitResult, parameter_names
from mavcal.calib.recording import Sensor
from mavcal.calib.simulate.scoring import RecoveryScore, joint_p_value, score
from mavcal.calib.triad import ThermalPolynomial, TriadModel

Json = Mapping[str, Any]

OFFSETS = parameter_names()[:3]
DIAGONAL = ("matrix_xx", "matrix_yy", "matrix_zz")
SYMMETRIC = ("matrix_xx", "matrix_xy", "matrix_xz", "matrix_yy", "matrix_yz", "matrix_zz")
LARGEST_Z = 4.5
SMALLEST_P = 1e-4
TOO_LARGE = 2.0
"""Largest ratio of stated to actual errors, rms. The stated ones include effects that this vehicle may lack: a field
that changes within a reading, coarse steps, a drifting bias."""


@dataclass(frozen=True)
class SensorReport:
    """One sensor before and after: the largest error over all directions, in `unit`."""

    sensor: Sensor
    instance: int
    before: float
    after: float
    cross: float
    """Part of the true calibration that the firmware cannot represent, same unit."""
    unit: str
    score: RecoveryScore
    drift: bool = False
    """Whether the temperature drift was calibrated."""


@dataclass(frozen=True)
class DemoJudgement:
    """All sensors of one job, or of several together."""

    reports: tuple[SensorReport, ...]

    @property
    def largest_z(self) -> float:
        """Largest |error| / stated sd of any written parameter."""
        return max(float(np.abs(r.score.standardised).max(initial=0.0)) for r in self.reports)

    @property
    def farthest(self) -> tuple[str, ...]:
        """The five written parameters farthest from the truth in standard deviations, in words."""
        errors = [
            (float(z), f"{name} of {r.sensor.value} {r.instance}")
            for r in self.reports
            for name, z in zip(r.score.names, r.score.standardised, strict=True)
        ]
        return tuple(f"{name} {z:+.1f}" for z, name in sorted(errors, key=lambda e: -abs(e[0]))[:5])

    @property
    def joint(self) -> tuple[float, int, float]:
        """Chi-square, degrees of freedom and p-value of every written, representable parameter."""
        return joint_p_value(tuple(r.score for r in self.reports))

    @property
    def honest(self) -> bool:
        """Whether the stated uncertainty is right: neither too small nor too large."""
        chi2, freedom, p = self.joint
        return self.largest_z <= LARGEST_Z and p >= SMALLEST_P and chi2 * TOO_LARGE**2 >= freedom


def true_model(truth: Json, sensor: Sensor, instance: int) -> TriadModel:
    """The true model of a simulated sensor, in its own frame."""
    entry = truth[f"{sensor.value}s"][instance]
    matrix = np.linalg.inv(np.array(entry["matrix"]))
    offset = np.array(entry["offset"])
    coefficients = np.array(entry["polynomial"])
    polynomial = None
    if np.any(coefficients):
        polynomial = ThermalPolynomial(truth["t_ref"], -273.0, 1000.0, coefficients)
    return TriadModel(offset, matrix, polynomial)


def held(fit: FitResult, autopilot: str) -> tuple[str, ...]:
    """The parameters of a fit that the autopilot can store as they were measured.

    Where PX4 cannot hold a term of a drift, the other terms of that axis are fitted again (:func:`held_drift`). They
    are then no estimates of the true ones, and are left out. The plan announces the cost.
    """
    if fit.model.polynomial is not None:
        altered = {axis for axis, _ in held_drift(fit).fixed} if autopilot == "px4" else set()
        return tuple(name for name in fit.names[12:] if name[-1] not in altered)
    if fit.sensor == Sensor.GYRO:
        return OFFSETS
    return OFFSETS + (SYMMETRIC if fit.sensor == Sensor.MAG else DIAGONAL)


def judge(
    truth: Json, fits: Sequence[FitResult], before: Mapping[str, float], after: Mapping[str, float]
) -> DemoJudgement:
    """Compare the calibration in force `before` and `after` (parameter values of the vehicle) with the truth."""
    autopilot = str(truth["autopilot"])
    reports = []
    for fit in fits:
        true = true_model(truth, fit.sensor, fit.instance)
        old = calibration_in_force(autopilot, before, fit.sensor, fit.instance)
        new = calibration_in_force(autopilot, after, fit.sensor, fit.instance)
        names = held(fit, autopilot)
        reports.append(
            SensorReport(
                fit.sensor,
                fit.instance,
                before=_largest_error(old, true, fit, truth),
                after=_largest_error(new, true, fit, truth),
                cross=_cost_of_form(true, fit, truth),
                unit=fit.unit,
                score=score(new, fit, true, names),
                drift=fit.model.polynomial is not None,
            )
        )
    return DemoJudgement(tuple(reports))


def _largest_error(held_model: TriadModel, true: TriadModel, fit: FitResult, truth: Json) -> float:
    """Largest error of the vehicle's calibration, over directions, and over temperature for a thermal fit.

    A rotation that is common to all directions is levelling, not calibration: both are compared in symmetric form.
    """
    directions = _magnitude(fit.sensor, truth) * _sphere()
    canonical = TriadModel(true.offset, true.symmetric().matrix, true.polynomial)
    believed = TriadModel(held_model.offset, held_model.symmetric().matrix, held_model.polynomial)
    polynomial = fit.model.polynomial
    if polynomial is None:
        t = fit.temperature if fit.temperature is not None else float(truth["t_ref"])
        errors = believed.apply(canonical.invert(directions, t), t) - directions
        return float(np.linalg.norm(errors, axis=1).max())
    temperatures = np.linspace(polynomial.t_min, polynomial.t_max, 41)
    drift = np.array([believed.apply(canonical.invert(np.zeros(3), t), t) for t in temperatures])
    return float(np.linalg.norm(drift - drift.mean(axis=0), axis=1).max())


def _cost_of_form(true: TriadModel, fit: FitResult, truth: Json) -> float:
    """Largest error that remains because the firmware cannot hold every term, over directions or temperatures."""
    if fit.model.polynomial is not None:
        return held_drift(fit).cost if truth["autopilot"] == "px4" else 0.0
    if fit.sensor != Sensor.ACCEL:
        return 0.0
    symmetric = true.symmetric().matrix
    cross = symmetric - np.diag(np.diag(symmetric))
    return float(np.abs(np.linalg.eigvalsh(cross)).max()) * _magnitude(fit.sensor, truth)


def _magnitude(sensor: Sensor, truth: Json) -> float:
    if sensor == Sensor.ACCEL:
        return STANDARD_GRAVITY
    return float(np.linalg.norm(truth["field_ned_ut"])) if sensor == Sensor.MAG else 0.0


def _sphere() -> np.ndarray[Any, np.dtype[np.float64]]:
    """Directions spread evenly (a Fibonacci lattice)."""
    k = np.arange(200) + 0.5
    z, longitude = 1 - 2 * k / 200, np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - z * z)
    return np.column_stack([r * np.cos(longitude), r * np.sin(longitude), z])
