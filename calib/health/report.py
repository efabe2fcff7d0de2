"""The health of every sensor of a log in one document, the whole log in one line, and what it lacks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mavcal.calib.flight.flying import shaking_items
from mavcal.calib.flight.item import JudgedItem
from mavcal.calib.flight.rest import ground
from mavcal.calib.health.compass import compass_findings
from mavcal.calib.health.dead import dead_findings, living, never_lived
from mavcal.calib.health.finding import BAD, HealthVerdict, SensorHealth, sensor_health, worst
from mavcal.calib.health.inertial import inertial_findings
from mavcal.calib.health.lacking import every_sample, lacking
from mavcal.calib.health.rectified import explained, rectified
from mavcal.calib.health.sampling import SENSORS, sampled, sampling_findings
from mavcal.calib.health.support import support_of
from mavcal.calib.health.temperature import temperature_findings
from mavcal.calib.health.vibration import vibration_findings
from mavcal.calib.preflight.installed import Key
from mavcal.calib.recording import Recording, Sensor


@dataclass(frozen=True)
class HealthReport:
    """Every sensor's health, and what would have to be logged to say more."""

    sensors: tuple[SensorHealth, ...]
    lacks: tuple[str, ...]
    shaking: tuple[JudgedItem, ...] = ()
    """Vibration and clipping as the sanity of a flight has them as well."""
    silent: frozenset[Key] = frozenset()
    """Sensors that never told anything, by sensor and instance."""

    @property
    def verdict(self) -> HealthVerdict:
        """That of the worst sensor."""
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
        """The summary, one for each verdict."""
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
    return HealthReport(sensors, tuple(lacking(heard, stood, every, silent)), shaking, frozenset(silent))
