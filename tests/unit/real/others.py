"""Magnetometers in counts, drift with temperature, and noise over hours."""

from __future__ import annotations

import numpy as np

from mavcal.calib.fit import FitResult
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Sensor
from tests.unit.real import recordings
from tests.unit.real.finding import Compared, Finding
from tests.unit.thermal.judged import judge_drift

_CENTRES = {  # published; found by orthogonal distance
    "filtered": ((6195.1, 252.1, 3477.5), (6194.2, 248.6, 3479.8)),
    "noisy": ((6158.6, 252.7, 3445.6), (6155.0, 257.1, 3444.8)),
}
_SWEEPS = ("P0_z", "P1_x")
_CATS = {  # slopes on either sweep: m/s2 or mrad/s per degC
    (Sensor.ACCEL, 1): (-0.0210, -0.0227),
    (Sensor.ACCEL, 2): (0.0239, 0.0244),
    (Sensor.GYRO, 1): (0.466, 0.449),
    (Sensor.GYRO, 2): (0.120, 0.135),
}


def findings() -> list[Finding]:
    """All of them."""
    return [*_magnetometers(), *_ntars(), *_cats(), *_allan()]


def _magnetometers() -> list[Finding]:
    found = []
    for kind, (published, distance) in _CENTRES.items():
        of = Compared(f"mag_cuyo_qmc5883l {kind}", "mag-ellipsoid")
        (fit,) = METHODS["mag-ellipsoid"].run(recordings.cuyo_magnetometer(kind), {})
        rms, misfit = {"filtered": 28, "noisy": 58}[kind], "a misfit of the model, not noise"
        for how, known in (("as published", published), ("by orthogonal distance", distance)):
            where = (fit.model.offset, fit.sd[:3])
            found.append(of.number(f"centre, counts, {how}", known, *where, 8, "8 counts are 0.7 % of the field"))
        found.append(of.number("ratio of the axes", 2.23, _ratio(fit), 0.0, 0.02, "1 %"))
        found.append(of.number("residual rms, counts", rms, fit.residual_rms, 0.0, 1, misfit))
    of = Compared("mag_ellipsoid_fit_python", "mag-ellipsoid")
    (fit,) = METHODS["mag-ellipsoid"].run(recordings.ellipsoid_fit(), {})
    centre, means = (-68.15, 82.77, -133.50), "geometric or arithmetic mean"
    return [
        *found,
        of.number("centre, counts", centre, fit.model.offset, fit.sd[:3], 0.01, "our own sd alone"),
        of.number("mean radius, counts", 173.8, fit.native["expmfs"], 0.0, 0.2, means),
        of.number("ratio of the axes", 1.150, _ratio(fit), 0.0, 0.003, "its sd"),
    ]


def _ratio(fit: FitResult) -> float:
    axes = np.linalg.eigvalsh(fit.model.matrix)
    return float(axes[-1] / axes[0])


def _slope(fit: FitResult, axis: int) -> tuple[float, float]:
    """Slope and sd of one axis; nan where it is declined."""
    name = f"poly1_{'xyz'[axis]}"
    if fit.model.polynomial is None or name in fit.undetermined:
        return np.nan, np.nan
    return float(fit.model.polynomial.coefficients[axis, 0]), float(fit.sd[fit.names.index(name)])


def _ntars() -> list[Finding]:
    of = Compared("ntars", "thermal-linear")
    fits = {fit.sensor: fit for fit in METHODS["thermal-linear"].run(recordings.ntars(), {})}
    accel, gyro = fits[Sensor.ACCEL], fits[Sensor.GYRO]
    slopes, rates = ([_slope(fit, k)[0] for k in range(n)] for fit, n in ((accel, 3), (gyro, 2)))
    repeated = [w for w in accel.warnings if "repeat" in w]
    declined, digits = "poly1_z" in gyro.undetermined, "the digits of the specification"
    noticed = repeated[0] if repeated else "not noticed"
    return [
        of.number("accel slope, counts per degC", (6.79942, 9.19042, 3.15345), slopes, 0.0, 1e-5, digits),
        of.number("gyro slope x, y, counts per degC", (0.87682, 0.46056), rates, 0.0, 1e-5, digits),
        of.word("gyro z", "0: it reads one value throughout", "declined" if declined else "fitted", agrees=declined),
        of.word("rows 26 to 49 repeat rows 2 to 25", "to be noticed", noticed, agrees=bool(repeated)),
    ]


def _cats() -> list[Finding]:
    read = {sweep: recordings.cats(sweep) for sweep in _SWEEPS}
    linear, poly = (
        {s: {f.sensor: f for f in METHODS[method].run(r, options)} for s, r in read.items()}
        for method, options in (("thermal-linear", {}), ("thermal-poly", {"degree": 1}))
    )
    by_line, by_poly = Compared("temp_cats_imu", "thermal-linear"), Compared("temp_cats_imu", "thermal-poly")
    first, second = _SWEEPS
    found = []
    for (sensor, axis), known in _CATS.items():
        factor, unit = (1e3, "mrad/s") if sensor == Sensor.GYRO else (1.0, "m/s2")
        ours = factor * np.array([_slope(linear[sweep][sensor], axis) for sweep in _SWEEPS])
        what, within = f"{sensor.value} {'xyz'[axis]}, {unit} per degC, on both sweeps", 0.02 * np.abs(known)
        found.append(by_line.number(what, known, ours[:, 0], ours[:, 1], within, "2 %, the same rows"))
        channel, temperature = read[second].channel(sensor), read[second].channel(Sensor.TEMPERATURE)
        at = np.interp(channel.t, temperature.t, temperature.values[:, 0])
        judged = judge_drift(poly[first][sensor], channel, at)
        before, after = factor * judged.before[axis], factor * judged.after[axis]
        what = f"{sensor.value} {'xyz'[axis]}: fitted on {first}, judged on {second}, rms of block means, {unit}"
        said = f"{before:.3g} before, {after:.3g} after"
        found.append(by_poly.word(what, "the drift repeats", said, agrees=bool(after < before)))
    declined = [s for s in _SWEEPS if np.isnan(_slope(poly[s][Sensor.GYRO], 0)[0])]
    said = f"declined on {' and '.join(declined) or 'neither'}"
    known = "not repeatable: to be declined"
    return [*found, by_poly.word("gyro x", known, said, agrees=len(declined) == len(_SWEEPS))]


def _allan() -> list[Finding]:
    found = []
    for fit in METHODS["allan"].run(recordings.galaxy(), {}):
        begins = [span[0] for span in fit.native["holds"]["N"] if span is not None]
        what = f"{fit.sensor.value}: where the slope of white noise begins"
        said = f"{', '.join(f'{b:g}' for b in begins)} s, low-pass said"
        right = all(fit.native["low_pass"]) and all(5.0 <= b <= 30.0 for b in begins)
        found.append(
            Compared("allan_galaxy_s5", "allan").word(what, "about 10 s: the phone low-passes", said, agrees=right)
        )
    return found
