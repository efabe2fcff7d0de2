"""Temperatures of the inertial units against those that their calibration covers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from mavcal.calib.firmware.ardupilot.learning import learning_units
from mavcal.calib.health import limits, motion
from mavcal.calib.health.finding import HealthFinding, HealthVerdict, judged_value
from mavcal.calib.preflight.history import corrected_by, covered_by
from mavcal.calib.recording import Recording, Sensor

_READING_SD: Final = 0.5
"""degC: how a driver reads the chip."""
_WARM: Final = "Calibrate over these temperatures: log a warm-up at rest from cold, then mavcal fit thermal-poly."


def temperature_findings(recording: Recording) -> Iterator[HealthFinding]:
    """How far every accelerometer and gyroscope left the temperatures of its calibration."""
    for sensor in (Sensor.ACCEL, Sensor.GYRO):
        for instance in recording.instances(sensor):
            found = _of_unit(recording, sensor, instance)
            if found is not None:
                yield found


def _of_unit(recording: Recording, sensor: Sensor, instance: int) -> HealthFinding | None:
    """None: it has no thermometer in the log."""
    warm = next(iter(recording.find(Sensor.TEMPERATURE, instance)), None)
    channel = None if warm is None else motion.usable(warm)
    if channel is None or not len(channel):
        return None
    degrees = channel.values[:, 0]
    low, high = np.percentile(degrees, (0.5, 99.5)).tolist()  # one odd reading is no temperature
    was = f"was at {low:.0f} to {high:.0f} degC"
    vehicle = recording.identity.autopilot, recording.parameters.final(), sensor, instance
    # autopilots zero their gyroscopes at each start: where they were zeroed once limits nothing
    covered = corrected_by(*vehicle) if sensor == Sensor.GYRO else covered_by(*vehicle, None)
    if covered is None:
        text = f"{was}; no temperature calibration is in force: its drift is not corrected"
        learns = learning_units(recording.parameters.final()).get(instance)
        text += f" ({learns} is 2: it learns one from the next start on)" if learns else ""
        return HealthFinding("temperature", sensor, instance, HealthVerdict.CANNOT_SAY, text)
    beyond = max(covered.low - low, high - covered.high, 0.0)
    verdict = judged_value(beyond, _READING_SD, limits.WARMTH)
    text = f"{was}; its calibration covers {covered.low:.0f} to {covered.high:.0f} degC ({covered.how})"
    start = end = None
    action = ""
    if verdict != HealthVerdict.OK:
        outside = channel.t[(degrees < covered.low) | (degrees > covered.high)]
        start, end = float(outside[0]), float(outside[-1])
        text, action = f"{text}: {beyond:.0f} degC beyond it between {start:.0f} and {end:.0f} s", _WARM
    return HealthFinding(
        *("temperature", sensor, instance, verdict, text, action, beyond, _READING_SD, limits.WARMTH), start, end
    )
