"""The gyroscope alone: at rest, on a turntable, on a thread, and its g-sensitivity."""

from __future__ import annotations

from mavcal.calib.gyro.g_sensitivity import fit_g_sensitivity
from mavcal.calib.gyro.rest import LARGEST_BIAS, PLAUSIBLE_BIAS, fit_gyro_rest, steady_turn
from mavcal.calib.gyro.thread import fit_thread, thread_scale
from mavcal.calib.gyro.turntable import fit_turntable

__all__ = [
    "LARGEST_BIAS",
    "PLAUSIBLE_BIAS",
    "fit_g_sensitivity",
    "fit_gyro_rest",
    "fit_thread",
    "fit_turntable",
    "steady_turn",
    "thread_scale",
]
