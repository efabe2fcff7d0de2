"""Accelerometers and gyroscopes turned by hand, and one on a fixture."""

from __future__ import annotations

import numpy as np

from mavcal.calib.fit import FitResult
from mavcal.calib.methods import METHODS
from tests.unit.real import recordings
from tests.unit.real.ferraris import GRAVITY, ferraris
from tests.unit.real.finding import Compared, Finding

_PADUA = 9.81744  # m/s2, where imu_tk's recording was made
_CROSS = ("matrix_xy", "matrix_xz", "matrix_yx", "matrix_yz", "matrix_zx", "matrix_zy")


def findings() -> list[Finding]:
    """All of them."""
    return [*_xsens(), *_mikoff(), *_cuyo(), *_ferraris()]


def _diagonal(fit: FitResult) -> tuple[np.ndarray, np.ndarray]:
    return np.diag(fit.model.matrix), np.diag(fit.sd[3:12].reshape(3, 3))


def _counts(fit: FitResult) -> tuple[np.ndarray, np.ndarray]:
    """Counts per unit and their sd, from a correction matrix in units per count."""
    scale, sd = _diagonal(fit)
    return 1.0 / scale, sd / scale**2


def _offset(fit: FitResult) -> tuple[np.ndarray, np.ndarray]:
    return fit.model.offset, fit.sd[:3]


def _xsens() -> list[Finding]:
    recording, options = recordings.xsens(), {"gravity": _PADUA, "form": "upper"}
    alone, joint = Compared("imu_tk_xsens", "accel-multi"), Compared("imu_tk_xsens", "imu-multi")
    (fit,) = METHODS["accel-multi"].run(recording, options)
    accel, gyro = METHODS["imu-multi"].run(recording, options)
    found = []
    for by, one in ((alone, fit), (joint, accel)):
        aged = "5 counts (0.012 m/s2) may be the age of the certificate"
        known = (33123, 33276, 32360)
        found.append(
            by.number("accel scale, counts per m/s2", (415, 413, 415), *_counts(one), 0.0025 * 414, "known to 0.25 %")
        )
        found.append(by.number("accel offset, counts", known, *_offset(one), 5, aged))
    C, sd = accel.model.matrix, accel.sd[3:12].reshape(3, 3)
    upper = ((0, 1), (0, 2), (1, 2))
    cross, cross_sd = ([M[i, j] / C[j, j] for i, j in upper] for M in (C, sd))
    rms = float(accel.quality["norm_rms"])
    known = (-0.0034, -0.0092, -0.0214)
    days = "50 counts (0.6 deg/s): a gyro's offset moves between days"
    return [
        *found,
        joint.number("accel misalignment xy, xz, yz, rad", known, cross, cross_sd, 0.0005, "half a milliradian"),
        joint.word("rms of the length of gravity, m/s2", "0.0010", f"{rms:.4f}", agrees=rms < 0.0012),
        joint.number("gyro scale, counts per rad/s", (4778, 4758, 4766), *_counts(gyro), 0.003 * 4766, "0.3 %"),
        joint.number("gyro offset, counts", (32768, 32466, 32485), *_offset(gyro), 50, days),
    ]


def _mikoff() -> list[Finding]:
    known = {
        0: ((0.9961, 0.9966, 0.9934), (0.103, 0.097, 0.344), (1.12, -0.38, 1.22)),
        1: ((0.9951, 0.9950, 0.9904), (0.090, 0.070, 0.338), (-0.60, 1.10, 0.32)),
    }
    found = []
    for unit, (scale, bias, rate) in known.items():
        name, recording = f"mikoff_mpu9150x5 imu{unit}", recordings.mikoff(unit)
        (alone,) = METHODS["accel-multi"].run(recording, {"form": "upper"})
        accel, gyro = METHODS["imu-multi"].run(recording, {"form": "upper"})
        joint, digits = Compared(name, "imu-multi"), "known to its last digits"
        for by, one in ((Compared(name, "accel-multi"), alone), (joint, accel)):
            found.append(by.number("accel scale", scale, *_diagonal(one), 5e-4, digits))
            found.append(by.number("accel offset, m/s2", bias, *_offset(one), 2e-3, digits))
        degrees = (np.degrees(value) for value in _offset(gyro))
        found.append(joint.number("gyro offset, deg/s", rate, *degrees, 0.015, "known to 0.01, and it drifts"))
        what = "gyro scale (known: 0.992 to 1.0025, to 0.3 %)"
        found.append(joint.number(what, 0.99725, *_diagonal(gyro), 0.00525 + 0.003, "the range that is known"))
    return found


def _cuyo() -> list[Finding]:
    of, lost = Compared("cuyo_mpu6050", "imu-multi"), "not observable from ten positions"
    known, known_gyro = recordings.cuyo_answers("params_acc"), recordings.cuyo_answers("params_gyro")
    accel, gyro = METHODS["imu-multi"].run(recordings.cuyo(), {"form": "upper"})
    scale, sd = (1e4 * value for value in _diagonal(accel))
    gyro_scale, gyro_sd = (1e4 * value for value in _diagonal(gyro))
    found = [
        of.number("accel scale, 1e-4 m/s2 per count", 1e4 * known[3:6], scale, sd, 6e-3, "known to 0.1 %"),
        of.number("accel offset, counts", -known[6:9], *_offset(accel), 16.4, "known to 0.1 % of g"),
        of.number("gyro offset, counts", known_gyro[9:12], *_offset(gyro), 2, "two counts"),
        of.number(
            "gyro scale, 1e-4 rad/s per count", 1e4 * known_gyro[6:9], gyro_scale, gyro_sd, 0.005 * 1.33, "0.5 %"
        ),
    ]
    for fit in (accel, gyro):
        left = [n for n in _CROSS if n in fit.undetermined]
        said = f"{fit.status.value}; undetermined: {', '.join(left) or 'nothing'}"
        found.append(of.word(f"{fit.sensor.value} misalignment", lost, said, agrees=bool(left)))
    return found


def _ferraris() -> list[Finding]:
    name, recording, answer = "imucal_ferraris", recordings.ferraris(), recordings.ferraris_answer()
    same = ferraris(recording, recordings.FERRARIS_RATE)
    apart = max(float(np.abs(same[key] - value).max()) for key, value in answer.items())
    faces = {f"{axis}_{side}": f"{axis}_{word}" for axis in "xyz" for side, word in (("p", "up"), ("a", "down"))}
    labelled = recordings.labelled(recording, faces)
    (fit,) = METHODS["accel-six-face"].run(labelled, {"gravity": GRAVITY})
    (gyro,) = METHODS["gyro-g-sensitivity"].run(labelled, {"gravity": GRAVITY})
    scale, scale_sd = np.linalg.norm(np.linalg.inv(fit.model.matrix), axis=1), _diagonal(fit)[1]
    K = [1e3 * np.degrees(np.array(gyro.native[key])).ravel() for key in ("K", "K_sd")]
    offset = (np.degrees(value) for value in _offset(gyro))
    faced, turned = Compared(name, "accel-six-face"), Compared(name, "gyro-g-sensitivity")
    means, ours = "both regress the same face means", "our own sd alone"
    own = 0.5 * fit.sd[:3]  # with twice the sd: 2.5 of them
    pairs = "imucal's are from each axis' own pair of faces"
    return [
        Compared(name, "ferraris").word(
            "all 45 numbers of imucal's own method", "imucal 2", f"apart by at most {apart:.0e}", agrees=apart < 1e-9
        ),
        faced.number("accel scale (imucal's K_a)", np.diag(answer["K_a"]), scale, scale_sd, 1e-4, means),
        faced.number("accel offset, m/s2", answer["b_a"], *_offset(fit), own, pairs),
        turned.number("K_ga by rows, 1e-3 deg/s per m/s2", 1e3 * answer["K_ga"].ravel(), *K, 0.0, ours),
        turned.number("gyro offset, deg/s", answer["b_g"], *offset, 0.0, ours),
    ]
