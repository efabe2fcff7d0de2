"""All checks of the inertial sensors of a log in one document."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.flight.flying import flying_items
from mavcal.calib.flight.item import FlightVerdict, JudgedItem
from mavcal.calib.flight.rest import Ground, Rest, ground, rests
from mavcal.calib.flight.resting import resting_items
from mavcal.calib.recording import Recording, Sensor

_ORDER = (FlightVerdict.PASS, FlightVerdict.NOT_TESTABLE, FlightVerdict.WARN, FlightVerdict.FAIL)


@dataclass(frozen=True)
class FlightReport:
    """Verdicts on all checks, and the times of rest and of flight."""

    ground: Ground
    rests: tuple[Rest, ...]
    items: tuple[JudgedItem, ...]
    spans: tuple[dict[str, Any], ...]

    @property
    def verdict(self) -> FlightVerdict:
        """The worst of what could be tested."""
        return max((item.verdict for item in self.items), key=_ORDER.index, default=FlightVerdict.NOT_TESTABLE)

    @property
    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "verdict": self.verdict.value,
            "motors_known_by": self.ground.known.value,
            "flown": [{"start": s.start, "end": s.end} for s in self.ground.running],
            "rests": [{"start": r.start, "end": r.end, "phase": r.phase.value} for r in self.rests],
            "items": [item.document for item in self.items],
            "spans": list(self.spans),
        }


def flight_report(recording: Recording, shaking: Sequence[JudgedItem] | None = None) -> FlightReport | None:
    """The sanity of a vehicle's inertial sensors, calibration in force; None: not a vehicle's, or labelled by hand.

    `shaking` is what :func:`calib.flight.flying.shaking_items` found already.
    """
    instances = sorted({*recording.instances(Sensor.ACCEL), *recording.instances(Sensor.GYRO)})
    if recording.identity.autopilot is None or recording.segments:
        return None
    stood = ground(recording)
    found: tuple[Rest, ...] = ()
    if instances:
        try:
            found = rests(recording, instances[0])
        except InvalidInputError:  # debiased streams alone, or time that goes back: no rest can be told
            found = ()
    items = (*resting_items(recording, found), *flying_items(recording, stood.running, shaking))
    return FlightReport(stood, found, items, tuple(_spans(recording, found)))


def _spans(recording: Recording, found: tuple[Rest, ...]) -> list[dict[str, Any]]:
    """Ranges of temperature and of what loads the battery."""
    spans = []
    for sensor in (Sensor.TEMPERATURE, Sensor.CURRENT, Sensor.THROTTLE):
        for instance in recording.instances(sensor):
            channel = recording.channel(sensor, instance)
            finite = np.isfinite(channel.values)
            values = channel.values if finite.all() else channel.values[finite]
            if not values.size:
                continue
            still = np.concatenate([channel.between(r.start, r.end).values for r in found] or [np.zeros((0, 1))])
            still = still[np.isfinite(still)]
            spans.append(
                {
                    "what": sensor.value,
                    "instance": instance,
                    "unit": channel.unit,
                    "least": float(values.min()),
                    "most": float(values.max()),
                    "at_rest": [float(still.min()), float(still.max())] if len(still) else None,
                }
            )
    return spans
