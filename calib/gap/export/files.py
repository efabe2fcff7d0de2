"""A report into the files of simulators and vehicles; the ending of a name says which."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import PurePath

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.export import ParameterFormat, number, write_plan
from mavcal.calib.gap.export.documents import to_document, to_matlab_text
from mavcal.calib.gap.export.gazebo import to_sdf
from mavcal.calib.gap.export.sitl import SitlPatch, older_names, patch
from mavcal.calib.gap.export.state import doubt_text
from mavcal.calib.gap.export.vehicle import vehicle_plan
from mavcal.calib.gap.schema import GapReport, GapVerdict
from mavcal.calib.recording import Recording


class Target(StrEnum):
    """Who the file is for."""

    SITL = "sitl"  # ArduPilot's simulator: SIM_*
    GAZEBO = "gazebo"  # SDF
    MATLAB = "matlab"  # imuSensor
    MAVCAL = "mavcal"  # mavcal simulate recording --params
    VEHICLE = "vehicle"  # the vehicle's own calibration


ENDINGS: Mapping[str, Target] = {
    ".parm": Target.SITL,
    ".param": Target.SITL,
    ".sdf": Target.GAZEBO,
    ".m": Target.MATLAB,
    ".json": Target.MAVCAL,
}
"""What a file is for where nothing else is said."""


@dataclass(frozen=True)
class Exported:
    """One file: its text, in words what it cannot hold, and which effects in it are less likely than something else."""

    text: str
    not_held: tuple[str, ...]
    doubtful: tuple[str, ...] = ()


def target_of(name: str) -> Target:
    """Whom a file of that name is for.

    Raises
    ------
    InvalidInputError
        If its ending says nothing.
    """
    suffix = PurePath(name).suffix.lower()
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
) -> Exported:
    """The effects of `report` as a file for `target`.

    Parameters
    ----------
    report, real
        A diagnosis and the recording that it is of.
    target
        Whom the file is for.
    base
        ``SIM_*`` of the simulator as it is; None: a fresh one's.
    instance
        From 1, for targets whose file is of one instance.
    form
        Of parameter files for a vehicle.

    Raises
    ------
    InvalidInputError
        If there is nothing to export.
    FirmwareError
        If a plan for the vehicle cannot be made, or is blocked.
    """
    if not report.effects:
        raise InvalidInputError(f"nothing to export: {_WHY_NOT.get(report.verdict, 'no effect was found')}")
    doubtful = tuple(doubt_text(e) for e in report.effects if e.evidence.doubtful)
    match target:
        case Target.SITL:
            found = patch(report, base)
            return Exported(sitl_text(found), found.not_held, doubtful)
        case Target.GAZEBO:
            snippet = to_sdf(report, instance=instance)
            return Exported(snippet.text, snippet.not_held, doubtful)
        case Target.MATLAB:
            script = to_matlab_text(report, instance=instance)
            return Exported(script.text, script.not_held, doubtful)
        case Target.MAVCAL:
            document = to_document(report, instance=instance)
            return Exported(document.text, document.not_held, doubtful)
        case Target.VEHICLE:
            plan, left = vehicle_plan(report, real)
            return Exported(write_plan(plan, form), left)


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
