"""Fits into a plan of writing: one function for every autopilot.

What the firmware cannot store, ignores or overwrites is said in the plan (losses and warnings); what must not be
written at all is a blocker. The plan is pure data; the service executes it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Final

from calib.errors import FirmwareError
from calib.firmware import compose_ardupilot, compose_px4
from calib.firmware.content import contents
from calib.firmware.draft import ComposeOptions, Draft, Subject
from calib.firmware.fitted import Pair, pair_fits, usable_fits
from calib.firmware.mag_ardupilot import compose_compasses
from calib.firmware.mag_motor import compose_motors
from calib.firmware.mag_px4 import compose_magnetometers
from calib.firmware.plan import Fingerprint, Value, WritePlan
from calib.firmware.trim import adjust_trim, compose_level
from calib.fit import FitResult
from calib.recording import Sensor

__all__ = ["ComposeOptions", "compose"]

Composer = Callable[[Draft, Sequence[Pair]], None]

DEFAULT_OPTIONS: Final = ComposeOptions()
COMPOSERS: Final[Mapping[str, tuple[Composer, Composer]]] = MappingProxyType(
    {
        "ardupilot": (compose_ardupilot.compose_imu, compose_compasses),
        "px4": (compose_px4.compose_imu, compose_magnetometers),
    }
)
"""By autopilot: for inertial sensors, for magnetometers."""


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
        With `blockers` where nothing may be written: values outside the limits or not finite, relative fits,
        parameters that the vehicle does not have or did not send.

    Raises
    ------
    FirmwareError
        If the autopilot is not known.
    """
    draft = Draft(parameters, options)
    usable = contents(usable_fits(draft, fits))
    pairs = pair_fits(usable.corrections)
    imu = [pair for pair in pairs if pair.about.sensor != Sensor.MAG]
    mags = [pair for pair in pairs if pair.about.sensor == Sensor.MAG]
    for fit in usable.others:
        draft.warn(f"{Subject(fit.sensor, fit.instance)} is left out: {fit.method} finds nothing that can be written")
    if fingerprint.autopilot not in COMPOSERS:
        raise FirmwareError(f"calibrations cannot be written to the autopilot {fingerprint.autopilot}")
    try:
        for composer, group in zip(COMPOSERS[fingerprint.autopilot], (imu, mags), strict=True):
            composer(draft, group)
        compose_motors(draft, fingerprint.autopilot, usable.motors)
    except FirmwareError as error:
        draft.block(str(error))
    adjust_trim(draft, fingerprint.autopilot, usable.corrections)
    compose_level(draft, fingerprint.autopilot, usable.levels)
    return draft.plan(fingerprint)
