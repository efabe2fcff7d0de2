"""Accelerometers and gyroscopes turned by hand, and one on a fixture."""

from __future__ import annotations

import numpy as np

from bench.realdata import recordings
from bench.realdata.ferraris import GRAVITY, ferraris
from bench.realdata.finding import Finding, compared, said, with_sd
from mavcal.calib.fit import FitResult
from mavcal.calib.methods import METHODS

_CERTIFICATE = "the certificate's last digit, and its gravity"
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


def _xsens() -> list[Finding]:
    name, recording = "imu_tk_xsens", recordings.xsens()
    found = []
    (fit,) = METHODS["accel-multi"].run(recording, {"gravity": _PADUA, "form": "upper"})
    joint, gyro = METHODS["imu-multi"].run(recording, {"gravity": _PADUA, "form": "upper"})
    for method, accel in (("accel-multi", fit), ("imu-multi", joint)):
        counts, sd = _counts(accel)
        found += [
            compared(
                name,
                method,
                "accel scale, counts per m/s2",
                (415, 413, 415),
                counts,
                sd,
                within=0.0025 * 414,
                because="known to 0.25 %",
            ),
            compared(
                name,
                method,
                "accel offset, counts",
                (33123, 33276, 32360),
                accel.model.offset,
                accel.sd[:3],
                within=5,
                because="5 counts (0.012 m/s2) may be the age of the certificate",
            ),
        ]
    C, sd = joint.model.matrix, joint.sd[3:12].reshape(3, 3)
    cross = [C[0, 1] / C[1, 1], C[0, 2] / C[2, 2], C[1, 2] / C[2, 2]]
    cross_sd = [sd[0, 1] / C[1, 1], sd[0, 2] / C[2, 2], sd[1, 2] / C[2, 2]]
    rms = float(joint.quality["norm_rms"])
    counts, counts_sd = _counts(gyro)
    return [
        *found,
        compared(
            name,
            "imu-multi",
            "accel misalignment xy, xz, yz, rad",
            (-0.0034, -0.0092, -0.0214),
            cross,
            cross_sd,
            within=0.0005,
            because="known to half a milliradian",
        ),
        said(name, "imu-multi", "rms of the length of gravity, m/s2", "0.0010", f"{rms:.4f}", agrees=rms < 0.0012),
        compared(
            name,
            "imu-multi",
            "gyro scale, counts per rad/s",
            (4778, 4758, 4766),
            counts,
            counts_sd,
            within=0.003 * 4766,
            because=f"0.3 %; {_CERTIFICATE}",
        ),
        compared(
            name,
            "imu-multi",
            "gyro offset, counts",
            (32768, 32466, 32485),
            gyro.model.offset,
            gyro.sd[:3],
            within=50,
            because="50 counts (0.6 deg/s): a gyro's offset moves between days",
        ),
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
        joint, gyro = METHODS["imu-multi"].run(recording, {"form": "upper"})
        for method, accel in (("accel-multi", alone), ("imu-multi", joint)):
            ours, sd = _diagonal(accel)
            found += [
                compared(name, method, "accel scale", scale, ours, sd, within=5e-4, because="known to its last digits"),
                compared(
                    name,
                    method,
                    "accel offset, m/s2",
                    bias,
                    accel.model.offset,
                    accel.sd[:3],
                    within=2e-3,
                    because="known to its last digits",
                ),
            ]
        ours, sd = _diagonal(gyro)
        degrees = np.degrees(gyro.model.offset)
        found += [
            compared(
                name,
                "imu-multi",
                "gyro offset, deg/s",
                rate,
                degrees,
                np.degrees(gyro.sd[:3]),
                within=0.015,
                because="known to 0.01, and it drifts",
            ),
            compared(
                name,
                "imu-multi",
                "gyro scale (known: 0.992 to 1.0025, to 0.3 %)",
                np.full(3, 0.99725),
                ours,
                sd,
                within=0.00525 + 0.003,
                because="the range that is known",
            ),
        ]
    return found


def _cuyo() -> list[Finding]:
    name = "cuyo_mpu6050"
    accel_answer, gyro_answer = recordings.cuyo_answers("params_acc"), recordings.cuyo_answers("params_gyro")
    accel, gyro = METHODS["imu-multi"].run(recordings.cuyo(), {"form": "upper"})
    scale, sd = _diagonal(accel)
    gyro_scale, gyro_sd = _diagonal(gyro)
    open_accel = [n for n in _CROSS if n in accel.undetermined]
    open_gyro = [n for n in _CROSS if n in gyro.undetermined]
    by_percent = "known to 0.1 %"
    return [
        compared(
            name,
            "imu-multi",
            "accel scale, 1e-4 m/s2 per count",
            1e4 * accel_answer[3:6],
            1e4 * scale,
            1e4 * sd,
            within=1e-3 * 6.0,
            because=by_percent,
        ),
        compared(
            name,
            "imu-multi",
            "accel offset, counts",
            -accel_answer[6:9],
            accel.model.offset,
            accel.sd[:3],
            within=1e-3 * 16_400,
            because=f"{by_percent} of g",
        ),
        said(
            name,
            "imu-multi",
            "accel misalignment",
            "not observable from ten positions",
            f"{accel.status.value}; undetermined: {', '.join(open_accel) or 'nothing'}",
            agrees=bool(open_accel),
        ),
        compared(
            name,
            "imu-multi",
            "gyro offset, counts",
            gyro_answer[9:12],
            gyro.model.offset,
            gyro.sd[:3],
            within=2,
            because="two counts",
        ),
        compared(
            name,
            "imu-multi",
            "gyro scale, 1e-4 rad/s per count",
            1e4 * gyro_answer[6:9],
            1e4 * gyro_scale,
            1e4 * gyro_sd,
            within=0.005 * 1.33,
            because="0.5 %",
        ),
        said(
            name,
            "imu-multi",
            "gyro misalignment",
            "not observable from ten positions",
            f"{gyro.status.value}; undetermined: {', '.join(open_gyro) or 'nothing'}",
            agrees=bool(open_gyro),
        ),
    ]


def _ferraris() -> list[Finding]:
    name, recording, answer = "imucal_ferraris", recordings.ferraris(), recordings.ferraris_answer()
    same = ferraris(recording, recordings.FERRARIS_RATE)
    apart = max(float(np.abs(same[key] - value).max()) for key, value in answer.items())
    faces = {f"{axis}_{side}": f"{axis}_{word}" for axis in "xyz" for side, word in (("p", "up"), ("a", "down"))}
    (fit,) = METHODS["accel-six-face"].run(recordings.labelled(recording, faces), {"gravity": GRAVITY})
    scale = np.linalg.norm(np.linalg.inv(fit.model.matrix), axis=1)
    (gyro,) = METHODS["gyro-g-sensitivity"].run(recordings.labelled(recording, faces), {"gravity": GRAVITY})
    K, K_sd = (1e3 * np.degrees(np.array(gyro.native[key])).ravel() for key in ("K", "K_sd"))
    return [
        said(
            name,
            "ferraris",
            "all 45 numbers of imucal's own method",
            "imucal 2",
            f"apart by at most {apart:.0e}",
            agrees=apart < 1e-9,
        ),
        compared(
            name,
            "accel-six-face",
            "accel scale (imucal's K_a)",
            np.diag(answer["K_a"]),
            scale,
            np.diag(fit.sd[3:12].reshape(3, 3)),
            within=1e-4,
            because="both regress the same face means",
        ),
        said(
            name,
            "accel-six-face",
            "accel offset, m/s2",
            with_sd(answer["b_a"], 0.0),
            f"{with_sd(fit.model.offset, fit.sd[:3])}: from all six faces, imucal's from each axis' own pair",
            agrees=bool((np.abs(fit.model.offset - answer["b_a"]) < 2.5 * fit.sd[:3]).all()),
        ),
        compared(
            name,
            "gyro-g-sensitivity",
            "K_ga by rows, 1e-3 deg/s per m/s2",
            1e3 * answer["K_ga"].ravel(),
            K,
            K_sd,
            within=0.0,
            because="our own sd alone: none is three sd from zero",
        ),
        compared(
            name,
            "gyro-g-sensitivity",
            "gyro offset, deg/s",
            answer["b_g"],
            np.degrees(gyro.model.offset),
            np.degrees(gyro.sd[:3]),
            within=0.0,
            because="our own sd alone",
        ),
        said(
            name,
            "accel-six-face",
            "do six faces fit one sensor?",
            "imucal does not say",
            f"no: {fit.residual_rms:.3f} m/s2 rms, {len(fit.warnings)} warning: the faces are not square to 0.1 deg",
            agrees=None,
        ),
    ]
