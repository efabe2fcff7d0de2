"""Fits into a plan of writing: one function for every autopilot.

What the firmware cannot store, ignores or overwrites is said in the plan (losses and warnings); what must not be
written at all is a blocker. The plan is pure data; the service executes it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Final

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.compose import ardupilot as compose_ardupilot
from mavcal.calib.firmware.compose import px4 as compose_px4
from mavcal.calib.firmware.compose.agreement import agreement
from mavcal.calib.firmware.compose.ardupilot_mag import compose_compasses
from mavcal.calib.firmware.compose.content import contents
from mavcal.calib.firmware.compose.draft import Draft, Subject
from mavcal.calib.firmware.compose.fitted import Pair, pair_fits, usable_fits
from mavcal.calib.firmware.compose.mag_motor import compose_motors
from mavcal.calib.firmware.compose.px4_mag import compose_magnetometers
from mavcal.calib.firmware.compose.trim import adjust_trim, compose_level
from mavcal.calib.firmware.options import ComposeOptions, to_confirm, unknown_keys
from mavcal.calib.firmware.plan import Agreement, Fingerprint, LeftOut, Loss, Value, WritePlan
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.fit import FitResult
from mavcal.calib.recording import Sensor

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


def compose(
    fits: Sequence[FitResult],
    parameters: Mapping[str, Value],
    fingerprint: Fingerprint,
    *,
    options: ComposeOptions = DEFAULT_OPTIONS,
) -> WritePlan:
    """Plan what to write so that the vehicle corrects as `fits` say.

    Parameters
    ----------
    fits
        Fits of raw recordings (the calibration in force undone), every sensor and instance that was calibrated.
    parameters
        The vehicle's parameters as they are now: the plan rests on them.
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
    """Why some of `fits` could not be written, one sentence a reason; arguments as for :func:`compose`."""
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
        """Why sensors are left out, wholly or in part, once the plan was made."""

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
        draft, autopilot = Draft(self._parameters, self._options), self._fingerprint.autopilot
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
        """The plan with what was left out said in it; where nothing remains, that is what stands against it."""
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
