"""Sentences on the motors' field: its size by either attitude, and where the two disagree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

_DISAGREES = 4.0  # sd between what the gyroscope and what the logged attitude make of the motors


def terms_text(term_of_drive: Mapping[str, Any]) -> str:
    """The motors' field with its sd, by the gyroscope and by the log's attitude."""
    text = _listed(term_of_drive["interference"], term_of_drive["interference_sd"], term_of_drive)
    if term_of_drive["by_log"] is None:
        return text
    log = _listed(term_of_drive["by_log"]["interference"], term_of_drive["by_log"]["interference_sd"], term_of_drive)
    return f"{text} by the gyroscope, {log} by the log's attitude"


def _listed(term: Sequence[Any], sd: Sequence[Any], term_of_drive: Mapping[str, Any]) -> str:
    motors, unit = term_of_drive["motors"], term_of_drive["unit"]
    if motors is None or len(motors) == 1:
        return f"{_vector(term, sd)} {unit}"
    squared = term_of_drive["squared"] or [False] * len(motors)
    each = (
        f"motor {n}{' squared' if square else ''} {_vector(t, s)}"
        for n, square, t, s in zip(motors, squared, term, sd, strict=True)
    )
    return f"{', '.join(each)} {unit}"


def disagreement(native: Mapping[str, Any], unit: str) -> list[str]:
    """A warning where the logged attitude gives another motor term than the gyroscope."""
    trusted = native["attitude_trusted"]
    if trusted is None:
        return []
    ours = native["candidates"][trusted["drive"]]
    theirs, found, sd = trusted["interference"], ours["interference"], ours["interference_sd"]
    if float((np.abs(np.subtract(theirs, found)) / sd).max()) <= _DISAGREES:
        return []
    return [
        f"the two attitudes disagree on {trusted['drive']}: the log's finds "
        f"{_vector(theirs, trusted['interference_sd'])}, the gyroscope's {_vector(found, sd)} {ours['unit']}. "
        "The log's heading came from a compass, and its corrections pass for the motors' field"
    ]


def _vector(values: Sequence[float], sd: Sequence[float]) -> str:
    return f"({', '.join(f'{v:.3g} +- {s:.1g}' for v, s in zip(values, sd, strict=True))})"
