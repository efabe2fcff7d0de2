"""The method ``allan``: noise figures of a sensor at rest, axis by axis.

It calibrates nothing: the model of the result is the identity, and every parameter of it is named as undetermined.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import AXES, FitBuilder, FitResult, parameter_names
from mavcal.calib.noise.allan import (
    FLICKER,
    MISFIT,
    TERMS,
    AllanFit,
    AllanTable,
    fit_noise,
    octaves,
    overlapping_deviation,
)
from mavcal.calib.recording import Array, Channel, Sensor
from mavcal.calib.stats.residuals import residual_statistics
from mavcal.calib.stats.windows import finite_rows
from mavcal.calib.triad import TriadModel

METHOD = "allan"

_LEAST = 64  # samples: averaging times of 1 to 8
_FILLED = 0.01  # share of missing samples that may be drawn in by straight lines
_UNEVEN = 0.2  # of an interval: time stamps that scatter more are no even sampling
_GAP = 1.5  # intervals
_JUMP = 6.0  # scatter of a stretch over the usual one that is a disturbance and no noise
_STRETCHES = 200
_MINUTE = 60.0
_INCLINED = math.cos(math.radians(60.0))  # horizontal share of a field that is not known better


def fit_allan(channel: Channel, *, relative: bool = False) -> FitResult:
    """White noise N, bias instability B and rate random walk K of every axis, by the overlapping Allan variance.

    Parameters
    ----------
    channel
        Samples at rest at an even rate, three axes, any unit. One sample in a hundred may be missing; where more are,
        the longest stretch without a gap counts.
    relative : bool
        The calibration in force was not known.

    Returns
    -------
    FitResult
        ``native`` has the table: ``tau`` in s, ``adev``, its relative sd, the model. It has ``N`` (unit/sqrt(Hz)),
        ``B`` (unit) and ``K`` (unit/sqrt(s)) with ``sd`` and ``upper``, the 95 % bound. A noise indistinguishable from
        zero is None and has only the bound. ``holds`` has the range of each slope (s), and ``read_off`` the usual
        readings at tau = 1, at the minimum and at tau = 3.
    """
    if channel.values.shape[1] != 3:
        raise InvalidInputError(f"{channel.sensor}: three axes are needed, not {channel.values.shape[1]}")
    longer = "record it at rest for longer, at an even rate"
    made = FitBuilder.of(METHOD, channel, relative=relative, movement=longer)
    try:
        values, rate, warnings = _even(channel)
    except InvalidInputError as error:
        return made.refused(str(error))
    constant = values.min(axis=0) == values.max(axis=0)
    if constant.all():
        return made.refused("every axis reads one constant value: it is stuck, or its noise is below one bin")
    warnings += _disturbed(values, rate)
    tables = [overlapping_deviation(values[:, i], rate, octaves(len(values))) for i in range(3)]
    fits = [None if constant[i] else fit_noise(tables[i], len(values)) for i in range(3)]
    warnings += _filtered(tables, fits)
    warnings += [f"{AXES[i]} reads one constant value: its noise is below one bin" for i in range(3) if constant[i]]
    known = [fit for fit in fits if fit is not None]
    whole = all(fit is not None and np.isfinite(fit.sd[0]) for fit in fits)
    names = parameter_names()
    return made.fitted(
        TriadModel(),
        np.zeros((len(names), len(names))),
        message=_message(channel, tables[0], fits),
        n_used=len(values),
        residual_rms=float(values.std()),
        condition_number=max(fit.condition for fit in known),
        undetermined=dict.fromkeys(names, "this method measures noise only: run a calibration method of this sensor"),
        partial=not whole,
        warnings=warnings,
        quality=_quality(channel, values, rate, known),
        native=_native(channel.unit, rate, tables, fits),
    )


def _even(channel: Channel) -> tuple[Array, float, list[str]]:
    """Samples (N, 3) without gaps and without their mean, their rate (Hz), and warnings about the repairs.

    Raises
    ------
    InvalidInputError
        If there are too few, or they are not evenly spaced.
    """
    good = finite_rows(channel.values) & np.isfinite(channel.t)
    t, y = channel.t[good], channel.values[good]
    if len(t) < _LEAST:
        raise InvalidInputError(f"{len(t)} finite samples: {_LEAST} are needed, and hours of them tell most")
    steps = np.diff(t)
    if (steps < 0).any():
        raise InvalidInputError(f"the time runs backwards at {int((steps < 0).sum())} samples: sort the recording")
    interval = float(np.median(steps))
    if not interval > 0.0:
        raise InvalidInputError("half of the samples or more share their time stamp: the rate is not known")
    gaps = steps > _GAP * interval
    # time stamps jitter, but their steps must be one number: whole spans tell it better than single steps
    interval = float(steps[~gaps].mean())
    if float(np.median(np.abs(steps - interval))) > _UNEVEN * interval:
        raise InvalidInputError(
            f"steps of {steps.min():.4g} to {steps.max():.4g} s are no even rate: resample it first"
        )
    warnings = []
    if len(t) < len(channel):
        warnings.append(f"{len(channel) - len(t)} rows without finite numbers were left out")
    if not gaps.any():
        return y - y.mean(axis=0), 1.0 / interval, warnings
    missing = int(np.round(steps[gaps] / interval - 1.0).sum())
    if missing <= _FILLED * len(t):
        grid = np.linspace(t[0], t[-1], len(t) + missing)
        filled = np.column_stack([np.interp(grid, t, y[:, i]) for i in range(3)])
        warnings.append(f"{missing} missing samples were drawn in by straight lines")
        return filled - filled.mean(axis=0), 1.0 / interval, warnings
    edges = np.concatenate([[0], np.flatnonzero(gaps) + 1, [len(t)]])
    longest = int(np.argmax(np.diff(edges)))
    y = y[edges[longest] : edges[longest + 1]]
    warnings.append(
        f"{missing} samples are missing in {int(gaps.sum())} gaps: only the longest of its stretches counts"
    )
    if len(y) < _LEAST:
        raise InvalidInputError(f"the longest stretch without a gap has {len(y)} samples: {_LEAST} are needed")
    return y - y.mean(axis=0), 1.0 / interval, warnings


def _disturbed(values: Array, rate: float) -> list[str]:
    """Warnings about periods that scatter far more than the others, as when the sensor was touched."""
    length = max(len(values) // _STRETCHES, 8)
    starts = np.arange(0, len(values) - length + 1, length // 2)  # halves shared
    scatter = np.sqrt([values[i : i + length].var(axis=0).sum() for i in starts])
    usual = float(np.median(scatter))
    worst = int(np.argmax(scatter))
    if usual <= 0.0 or scatter[worst] < _JUMP * usual:
        return []
    return [
        f"it was disturbed: at {starts[worst] / rate:.0f} s it scatters {scatter[worst] / usual:.0f} times as much as "
        "usual; cut that out: noise of a motion is not the sensor's"
    ]


def _filtered(tables: list[AllanTable], fits: list[AllanFit | None]) -> list[str]:
    """Warnings if the shortest averaging times lie below the model, due to a low-pass, or above it."""
    below: list[str] = []
    above: list[str] = []
    for axis, (table, fit) in enumerate(zip(tables, fits, strict=True)):
        if fit is None or fit.used[0]:
            continue
        side = below if low_passed(table, fit) else above
        side.append(f"{AXES[axis]} from {table.tau[fit.used][0]:.3g} s")
    warnings = []
    if below:
        warnings.append(
            f"low-pass filtered: the slope of white noise holds only for {', '.join(below)} on; shorter times show the "
            "filter, and N is that of the slow part"
        )
    if above:
        warnings.append(
            f"there is more fast noise than white (vibration, coarse bins): the model holds for {', '.join(above)} on"
        )
    strange = [f"{AXES[i]} (p = {f.p_value:.1e})" for i, f in enumerate(fits) if f is not None and _misfits(f)]
    if strange:
        warnings.append(f"{', '.join(strange)} is no sum of the three noises: the sd is widened by the misfit")
    return warnings


def _misfits(fit: AllanFit) -> bool:
    return fit.p_value is not None and fit.p_value < MISFIT


def low_passed(table: AllanTable, fit: AllanFit) -> bool:
    """Whether the averaging times that were left out lie below the model, as behind a low-pass filter."""
    out = ~fit.used
    return bool(out.any() and np.median(table.adev[out] / fit.model[out]) < 1.0)


def _holds(table: AllanTable, fit: AllanFit) -> list[list[float] | None]:
    """For each noise, the first and last averaging time (s) at which it is most of the variance; None: nowhere."""
    parts = np.column_stack([1.0 / table.tau, np.full(len(table.tau), FLICKER), table.tau / 3.0]) * fit.values**2
    spans: list[list[float] | None] = []
    for part in parts.T:
        most = np.flatnonzero(fit.used & (part > 0.5 * fit.model**2))
        spans.append([float(table.tau[most[0]]), float(table.tau[most[-1]])] if len(most) else None)
    return spans


def _read_off(table: AllanTable, fit: AllanFit) -> dict[str, float | None]:
    """N, B and K by the usual readings: the line of slope -1/2 at 1 s, the minimum, the line of slope +1/2 at 3 s."""
    tau, adev = table.tau[fit.used], table.adev[fit.used]
    slope = np.diff(np.log(np.maximum(adev, 1e-300))) / np.diff(np.log(tau))
    lowest = int(np.argmin(adev))
    falling = np.flatnonzero(np.abs(slope + 0.5) < 0.15)
    rising = np.flatnonzero((np.abs(slope - 0.5) < 0.25) & (np.arange(len(slope)) >= lowest))
    return {
        "N": float(adev[falling[0]] * np.sqrt(tau[falling[0]])) if len(falling) else None,
        "B": float(adev[lowest] / math.sqrt(FLICKER)) if 0 < lowest < len(adev) - 1 else None,
        "K": float(adev[rising[-1] + 1] * np.sqrt(3.0 / tau[rising[-1] + 1])) if len(rising) else None,
    }


def _message(channel: Channel, table: AllanTable, fits: list[AllanFit | None]) -> str:
    def listed(k: int, unit: str) -> str:
        numbers = ["-" if f is None or not np.isfinite(f.sd[k]) else f"{f.values[k]:.3g}" for f in fits]
        return f"{TERMS[k]} {' '.join(numbers)} {unit}"

    u = channel.unit
    parts = (listed(0, f"{u}/sqrt(Hz)"), listed(1, u), listed(2, f"{u}/sqrt(s)"))
    return f"noise over {table.tau[0]:.3g} to {table.tau[-1]:.3g} s of averaging: {'; '.join(parts)} (- not told)"


def _quality(channel: Channel, values: Array, rate: float, known: list[AllanFit]) -> dict[str, Any]:
    residuals = np.concatenate([fit.residuals for fit in known])
    N, B, K = (np.array([fit.values[k] for fit in known]) for k in range(3))
    quality: dict[str, Any] = {
        **residual_statistics(residuals, sum(fit.dof for fit in known), 1.0),
        "axes_p_value": [fit.p_value for fit in known],
        "duration": len(values) / rate,
        "rate": rate,
    }
    if channel.sensor == Sensor.GYRO and channel.unit == "rad/s":
        angle = N**2 * _MINUTE + (B * _MINUTE) ** 2 + K**2 * _MINUTE**3 / 3.0
        quality["attitude_sd_deg_per_min"] = float(np.degrees(np.sqrt(angle.max())))
    elif channel.sensor == Sensor.ACCEL and channel.unit == "m/s2":
        quality["attitude_sd_deg"] = float(np.degrees(np.sqrt((B**2 + N**2).max()) / STANDARD_GRAVITY))
    elif channel.sensor == Sensor.MAG:
        horizontal = _INCLINED * float(np.linalg.norm(np.nanmean(channel.values, axis=0)))
        quality["heading_sd_deg"] = float(np.degrees(np.sqrt((B**2 + N**2).max()) / max(horizontal, 1e-300)))
    return quality


def _native(unit: str, rate: float, tables: list[AllanTable], fits: list[AllanFit | None]) -> dict[str, Any]:
    def each(numbers: Any) -> list[Any]:
        return [None if fit is None else numbers(table, fit) for table, fit in zip(tables, fits, strict=True)]

    def values(k: int) -> list[float | None]:
        return [float(f.values[k]) if f is not None and np.isfinite(f.sd[k]) else None for f in fits]

    return {
        "tau": tables[0].tau.tolist(),
        "adev": [table.adev.tolist() for table in tables],
        "adev_relative_sd": each(lambda _, fit: fit.relative_sd.tolist()),
        "model_adev": each(lambda _, fit: fit.model.tolist()),
        **{term: values(k) for k, term in enumerate(TERMS)},
        "sd": {
            t: each(lambda _, f, k=k: float(f.sd[k]) if np.isfinite(f.sd[k]) else None) for k, t in enumerate(TERMS)
        },
        "upper": {term: each(lambda _, fit, k=k: float(fit.upper[k])) for k, term in enumerate(TERMS)},
        "unit": {"N": f"{unit}/sqrt(Hz)", "B": unit, "K": f"{unit}/sqrt(s)"},
        "holds": {term: each(lambda table, fit, k=k: _holds(table, fit)[k]) for k, term in enumerate(TERMS)},
        "model_from": each(lambda table, fit: float(table.tau[fit.used][0])),
        "low_pass": each(low_passed),
        "read_off": each(_read_off),
        "rate": rate,
    }
