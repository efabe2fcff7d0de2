"""Every procedure by the name of its job."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.procedures.base import TickedProcedure
from mavcal.calib.procedures.protocol import Done, GaveUp
from mavcal.calib.procedures.spec import OperatorAnswer, Options, ProcedureContext, ProcedureSpec
from mavcal.calib.recording import Recording

_CLASSES: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "gyro": ("gyro", "GyroProcedure"),
        "accel": ("accel", "AccelProcedure"),
        "mag": ("mag", "MagProcedure"),
        "thermal": ("thermal", "ThermalProcedure"),
        "level": ("level", "LevelProcedure"),
        "accel-one-axis": ("one_axis", "AccelOneAxisProcedure"),
        "accel-six-face": ("six_face", "AccelSixFaceProcedure"),
        "mag-rings": ("rings", "MagRingsProcedure"),
        "mag-fixed-yaw": ("fixed_yaw", "MagFixedYawProcedure"),
        "gyro-turntable": ("turntable", "GyroTurntableProcedure"),
        "gyro-thread": ("thread", "GyroThreadProcedure"),
        "imu-multi": ("imu", "ImuProcedure"),
    }
)
"""Module and class of every kind of job, loaded on demand with the fits that it needs."""


class _Procedures(Mapping[str, ProcedureSpec]):
    def __getitem__(self, kind: str) -> ProcedureSpec:
        return _loaded(kind).spec

    def __iter__(self) -> Iterator[str]:
        return iter(_CLASSES)

    def __len__(self) -> int:
        return len(_CLASSES)


PROCEDURES: Mapping[str, ProcedureSpec] = _Procedures()
"""Specification of every kind of job."""
LIBRARIES = ("scipy.linalg", "scipy.special", "scipy.spatial.transform")


def load_libraries() -> None:
    """Load the numerical libraries of the fits: half a second of processor time, and several on a busy host.

    Otherwise they are loaded at their first use, while somebody waits for a result.
    """
    for name in LIBRARIES:
        importlib.import_module(name)


def load_procedures() -> None:
    """Load every procedure, so that a running service does not pause for it later."""
    for kind in _CLASSES:
        _loaded(kind)


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
    if kind in _CLASSES:
        return _loaded(kind)
    for candidate in map(_loaded, _CLASSES):
        if kind in candidate.spec.aliases:
            return candidate
    raise InvalidInputError(f"there is no procedure {kind!r}; known are: {', '.join(PROCEDURES)}")


def _loaded(kind: str) -> type[TickedProcedure]:
    module, name = _CLASSES[kind]
    found: type[TickedProcedure] = getattr(importlib.import_module(f"mavcal.calib.procedures.{module}"), name)
    return found


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
