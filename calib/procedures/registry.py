"""Every procedure by the name of its job."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.procedures.accel import AccelProcedure
from mavcal.calib.procedures.base import TickedProcedure
from mavcal.calib.procedures.context import OperatorAnswer, ProcedureContext
from mavcal.calib.procedures.fixed_yaw import MagFixedYawProcedure
from mavcal.calib.procedures.gyro import GyroProcedure
from mavcal.calib.procedures.imu import ImuProcedure
from mavcal.calib.procedures.level import LevelProcedure
from mavcal.calib.procedures.mag import MagProcedure
from mavcal.calib.procedures.one_axis import AccelOneAxisProcedure
from mavcal.calib.procedures.protocol import Done, GaveUp
from mavcal.calib.procedures.rings import MagRingsProcedure
from mavcal.calib.procedures.six_face import AccelSixFaceProcedure
from mavcal.calib.procedures.spec import Options, ProcedureSpec
from mavcal.calib.procedures.thermal import ThermalProcedure
from mavcal.calib.procedures.thread import GyroThreadProcedure
from mavcal.calib.procedures.turntable import GyroTurntableProcedure
from mavcal.calib.recording import Recording

_CLASSES: tuple[type[TickedProcedure], ...] = (
    GyroProcedure,
    AccelProcedure,
    MagProcedure,
    ThermalProcedure,
    LevelProcedure,
    AccelOneAxisProcedure,
    AccelSixFaceProcedure,
    MagRingsProcedure,
    MagFixedYawProcedure,
    GyroTurntableProcedure,
    GyroThreadProcedure,
    ImuProcedure,
)
PROCEDURES: Mapping[str, ProcedureSpec] = MappingProxyType({c.spec.kind: c.spec for c in _CLASSES})
"""Specification of every kind of job."""
LIBRARIES = ("scipy.linalg", "scipy.special", "scipy.spatial.transform")


def load_libraries() -> None:
    """Load what fits compute with: half a second of a processor, and several where it is busy.

    They are loaded at their first use otherwise, which is when somebody waits for a result.
    """
    for name in LIBRARIES:
        importlib.import_module(name)


def specification(kind: str) -> ProcedureSpec:
    """The specification of `kind` (or of one of its other names).

    Raises
    ------
    InvalidInputError
        If there is no such procedure.
    """
    return _class_of(kind).spec


def validate_options(kind: str, options: Mapping[str, Any]) -> Options:
    """Every option of `kind`, defaults filled in.

    Raises
    ------
    InvalidInputError
        If the kind or an option is unknown, or a value is out of its limits.
    """
    return specification(kind).validated(options)


def create(kind: str, options: Mapping[str, Any], context: ProcedureContext) -> TickedProcedure:
    """A new run of the procedure `kind`.

    Raises
    ------
    InvalidInputError
        If the kind or an option is unknown, or a value is out of its limits.
    """
    return _class_of(kind)(validate_options(kind, options), context)


def _class_of(kind: str) -> type[TickedProcedure]:
    for candidate in _CLASSES:
        if kind == candidate.spec.kind or kind in candidate.spec.aliases:
            return candidate
    raise InvalidInputError(f"there is no procedure {kind!r}; known are: {', '.join(PROCEDURES)}")


def replay(
    kind: str,
    options: Mapping[str, Any],
    context: ProcedureContext,
    recording: Recording,
    answers: Sequence[OperatorAnswer] = (),
) -> Done | GaveUp:
    """Run the procedure `kind` over a raw `recording` (calibration in force undone).

    `answers` are what the operator answered, each stamped with the procedure's `time` when it came.

    Raises
    ------
    InvalidInputError
        If `kind` or an option is unknown.
    """
    procedure = create(kind, options, context)
    procedure.schedule(answers)
    procedure.feed(recording)
    procedure.end()
    assert procedure.outcome is not None
    return procedure.outcome
