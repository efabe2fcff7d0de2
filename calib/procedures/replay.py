"""A finished recording through a procedure: the same ticks as live, hence the same digits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from mavcal.calib.procedures.context import OperatorAnswer, ProcedureContext
from mavcal.calib.procedures.protocol import Done, GaveUp
from mavcal.calib.procedures.registry import create
from mavcal.calib.recording import Recording


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
