"""A report as files of simulators and vehicles; the file name's ending selects the format."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import PurePath
from typing import Any

from mavcal.calib.airframe.answer import Domain
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.export import MAV_PARAM_TYPE, ParameterFormat, number, write_plan
from mavcal.calib.firmware.plan import ParameterKind
from mavcal.calib.gap.export.airframe import Patch, airframe_effects, airframe_patch, sih
from mavcal.calib.gap.export.airframe.patch import is_sih
from mavcal.calib.gap.export.documents import airframe_struct, to_document, to_matlab_text
from mavcal.calib.gap.export.gazebo import airframe_sdf, to_sdf
from mavcal.calib.gap.export.sensor_errors import doubt_text, named, sensor_effects
from mavcal.calib.gap.export.sitl import SitlPatch, older_names, patch
from mavcal.calib.gap.export.vehicle import vehicle_plan
from mavcal.calib.gap.schema import GapReport, GapVerdict
from mavcal.calib.recording import Recording


class Target(StrEnum):
    """The simulator or vehicle of a file."""

    SITL = "sitl"  # ArduPilot's simulator: SIM_*
    FRAME = "frame"  # the frame's file of ArduPilot's simulator
    SIH = "sih"  # PX4's simulation in hardware: SIH_*
    GAZEBO = "gazebo"  # SDF
    MATLAB = "matlab"  # imuSensor
    MAVCAL = "mavcal"  # mavcal simulate recording --params
    VEHICLE = "vehicle"  # the vehicle's own calibration


ENDINGS: Mapping[str, Target] = {
    ".parm": Target.SITL,
    ".param": Target.SITL,
    ".params": Target.SIH,
    ".sdf": Target.GAZEBO,
    ".m": Target.MATLAB,
    ".json": Target.MAVCAL,
}
"""Target by file ending, unless stated otherwise."""


@dataclass(frozen=True)
class Exported:
    """A file: its text, notes on what it cannot represent, and its doubtful effects."""

    text: str
    not_held: tuple[str, ...]
    doubtful: tuple[str, ...] = ()


def target_of(name: str, stated: str | None = None) -> Target:
    """Target of a file of that name; `stated` overrides the ending. JSON for ``sitl`` is a frame file.

    Raises
    ------
    InvalidInputError
        If nothing is stated and its ending says nothing.
    """
    suffix = PurePath(name).suffix.lower()
    if stated is not None:
        target = Target(stated)
        return Target.FRAME if target is Target.SITL and suffix == ".json" else target
    if suffix not in ENDINGS:
        raise InvalidInputError(
            f"{PurePath(name).name}: an export ends in {', '.join(ENDINGS)}, or --for says whom it is for"
        )
    return ENDINGS[suffix]


def exported(
    report: GapReport,
    real: Recording,
    target: Target,
    *,
    base: Mapping[str, float] | None = None,
    instance: int = 1,
    form: ParameterFormat = ParameterFormat.PARM,
    frame: Mapping[str, Any] | None = None,
    mass: float | None = None,
) -> Exported:
    """The effects of `report` as a file for `target`.

    Parameters
    ----------
    report, real
        A diagnosis and the recording that it is of.
    target
        Simulator or vehicle that reads the file.
    base
        Parameters of the simulator as it is (``SIM_*``, ``SIH_*``); None: a fresh one's.
    instance
        From 1, for targets whose file is of one instance.
    form
        Of parameter files for a vehicle.
    frame
        Keys of the frame file that ArduPilot's simulator was flown with; None: the stock frame.
    mass
        Of the real vehicle, kg; None: the simulator keeps its own, and forces are right as ratios to it.

    Raises
    ------
    InvalidInputError
        If there is nothing to export.
    FirmwareError
        If a plan for the vehicle cannot be made, or is blocked.
    """
    kept = tuple(e for e in report.effects if e.domain is not Domain.ENVIRONMENT)
    if not kept:
        why = "only the air differs" if report.effects else _WHY_NOT.get(report.verdict, "no effect was found")
        raise InvalidInputError(f"nothing to export: {why}")
    flying = airframe_effects(kept)
    if target in {Target.FRAME, Target.SIH} and not flying:
        raise InvalidInputError(f"nothing to export for {target}: no effect of the airframe was found")
    air = tuple(f"{named(e)}: the air of that day, no setting of a vehicle" for e in report.effects if e not in kept)
    doubtful = tuple(doubt_text(e) for e in kept if e.evidence.doubtful)
    found = replace(report, effects=sensor_effects(kept))
    match target:
        case Target.SITL | Target.FRAME | Target.SIH:
            patched = _airframe_patch(report, real, target, base, frame, mass)
            return Exported(*_of_simulator(found, target, base, frame, patched, air), doubtful)
        case Target.GAZEBO:
            (sensors, lost), (model, left) = to_sdf(found, instance=instance), airframe_sdf(flying, mass=mass)
            text = f"{sensors if found.effects else ''}{model if flying else ''}"
            return Exported(text, (*lost, *left, *air), doubtful)
        case Target.MATLAB:
            script, lost = to_matlab_text(found, instance=instance)
            struct, left = airframe_struct(flying, mass=mass)
            return Exported(script + struct, (*lost, *left, *air), doubtful)
        case Target.MAVCAL:
            document, lost = to_document(found, instance=instance)
            left = tuple(f"{named(e)}: mavcal simulate has sensors and no airframe" for e in flying)
            return Exported(document, (*lost, *left, *air), doubtful)
        case Target.VEHICLE:
            plan, left = vehicle_plan(replace(report, effects=kept), real)
            return Exported(write_plan(plan, form), (*left, *air))


def _airframe_patch(
    report: GapReport,
    real: Recording,
    target: Target,
    base: Mapping[str, float] | None,
    frame: Mapping[str, Any] | None,
    mass: float | None,
) -> Patch:
    """Airframe parameters for the simulator of `target`, without parameters of another one."""
    known = dict(base or {})
    if target is not Target.SIH:
        known = {name: v for name, v in known.items() if not name.startswith("SIH_")}
    elif not is_sih(known):
        known |= sih.DEFAULTS
    geometry = None if report.airframe is None else report.airframe.geometry
    return airframe_patch(report.effects, known, frame, geometry=geometry, mass=mass, vehicle=real.parameters.final())


def _of_simulator(
    found: GapReport,
    target: Target,
    base: Mapping[str, float] | None,
    frame: Mapping[str, Any] | None,
    patched: Patch,
    air: tuple[str, ...],
) -> tuple[str, tuple[str, ...]]:
    """The text of a simulator's file, and notes on what it cannot represent or another file contains."""
    if target is Target.SITL:
        sensors = patch(found, base)
        elsewhere = _elsewhere(patched.frame_json, "the frame's file (--for sitl, .json)")
        lost = (*sensors.not_held, *patched.lost, *elsewhere, *air)
        values = {**sensors.values, **patched.parameters}
        return sitl_text(SitlPatch(values, lost, (*sensors.notes, *patched.notes))), lost
    others = tuple(f"{named(e)}: this file is of the airframe" for e in found.effects)
    if target is Target.SIH:
        lost = (*patched.lost, *others, *air)
        return sih_text(patched, lost), lost
    elsewhere = _elsewhere(patched.parameters, "the parameter file (--for sitl, .parm)")
    lost = (*patched.lost, *elsewhere, *others, *air)
    stock = () if frame is not None else (STOCK_FRAME,)
    return frame_text({**(frame or {}), **patched.frame_json}, (*stock, *patched.notes), lost), lost


def _elsewhere(settings: Mapping[str, Any], where: str) -> tuple[str, ...]:
    return (f"{', '.join(settings)}: in {where}",) if settings else ()


STOCK_FRAME = "on top of the stock frame: where the simulator flew with another one, --sim-frame states it"
_WHY_NOT = {
    GapVerdict.NO_GAP: "there is no gap",
    GapVerdict.UNKNOWN: "no effect of the catalogue explains the gap",
    GapVerdict.REFERENCE: "no sensor could be compared with the reference",
    GapVerdict.NOT_TESTABLE: "these recordings could not be diagnosed",
}


def sitl_text(found: SitlPatch) -> str:
    """A parameter file that ArduPilot's simulator and the ground stations load."""
    head = ["# mavcal: sim-to-real gap as parameters of ArduPilot's simulator"]
    head += [f"# {text}" for text in found.notes]
    head += [f"# not held: {text}" for text in found.not_held]
    if any(older != name for older, name in zip(older_names(found.values), found.values, strict=True)):
        head.append("# ArduPilot 4.1 and older call SIM_MAG1_OFS, SIM_MAG1_DIA and SIM_MAG1_ODI without the 1")
    lines = [f"{name:<18} {number(v)}" for name, v in found.values.items()]
    return "\n".join([*(h.replace("\n", " ") for h in head), *lines]) + "\n"


def frame_text(keys: Mapping[str, Any], notes: tuple[str, ...] = (), lost: tuple[str, ...] = ()) -> str:
    """A frame file of ArduPilot's simulator (``--model quad:NAME.json``); ``#`` begins a comment there.

    The simulator takes what stands before the first brace for a comment.
    """
    head = ["# mavcal: sim-to-real gap of the airframe as the frame of ArduPilot's simulator"]
    head += [f"# {text}" for text in notes]
    head += [f"# not held: {text}" for text in lost]
    lines = [h.replace("\n", " ").replace("{", "(").replace("}", ")") for h in head]
    return "\n".join([*lines, json.dumps(keys, indent=4, allow_nan=False)]) + "\n"


def sih_text(found: Patch, lost: tuple[str, ...]) -> str:
    """A parameter file that QGroundControl loads into PX4's simulation in hardware."""
    head = ["# mavcal: sim-to-real gap of the airframe as parameters of PX4's simulation in hardware"]
    head += [f"# {text}" for text in found.notes]
    head += [f"# not held: {text}" for text in lost]
    kind = MAV_PARAM_TYPE[ParameterKind.REAL32]
    lines = [f"1\t1\t{name}\t{number(v)}\t{kind}" for name, v in found.parameters.items()]
    return "\n".join([*(h.replace("\n", " ") for h in head), *lines]) + "\n"
