"""Health of every sensor of a log, the verdict on the log in one line, and the data that are missing.

Temperatures of the inertial units are compared with those that their calibration covers.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from mavcal.calib.firmware.ardupilot.doubts import learning_units
from mavcal.calib.flight.flying import shaking_items, usable
from mavcal.calib.flight.item import JudgedItem
from mavcal.calib.flight.rest import ground
from mavcal.calib.health import limits
from mavcal.calib.health.compass import compass_findings
from mavcal.calib.health.dead import dead_findings, living, never_lived
from mavcal.calib.health.finding import (
    BAD,
    HealthFinding,
    HealthVerdict,
    SensorHealth,
    judged_value,
    sensor_health,
    worst,
)
from mavcal.calib.health.inertial import inertial_findings
from mavcal.calib.health.sampling import SENSORS, every_sample, missing_data, sampled, sampling_findings
from mavcal.calib.health.support import support_of
from mavcal.calib.health.vibration import explained, rectified, vibration_findings
from mavcal.calib.preflight.history import corrected_by, covered_by
from mavcal.calib.preflight.installed import Key
from mavcal.calib.recording import Recording, Sensor

_READING_SD: Final = 0.5
"""Standard deviation of a thermometer reading, degC."""
_WARM: Final = "Calibrate over these temperatures: log a warm-up at rest from cold, then mavcal fit thermal-poly."


@dataclass(frozen=True)
class HealthReport:
    """Every sensor's health, and the data that would allow more checks."""

    sensors: tuple[SensorHealth, ...]
    lacks: tuple[str, ...]
    shaking: tuple[JudgedItem, ...] = ()
    """Vibration and clipping, as in the flight checks."""
    silent: frozenset[Key] = frozenset()
    """Sensors without any valid reading, by sensor and instance."""

    @property
    def verdict(self) -> HealthVerdict:
        """Verdict of the worst sensor."""
        return worst(s.verdict for s in self.sensors)

    @property
    def urgent_first(self) -> tuple[SensorHealth, ...]:
        """The sensors, the worst first."""
        return tuple(sorted(self.sensors, key=lambda s: BAD.index(s.verdict) if s.verdict in BAD else len(BAD)))

    @property
    def summary(self) -> str:
        """The whole log in one line."""
        return " ".join(self.sentences)

    @property
    def sentences(self) -> tuple[str, ...]:
        """The sentences of the summary, one for each verdict."""
        if not self.sensors:
            return ("The log has no accelerometer, gyroscope or compass.",)
        parts = []
        for verdict in BAD:
            bad = [s for s in self.sensors if s.verdict == verdict]
            if bad:
                parts.append(
                    f"{verdict.value}: " + "; ".join(f"{s.name} ({s.findings[0].text.partition('. ')[0]})" for s in bad)
                )
        good = sum(s.verdict == HealthVerdict.OK for s in self.sensors)
        silent = len(self.sensors) - good - sum(s.verdict in BAD for s in self.sensors)
        parts += [f"{good} of {len(self.sensors)} sensors ok"] if good else []
        parts += [f"{silent} cannot be judged"] if silent else []
        return tuple(f"{part[:1].upper()}{part[1:]}." for part in parts)

    @property
    def action(self) -> str:
        """Next action for the worst sensor; empty: nothing to do."""
        bad = [s for s in self.sensors if s.verdict in BAD]
        first = max(bad, key=lambda s: s.verdict == HealthVerdict.FAULTY, default=None)
        return "" if first is None else next(iter(first.actions), "")

    @property
    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "verdict": self.verdict.value,
            "summary": self.summary,
            "action": self.action,
            "sensors": [s.document for s in self.sensors],
            "lacks": list(self.lacks),
        }


def health(recording: Recording) -> HealthReport:
    """Judge every sensor of `recording`."""
    stood = ground(recording)
    dead = dead_findings(recording)
    silent = never_lived(dead)
    heard = living(recording, silent)
    # of the whole recording: a compass that is dead holds the logged heading, and tells so
    support = support_of(recording, next(iter(recording.find(Sensor.ATTITUDE)), None))
    every, shaking = sampled(heard), tuple(shaking_items(heard, stood.running))
    findings = [
        *dead,
        *explained(list(inertial_findings(heard, stood.off, support)), rectified(heard, shaking)),
        *vibration_findings(heard, stood.running, shaking, every_sample(heard)),
        *temperature_findings(heard),
        *compass_findings(heard, support),
        *sampling_findings(heard, every, stood.running),
    ]
    findings = [f for f in findings if f in dead or (f.sensor, f.instance) not in silent]
    named = sorted({(f.sensor, f.instance) for f in findings}, key=lambda one: (SENSORS.index(one[0]), one[1]))
    sensors = tuple(sensor_health(sensor, instance, findings) for sensor, instance in named)
    return HealthReport(sensors, tuple(missing_data(heard, stood, every, silent)), shaking, frozenset(silent))


def temperature_findings(recording: Recording) -> Iterator[HealthFinding]:
    """Excess of every accelerometer and gyroscope over the temperatures of its calibration."""
    for sensor in (Sensor.ACCEL, Sensor.GYRO):
        for instance in recording.instances(sensor):
            found = _of_unit(recording, sensor, instance)
            if found is not None:
                yield found


def _of_unit(recording: Recording, sensor: Sensor, instance: int) -> HealthFinding | None:
    """Finding on the temperature of a unit; None: it has no thermometer in the log."""
    warm = next(iter(recording.find(Sensor.TEMPERATURE, instance)), None)
    channel = None if warm is None else usable(warm)
    if channel is None or not len(channel):
        return None
    degrees = channel.values[:, 0]
    low, high = np.percentile(degrees, (0.5, 99.5)).tolist()  # one odd reading is no temperature
    was = f"was at {low:.0f} to {high:.0f} degC"
    vehicle = recording.identity.autopilot, recording.parameters.final(), sensor, instance
    # autopilots zero their gyroscopes at each start, so the temperature of a calibration is no limit
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
