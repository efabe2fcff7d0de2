"""Hard and soft iron of a compass from an ordinary flight.

The fit uses the log's attitude and the field of the magnetic model, or the gyroscope alone and an unknown constant
field. Parameters that the flight's attitudes do not determine keep their values in force, and are named.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal, Unpack

import numpy as np

from mavcal.calib.errors import UndeterminedError
from mavcal.calib.fit import AXES, OFFSETS, FitBuilder, FitResult
from mavcal.calib.mag.flight_fit import SOFT_IRON_SD, FlightEstimate, Knowledge, estimate, estimated_soft_iron_sd
from mavcal.calib.mag.flight_input import MOVEMENT, FlightInput, prepared, unusable
from mavcal.calib.mag.flight_path import Turning
from mavcal.calib.mag.flight_problem import OFFSET, SHAPE, SHAPES
from mavcal.calib.mag.heading import heading_sd_deg
from mavcal.calib.mag.motor_drives import Drive
from mavcal.calib.mag.motor_hidden import unusable_attitude
from mavcal.calib.mag.result import FIELD_TOLERANCE, UNDETERMINED_SD, CompassFit, MagContext, MagFacts, compass_result
from mavcal.calib.recording import Array, Channel
from mavcal.calib.stats.residuals import residual_statistics
from mavcal.calib.triad import TriadModel

SoftIron = Literal["auto", "held", "free"]

METHOD = "mag-flight"
SOFT_IRON: tuple[SoftIron, ...] = ("auto", "held", "free")
_BELIEVED = 0.7
"""Posterior over prior sd above which the flight did not determine an entry of the matrix."""
_ROUGHEST = 0.15  # of the field: residuals with which nothing is calibrated
_MOST_OUTLIERS = 0.3
_COARSE_DEG = 3.0
_ENTRIES = ("xx", "yy", "zz", "xy", "xz", "yz")
_MIRROR = {"xy": "yx", "xz": "zx", "yz": "zy"}
_WANTED = {
    "x": "turn a whole circle on the spot: it tells the offset, which goes with the vehicle, from the field",
    "y": "turn a whole circle on the spot: it tells the offset, which goes with the vehicle, from the field",
    "z": "bank and pitch by 20 degrees and more while turning, or turn it upside down by hand",
}


def fit_flight(
    mag: Channel,
    turning: Turning,
    *,
    in_force: TriadModel | None = None,
    drive: Drive | None = None,
    soft_iron: SoftIron = "auto",
    window: float = 0.0,
    **facts: Unpack[MagFacts],
) -> FitResult:
    """Offset and symmetric matrix of a compass from a flight.

    Parameters
    ----------
    mag
        Of the bare sensor, in its own axes.
    turning
        Gyroscope and attitude of the log, body axes: both, or either alone. The heading of an attitude is never
        trusted. Without an attitude the reference frame is that of the start.
    in_force
        The correction in force, sensor axes to body, whose soft iron is the start of the fit. None: none.
    drive
        The current or another drive signal of the motors, whose field is estimated too; the offset then excludes it.
    soft_iron
        ``held``: as in force. ``free``: entries of any size up to a tenth. ``auto``: as large as the flight shows.
    window
        Time over which the compass averages, s.
    **facts
        :class:`calib.mag.result.MagContext`.

    Returns
    -------
    FitResult
        Of the sensor in its own axes, matrix symmetric. ``partial`` where entries of the matrix stay as they were.

    Raises
    ------
    InvalidInputError
        If the clocks go back, or units or shapes do not fit.
    """
    context = MagContext(**facts)
    made = context.made(METHOD, len(mag), MOVEMENT)
    data = prepared(mag, turning, in_force, drive, window, context)
    reason = unusable(data)
    if reason:
        return made.refused(reason)
    try:
        found = _fitted(data, context, soft_iron)
    except UndeterminedError as error:
        return made.refused(str(error))
    return _verdict(made, found, data, in_force or TriadModel(), context)


def _fitted(data: FlightInput, context: MagContext, soft_iron: SoftIron) -> FlightEstimate:
    if soft_iron == "held":
        return estimate(data.samples, data.turning, Knowledge(context.field, 0.0))
    found = estimate(data.samples, data.turning, Knowledge(context.field, SOFT_IRON_SD))
    if soft_iron == "free":
        return found
    return estimate(data.samples, data.turning, Knowledge(context.field, estimated_soft_iron_sd(found)))


def _departure(rough: float, outliers: float) -> str:
    """Text on excessive residuals, or else on the number of outliers."""
    if rough > _ROUGHEST:
        return f"compass and attitude do not agree: {rough:.0%} of the field is left of any offset and Earth's field"
    return f"{outliers:.0%} of the compass's samples depart from the Earth's field by more than their noise"


def _model(x: Array, sensor_from_body: Array) -> TriadModel:
    """The correction of the sensor in its own axes from offset and matrix in the body's."""
    matrix = np.linalg.inv(np.einsum("k,kij->ij", x[SHAPE], SHAPES))
    return TriadModel(sensor_from_body @ x[OFFSET], sensor_from_body @ matrix @ sensor_from_body.T)


def _spread(x: Array, covariance: Array, sensor_from_body: Array) -> Array:
    """Covariance (12, 12) of the model's numbers by central differences."""

    def numbers(at: Array) -> Array:
        model = _model(at, sensor_from_body)
        return np.concatenate([model.offset, model.matrix.ravel()])

    step = 1e-6 * np.concatenate([np.full(3, np.linalg.norm(x[OFFSET]) + 1.0), np.ones(6)])
    columns = [(numbers(x[:9] + h) - numbers(x[:9] - h)) / (2.0 * h.sum()) for h in np.diag(step)]
    J = np.column_stack(columns)
    return np.asarray(J @ covariance[:9, :9] @ J.T)


def _verdict(
    made: FitBuilder, found: FlightEstimate, data: FlightInput, in_force: TriadModel, context: MagContext
) -> FitResult:
    x, layout = found.x, found.layout
    strength = float(np.linalg.norm(x[layout.field]))
    model = _model(x, data.sensor_from_body)
    full = _spread(x, found.solved.covariance, data.sensor_from_body)
    quality = _quality(found, data, context, model, full, strength)
    outliers = 1.0 - found.used / len(data.samples.t)
    rough = quality["residual_rms"] / strength
    lost = unusable_attitude(data, found, in_force, context)
    if lost:
        return made.refused(lost, quality=quality)
    if rough > _ROUGHEST or outliers > _MOST_OUTLIERS:
        return made.refused(
            f"{_departure(rough, outliers)}: another cause than iron on board is at work (corrupt parameters, "
            "currents, steel on the ground, a wrong mounting, an attitude that is bent)",
            quality=quality,
        )
    offsets, entries = _open(found, strength)
    if len(offsets) == 3:
        worst = math.sqrt(float(np.diag(full)[:3].max()))
        return made.refused(
            f"the flight does not determine the offset (known to {worst:.2g} {context.unit} at a field of "
            f"{strength:.3g}): {MOVEMENT}",
            OFFSETS,
            quality=quality,
        )
    names = tuple(f"offset_{a}" for a in offsets) + tuple(n for entry in entries for n in _both(entry))
    return compass_result(
        CompassFit(
            METHOD,
            model,
            full,
            n_samples=made.n_samples,
            n_used=found.used,
            message=_message(quality, offsets, entries, strength),
            residual_rms=quality["residual_rms"],
            condition_number=quality["condition_number"],
            quality=quality,
            native=_native(found, data, context, strength),
            warnings=_warnings(found, context, quality, strength),
            undetermined={n: _movement(n) for n in names},
        ),
        context,
    )


def _both(entry: str) -> tuple[str, ...]:
    return (f"matrix_{entry}", f"matrix_{_MIRROR[entry]}") if entry in _MIRROR else (f"matrix_{entry}",)


def _movement(name: str) -> str:
    if name.startswith("offset"):
        return _WANTED[name[-1]]
    return f"{MOVEMENT}; by hand in all directions for the whole matrix"


def _open(found: FlightEstimate, strength: float) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Axes of the offset and entries of the matrix that the flight does not determine, in body axes."""
    sd = np.sqrt(np.diag(found.solved.covariance)[:9])
    prior = found.prior.sd[SHAPE]
    offsets = tuple(a for a, s in zip(AXES, sd[OFFSET], strict=True) if s > UNDETERMINED_SD * strength)
    entries = tuple(
        e
        for e, s, before in zip(_ENTRIES, sd[SHAPE], prior, strict=True)
        if before > 0.0 and s >= min(_BELIEVED * before, UNDETERMINED_SD)
    )
    return offsets, entries


def _quality(
    found: FlightEstimate, data: FlightInput, context: MagContext, model: TriadModel, full: Array, strength: float
) -> dict[str, Any]:
    weights = found.flight.weights
    kept = weights > 0.0
    residuals = found.solved.residuals[kept]
    standard = residuals / found.noise[kept, None]
    rms = math.sqrt(float((weights[kept, None] * residuals**2).sum()) / float(weights.sum()))
    field = found.x[found.layout.field]
    horizontal = math.hypot(float(field[0]), float(field[1]))
    dip = math.atan2(float(field[2]), horizontal) if data.turning.attitude is not None else context.inclination
    statistics = residual_statistics(standard, 3 * len(standard) - found.layout.size, None)
    scale = float(np.cbrt(np.linalg.det(np.einsum("k,kij->ij", found.x[SHAPE], SHAPES))))
    reduced = found.solved.covariance[:9, :9][np.ix_(found.prior.sd[:9] > 0, found.prior.sd[:9] > 0)]
    unit = np.sqrt(np.diag(reduced))
    return {
        **statistics,
        "residual_rms": rms,
        "noise_sd": float(np.median(found.noise)),
        "noise_from": "residuals",
        "variance_inflation": found.inflation,
        "effective_samples": found.used / found.inflation,
        "n_outliers": len(weights) - found.used,
        "condition_number": float(np.linalg.cond(reduced / np.outer(unit, unit))),
        "radius": scale * strength,
        "field_ratio": scale if context.field is not None and context.unit == "uT" else None,
        "heading_sd_deg": heading_sd_deg(model, full, strength, dip, context.body_from_sensor),
        "heading_dip_deg": math.degrees(dip),
        "soft_iron_kept": True,
        "soft_iron_sd_before": float(found.prior.sd[SHAPE].max()),
        "yaw_range_deg": data.yaw_range_deg,
        "tilt_range_deg": data.tilt_range_deg,
    }


def _message(quality: Mapping[str, Any], offsets: tuple[str, ...], entries: tuple[str, ...], strength: float) -> str:
    text = (
        f"heading good to {quality['heading_sd_deg']:.2g} deg, residual {quality['residual_rms']:.2g} at a field of "
        f"{strength:.3g}"
    )
    if offsets:
        text += f"; the offset along {' and '.join(offsets)} is not determined"
    if entries:
        text += f"; the flight says nothing of {', '.join(entries)} of the matrix, kept near what was in force"
    return text


def _warnings(
    found: FlightEstimate, context: MagContext, quality: Mapping[str, Any], strength: float
) -> tuple[str, ...]:
    warnings = []
    ratio = quality["field_ratio"]
    if context.strength is None:
        warnings.append("field strength unknown: the common scale of the matrix stays as in force")
    elif ratio is not None and abs(ratio - 1.0) > FIELD_TOLERANCE:
        warnings.append(f"the compass measures {ratio:.2f} times the field of the magnetic model")
    if context.field is not None and not context.field.valid:
        warnings.append(f"the date is outside the years of {context.field.model}: its field is extrapolated")
    if quality["heading_sd_deg"] > _COARSE_DEG:
        warnings.append(
            f"the heading would be good to {quality['heading_sd_deg']:.1f} degrees only: fly whole circles before "
            "this is written"
        )
    if quality["n_outliers"]:
        warnings.append(f"{quality['n_outliers']} samples lie off the model and were left out")
    if found.layout.drives:
        peak = np.abs(found.flight.drives[:, 0]).max() * np.linalg.norm(found.x[found.layout.motor][:3])
        if peak > 0.01 * strength:
            helps = "" if context.compensated else ". The method mag-motor finds what compensates them"
            warnings.append(f"the motors add up to {peak:.2g} {context.unit}; the offset is that without them{helps}")
    return tuple(warnings)


def _native(found: FlightEstimate, data: FlightInput, context: MagContext, strength: float) -> dict[str, Any]:
    layout, path = found.layout, found.flight.path
    bias = path.bias + found.solved.knots[:, 3:]
    sources = [n for n, c in (("gyro", data.turning.gyro), ("attitude", data.turning.attitude)) if c is not None]
    return {
        "from": sources,
        "field_ned": found.x[layout.field].tolist() if data.turning.attitude is not None else None,
        "field_strength": strength,
        "offset_body": found.x[OFFSET].tolist(),
        "offset_body_sd": np.sqrt(np.diag(found.solved.covariance)[OFFSET]).tolist(),
        "change_of_offset_body": (found.x[OFFSET] - data.offset_in_force).tolist(),
        "gyro_bias": bias.mean(axis=0).tolist() if data.turning.gyro is not None else None,
        "mounting_deg": np.degrees(found.x[layout.mounting]).tolist(),
        "mounting_sd_deg": np.degrees(np.sqrt(np.diag(found.solved.covariance)[layout.mounting])).tolist(),
        "delay": float(found.x[layout.delay][0]) + 0.5 * data.samples.window,
        "attitude_error_deg": math.degrees(float(np.sqrt((found.solved.knots[:, :3] ** 2).sum(axis=1).mean()))),
        "directions": directions(found, strength),
        "without_motors": bool(layout.drives),
    }


def directions(found: FlightEstimate, strength: float) -> list[dict[str, Any]]:
    """Combinations of offset and matrix that the flight alone determines, best first, with their sd (field = 1)."""
    scale = np.concatenate([np.full(3, strength), np.ones(6)])
    free = found.prior.sd[:9] > 0.0
    covariance = (found.solved.covariance[:9, :9] / np.outer(scale, scale))[np.ix_(free, free)]
    before = np.where(np.isfinite(found.prior.sd[:9]), found.prior.sd[:9], np.inf)[free]
    with np.errstate(divide="ignore"):
        information = np.linalg.inv(covariance) - np.diag(1.0 / before**2)
    values, vectors = np.linalg.eigh(information)
    names = np.array([f"offset_{a}" for a in AXES] + [f"matrix_{e}" for e in _ENTRIES])[free]
    listed = []
    for value, vector in zip(values[::-1], vectors.T[::-1], strict=True):
        large = np.flatnonzero(np.abs(vector) > 0.2)
        listed.append(
            {
                "sd": 1.0 / math.sqrt(value) if value > 1e-3 else None,
                "combination": {str(names[i]): round(float(vector[i]), 3) for i in large},
            }
        )
    return listed
