"""Calibration of three-axis sensors: pure functions of recordings.

The domain contract, fixed once (``tests/unit/test_contract.py`` holds it with literal numbers):

Frames
    ``b`` body (forward, right, down), ``n`` local (north, east, down), ``s`` sensor. ``R_nb`` takes body
    vectors to north-east-down. Rotations are named ``<to>_from_<from>``; quaternions are ``w x y z``.
Specific force
    Level and at rest the accelerometer reads ``(0, 0, -g)``. What is written to a vehicle refers to the
    ``g = 9.80665 m/s2`` of the firmwares (:data:`STANDARD_GRAVITY`); local gravity serves diagnosis.
Units
    Seconds (float64), m/s2, rad/s, uT, degC, A; throttle and motors 0..1. A unit suffix appears in a name
    only at an edge of the program (``_mgauss``, ``_cdegc``, ``_ms``).
Instances
    Count from 0, as MAVLink does: ``RAW_IMU``/``SCALED_IMU`` carry instance 0, ``SCALED_IMU2`` instance 1.
Sensor equation
    ``measured = M truth + b + p(T)`` with ``p(T_ref) = 0``;
    ``corrected = C (measured - b - p(T))`` with ``C = M^-1``. :class:`calib.triad.TriadModel` owns it.
Uncertainty
    Every estimate carries a covariance and a list of what the data do not determine.

The names of :data:`__all__` are what a notebook or another program needs (``docs/library.md``). Each is loaded when it
is first requested, so that the help of the command line does not wait for numpy. Their types are in ``__init__.pyi``.

The package opens files that it is given and nothing else: no sockets, no clocks, no printing.
"""

from __future__ import annotations

from importlib import import_module

STANDARD_GRAVITY = 9.80665
"""Gravity that both firmwares calibrate against, m/s2 (ArduPilot AP_Math/definitions.h, PX4 geo.h)."""

__version__ = "0.1.0"

_PUBLIC = {
    "METHODS": ("methods", "METHODS"),
    "CalibError": ("errors", "CalibError"),
    "Channel": ("recording", "Channel"),
    "FitResult": ("fit", "FitResult"),
    "FitStatus": ("fit", "FitStatus"),
    "GapReport": ("gap", "GapReport"),
    "Recording": ("recording", "Recording"),
    "Sensor": ("recording", "Sensor"),
    "Stage": ("recording", "Stage"),
    "bare": ("library", "bare"),
    "diagnose": ("gap", "run"),
    "fit_recording": ("library", "fit_recording"),
    "read": ("logs", "read"),
    "save_fits": ("library", "save_fits"),
    "save_report": ("library", "save_report"),
}
"""Where each public name is defined: the room, and its name there."""

__all__ = ["STANDARD_GRAVITY", "__version__", *_PUBLIC]


def __getattr__(name: str) -> object:
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    room, own = _PUBLIC[name]
    value: object = getattr(import_module(f"{__name__}.{room}"), own)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
