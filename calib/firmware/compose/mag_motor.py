"""Turns the motors' field at a compass into parameters, and judges those in force (FLIGHT_CONTROLLERS 1.3, 1.4).

=========  =================================================================================================
ArduPilot  ``c = M (s (R m + OFS)) + MOT * drive``: *added* behind the matrix, body axes, mGauss per A (COMPASS_MOTCT 2)
           or per throttle 0..1 (COMPASS_MOTCT 1); one kind for all compasses
PX4        ``b = L R S (m + drive * COMP - OFF)``: *added* before offset and matrix, sensor axes, Gauss per kA
           (CAL_MAG_COMP_TYP 2) or per thrust 0..1 (1); one kind for all magnetometers
=========  =================================================================================================

A fit says what the motors add behind the correction in force (`interference`, body axes); the parameter is minus that.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware import names
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.ardupilot.parameters import UT_PER_MGAUSS
from mavcal.calib.firmware.compose.draft import Draft, Rank, Subject
from mavcal.calib.firmware.names import Role
from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.firmware.px4.parameters import UT_PER_GAUSS
from mavcal.calib.fit import AXES, FitResult
from mavcal.calib.mag.motor_drives import METHOD
from mavcal.calib.recording import Array, ParameterTimeline, Sensor

ARDUPILOT_KINDS: Final[Mapping[str, int]] = {"throttle": 1, "current": 2}
PX4_KINDS: Final[Mapping[str, int]] = {"throttle": 1, "current": 2}
AMPERES_PER_KILOAMPERE: Final = 1000.0
ABSURD_MGAUSS: Final = 1000.0
"""Largest plausible COMPASS_MOT, documented as -1000 to 1000 mGauss; twice the Earth's field per ampere is
implausible."""
ABSURD_GAUSS: Final = {1: 10.0, 2: 1000.0, 3: 1000.0}
"""Largest plausible compensation by CAL_MAG_COMP_TYP: twenty times the Earth's field at full thrust, or at one
ampere."""


def is_motor(fit: FitResult) -> bool:
    """Whether `fit` is of the motors' field."""
    return fit.method == METHOD


def compensated(autopilot: str, parameters: Mapping[str, Value], instance: int) -> bool:
    """Whether the parameters in force compensate compass `instance` for the motors' field."""
    module = ardupilot if autopilot == "ardupilot" else px4
    try:
        roles = module.calibration_names(parameters, Sensor.MAG, instance)
    except FirmwareError:
        return False
    kind = float(parameters.get(roles.get(Role.MOTOR_TYPE, ""), 0.0))
    return kind != 0.0 and any(float(parameters.get(roles.get(role, ""), 0.0)) != 0.0 for role in names.MOTOR)


def corrupt_compensation(autopilot: str | None, timeline: ParameterTimeline, instance: int) -> str:
    """A sentence that names the corrupt parameters of compass `instance`; empty: none is corrupt.

    A compensation that is not a number makes the reading NaN, or zero, as soon as the motors run.
    """
    if autopilot not in {"ardupilot", "px4"} or not timeline:
        return ""
    bad: dict[str, float] = {}
    for parameters in (timeline.at(-math.inf), timeline.final()):
        bad |= _bad(autopilot, parameters, instance)
    if not bad:
        return ""
    listed = ", ".join(f"{name} = {value:g}" for name, value in bad.items())
    return (
        f"corrupt parameters in force for compass {instance + 1}: {listed}. What it reads is spoilt by them as soon as "
        "the motors run, and no interference can be told from that: set them to 0 (or recover them) and fly again"
    )


def _bad(autopilot: str, parameters: Mapping[str, Value], instance: int) -> dict[str, float]:
    module = ardupilot if autopilot == "ardupilot" else px4
    try:
        roles = module.calibration_names(parameters, Sensor.MAG, instance)
    except FirmwareError:
        return {}
    kind = float(parameters.get(roles.get(Role.MOTOR_TYPE, ""), 0))
    found = {}
    for role in (*names.OFFSET, *names.SCALE, *names.CROSS, *names.MOTOR):
        value = parameters.get(roles.get(role, ""))
        if value is None:
            continue
        number = float(value)
        absurd = role in names.MOTOR and kind != 0 and abs(number) > _absurd(autopilot, kind)
        if not math.isfinite(number) or absurd:
            found[roles[role]] = number
    return found


def _absurd(autopilot: str, kind: float) -> float:
    if not math.isfinite(kind):
        return 0.0
    return ABSURD_MGAUSS if autopilot == "ardupilot" else ABSURD_GAUSS.get(int(kind), math.inf)


def compose_motors(draft: Draft, autopilot: str, fits: Sequence[FitResult]) -> None:
    """Plan the compensation of every compass among `fits` (of :data:`calib.mag.motor.METHOD`), and its kind."""
    if not fits:
        return
    kinds = ARDUPILOT_KINDS if autopilot == "ardupilot" else PX4_KINDS
    proposed = [fit for fit in fits if fit.native["proposed"]]
    for fit in proposed:
        if fit.unit != "uT":
            draft.block(f"{Subject(fit.sensor, fit.instance)}: the fit is in {fit.unit}, parameters are in gauss")
            return
    kind = _kind(draft, proposed, kinds)
    module = ardupilot if autopilot == "ardupilot" else px4
    for fit in fits:
        about = Subject(fit.sensor, fit.instance)
        roles = module.calibration_names(draft.parameters, Sensor.MAG, fit.instance)
        candidate = _candidate(fit, kind) if fit.native["proposed"] and kind is not None else None
        term = np.zeros(3) if candidate is None else _parameter(draft, module, fit, np.array(candidate["interference"]))
        if autopilot == "px4":
            term = term * (AMPERES_PER_KILOAMPERE if kind == "current" else 1.0) / UT_PER_GAUSS
        else:
            term = term / UT_PER_MGAUSS
        _set(draft, about, roles, term, _unit(autopilot, kind), candidate is not None)
    _set_kind(draft, module, kind, kinds, {fit.instance for fit in fits})


def _kind(draft: Draft, proposed: Sequence[FitResult], kinds: Mapping[str, int]) -> str | None:
    """The storable kind that predicts hidden data best, over all compasses; None: nothing to compensate."""
    if not proposed:
        return None

    def cost(kind: str) -> float:
        found = 0.0
        for fit in proposed:
            candidate, before = _candidate(fit, kind), fit.native["held_out_rms_before"]
            found += 1.0 if candidate is None else min((candidate["held_out_rms"] / before) ** 2, 1.0)
        return found

    best = min(kinds, key=cost)
    for fit in proposed:
        if fit.native["drive"] == best:
            continue
        about = Subject(fit.sensor, fit.instance)
        candidate = _candidate(fit, best)
        left = fit.native["held_out_rms_before"] if candidate is None else candidate["held_out_rms"]
        cost_ut = max(left - fit.native["held_out_rms_after"], 0.0)
        draft.lose(
            about,
            "motor compensation",
            cost_ut,
            "uT",
            f"{about}: best against {fit.native['drive']}, which cannot be stored beside the others; written against "
            f"{best}: {cost_ut:.2g} uT more stay in hidden parts of the flight",
        )
    return best if cost(best) < len(proposed) else None


def _candidate(fit: FitResult, kind: str) -> Mapping[str, Any] | None:
    """The term of that kind if hidden parts of the flight support it; None: they do not."""
    candidate: Mapping[str, Any] | None = fit.native["candidates"].get(kind)
    return candidate if candidate is not None and candidate["proposed"] else None


def _parameter(draft: Draft, module: object, fit: FitResult, interference: Array) -> Array:
    """Compensation to write, uT per unit: minus the interference, carried to the calibration that will be in force."""
    at_sensor = np.linalg.solve(fit.model.matrix, -interference)
    if module is px4:
        return np.asarray(at_sensor)
    future = ardupilot.calibration_in_force(draft.predicted, Sensor.MAG, fit.instance)
    return np.asarray(future.matrix @ at_sensor)


def _unit(autopilot: str, kind: str | None) -> str:
    if autopilot == "ardupilot":
        return "mGauss/A" if kind == "current" else "mGauss"
    return "gauss/kA" if kind == "current" else "gauss"


def _set(draft: Draft, about: Subject, roles: Mapping[Role, str], term: Array, unit: str, wanted: bool) -> None:
    for axis, role in enumerate(names.MOTOR):
        draft.set_real(
            roles[role],
            float(term[axis]),
            Rank.SETTING,
            f"takes the motors' field off {about}, {AXES[axis]} axis (added)"
            if wanted
            else f"no motor compensation helps {about} on unseen data",
            about=about,
            unit=unit,
        )


def _set_kind(draft: Draft, module: object, kind: str | None, kinds: Mapping[str, int], planned: set[int]) -> None:
    name = "COMPASS_MOTCT" if module is ardupilot else "CAL_MAG_COMP_TYP"
    old = int(draft.parameters.get(name, 0))
    new = 0 if kind is None else kinds[kind]
    if kind is None and old == 0:
        return
    others = _unplanned_compasses(draft, module, planned)
    if others and old not in (0, new):
        listed = ", ".join(str(i + 1) for i in others)
        draft.block(
            f"{name} would change from {old} to {new} for every compass. Compass {listed} is not part of this plan and "
            "keeps a compensation in the old unit. Fit it too, or set its compensation to 0"
        )
        return
    draft.set_integer(
        name, new, Rank.SETTING, "no compass needs compensation" if kind is None else f"compensate against {kind}"
    )


def _unplanned_compasses(draft: Draft, module: object, planned: set[int]) -> list[int]:
    """Compasses outside the plan that have a compensation."""
    ids = ardupilot.sensor_ids(draft.parameters) if module is ardupilot else px4.sensor_ids(draft.parameters)
    found = []
    for sensor, instance in ids:
        if sensor != Sensor.MAG or instance in planned:
            continue
        of = ardupilot if module is ardupilot else px4
        roles = of.calibration_names(draft.parameters, Sensor.MAG, instance)
        if any(float(draft.parameters.get(roles[role], 0.0)) for role in names.MOTOR):
            found.append(instance)
    return found
