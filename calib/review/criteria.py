"""Criteria for and against a plan, each with its number, limit and remedy."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from mavcal.calib.firmware.plan import WritePlan
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.preflight.check import Verdict
from mavcal.calib.recording import Sensor
from mavcal.calib.review.effect import NAMES, amount

FIELD_WITHIN: Final = 0.15
"""Relative difference of a compass's field strength from the model's above which steel is suspected."""
COVERED: Final = 0.4
"""Fraction of the sphere below which a compass has covered too few directions."""
CHANCE: Final = 1e-4
"""P-value of the residuals below which the model is doubted."""
MATRIX_ENTRIES: Final = 9


@dataclass(frozen=True)
class Criterion:
    """What speaks for or against a plan."""

    id: str
    verdict: Verdict
    value: float | None
    """In `unit`; None: it has none."""
    limit: float | None
    """In `unit`; None: it has none."""
    unit: str
    text: str
    remedy: str
    """What helps; empty: nothing has to be done."""


def criteria_of(fits: Sequence[FitResult], plan: WritePlan, options: Mapping[str, Any]) -> tuple[Criterion, ...]:
    """The criteria of every fit, then those of the plan. `options` are those of the procedure."""
    found: list[Criterion] = []
    for fit in fits:
        found += _of_fit(fit, options)
    reach = [change.name for change in plan.changes if change.needs_reboot]
    if reach:
        text = f"{len(reach)} parameters act only after a restart"
        found.append(Criterion("restart", Verdict.WARN, float(len(reach)), None, "", text, "Let mavcal restart it."))
    for number, loss in enumerate(plan.losses):
        text = f"not stored: {loss.what} of {NAMES.get(loss.sensor, loss.sensor)} {loss.instance + 1}"
        text += f", costs {amount(loss.cost, loss.unit)}"
        found.append(Criterion(f"loss-{number}", Verdict.PASS, loss.cost, None, loss.unit, text, ""))
    return tuple(found)


def _of_fit(fit: FitResult, options: Mapping[str, Any]) -> list[Criterion]:
    name, key = f"{NAMES.get(fit.sensor, str(fit.sensor))} {fit.instance + 1}", f"{fit.sensor}{fit.instance}"
    found = [_status(fit, name, key)]
    reached = _uncertainty(fit, options)
    if reached is not None:
        value, limit, unit = reached
        text = f"{name}: known to {amount(value, unit)}, asked for {amount(limit, unit)}"
        remedy = "Repeat it with more movement or a longer rest."
        found.append(_judged(f"{key}-uncertainty", (value, limit, unit), text, remedy, good=value <= limit * 1.0001))
    chance = fit.quality.get("p_value")
    if isinstance(chance, float):
        good = chance >= CHANCE
        text = f"{name}: the readings fit the model"
        text = text if good else f"{name}: the readings do not fit the model (P {chance:.1g})"
        remedy = "Something moved or a magnet was near: repeat it."
        found.append(_judged(f"{key}-residuals", (chance, CHANCE, ""), text, remedy, good=good))
    return found + (_of_compass(fit, name, key) if fit.sensor == Sensor.MAG else [])


def _judged(of: str, number: tuple[float, float, str], text: str, remedy: str, *, good: bool) -> Criterion:
    """A criterion with its value, limit and unit; a warning unless `good`."""
    return Criterion(of, Verdict.PASS if good else Verdict.WARN, *number, text, "" if good else remedy)


def _status(fit: FitResult, name: str, key: str) -> Criterion:
    if fit.status == FitStatus.OK:
        return Criterion(f"{key}-fit", Verdict.PASS, None, None, "", f"{name}: every parameter is determined", "")
    missing = _missing(fit)
    remedy = next(iter(fit.movements.values()), "Repeat it with more movement.")
    verdict = Verdict.WARN if fit.status == FitStatus.PARTIAL else Verdict.FAIL
    return Criterion(f"{key}-fit", verdict, None, None, "", f"{name}: {missing}", remedy)


def _missing(fit: FitResult) -> str:
    """Clause that lists the parameters that a fit does not determine."""
    matrix = [name for name in fit.undetermined if name.startswith("matrix")]
    if fit.quality.get("soft_iron_kept") and len(matrix) == len(fit.undetermined) == MATRIX_ENTRIES:
        return "soft iron and scale stay as they are, nothing was measured of them"
    return f"not determined: {', '.join(fit.undetermined) or fit.message}"


def _uncertainty(fit: FitResult, options: Mapping[str, Any]) -> tuple[float, float, str] | None:
    """Uncertainty reached, uncertainty requested, and the unit; None: none was requested."""
    asked = options.get("uncertainty")
    if asked is None or fit.model.polynomial is not None:
        return None
    if fit.sensor == Sensor.MAG:
        sd = fit.quality.get("heading_sd_deg")
        return None if sd is None else (float(sd), float(asked), "deg")
    named = zip(fit.names, fit.sd.tolist(), strict=True)
    sds = [sd for name, sd in named if name.startswith("offset") and math.isfinite(sd)]
    if not sds:
        return None
    if fit.sensor == Sensor.GYRO and fit.method.startswith("gyro-rest"):
        return math.degrees(max(sds)), float(asked), "deg/s"
    return (max(sds), float(asked), "m/s²") if fit.sensor == Sensor.ACCEL else None


def _of_compass(fit: FitResult, name: str, key: str) -> list[Criterion]:
    found = []
    ratio, coverage = fit.quality.get("field_ratio"), fit.quality.get("coverage")
    if ratio is not None:
        off = abs(float(ratio) - 1.0)
        text = f"{name}: field {100 * float(ratio):.0f} % of the Earth's"
        remedy = "Go away from steel and magnets, and repeat it."
        found.append(_judged(f"{key}-field", (off, FIELD_WITHIN, ""), text, remedy, good=off <= FIELD_WITHIN))
    if coverage is not None:
        seen = float(coverage)
        text = f"{name}: {100 * seen:.0f} % of all directions seen"
        found.append(
            _judged(f"{key}-coverage", (seen, COVERED, ""), text, "Turn it about more axes.", good=seen >= COVERED)
        )
    return found
