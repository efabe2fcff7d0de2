"""Finishing touches that every procedure's fits share."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Iterable

from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.procedures.pool import Pool
from mavcal.calib.procedures.roster import label
from mavcal.calib.procedures.spec import ProcedureContext
from mavcal.calib.recording import Sensor


def mean_temperature(pool: Pool, instance: int) -> float | None:
    """Mean temperature of an inertial unit over what was kept, degC; None: it does not stream."""
    key = (Sensor.TEMPERATURE, instance)
    return float(pool.channel(key).values.mean()) if key in pool else None


def mean_or_none(values: Collection[float]) -> float | None:
    """Their mean; None: there are none."""
    return math.fsum(values) / len(values) if values else None


def annotated(fit: FitResult, context: ProcedureContext, warnings: Iterable[str]) -> FitResult:
    """The fit with the capture's warnings, and `relative` if the calibration in force is unknown."""
    extra = tuple(w for w in warnings if w not in fit.warnings)
    return dataclasses.replace(fit, warnings=fit.warnings + extra, relative=fit.relative or context.relative)


def share_of_information(target: float, reached: float) -> float:
    """Share of the information for a standard deviation of `target` that `reached` amounts to, percent.

    Information is ``1/sd^2`` and grows with the samples, so a bar of it moves evenly and never without a gain.
    """
    return 100.0 * min(1.0, (target / reached) ** 2) if math.isfinite(reached) and reached > 0.0 else 0.0


def refusals(fits: Iterable[FitResult]) -> str:
    """Reasons why fits were refused, sensor by sensor."""
    refusals = [f"{label(f.sensor, f.instance)}: {f.message}" for f in fits if f.status == FitStatus.REFUSED]
    return "; ".join(refusals) or "no sensor is left"
