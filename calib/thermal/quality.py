"""Warnings, remedies and ``quality`` figures of :mod:`calib.thermal.fit`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.fit import AXES
from mavcal.calib.recording import Array, Channel, Sensor
from mavcal.calib.stats.correlated import ColouredCovariance
from mavcal.calib.stats.residuals import residual_statistics
from mavcal.calib.thermal.drift import DriftBlocks, DriftCurve, DriftData
from mavcal.calib.thermal.sweeps import ThermometerLag


def fit_message(what: str, data: DriftData, estimated: NDArray[np.bool_]) -> str:
    """Sentence that names the fitted drift, its axes and its range of temperature."""
    axes = ", ".join(AXES[i] for i in range(3) if estimated[i]) or "no axis"
    return f"{what} of {axes} over {data.t_min:.1f} to {data.t_max:.1f} degC from {data.samples} rows"


def common_warnings(data: DriftData, estimated: NDArray[np.bool_]) -> tuple[str, ...]:
    """Warnings of any fit of `data`: constant axes, and ignored rows."""
    warnings = []
    constant = ", ".join(AXES[i] for i in range(3) if data.constant[i] and not estimated[i])
    if constant and not data.quantised:
        warnings.append(f"{constant} reads one constant value: not estimated")
    elif constant:
        warnings.append(f"{constant} reads one constant value: its drift is below one bin, not estimated")
    if data.ignored:
        warnings.append(f"{data.ignored} rows without finite numbers were left out")
    if data.unsorted:
        warnings.append(f"the time ran backwards {data.unsorted} times: the rows were sorted by it")
    if data.spiked:
        warnings.append(f"{data.spiked} rows lie far from all others (spikes) and were left out")
    return tuple(warnings)


def declined_warnings(declined: NDArray[np.bool_], too_coarse: NDArray[np.bool_], channel: Channel) -> tuple[str, ...]:
    """Warnings that name each axis that is not estimated, with the reason."""
    warnings = []
    if declined.any():
        names = ", ".join(AXES[i] for i in range(3) if declined[i])
        warnings.append(
            f"{names} wanders as much by itself as with temperature: its drift is not repeatable, not estimated"
        )
    if too_coarse.any():
        names = ", ".join(AXES[i] for i in range(3) if too_coarse[i])
        warnings.append(
            f"{names} shows too few levels of {channel.quantum:.3g} {channel.unit}: its drift cannot be resolved"
        )
    return tuple(warnings)


def two_way_warnings(
    lag: ThermometerLag | None, two_ways: tuple[Array, Array] | None, curve: DriftCurve, estimated: NDArray[np.bool_]
) -> list[str]:
    """Warnings about the lag, and about the remaining difference of warming and cooling."""
    warnings = []
    if lag is not None:
        who = "the sensor lags its thermometer" if lag.seconds > 0.0 else "the thermometer lags the sensor"
        warnings.append(
            f"warming and cooling disagree: {who} by {abs(lag.seconds):.3g} +- {lag.sd:.1g} s; "
            "the drift is fitted against the temperature of the die; "
            "let the temperature change more slowly for a fit that is flown"
        )
    if two_ways is not None:
        difference, sd = two_ways
        loops = estimated & (np.abs(difference) > 4.0 * sd) & (np.abs(difference) > 0.1 * curve.drift)
        names = ", ".join(f"{AXES[i]} by {abs(difference[i]):.2g}" for i in np.flatnonzero(loops))
        if names:
            warnings.append(f"warming and cooling differ in {names}: half of that stays, whatever the polynomial")
    return warnings


def remedy_for(name: str, data: DriftData, too_coarse: NDArray[np.bool_], declined: NDArray[np.bool_]) -> str:
    """The movement or change of temperature that would determine the parameter `name`."""
    axis = AXES.index(name[-1])
    if data.constant[axis] or too_coarse[axis]:
        return "stream it at a finer resolution (HIGHRES_IMU), or move the temperature over a wider range"
    if declined[axis]:
        return (
            "move the temperature up and down once more, slowly and at rest; if the sweeps disagree again, it has none"
        )
    return "gravity and tilt are inside the offset of one pose: run accel-thermal or accel-multi for it"


def attitude_quality(channel: Channel, curve: DriftCurve, estimated: NDArray[np.bool_]) -> dict[str, float]:
    """Error of the attitude by the sd of the curves, at the worst temperature of the span."""
    worst = float(np.where(estimated, curve.drift_sd, 0.0).max())
    if channel.sensor == Sensor.GYRO and channel.unit == "rad/s":
        return {"attitude_sd_deg_per_min": float(np.degrees(60.0 * worst))}
    if channel.sensor == Sensor.ACCEL and channel.unit == "m/s2":
        return {"attitude_sd_deg": float(np.degrees(worst / STANDARD_GRAVITY))}
    return {}


def block_statistics(blocks: DriftBlocks, coefficients: Array, estimated: NDArray[np.bool_]) -> dict[str, Any]:
    """Residuals of the block means against the scatter of single samples; slow wander is the excess."""
    size = np.abs(blocks.series).max(axis=0)
    sd = np.maximum(blocks.residual_sd(), 1e-9 * np.maximum(size, 1e-290))
    left = (blocks.series - blocks.design @ coefficients) * np.sqrt(blocks.counts)[:, None] / sd
    dof = int((len(left) - len(coefficients)) * estimated.sum())
    known = blocks.n > 2 * len(left)  # else the blocks are the samples
    return {**residual_statistics(left[:, estimated], dof, 1.0 if known else None)} if estimated.any() else {}


def noise_quality(data: DriftData, noise: ColouredCovariance, estimated: NDArray[np.bool_]) -> dict[str, Any]:
    """Range of the drift, and deviation of the noise from white."""
    return {
        "span": data.span,
        "t_min": data.t_min,
        "t_max": data.t_max,
        "probability_of_white_noise": or_none(noise.whiteness, estimated),
        "sd_over_white_noise": or_none(np.sqrt(noise.excess), estimated),
    }


def or_none(values: Array, known: NDArray[np.bool_]) -> list[float | None]:
    """`values`, with None for unknown ones."""
    return [float(value) if ok else None for value, ok in zip(values, known, strict=True)]
