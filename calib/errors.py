"""Everything that ``calib`` raises on purpose.

.. code-block:: text

    CalibError
    +-- InvalidInputError          what was handed in is not what it claims to be
    |   +-- UnreadableError        a file or a byte stream cannot be read as the stated format
    |   +-- IncomparableError      it is sound, and nothing in it says what was asked; names what would
    +-- UndeterminedError          the data do not determine what was asked; names the movement that would
    |   +-- NotConvergedError      an iteration did not settle on an answer
    +-- FirmwareError              an autopilot cannot take, hold or undo what was asked
    +-- ProcedureError             a procedure was driven in a way that it does not allow

The docstring of a class is its default message.
"""

from __future__ import annotations

import math


class CalibError(Exception):
    """The calibration could not be computed."""

    def __init__(self, message: str | None = None) -> None:
        super().__init__(message or self.__doc__)


class InvalidInputError(CalibError, ValueError):
    """The input is not valid: check its shape, its unit and that every number is finite."""


class UnreadableError(InvalidInputError):
    """The file cannot be read as a recording: give a table (.csv, .npz) or a telemetry log (.tlog)."""


class IncomparableError(InvalidInputError):
    """Nothing in the recording can be compared with a reference."""

    def __init__(self, message: str | None = None, *, need: str = "") -> None:
        super().__init__(f"{message}: {need}" if message and need else message)
        self.reason = message or self.__doc__ or ""
        """The reason alone, without the remedy."""
        self.need = need
        """The remedy."""


class UndeterminedError(CalibError):
    """The data do not determine the parameters that were asked for."""

    def __init__(self, message: str | None = None, *, missing: tuple[str, ...] = (), remedy: str = "") -> None:
        super().__init__(message)
        self.missing = missing
        """Names of the parameters that stay undetermined."""
        self.remedy = remedy
        """The movement or measurement that would determine them."""


class NotConvergedError(UndeterminedError):
    """The iteration did not settle: the data may hold an answer to a simpler question."""


class FirmwareError(CalibError):
    """The autopilot cannot hold this calibration."""


class ProcedureError(CalibError):
    """The procedure does not accept this answer at this step."""


def require_positive(value: float, name: str = "gravity") -> None:
    """Raise InvalidInputError unless `value` is a finite number above zero."""
    if not (math.isfinite(value) and value > 0.0):
        raise InvalidInputError(f"{name} must be positive, not {value}")
