"""Parameter values: read, where one that was never seen is an error, and as a firmware keeps them over a restart.

PX4 does not save a float within FLT_EPSILON of its default, by absolute difference (``param_export_internal`` in PX4
src/lib/parameters/parameters.cpp). It is echoed, read back and in force until the restart brings the default back.
Boards that keep their parameters in flash save it (flashparams.cpp); no stream tells which kind a board is, so the
stricter rule holds for all. A change by no more than FLT_EPSILON is stored in memory, but triggers no save
(``param_set_internal``). A larger change of some value has to be written after it.

ArduPilot leaves out a scalar that is not in its storage yet and lies within 0.01 % of its default
(``AP_Param::save_sync``). That never meets a PARAM_SET that changes the value by 1.2e-7 or more: it forces the save
(``GCS_MAVLINK::handle_param_set``). The thermal coefficients, offsets, scales and compass matrices are vectors, to
which the rule does not apply at all. So everything that is written to ArduPilot is kept.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import FirmwareError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mavcal.calib.firmware.names import Role
    from mavcal.calib.firmware.plan import Value

FLT_EPSILON: Final = float(np.finfo(np.float32).eps)
"""1.1920929e-07; a float32 within this of its default is not saved by PX4."""
LEAST_KEPT: Final = float(np.nextafter(np.float32(FLT_EPSILON), np.float32(1.0)))
"""The smallest number that PX4 saves where the default is 0."""

PX4_DEFAULTS: Final = (
    (re.compile(r"TC_[AGM]\d_X[0-3]_[012]"), 0.0),
    (re.compile(r"TC_[AGM]\d_TMIN"), 0.0),
    (re.compile(r"TC_[AGM]\d_TMAX"), 100.0),
    (re.compile(r"TC_[AGM]\d_TREF"), 25.0),
    (re.compile(r"CAL_(ACC|GYRO|MAG)\d_[XYZ]OFF"), 0.0),
    (re.compile(r"CAL_(ACC|MAG)\d_[XYZ]SCALE"), 1.0),
    (re.compile(r"CAL_MAG\d_[XYZ](ODIAG|COMP)"), 0.0),
    (re.compile(r"CAL_MAG\d_(ROLL|PITCH|YAW)"), 0.0),
    (re.compile(r"SENS_BOARD_[XYZ]_OFF"), 0.0),
)
"""Defaults of PX4's floats that a calibration writes (module.yaml and sensor_params*.c of its module sensors)."""


def shown(value: Value | None, digits: int = 9) -> str:
    """A parameter's value as a person reads it; an integer stays one, however many digits it has; None: not known.

    >>> shown(2147483647), shown(0.1), shown(1310988, 6), shown(float(np.float32(0.1)), 6)
    ('2147483647', '0.1', '1310988', '0.1')
    """
    if value is None:
        return "unknown"
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


def px4_default(name: str) -> float | None:
    """PX4's default of a float that a calibration writes; None: it writes none of that name."""
    return next((default for pattern, default in PX4_DEFAULTS if pattern.fullmatch(name)), None)


def retained(name: str, value: float) -> float:
    """Value of `name`, as a float32, after it was set to `value`, saved and the vehicle restarted."""
    single = float(np.float32(value))
    default = px4_default(name)
    if default is None or np.abs(np.float32(single) - np.float32(default)) > np.float32(FLT_EPSILON):
        return single
    return default


def asks_for_save(name: str, old: float, new: float) -> bool:
    """Whether setting `name` from `old` to `new` makes the vehicle save its parameters."""
    return px4_default(name) is None or bool(np.abs(np.float32(old) - np.float32(new)) > np.float32(FLT_EPSILON))
