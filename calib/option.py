"""What may be set before a method or a procedure runs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real
from typing import Any, Final

from mavcal.calib.errors import InvalidInputError

OptionType = type[float] | type[int] | type[str] | type[bool] | tuple[str, ...]


@dataclass(frozen=True)
class Option:
    """A number, a switch or a text; a tuple as `type` lists the texts that are allowed."""

    name: str
    type: OptionType
    default: Any
    """None: not set unless the user sets it."""
    help: str
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf

    def from_text(self, value: Any) -> Any:
        """`value` as a number if it is the text of one; anything else unchanged, for :meth:`check` to judge."""
        if not isinstance(value, str) or self.type not in _NUMBERS:
            return value
        try:
            return int(value) if self.type is int else float(value)
        except ValueError:
            return value

    def check(self, value: Any) -> Any:
        """`value` as this option's type.

        Raises
        ------
        InvalidInputError
            If it has another type or lies outside the limits.
        """
        if isinstance(self.type, tuple):
            if value not in self.type:
                raise InvalidInputError(f"{self.name} is one of {', '.join(self.type)}, not {value!r}")
            return value
        if self.type is bool:
            if not isinstance(value, bool):
                raise InvalidInputError(f"option {self.name} is a switch: give true or false, not {value!r}")
            return value
        if self.type is str and not isinstance(value, bool):
            return str(value)
        return self._number(value)

    def _number(self, value: Any) -> float | int:
        unit = f" {self.unit}" if self.unit else ""
        number = _finite(value)
        if number is None or (self.type is int and number != value // 1):
            kind = "whole" if self.type is int else "finite"
            raise InvalidInputError(f"option {self.name} must be a {kind} number{unit} ({self.help}), not {value!r}")
        if not self.low <= number <= self.high:
            raise InvalidInputError(
                f"option {self.name} is {number:g}{unit}; it must lie between {self.low:g} and {self.high:g}"
            )
        return int(value) if self.type is int else number


_NUMBERS: Final = (float, int)


def _finite(value: Any) -> float | None:
    """The number; None if it is a switch, no number, or none that a float can hold."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None
