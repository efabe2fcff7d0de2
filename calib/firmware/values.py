"""Reads parameter values: one that was never seen is an error and has no default."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import FirmwareError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mavcal.calib.firmware.names import Role
    from mavcal.calib.firmware.plan import Value


def shown(value: Value, digits: int = 9) -> str:
    """A parameter's value as a person reads it; an integer stays one, however many digits it has.

    >>> shown(2147483647), shown(0.1), shown(1310988, 6), shown(float(np.float32(0.1)), 6)
    ('2147483647', '0.1', '1310988', '0.1')
    """
    return str(value) if isinstance(value, int) else f"{value:.{digits}g}"


def need(parameters: Mapping[str, Value], name: str) -> float:
    """The finite value of `name`.

    Raises
    ------
    FirmwareError
        If it was not seen, or is NaN or infinite.
    """
    if name not in parameters:
        raise FirmwareError(f"{name} was not seen: read the vehicle's parameters before its streams can be undone")
    value = float(parameters[name])
    if not np.isfinite(value):
        raise FirmwareError(f"{name} is {value}: write a number there first")
    return value


def vector(parameters: Mapping[str, Value], roles: Mapping[Role, str], triple: Sequence[Role]) -> NDArray[np.float64]:
    """The finite values of three roles, shape (3,); errors as :func:`need`."""
    return np.array([need(parameters, roles[role]) for role in triple])
