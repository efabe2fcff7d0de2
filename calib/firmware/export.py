"""Parameter files of the ground stations: written with nine digits or more.

=========  ===================================================================================================
.param     Mission Planner: ``NAME,VALUE``; ``#`` begins a comment
.parm      MAVProxy: ``NAME`` in 16 columns, a space, the value; ``#`` begins a comment
.params    QGroundControl: tabs between system, component, name, value and MAV_PARAM_TYPE (6 int32, 9 real32)
=========  ===================================================================================================

A float32 needs nine significant digits to come back bit by bit; ``%f`` destroys PX4's cubic terms of 1e-7. Old values
stand beside the new ones as comments, in a line of their own in QGroundControl's format, which knows no others.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.plan import Change, ParameterKind, Value, WritePlan


class ParameterFormat(StrEnum):
    """The file name's ending."""

    PARAM = "param"
    PARM = "parm"
    PARAMS = "params"


MAV_PARAM_TYPE: Final[Mapping[ParameterKind, int]] = MappingProxyType(
    {
        ParameterKind.UINT8: 1,
        ParameterKind.INT8: 2,
        ParameterKind.UINT16: 3,
        ParameterKind.INT16: 4,
        ParameterKind.UINT32: 5,
        ParameterKind.INT32: 6,
        ParameterKind.REAL32: 9,
    }
)


def number(value: Value) -> str:
    """Shortest text that reads back as the same float32, with nine significant digits where those are needed.

    >>> number(0.1), number(float(np.float32(0.1))), number(1310988), number(1e-7)
    ('0.1', '0.1', '1310988', '1e-07')
    """
    if isinstance(value, int):
        return str(value)
    single = np.float32(value)
    text = f"{float(value):.9g}"
    short = str(single)
    return short if np.float32(short) == single and len(short) < len(text) else text


def write_plan(plan: WritePlan, form: ParameterFormat) -> str:
    """The plan as a parameter file, session settings left out, in the order of writing.

    Raises
    ------
    FirmwareError
        If the plan is blocked: what may not be written is not handed out as a file either.
    """
    if plan.blockers:
        raise FirmwareError(f"the plan is blocked and not exported: {'; '.join(plan.blockers)}")
    changes = [c for c in plan.changes if not c.session]
    head = [
        f"# mavcal: {plan.fingerprint.autopilot} {plan.fingerprint.firmware}".rstrip(),
        f"# plan {plan.sha256}",
        f"# board {plan.fingerprint.uid or 'not known'}",
        *(f"# {sensor} has the device id {device}" for sensor, device in plan.fingerprint.device_ids),
        *(f"# {text}" for text in (*plan.warnings, *(loss.text for loss in plan.losses))),
    ]
    if form == ParameterFormat.PARAMS:
        head += ["# Onboard parameters", "#", "# Vehicle-Id Component-Id Name Value Type"]
    return "\n".join([*(h.replace("\n", " ") for h in head), *(_line(c, form) for c in changes)]) + "\n"


def write_export(plan: WritePlan, path: Path) -> None:
    """Write the plan to `path` in the format of its ending.

    Raises
    ------
    FirmwareError
        If the plan is blocked, or the ending is none of .param, .parm, .params.
    OSError
        If the file cannot be written.
    """
    path.write_text(write_plan(plan, _form_of(path)), encoding="utf-8")


def _form_of(path: Path) -> ParameterFormat:
    try:
        return ParameterFormat(path.suffix.removeprefix("."))
    except ValueError as error:
        raise FirmwareError(
            f"{path.name}: a parameter file ends in {', '.join(f'.{form}' for form in ParameterFormat)}"
        ) from error


def _comment(change: Change) -> str:
    old = "not listed" if change.old is None else number(change.old)
    spread = "" if change.sd is None else f", sd {change.sd:.3g}"
    return f"# was {old}{spread}: {change.why}"


def _line(change: Change, form: ParameterFormat) -> str:
    value, comment = number(change.new), _comment(change)
    match form:
        case ParameterFormat.PARAM:
            return f"{comment}\n{change.name},{value}"
        case ParameterFormat.PARM:
            return f"{change.name:<16} {value}  {comment}"
        case ParameterFormat.PARAMS:
            return f"{comment}\n1\t1\t{change.name}\t{value}\t{MAV_PARAM_TYPE[change.kind]}"
