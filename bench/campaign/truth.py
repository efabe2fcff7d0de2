"""What is true of a simulated vehicle, by its own word: the service is not asked and its formulas are not used."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mavcal.service.simvehicle import SimulatedVehicle

Json = Mapping[str, Any]
AXES = ("X", "Y", "Z")
G = 9.80665

OWN_COUNTERS = ("STAT_",)
"""Parameters that the vehicle changes by itself all the time."""
UT_PER = {"ardupilot": 0.1, "px4": 100.0}
"""Microtesla per unit of a compass offset: milligauss, gauss."""


@dataclass(frozen=True)
class Holding:
    """The parameters of a vehicle at one instant."""

    stored: Mapping[str, float]
    """What a read would give."""
    in_force: Mapping[str, float]
    """What its corrections really use."""

    def differing(self, other: Holding) -> dict[str, tuple[float, float]]:
        """Stored values (here, there) that differ, without the vehicle's own counters."""
        return {
            name: (value, other.stored[name])
            for name, value in self.stored.items()
            if not equal(value, other.stored[name]) and not name.startswith(OWN_COUNTERS)
        }


def holding(vehicle: SimulatedVehicle) -> Holding:
    """The parameters now. Raises ControlError if the vehicle has gone."""
    in_force, stored = vehicle.parameters()
    return Holding({k: float(v) for k, v in stored.items()}, {k: float(v) for k, v in in_force.items()})


def equal(a: float, b: float) -> bool:
    """Whether two values are one on the wire."""
    return bool(np.float32(a) == np.float32(b))


@dataclass(frozen=True)
class Residual:
    """What is left of a sensor's errors, against what the job was asked for; same unit."""

    sensor: str
    instance: int
    worst: float
    bound: float

    @property
    def good(self) -> bool:
        """Whether the sensor is as good as asked for."""
        return self.worst <= self.bound


def residuals(
    truth: Json, in_force: Mapping[str, float], job: str, options: Json, instances: Iterable[int]
) -> tuple[Residual, ...]:
    """The true residual error of `instances` of the job's sensor, as the autopilot corrects them now.

    `bound` is 4.5 times the standard deviation that the job was asked to reach.
    """
    autopilot = str(truth["autopilot"])
    found = []
    for instance in instances:
        entry = truth[f"{job}s"][instance]
        matrix, offset = _correction(autopilot, in_force, job, instance, int(entry["id"]))
        body = autopilot == "ardupilot" and job == "mag"
        true_matrix = np.array(entry["body_matrix" if body else "matrix"])
        true_offset = np.array(entry["body_offset" if body else "offset"])
        left = matrix @ (true_offset - offset)
        errors = [float(np.abs(left).max())]
        if job != "gyro":  # no autopilot holds a gyro's scale
            errors.append(_scale_error(matrix @ true_matrix, job) * _magnitude(truth, job))
        found.append(Residual(job, instance, max(errors), 4.5 * _asked(truth, job, float(options["uncertainty"]))))
    return tuple(found)


def true_px4_gyro(truth: Json, stored: Mapping[str, float]) -> dict[str, float]:
    """The offsets that would leave the gyro of PX4's first slot without any, by their parameters' names; x first."""
    (gyro,) = [entry for entry in truth["gyros"] if int(entry["id"]) == int(stored["CAL_GYRO0_ID"])]
    return {f"CAL_GYRO0_{axis}OFF": float(value) for axis, value in zip("XYZ", gyro["offset"], strict=True)}


def _asked(truth: Json, job: str, uncertainty: float) -> float:
    if job == "gyro":
        return math.radians(uncertainty)
    if job == "accel":
        return uncertainty
    north, east, _ = truth["field_ned_ut"]
    return math.radians(uncertainty) * math.hypot(north, east)  # of the heading, in microtesla


def _magnitude(truth: Json, job: str) -> float:
    return G if job == "accel" else float(np.linalg.norm(truth["field_ned_ut"]))


def _scale_error(product: np.ndarray, job: str) -> float:
    """Largest departure of correction · sensor from a rotation; the accelerometer's cross terms cannot be held."""
    _, singular, vt = np.linalg.svd(product)
    symmetric = vt.T @ np.diag(singular) @ vt - np.eye(3)
    return float(np.abs(np.diag(symmetric) if job == "accel" else symmetric).max())


def _correction(
    autopilot: str, p: Mapping[str, float], job: str, instance: int, device: int
) -> tuple[np.ndarray, np.ndarray]:
    """Matrix and offset of corrected = matrix · (raw − offset), SI and microtesla."""
    if autopilot == "ardupilot":
        return _ardupilot(p, job, instance)
    kind = {"gyro": "GYRO", "accel": "ACC", "mag": "MAG"}[job]
    slot = next(s for s in range(4) if int(p[f"CAL_{kind}{s}_ID"]) == device)
    row = {what: np.array([p.get(f"CAL_{kind}{slot}_{a}{what}", d) for a in AXES]) for what, d in _PX4.items()}
    if job == "mag":
        return _symmetric(row["SCALE"], row["ODIAG"]), row["OFF"] * UT_PER[autopilot]
    return np.diag(row["SCALE"]), row["OFF"]


_PX4 = {"OFF": 0.0, "SCALE": 1.0, "ODIAG": 0.0}


def _ardupilot(p: Mapping[str, float], job: str, instance: int) -> tuple[np.ndarray, np.ndarray]:
    n = "" if instance == 0 else str(instance + 1)

    def vector(base: str) -> np.ndarray:
        return np.array([p[f"{base}_{a}"] for a in AXES])

    if job == "gyro":
        return np.eye(3), vector(f"INS_GYR{n}OFFS")
    if job == "accel":
        return np.diag(vector(f"INS_ACC{n}SCAL")), vector(f"INS_ACC{n}OFFS")
    scale = p[f"COMPASS_SCALE{n}"]
    scale = scale if 1 / 1.5 <= scale <= 1.5 else 1.0
    shape = _symmetric(vector(f"COMPASS_DIA{n}"), vector(f"COMPASS_ODI{n}"))
    return shape * scale, -vector(f"COMPASS_OFS{n}") * UT_PER["ardupilot"]


def _symmetric(diagonal: np.ndarray, off: np.ndarray) -> np.ndarray:
    x, y, z = off
    return np.array([[diagonal[0], x, y], [x, diagonal[1], z], [y, z, diagonal[2]]])
