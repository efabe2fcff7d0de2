"""Whether a sensor's fit agrees with the calibration in force: then nothing is written, least of all with a restart.

The whole change of a sensor (offset, scale or matrix, drift) is judged at once (:mod:`calib.firmware.significance`).

Three cases are written without this judgement: a sensor that was never calibrated; one whose id, rotation or
temperature reference is new; and a drift measured over a wider range than the one in force.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware import losses
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.compose.draft import Draft, Rank, Subject
from mavcal.calib.firmware.compose.fitted import InForce, Pair
from mavcal.calib.firmware.compose.px4_memory import placed
from mavcal.calib.firmware.names import OFFSET, Role
from mavcal.calib.firmware.plan import Agreement, Value
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.firmware.significance import Judged, agreed, within
from mavcal.calib.fit import FitResult
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import ThermalPolynomial, TriadModel

Array = NDArray[np.float64]
NEWS: Final = frozenset({Rank.ROTATION, Rank.ID})
"""A number of these ranks is no estimate that could agree."""
WIDER: Final = 1.0
"""degC by which a drift must be measured beyond the range in force to be written for that alone."""
UNKNOWN_TEMPERATURE: Final = -100.0
"""degC; ArduPilot's CALTEMP of -300 means unknown."""

IN_FORCE: Final[Mapping[str, InForce]] = MappingProxyType(
    {"ardupilot": ardupilot.calibration_in_force, "px4": px4.calibration_in_force}
)


def agreement(draft: Draft, autopilot: str, pair: Pair) -> Agreement | None:
    """That the sensor agrees with what is in force; None: it does not, or it cannot be told."""
    if draft.ranks(pair.about) & NEWS or _is_news(draft, autopilot, pair):
        return None
    try:
        old, new = (_model(draft, autopilot, p, pair.about) for p in (draft.parameters, draft.predicted))
    except FirmwareError:  # what is in force is not a calibration
        return None
    judged, name = [], str(pair.about)
    if pair.at_rest is not None:
        wanted = _at_rest(pair.at_rest, old, pair.at_rest.model)
        if within([wanted]) is None:  # what the firmware cannot hold may still differ
            wanted, name = _at_rest(pair.at_rest, old, new), f"what can be stored of {name}"
        judged.append(wanted)
    if pair.drift is not None:
        judged.append(_drift(pair.drift, old, new, whole=pair.absolute is pair.drift))
    return agreed(pair.about.sensor, pair.about.instance, name, judged)


def _model(draft: Draft, autopilot: str, parameters: Mapping[str, Value], about: Subject) -> TriadModel:
    of = placed(draft, about, parameters) if autopilot == "px4" else about
    return IN_FORCE[autopilot](parameters, of.sensor, of.instance)


def _is_news(draft: Draft, autopilot: str, pair: Pair) -> bool:
    """Whether the write says more than numbers: the first calibration, or the first known temperature."""
    about = pair.about
    if pair.absolute is None:
        return False
    module = ardupilot if autopilot == "ardupilot" else px4
    try:
        roles = module.calibration_names(draft.parameters, about.sensor, about.instance)
    except FirmwareError:
        return True
    offsets = [float(draft.parameters.get(roles[role], 0.0)) for role in OFFSET]
    if autopilot != "ardupilot":
        return False
    if about.sensor != Sensor.GYRO and not any(offsets):  # the firmware takes it as never calibrated
        return True
    name = roles.get(Role.TEMPERATURE, "")
    unknown = name in draft.parameters and not float(draft.parameters[name]) > UNKNOWN_TEMPERATURE
    return unknown and pair.absolute.temperature is not None


def _at_rest(fit: FitResult, old: TriadModel, new: TriadModel) -> Judged | None:
    """Offset and matrix, in the frame of the raw sensor; what the fit leaves open stays as it is."""
    if fit.temperature is None and (old.polynomial is not None or new.polynomial is not None):
        return None
    offset = _bias(new, fit.temperature) - _bias(old, fit.temperature)
    parts = losses.split(fit)
    before, after = (_elements(model) for model in (old, new))
    count = {Sensor.GYRO: 3, Sensor.ACCEL: 6}.get(fit.sensor, 9)
    change = np.concatenate([offset, after - before])[:count]
    kept = np.array([n in fit.undetermined for n in fit.names])[[0, 1, 2, 3, 7, 11, 4, 5, 8]][:count]
    return np.where(kept, 0.0, change), parts.covariance[:count, :count]


def _bias(model: TriadModel, temperature: float | None) -> Array:
    if model.polynomial is None or temperature is None:
        return model.offset
    return np.asarray(model.offset + model.polynomial(temperature))


def _elements(model: TriadModel) -> Array:
    """``S_xx S_yy S_zz S_xy S_xz S_yz`` of the symmetric part."""
    s = model.symmetric().matrix
    return np.array([s[0, 0], s[1, 1], s[2, 2], s[0, 1], s[0, 2], s[1, 2]])


def _drift(fit: FitResult, old: TriadModel, new: TriadModel, *, whole: bool) -> Judged | None:
    """Coefficients about the fit's reference, and the offset there if the fit says it (`whole`)."""
    measured, planned = fit.model.polynomial, new.polynomial
    if measured is None or planned is None:
        return None
    before = old.polynomial
    if before is not None and (measured.t_min < before.t_min - WIDER or measured.t_max > before.t_max + WIDER):
        return None
    degree = fit.degree
    change = (_about(planned, measured.t_ref, degree) - _about(before, measured.t_ref, degree)).ravel()
    covariance = fit.covariance[losses.POLYNOMIAL :, losses.POLYNOMIAL :]
    if whole:
        offset = _bias(new, measured.t_ref) - _bias(old, measured.t_ref)
        rows = np.r_[losses.OFFSETS, losses.POLYNOMIAL : len(fit.covariance)]
        change, covariance = np.concatenate([offset, change]), fit.covariance[np.ix_(rows, rows)]
    return change, covariance


def _about(polynomial: ThermalPolynomial | None, reference: float, degree: int) -> Array:
    """Coefficients (3, degree) of the powers about another reference, without the constant."""
    if polynomial is None:
        return np.zeros((3, degree))
    moved = Polynomial([reference - polynomial.t_ref, 1.0])
    rows = []
    for row in polynomial.coefficients:
        found = Polynomial([0.0, *row])(moved).coef[1:]
        rows.append(np.pad(found, (0, max(0, degree - len(found))))[:degree])
    return np.array(rows)
