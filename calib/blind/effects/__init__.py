"""Every error that the generator knows, one family a file."""

from __future__ import annotations

from mavcal.calib.blind.effects import linear, noise, place, thermal, timing, unknown, vibration
from mavcal.calib.blind.effects.kind import Kind

KNOWN: tuple[Kind, ...] = (
    *linear.KINDS,
    *thermal.KINDS,
    *place.KINDS,
    *vibration.KINDS,
    *noise.KINDS,
    *timing.KINDS,
)
"""Those that the report has a name for."""

UNKNOWN: tuple[Kind, ...] = unknown.KINDS
"""Those that it has none for."""
