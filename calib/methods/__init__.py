"""Every method by its name: what the command line and the REST API run on a recording.

A method takes a :class:`~calib.recording.Recording` as it was read and options by name, undoes the calibration in
force where the recording is of a vehicle, and returns one fit a sensor instance.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from mavcal.calib.methods import accel, gyro, imu, mag, mag_flight, noise, thermal
from mavcal.calib.methods.method import Finding, Method, Option, Options

_TABLES = (accel, gyro, mag, mag_flight, thermal, imu, noise)

METHODS: Mapping[str, Method] = MappingProxyType({method.name: method for t in _TABLES for method in t.METHODS})
"""Every method by its name."""

__all__ = ["METHODS", "Finding", "Method", "Option", "Options"]
