"""Sensors without data: zero, constant, rejected throughout, or announced but never received.

They are judged first and left out of every other check: the readings of a dead sensor are no evidence against others.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Final

import numpy as np

from mavcal.calib.firmware.names import ARDUPILOT_IMU_SLOTS, Role, ardupilot_imu_names
from mavcal.calib.firmware.stream.auxiliary import telemetry
from mavcal.calib.flight.rest import ground
from mavcal.calib.health.channels import in_use
from mavcal.calib.health.finding import HealthFinding, HealthVerdict
from mavcal.calib.preflight.installed import WORDS, Announced, Key, announced
from mavcal.calib.recording import Channel, Event, Oddity, Recording, Sensor, Stage
from mavcal.calib.stats.windows import finite_rows

SENSORS: Final = (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG)
_LEAST: Final = 50
"""Least number of samples to call a sensor constant."""
_ZEROS: Final = 0.1
"""Fraction of samples at 0, 0, 0 above which it is more than a start-up."""
_FLOWN_S: Final = 10.0
_TURNED: Final = 1.0
"""Change of an accelerometer axis, m/s2, when the vehicle is turned by 6 deg."""
_MULTIPLE: Final = frozenset({"vehicle_imu"})
"""PX4 topics that every version with them logs for every unit."""
_WIRING: Final = "Check its wiring and its driver; replace it."
_ABSENT: Final = "Look at its wiring and its driver. If it was removed, switch it off in the parameters."
_ROW: Final = "If it is installed, look at its wiring and its driver. If not, set the id in its row to 0."


def dead_findings(recording: Recording) -> tuple[HealthFinding, ...]:
    """One finding for each sensor that delivers nothing, or nothing for a part of the log."""
    found = {**_zero(recording), **_constant(recording), **_distrusted(recording)}
    return (*found.values(), *_silent(recording, {key for key, one in found.items() if one.check == "dead"}))


def living(recording: Recording, dead: Collection[Key]) -> Recording:
    """`recording` without the channels of the sensors in `dead`."""
    return recording.with_channels(c for c in recording.channels if (c.sensor, c.instance) not in dead)


def never_lived(found: tuple[HealthFinding, ...]) -> dict[Key, HealthFinding]:
    """The sensors of `found` without a single reading that means anything, by sensor and instance."""
    return {(one.sensor, one.instance): one for one in found if one.check in ("dead", "unhealthy", "silent")}


def _zero(recording: Recording) -> dict[Key, HealthFinding]:
    """Sensors that read exactly zero throughout, or often; a reader leaves such samples out and counts them."""
    found: dict[Key, HealthFinding] = {}
    for event in recording.events:
        odd = event.odd
        if odd is None or odd.what != Oddity.ZERO or odd.sensor not in SENSORS:
            continue
        key = odd.sensor, odd.instance
        if event.kind != "dead":
            often = _often_zero(event)
            if often is not None:
                found[key] = often
            continue
        made = _zero_throughout(recording, key)
        if made is not None:
            found[key] = made
    return found


def _zero_throughout(recording: Recording, key: Key) -> HealthFinding | None:
    """Finding on a sensor that reads zero throughout; None: by the parameters there is no such sensor."""
    text = "reads 0, 0, 0 throughout"
    if _not_installed(recording, key) or (telemetry(recording) and key not in _installed(recording)):
        return None  # a message of two sensors carries zeros for one that is not there
    if not in_use(recording, *key):
        return HealthFinding("dead", *key, HealthVerdict.CANNOT_SAY, f"{text}; the vehicle does not use it")
    action = f"Check its wiring and its driver; the vehicle does without this {WORDS[key[0]][0]}."
    return HealthFinding("dead", *key, HealthVerdict.FAULTY, text, action)


def _often_zero(event: Event) -> HealthFinding | None:
    odd = event.odd
    if odd is None or not odd.total or odd.count < _ZEROS * odd.total:
        return None
    text = f"reads 0, 0, 0 in {100.0 * odd.count / odd.total:.0f} % of its samples, first at {event.t:.1f} s"
    action = "Check its wiring and its parameters."
    return HealthFinding(
        *("zeros", odd.sensor, odd.instance, HealthVerdict.FAULTY, text, action), start=event.t, end=odd.until
    )


def _constant(recording: Recording) -> dict[Key, HealthFinding]:
    """Sensors whose every sample is the same."""
    found: dict[Key, HealthFinding] = {}
    for sensor in SENSORS:
        for instance in recording.instances(sensor):
            key = sensor, instance
            channels = [c for c in recording.find(*key) if c.stage != Stage.DEBIASED]
            values = [c.values[finite_rows(c.values)] for c in channels]
            values = [v for v in values if len(v)]
            if not values or any(np.ptp(v, axis=0).any() for v in values) or max(map(len, values)) < _LEAST:
                continue
            coarse = all(c.quantum > 0.0 for c in channels)
            zero = not any(v.any() for v in values)
            made = (
                _zero_throughout(recording, key)
                if zero and (sensor != Sensor.GYRO or not coarse)
                else _same_throughout(recording, channels[0], coarse=coarse)
            )
            found[key] = made or HealthFinding("dead", *key, HealthVerdict.CANNOT_SAY, "is not installed")
    return found


def _same_throughout(recording: Recording, channel: Channel, *, coarse: bool) -> HealthFinding:
    """Finding on a constant sensor; at rest, coarse values may repeat, and a compass may repeat any value."""
    key = channel.sensor, channel.instance
    listed = ", ".join(f"{value:.4g}" for value in channel.values[finite_rows(channel.values)][0])
    text = f"reads the same throughout ({listed} {channel.unit})"
    if (coarse or channel.sensor == Sensor.MAG) and not _in_motion(recording, key):
        text += ", and the vehicle was not turned: whether it lives is not known"
        return HealthFinding("dead", *key, HealthVerdict.CANNOT_SAY, text, "Turn the vehicle while it logs.")
    return HealthFinding("dead", *key, HealthVerdict.FAULTY, text, _WIRING)


def _in_motion(recording: Recording, key: Key) -> bool:
    """Whether the vehicle flew, or gravity went from one axis of the board towards another.

    Not by its attitude, whose heading may settle while it stands.
    """
    if sum(span.duration for span in ground(recording).running) > _FLOWN_S:
        return True
    for channel in recording.channels:
        if (channel.sensor, channel.instance) == key or channel.sensor != Sensor.ACCEL or channel.unit != "m/s2":
            continue
        good = channel.values[finite_rows(channel.values)]
        if len(good) >= _LEAST:
            low, high = np.percentile(good, (5.0, 95.0), axis=0)
            if float((high - low).max()) > _TURNED:
                return True
    return False


def _distrusted(recording: Recording) -> dict[Key, HealthFinding]:
    """Sensors whose every sample the autopilot called unhealthy."""
    found: dict[Key, HealthFinding] = {}
    for event in recording.events:
        odd = event.odd
        if odd is None or odd.what != Oddity.UNHEALTHY or odd.sensor not in SENSORS or not odd.total:
            continue
        if odd.count >= odd.total:
            key = odd.sensor, odd.instance
            text = f"was called unhealthy by the autopilot in all of its {odd.total} samples"
            found[key] = HealthFinding("unhealthy", *key, HealthVerdict.FAULTY, text, _WIRING, value=1.0)
    return found


def _silent(recording: Recording, dead: set[Key]) -> Iterator[HealthFinding]:
    """Sensors that the parameters announce and use, without a sample although others of their kind have some."""
    if telemetry(recording):  # which messages come is the ground station's choice
        return
    for key, one in _installed(recording).items():
        heard = recording.instances(key[0])
        if key in dead or key[1] in heard or not _logs_every_unit(recording, key[0]):
            continue
        text = f"is announced by {one.by} and was never heard"
        if one.kept:
            yield HealthFinding("silent", *key, HealthVerdict.FAULTY, text, _ABSENT)
            continue
        text += ": it is dead, or its row is left over from a sensor that is gone"
        yield HealthFinding("silent", *key, HealthVerdict.CANNOT_SAY, text, _ROW)


def _logs_every_unit(recording: Recording, sensor: Sensor) -> bool:
    """Whether the log would contain another unit of that kind if it delivered anything."""
    heard = recording.instances(sensor)
    if recording.identity.autopilot == "ardupilot":
        return bool(heard) or any(_is_dead(event, sensor) for event in recording.events)
    return len(heard) > 1 or any(c.sensor == sensor and c.source in _MULTIPLE for c in recording.channels)


def _is_dead(event: Event, sensor: Sensor) -> bool:
    return event.kind == "dead" and event.odd is not None and event.odd.sensor == sensor


def _installed(recording: Recording) -> dict[Key, Announced]:
    """Sensors that the parameters announce; none without parameters, or without an autopilot."""
    autopilot = recording.identity.autopilot
    return announced(autopilot, recording.parameters.final()) if autopilot is not None else {}


def _not_installed(recording: Recording, key: Key) -> bool:
    """Whether ArduPilot found no such unit at its start: it clears the id then. Old firmwares have no ids."""
    if recording.identity.autopilot != "ardupilot" or key[0] == Sensor.MAG or key[1] >= ARDUPILOT_IMU_SLOTS:
        return False
    return recording.parameters.final().get(ardupilot_imu_names(*key)[Role.ID]) == 0
