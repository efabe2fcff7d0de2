"""The health of every sensor of a log in one document, the whole log in one line, and what it lacks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from mavcal.calib.flight.rest import DISARMED, Ground, ground
from mavcal.calib.health.compass import compass_findings
from mavcal.calib.health.finding import BAD, HealthFinding, HealthVerdict, SensorHealth, sensor_health, worst
from mavcal.calib.health.inertial import inertial_findings
from mavcal.calib.health.limits import STUCK
from mavcal.calib.logs.inspection import summarise
from mavcal.calib.recording import Recording, Sensor

SENSORS: Final = (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG)
_SLOW_HZ: Final = 20.0


@dataclass(frozen=True)
class HealthReport:
    """Every sensor's health, and what would have to be logged to say more."""

    sensors: tuple[SensorHealth, ...]
    lacks: tuple[str, ...]

    @property
    def verdict(self) -> HealthVerdict:
        """Of the worst sensor."""
        return worst(s.verdict for s in self.sensors)

    @property
    def summary(self) -> str:
        """The whole log in one line."""
        if not self.sensors:
            return "The log has no accelerometer, gyroscope or compass."
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
        return ". ".join(f"{part[:1].upper()}{part[1:]}" for part in parts) + "."

    @property
    def action(self) -> str:
        """What to do next, for the worst sensor; empty: nothing."""
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
    findings = [
        *inertial_findings(recording, stood.running),
        *compass_findings(recording),
        *_stuck(recording),
    ]
    named = sorted({(f.sensor, f.instance) for f in findings}, key=lambda one: (SENSORS.index(one[0]), one[1]))
    sensors = tuple(sensor_health(sensor, instance, findings) for sensor, instance in named)
    return HealthReport(sensors, tuple(_lacks(recording, stood)))


def _stuck(recording: Recording) -> Iterator[HealthFinding]:
    """Units that repeat themselves to the last digit while their channel otherwise moves."""
    for channel in recording.channels:
        if channel.sensor not in SENSORS or channel.quantum or len(channel) < 3 or channel.sensor == Sensor.MAG:
            continue
        found = summarise(channel)
        if not found.rate or found.longest_constant <= max(STUCK.suspicious, 10.0 / found.rate):
            continue
        verdict = HealthVerdict.FAULTY if found.longest_constant > STUCK.faulty else HealthVerdict.SUSPICIOUS
        text = f"repeats one value for {found.longest_constant:.1f} s"
        action = "Check its bus and power; replace it if it comes back."
        yield HealthFinding(
            "stuck", channel.sensor, channel.instance, verdict, text, action, found.longest_constant, 0.0, STUCK
        )


def _lacks(recording: Recording, stood: Ground) -> Iterator[str]:
    """What was not recorded, and what it would tell."""
    if not recording.find(Sensor.ATTITUDE):
        yield "attitude: offsets of gyroscopes and accelerometers in flight, and the compass's dip"
    if not recording.find(Sensor.POSITION):
        yield "position: the Earth's field at the place"
    if not recording.find(Sensor.TEMPERATURE):
        yield "temperature of the inertial units: their drift"
    if not recording.find(Sensor.CURRENT) and not recording.find(Sensor.THROTTLE):
        yield "battery current or throttle: interference of the motors with the compass"
    rates = [c for c in recording.channels if c.sensor == Sensor.ACCEL and len(c) > 1]
    fastest = max((1.0 / float(np.median(np.diff(c.t))) for c in rates if np.median(np.diff(c.t)) > 0.0), default=0.0)
    if rates and fastest < _SLOW_HZ:
        yield f"inertial samples at {_SLOW_HZ:.0f} Hz or more (it has {fastest:.0f}): vibration"
    if stood.running and not stood.off:
        yield f"a rest with the motors off ({DISARMED}): offsets at rest"
