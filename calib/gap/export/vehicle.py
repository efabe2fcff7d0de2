"""A report as parameters of the vehicle: corrections and airframe values in its firmware that remove the gap.

The correction in force is ``truth = L (raw - o - p(T))``. With R the mounting, the diagnosis says ``R (raw - o - p) = A
R L^-1 truth + b + dp(T)``. Hence ``truth = L R^T A^-1 R (raw - o - R^T b - p - R^T dp)``: a new model of the same form.
A fit of a raw recording leaves the mounting to the firmware, so ``R^T`` stands before it all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware import body_from_sensor, calibration_in_force
from mavcal.calib.firmware.compose.plan import compose
from mavcal.calib.firmware.in_force.fingerprint import fingerprint
from mavcal.calib.firmware.plan import Change, WritePlan, snapshot_sha256
from mavcal.calib.fit import FitBuilder, FitResult
from mavcal.calib.gap.export.airframe.belief import WHILE_DISARMED, belief_changes
from mavcal.calib.gap.export.sensor_errors import (
    REFERENCE_TEMPERATURE,
    TEMPERATURE_TERMS,
    doubt_text,
    named,
    sensor_effects,
    sensors_with,
    term_of,
    value,
)
from mavcal.calib.gap.problem import UNIT
from mavcal.calib.gap.schema import EffectEstimate, GapReport, ParameterEstimate
from mavcal.calib.recording import Recording, Sensor
from mavcal.calib.triad import ThermalPolynomial, TriadModel

Array = NDArray[np.float64]

_CALIBRATIONS = frozenset(
    {
        *("accel_bias", "accel_scale", "accel_misalignment", "accel_rotation", "accel_temp_linear", "accel_temp_poly"),
        *("gyro_bias", "gyro_scale", "gyro_misalignment", "gyro_rotation", "gyro_temp_linear", "gyro_temp_poly"),
        *("mag_hard_iron", "mag_soft_iron", "mag_rotation"),
    }
)
"""Effects that a firmware's parameters can correct."""

_STEP = 1e-3
"""Step of a derivative in standard errors. Source: central differences err by its square, 1e-6."""


def vehicle_plan(report: GapReport, real: Recording) -> tuple[WritePlan, tuple[str, ...]]:
    """Plan that corrects the report's calibration effects, and the effects that remain.

    The firmware's airframe parameters (thrust curve, hover thrust, drag) are set to the values that the flight shows. A
    sensor with a doubtful calibration effect is not written: its other effects were estimated beside it.

    Parameters
    ----------
    report
        Of `real`.
    real
        Whose parameters, the ones in force when it was recorded, the plan is composed on.

    Raises
    ------
    FirmwareError
        If the recording is not of an ArduPilot or PX4, or has no parameters. If no effect is a calibration or an
        airframe value of the firmware, or all of them are doubtful.
    """
    autopilot, parameters = real.identity.autopilot, real.parameters.final()
    if autopilot is None or not parameters:
        raise FirmwareError(
            "the recording does not say whose calibration it was made with: a plan needs a log with parameters"
        )
    effects = sensor_effects(report.effects)
    beliefs, said = belief_changes(report.effects, autopilot, parameters)
    chosen = [e for e in effects if e.id in _CALIBRATIONS]
    if not chosen and not beliefs:
        why = f" ({'; '.join(said)})" if said else ""
        raise FirmwareError(f"no effect of the report is a calibration: there is nothing to write to the vehicle{why}")
    left = [f"{named(e)}: no calibration takes it away" for e in effects if e not in chosen]
    doubtful = [e for e in chosen if e.evidence.doubtful]
    unsure = _units(doubtful)
    keys = sorted(_units(chosen) - unsure)
    if not keys and not beliefs:
        raise FirmwareError(
            f"{'; '.join(map(doubt_text, doubtful))}: nothing is written to a vehicle that is less likely than not"
        )
    left += map(doubt_text, doubtful)
    left += [
        f"{named(e)}: not of {s.value} {n}, beside what is doubtful there"
        for e in chosen
        if not e.evidence.doubtful
        for s, n in sorted(unsure)
        if e.sensor is s and n in e.instances
    ]
    if report.unknown.flag:
        left.append(f"something unknown, beside which all was estimated: {report.unknown.shape}")
    fits = [_fit(report, real, [e for e in chosen if e.sensor is s and n in e.instances], s, n) for s, n in keys]
    owner = fingerprint(real.identity, parameters)
    if fits:
        plan = compose(fits, parameters, owner)
    else:
        plan = WritePlan(owner, snapshot_sha256({c.name: parameters[c.name] for c in beliefs}), ())
    return _with_beliefs(plan, beliefs), (*left, *said)


def _units(effects: Iterable[EffectEstimate]) -> set[tuple[Sensor, int]]:
    """Sensors and instances of the effects."""
    return {(e.sensor, n) for e in effects if e.sensor is not None for n in e.instances}


def _with_beliefs(plan: WritePlan, beliefs: Sequence[Change]) -> WritePlan:
    if not beliefs:
        return plan
    return replace(plan, changes=(*plan.changes, *beliefs), warnings=(*plan.warnings, WHILE_DISARMED))


def _fit(
    report: GapReport, real: Recording, effects: Sequence[EffectEstimate], sensor: Sensor, number: int
) -> FitResult:
    """The new calibration of one sensor, with the errors of the effects."""
    autopilot, parameters, instance = real.identity.autopilot, real.parameters.final(), number - 1
    force = calibration_in_force(autopilot, parameters, sensor, instance)
    mounting = body_from_sensor(autopilot, parameters, sensor, instance)
    t_ref = _reference(effects, force)
    seen = _temperatures(report, sensor, number)
    if seen is None and any(term_of(e) in TEMPERATURE_TERMS for e in effects):
        raise FirmwareError(f"{sensor.value} {number}: the temperatures that it was seen at are not known")

    def model(changed: Sequence[EffectEstimate]) -> TriadModel:
        return corrected_model(force, mounting, changed, (sensor, number), t_ref, seen or (t_ref, t_ref))

    found = model(effects)
    covariance = _covariance(effects, model)
    n = _samples(report, sensor, number)
    at = None if found.polynomial is None else t_ref
    return FitBuilder("gap", sensor, instance, UNIT[sensor], n, temperature=at).fitted(
        found,
        covariance,
        message=f"the calibration in force with {', '.join(e.id for e in effects)} taken away",
        n_used=n,
        residual_rms=_residual(report, sensor, number),
        condition_number=1.0,
    )


def corrected_model(
    force: TriadModel,
    mounting: Array,
    effects: Sequence[EffectEstimate],
    key: tuple[Sensor, int],
    t_ref: float,
    seen: tuple[float, float],
) -> TriadModel:
    """The correction of `effects` in addition to `force`, from the raw sensor to its own axes.

    Drifts are stated about `t_ref` (degC), and hold from the first to the second temperature of `seen`.
    """
    errors = sensors_with(effects, t_ref=t_ref).errors[key]
    matrix = mounting.T @ force.matrix @ mounting.T @ np.linalg.inv(errors.matrix) @ mounting
    offset = force.offset + mounting.T @ errors.bias
    if force.polynomial is None and not errors.temperature.any():
        return TriadModel(offset, matrix, None)
    added = mounting.T @ errors.temperature
    curve = np.zeros((3, 3))
    low, high = seen
    if force.polynomial is not None:
        before = force.polynomial
        curve[:, : before.coefficients.shape[1]] = before.coefficients
        low, high = before.t_min, before.t_max
    curve[:, : added.shape[1]] += added
    return TriadModel(offset, matrix, ThermalPolynomial(t_ref, low, high, curve))


def _reference(effects: Sequence[EffectEstimate], force: TriadModel) -> float:
    """Reference temperature: that of the drifts in force, else that of the found ones."""
    if force.polynomial is not None:
        return force.polynomial.t_ref
    return next((value(e, "t_ref") for e in effects if term_of(e) in TEMPERATURE_TERMS), REFERENCE_TEMPERATURE)


def _covariance(effects: Sequence[EffectEstimate], model: Callable[[Sequence[EffectEstimate]], TriadModel]) -> Array:
    """Covariance of the model's values: the effects' standard errors through central differences.

    Raises
    ------
    FirmwareError
        If an error is unknown, as for an offset that cannot be separated from the temperature at which a drift
        vanishes.
    """
    size = len(_flat(model(effects)))
    covariance = np.zeros((size, size))
    for i, effect in enumerate(effects):
        for j, parameter in enumerate(effect.params):
            if not np.isfinite(parameter.se):
                raise FirmwareError(
                    f"{named(effect)}: {parameter.name} has no finite error here, so it is not written to a vehicle; "
                    "calibrate with `mavcal fit` on a recording made for it"
                )
            if parameter.se <= 0.0:
                continue
            up, down = (_flat(model(_moved(effects, i, j, s * _STEP * parameter.se))) for s in (1.0, -1.0))
            slope = (up - down) / (2.0 * _STEP)
            covariance += np.outer(slope, slope)
    return covariance


def _moved(effects: Sequence[EffectEstimate], i: int, j: int, step: float) -> list[EffectEstimate]:
    old = effects[i].params[j]
    moved: ParameterEstimate = replace(old, value=old.value + step)
    params = (*effects[i].params[:j], moved, *effects[i].params[j + 1 :])
    return [*effects[:i], replace(effects[i], params=params), *effects[i + 1 :]]


def _flat(model: TriadModel) -> Array:
    curve = np.zeros(0) if model.polynomial is None else model.polynomial.coefficients.ravel()
    return np.concatenate([model.offset, model.matrix.ravel(), curve])


def _samples(report: GapReport, sensor: Sensor, number: int) -> int:
    return max((len(s.t) for s in report.series if s.sensor is sensor and number in s.instances), default=0)


def _temperatures(report: GapReport, sensor: Sensor, number: int) -> tuple[float, float] | None:
    """Lowest and highest temperature, degC."""
    for fit in report.series:
        warmth = fit.covariates.get("temperature")
        if fit.sensor is sensor and number in fit.instances and warmth is not None and len(warmth):
            return float(warmth.min()), float(warmth.max())
    return None


def _residual(report: GapReport, sensor: Sensor, number: int) -> float:
    """Rms of the residual with the effects, per axis."""
    left = [s.residual - s.modelled for s in report.series if s.sensor is sensor and number in s.instances]
    return float(np.sqrt(np.mean(left[0] ** 2))) if left else 0.0
