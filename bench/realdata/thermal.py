"""Drift with temperature, and noise over hours."""

from __future__ import annotations

import numpy as np

from bench.realdata import recordings
from bench.realdata.finding import Finding, compared, said, with_sd
from mavcal.calib.fit import FitResult
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Recording, Sensor
from mavcal.calib.thermal.sweeps import judge_drift

_SWEEPS = ("P0_z", "P1_x")
_CATS = {  # slopes on either sweep: m/s2 or mrad/s per degC
    (Sensor.ACCEL, 1): (-0.0210, -0.0227),
    (Sensor.ACCEL, 2): (0.0239, 0.0244),
    (Sensor.GYRO, 1): (0.466, 0.449),
    (Sensor.GYRO, 2): (0.120, 0.135),
}


def findings() -> list[Finding]:
    """All of them."""
    return [*_ntars(), *_cats(), *_allan()]


def _slope(fit: FitResult, axis: int) -> tuple[float, float]:
    """Slope and sd of one axis; nan where it is declined."""
    name = f"poly1_{'xyz'[axis]}"
    if fit.model.polynomial is None or name in fit.undetermined:
        return np.nan, np.nan
    return float(fit.model.polynomial.coefficients[axis, 0]), float(fit.sd[fit.names.index(name)])


def _ntars() -> list[Finding]:
    name = "ntars"
    fits = {fit.sensor: fit for fit in METHODS["thermal-linear"].run(recordings.ntars(), {})}
    accel, gyro = fits[Sensor.ACCEL], fits[Sensor.GYRO]
    slopes = [_slope(accel, k) for k in range(3)]
    rates = [_slope(gyro, k) for k in range(2)]
    repeated = [w for w in accel.warnings if "repeat" in w]
    return [
        compared(
            name,
            "thermal-linear",
            "accel slope, counts per degC",
            (6.79942, 9.19042, 3.15345),
            [s[0] for s in slopes],
            0.0,
            within=1e-5,
            because="the digits of the specification",
        ),
        compared(
            name,
            "thermal-linear",
            "gyro slope x, y, counts per degC",
            (0.87682, 0.46056),
            [s[0] for s in rates],
            0.0,
            within=1e-5,
            because="the digits of the specification",
        ),
        said(
            name,
            "thermal-linear",
            "sd of those slopes",
            "not stated",
            ", ".join(f"{s[1]:.2g}" for s in [*slopes, *rates]),
            agrees=None,
        ),
        said(
            name,
            "thermal-linear",
            "gyro z",
            "0: it reads one value throughout",
            "declined" if "poly1_z" in gyro.undetermined else "not declined",
            agrees="poly1_z" in gyro.undetermined,
        ),
        said(
            name,
            "thermal-linear",
            "rows 26 to 49 repeat rows 2 to 25",
            "to be noticed",
            repeated[0] if repeated else "not noticed",
            agrees=bool(repeated),
        ),
    ]


def _cats() -> list[Finding]:
    recordings_of = {sweep: recordings.cats(sweep) for sweep in _SWEEPS}
    linear, poly = (
        {s: {f.sensor: f for f in METHODS[method].run(r, options)} for s, r in recordings_of.items()}
        for method, options in (("thermal-linear", {}), ("thermal-poly", {"degree": 1}))
    )
    found = []
    for (sensor, axis), known in _CATS.items():
        factor = 1e3 if sensor == Sensor.GYRO else 1.0
        unit = "mrad/s" if sensor == Sensor.GYRO else "m/s2"
        ours = factor * np.array([_slope(linear[sweep][sensor], axis) for sweep in _SWEEPS])
        found.append(
            compared(
                "temp_cats_imu",
                "thermal-linear",
                f"{sensor.value} {'xyz'[axis]}, {unit} per degC, sweeps {' and '.join(_SWEEPS)}",
                known,
                ours[:, 0],
                ours[:, 1],
                within=0.02 * np.abs(known),
                because="2 %, the same rows",
            )
        )
    declined = [s for s in _SWEEPS if np.isnan(_slope(poly[s][Sensor.GYRO], 0)[0])]
    return [
        *found,
        *_judged(recordings_of, poly),
        said(
            "temp_cats_imu",
            "thermal-poly",
            "gyro x",
            "not repeatable: to be declined",
            f"declined on {' and '.join(declined) or 'neither'}",
            agrees=len(declined) == len(_SWEEPS),
        ),
    ]


def _judged(of: dict[str, Recording], fits: dict[str, dict[Sensor, FitResult]]) -> list[Finding]:
    """How much of the second sweep's drift the first sweep's straight line removes, and its own."""
    first, second = _SWEEPS
    found = []
    for sensor, factor, unit in ((Sensor.ACCEL, 1.0, "m/s2"), (Sensor.GYRO, 1e3, "mrad/s")):
        channel, temperature = of[second].channel(sensor), of[second].channel(Sensor.TEMPERATURE)
        at = np.interp(channel.t, temperature.t, temperature.values[:, 0])
        judged, own = (judge_drift(fits[sweep][sensor], channel, at) for sweep in _SWEEPS)
        for axis in range(3):
            if np.isnan(_slope(fits[first][sensor], axis)[0]):
                continue
            before, after = factor * judged.before[axis], factor * judged.after[axis]
            declined = np.isnan(_slope(fits[second][sensor], axis)[0])
            itself = f"{second} alone is declined" if declined else f"{factor * own.after[axis]:.3g} by its own line"
            known = "the drift repeats" if (sensor, axis) in _CATS else "not stated"
            found.append(
                said(
                    "temp_cats_imu",
                    "thermal-poly",
                    f"{sensor.value} {'xyz'[axis]}: fitted on {first}, judged on {second}, rms of block means, {unit}",
                    known,
                    f"{before:.3g} before, {after:.3g} after; {itself}",
                    agrees=bool(after < before) if (sensor, axis) in _CATS else None,
                )
            )
    return found


def _allan() -> list[Finding]:
    found = []
    for fit in METHODS["allan"].run(recordings.galaxy(), {}):
        begins = [span[0] for span in fit.native["holds"]["N"] if span is not None]
        sd = fit.native["sd"]["N"]
        found += [
            said(
                "allan_galaxy_s5",
                "allan",
                f"{fit.sensor.value}: where the slope of white noise begins",
                "about 10 s: the phone low-passes",
                f"{', '.join(f'{b:g}' for b in begins)} s, low-pass said",
                agrees=all(fit.native["low_pass"]) and all(5.0 <= b <= 30.0 for b in begins),
            ),
            said(
                "allan_galaxy_s5",
                "allan",
                f"{fit.sensor.value}: N, {fit.native['unit']['N']}",
                "not stated",
                with_sd(fit.native["N"], sd),
                agrees=None,
            ),
        ]
    return found
