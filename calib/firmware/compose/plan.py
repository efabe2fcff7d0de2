"""Turns fits into a write plan for either autopilot.

Losses and warnings of the plan state what the firmware cannot store, ignores or overwrites; values that must not be
written are blockers. The plan is pure data; the service executes it.

A sensor whose fit agrees with the calibration in force is not written, particularly if that needs a restart. Its whole
change (offset, scale or matrix, drift) is judged at once (:mod:`calib.firmware.significance`). Some sensors are not
judged: those never calibrated, and those whose id, rotation or temperature reference is new. Nor is a drift measured
over a wider range than the one in force.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.polynomial import Polynomial

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware import losses
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.compose import ardupilot as compose_ardupilot
from mavcal.calib.firmware.compose import px4 as compose_px4
from mavcal.calib.firmware.compose.ardupilot_mag import compose_compasses
from mavcal.calib.firmware.compose.draft import INTEGERS, Draft, Rank, Subject
from mavcal.calib.firmware.compose.fitted import InForce, Pair, contents, pair_fits, usable_fits
from mavcal.calib.firmware.compose.mag_motor import compose_motors
from mavcal.calib.firmware.compose.px4_mag import compose_magnetometers
from mavcal.calib.firmware.compose.px4_memory import placed
from mavcal.calib.firmware.compose.trim import adjust_trim, compose_level
from mavcal.calib.firmware.names import OFFSET, Role
from mavcal.calib.firmware.options import ComposeOptions, to_confirm, unknown_keys
from mavcal.calib.firmware.plan import Agreement, Fingerprint, LeftOut, Loss, Value, WritePlan
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.firmware.significance import Judged, agreed, within
from mavcal.calib.fit import FitResult
from mavcal.calib.recording import Array, Sensor
from mavcal.calib.triad import ThermalPolynomial, TriadModel

__all__ = ["ComposeOptions", "compose", "unwritable"]
Composer = Callable[[Draft, Sequence[Pair]], None]
DEFAULT_OPTIONS: Final = ComposeOptions()
COMPOSERS: Final[Mapping[str, tuple[Composer, Composer]]] = MappingProxyType(
    {
        "ardupilot": (compose_ardupilot.compose_imu, compose_compasses),
        "px4": (compose_px4.compose_imu, compose_magnetometers),
    }
)
"""By autopilot: for inertial sensors, for magnetometers."""
NAMES: Final = MappingProxyType({"ardupilot": ardupilot.calibration_names, "px4": px4.calibration_names})
NEWS: Final = frozenset({Rank.ROTATION, Rank.ID})
"""Ranks of values that are not estimates and cannot agree."""
WIDER: Final = 1.0
"""degC by which a drift must be measured beyond the range in force to be written for that alone."""
UNKNOWN_TEMPERATURE: Final = -100.0
"""degC; ArduPilot's CALTEMP of -300 means unknown."""
IN_FORCE: Final[Mapping[str, InForce]] = MappingProxyType(
    {"ardupilot": ardupilot.calibration_in_force, "px4": px4.calibration_in_force}
)


def compose(
    fits: Sequence[FitResult],
    parameters: Mapping[str, Value],
    fingerprint: Fingerprint,
    *,
    options: ComposeOptions = DEFAULT_OPTIONS,
) -> WritePlan:
    """Plan the parameters with which the vehicle corrects by `fits`.

    Parameters
    ----------
    fits
        Fits of raw recordings (the calibration in force undone), every sensor and instance that was calibrated.
    parameters
        The vehicle's present parameters, on which the plan is based.
    fingerprint
        Whose plan it is.
    options
        What the operator decided.

    Returns
    -------
    WritePlan
        A sensor that cannot be written is left out with a warning; if nothing remains, the plan has `blockers`. Reasons
        are values outside the limits or not finite, a relative fit, or parameters that the vehicle does not have. A
        sensor whose change is smaller than its uncertainty is left as it is (`agreements`).

    Raises
    ------
    FirmwareError
        If the autopilot is not known.
    """
    if fingerprint.autopilot not in COMPOSERS:
        raise FirmwareError(f"calibrations cannot be written to the autopilot {fingerprint.autopilot}")
    return _Composition(fits, parameters, fingerprint, options).plan()


def unwritable(
    fits: Sequence[FitResult],
    parameters: Mapping[str, Value],
    fingerprint: Fingerprint,
    *,
    options: ComposeOptions = DEFAULT_OPTIONS,
) -> tuple[str, ...]:
    """Reasons against writing some of `fits`, one sentence each; arguments as for :func:`compose`."""
    composition = _Composition(fits, parameters, fingerprint, options)
    composition.plan()
    return composition.unwritable


class _Composition:
    """Drafts again without the sensors that cannot be written, and without those that agree with what is in force."""

    def __init__(
        self,
        fits: Sequence[FitResult],
        parameters: Mapping[str, Value],
        fingerprint: Fingerprint,
        options: ComposeOptions,
    ) -> None:
        self._fits, self._parameters = fits, parameters
        self._fingerprint, self._options = fingerprint, options
        self._left: dict[Subject, tuple[str, ...]] = {}
        self._losses: list[Loss] = []
        self._agreed: dict[Subject, Agreement] = {}
        self._level: Agreement | None = None
        self.unwritable: tuple[str, ...] = ()
        """Reasons for sensors that a finished plan leaves out, wholly or in part."""

    def plan(self) -> WritePlan:
        while True:
            draft, pairs = self._draft()
            refused = {about: texts for about, texts in draft.refused.items() if about not in self._left}
            if refused:
                self._left |= refused
                self._keep_losses(draft, refused)
                continue
            agreed = {pair.about: agreement(draft, self._fingerprint.autopilot, pair) for pair in pairs}
            found = {about: agrees for about, agrees in agreed.items() if agrees is not None}
            if not found:
                return self._finished(draft)
            self._keep_losses(draft, found)
            self._agreed |= found

    def _keep_losses(self, draft: Draft, of: Mapping[Subject, object]) -> None:
        self._losses += [loss for loss in draft.losses if Subject(loss.sensor, loss.instance) in of]

    def _draft(self) -> tuple[Draft, tuple[Pair, ...]]:
        """Everything that is still to be written, and the sensors in it that could agree."""
        autopilot = self._fingerprint.autopilot
        draft = Draft(self._parameters, self._options, INTEGERS[autopilot])
        usable = contents(usable_fits(draft, self._chosen(draft)))
        pairs = tuple(pair for pair in pair_fits(usable.corrections) if self._named(draft, pair))
        imu = [pair for pair in pairs if pair.about.sensor != Sensor.MAG]
        mags = [pair for pair in pairs if pair.about.sensor == Sensor.MAG]
        try:
            for composer, group in zip(COMPOSERS[autopilot], (imu, mags), strict=True):
                composer(draft, group)
            compose_motors(draft, autopilot, usable.motors)
        except FirmwareError as error:
            draft.block(str(error))
        if autopilot == "ardupilot":
            self._boot(draft, imu)
        adjust_trim(draft, autopilot, usable.corrections)
        self._level = compose_level(draft, autopilot, usable.levels)
        for fit in usable.others:
            about = Subject(fit.sensor, fit.instance)
            draft.warn(f"{about} is left out: {fit.method} finds nothing that can be written")
        return draft, tuple(p for p in pairs if p.about not in draft.dropped)

    def _chosen(self, draft: Draft) -> list[FitResult]:
        """The fits that the operator asked for, without those that are left out already."""
        there = [Subject(fit.sensor, fit.instance) for fit in self._fits]
        wrong = unknown_keys(self._options.only, [(a.sensor, a.instance) for a in there])
        if wrong:
            draft.block(wrong)
        asked = self._options.only or [(a.sensor, a.instance) for a in there]
        out = {*self._left, *self._agreed}
        return [
            fit
            for fit, about in zip(self._fits, there, strict=True)
            if (about.sensor, about.instance) in asked and about not in out
        ]

    def _named(self, draft: Draft, pair: Pair) -> bool:
        """Whether the autopilot has parameters for that sensor."""
        try:
            NAMES[self._fingerprint.autopilot](self._parameters, pair.about.sensor, pair.about.instance)
        except FirmwareError as error:
            draft.block(str(error), pair.about)
            return False
        return True

    def _boot(self, draft: Draft, pairs: Sequence[Pair]) -> None:
        planned = any(p.about.sensor == Sensor.GYRO and p.absolute is not None for p in pairs)
        if planned or any(about.sensor == Sensor.GYRO for about in self._agreed):
            compose_ardupilot.boot_calibration(draft, planned=planned)

    def _finished(self, draft: Draft) -> WritePlan:
        """The plan with its omissions; where nothing remains, they become its blocker."""
        left = [text for texts in self._left.values() for text in texts]
        self.unwritable = tuple(dict.fromkeys((*left, *draft.dropped.values())))
        agreements = [*self._agreed.values(), *([self._level] if self._level is not None else [])]
        if self._options.unproved_origin:
            self._ask_for_origin(draft)
        for agrees in agreements:
            draft.warn(agrees.text)
        draft.losses_of(self._losses)
        for about, texts in self._left.items():
            for text in texts:
                if draft.changes:
                    draft.warn(f"{about} is left out: {text.removeprefix(f'{about}: ')}")
                else:
                    draft.block(text)
        if not (draft.changes or agreements or self._left):
            why = "; ".join(draft.dropped.values()) or "; ".join(loss.text for loss in draft.losses)
            draft.block(f"there is nothing to write: {why or 'no sensor has a usable fit'}")
        return draft.plan(self._fingerprint, agreements, self._left_out(draft))

    def _left_out(self, draft: Draft) -> list[LeftOut]:
        """Sensors that the operator asked for and that are not written, or in part only."""
        why = {about: "; ".join(texts) for about, texts in self._left.items()}
        for about, text in draft.left_out.items():
            why.setdefault(about, text)
        found = []
        for about, text in sorted(why.items(), key=lambda item: (item[0].sensor, item[0].instance)):
            reason = text.removeprefix(str(about)).removeprefix(" is left out").lstrip(": ")
            found.append(LeftOut(about.sensor, about.instance, reason))
        return found

    def _ask_for_origin(self, draft: Draft) -> None:
        if self._options.confirm_other_unit:
            draft.warn(
                f"{self._options.unproved_origin}; the operator has confirmed that it is of this vehicle", first=True
            )
        else:
            draft.block(f"{self._options.unproved_origin}. {to_confirm('confirm_other_unit')}")


def agreement(draft: Draft, autopilot: str, pair: Pair) -> Agreement | None:
    """Agreement of the sensor with the calibration in force; None: it differs, or this is unknown."""
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
    """Whether the write is the first calibration, or states the first known temperature."""
    about = pair.about
    if pair.absolute is None:
        return False
    try:
        roles = NAMES[autopilot](draft.parameters, about.sensor, about.instance)
    except FirmwareError:
        return True
    if autopilot != "ardupilot":
        return False
    offsets = [float(draft.parameters.get(roles[role], 0.0)) for role in OFFSET]
    if about.sensor != Sensor.GYRO and not any(offsets):  # the firmware takes it as never calibrated
        return True
    name = roles.get(Role.TEMPERATURE, "")
    unknown = name in draft.parameters and not float(draft.parameters[name]) > UNKNOWN_TEMPERATURE
    return unknown and pair.absolute.temperature is not None


def _at_rest(fit: FitResult, old: TriadModel, new: TriadModel) -> Judged | None:
    """Change of offset and matrix, in the raw sensor frame; undetermined values are unchanged."""
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
    """Change of the coefficients about the fit's reference, and of the offset there if determined (`whole`)."""
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
