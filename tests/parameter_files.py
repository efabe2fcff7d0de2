"""Reads the parameter files that are written for ground stations, as the stations do."""

from __future__ import annotations

from mavcal.calib.firmware.export import ParameterFormat
from mavcal.calib.firmware.plan import Value

REALS = ("9", "10")
"""MAV_PARAM_TYPE of real numbers."""


def read_parameters(text: str, form: ParameterFormat) -> dict[str, Value]:
    """The values by name; whole numbers are integers where the format does not say otherwise."""
    values: dict[str, Value] = {}
    for line in filter(None, (raw.split("#", 1)[0].strip() for raw in text.splitlines())):
        if form == ParameterFormat.PARAMS:
            _, _, name, value, kind = line.split("\t")
        else:
            name, value = line.split("," if form == ParameterFormat.PARAM else None)
            kind = "6" if value.lstrip("-").isdecimal() else "9"
        values[name] = float(value) if kind in REALS else int(value)
    return values
