"""Ferraris, Grimaldi and Parvis (1995): six faces and three whole turns, by their equations.

What imucal computes, here from segments of a recording. The equations' bias is the mean of each axis' own pair of
faces, the gyroscope's scale the integral of one turn about each axis.
"""

from __future__ import annotations

import numpy as np

from mavcal.calib.recording import Recording, Sensor

GRAVITY = 9.81
TURN = -360.0  # deg: clockwise seen along the axis that points up


def ferraris(recording: Recording, rate: float) -> dict[str, np.ndarray]:
    """Scale ``K``, orthogonality ``R``, bias ``b`` of accelerometer (a) and gyroscope (g, deg/s), and ``K_ga``.

    `recording` has the segments ``x_p x_a y_p y_a z_p z_a`` (that axis up, down) and ``x_rot y_rot z_rot``.
    """
    accel = _sections(recording, Sensor.ACCEL)
    gyro = {name: np.degrees(values) for name, values in _sections(recording, Sensor.GYRO).items()}
    up, down = _means(accel, "p"), _means(accel, "a")
    b_a = np.diag(up + down) / 2.0
    K_a, R_a = _polar((up - down) / (2.0 * GRAVITY))
    b_g = np.concatenate([gyro[f"{axis}_{side}"] for axis in "xyz" for side in "pa"]).mean(axis=0)
    K_ga = (_means(gyro, "p") - _means(gyro, "a")) / (2.0 * GRAVITY)
    angles = np.zeros((3, 3))
    for k, axis in enumerate("xyz"):
        force = (accel[f"{axis}_rot"] - b_a) @ np.linalg.inv(K_a @ R_a).T
        angles[:, k] = (gyro[f"{axis}_rot"] - force @ K_ga.T - b_g).sum(axis=0) / rate
    K_g, R_g = _polar(angles / TURN)
    return {"K_a": K_a, "R_a": R_a, "b_a": b_a, "K_g": K_g, "R_g": R_g, "K_ga": K_ga, "b_g": b_g}


def _sections(recording: Recording, sensor: Sensor) -> dict[str, np.ndarray]:
    channel = recording.channel(sensor)
    spans = {s.label: channel.between(s.start - 1e-6, s.end - 1e-6) for s in recording.segments}
    return {label: span.values for label, span in spans.items()}


def _means(sections: dict[str, np.ndarray], side: str) -> np.ndarray:
    return np.column_stack([sections[f"{axis}_{side}"].mean(axis=0) for axis in "xyz"])


def _polar(sensitivity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lengths of the rows on a diagonal, and the rows of length one."""
    K = np.diag(np.linalg.norm(sensitivity, axis=1))
    return K, np.linalg.inv(K) @ sensitivity
