"""Data that a log lacks: messages and rates, their use, and the parameter that logs them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import Final

import numpy as np

from mavcal.calib.firmware.log_options import Logged, how_to_log, how_to_stream
from mavcal.calib.firmware.stream.source import telemetry
from mavcal.calib.flight.craft import craft_of
from mavcal.calib.flight.rest import Ground, how_to_rest
from mavcal.calib.health.sampling import Sampled, lost
from mavcal.calib.preflight.installed import Key
from mavcal.calib.recording import Recording, Sensor, Stage

_SLOW_HZ: Final = 20.0
ON_BOARD: Final = "Take the log on board: no telemetry carries every sample."
_BATCHES: Final = "INS_LOG_BAT_MASK 1"
"""ArduPilot's batch sampling: short stretches of every sample."""


def setting(recording: Recording, what: Logged, rate: float = 0.0) -> str:
    """What has to be set so that it is recorded, at `rate` Hz or more; empty where that is not known."""
    if telemetry(recording):
        return how_to_stream(what, recording.identity, recording.parameters.final(), rate)
    return how_to_log(what, recording.identity, recording.parameters.final())


def every_sample(recording: Recording) -> str:
    """The action that has every sample of an accelerometer logged; empty where it is not known."""
    if telemetry(recording):
        return ON_BOARD
    found = setting(recording, Logged.RAW_INERTIAL)
    if recording.identity.autopilot != "ardupilot":
        return found
    raw = f", or {found[0].lower()}{found[1:]}" if found.startswith("Set") else "."
    return f"Set {_BATCHES} (batch sampling){raw}"


def missing_data(
    recording: Recording, stood: Ground, every: Sequence[Sampled], silent: Collection[Key] = ()
) -> Iterator[str]:
    """Data that were not recorded, their use, and how to log them; `silent` are sensors without data."""
    for sensor, what, name, use in (
        (
            Sensor.ATTITUDE,
            Logged.ATTITUDE,
            "attitude",
            f"offsets {craft_of(recording.identity).moving}, and the dip of the field",
        ),
        (Sensor.POSITION, Logged.POSITION, "position", "the Earth's field and gravity of the place"),
        (Sensor.TEMPERATURE, Logged.INERTIAL, "temperature of the inertial units", "whether they left their range"),
    ):
        if not recording.find(sensor):
            yield _line(f"{name}: {use}", setting(recording, what))
    yield from _loads(recording)
    yield from _inertial(recording)
    if not recording.instances(Sensor.MAG) and all(sensor != Sensor.MAG for sensor, _ in silent):
        yield _line("compass: whether there is one and how it is", setting(recording, Logged.COMPASS))
    if recording.identity.autopilot is not None and not recording.parameters:
        yield "parameters: the calibration in force, and whether there is one"
    if stood.running and not stood.off:
        yield f"a rest with the motors off: offsets at rest. {how_to_rest(recording)}"
    yield from _losses(recording, every)


def _line(text: str, how: str) -> str:
    return f"{text}. {how}".removesuffix(".") if how else text


def _loads(recording: Recording) -> Iterator[str]:
    """Data on the motors' field."""
    currents = recording.find(Sensor.CURRENT)
    use = "interference of the motors with the compass"
    if not currents and not recording.find(Sensor.THROTTLE):
        yield _line(f"battery current or throttle: {use}", setting(recording, Logged.CURRENT))
    elif currents and not any(np.nan_to_num(channel.values).any() for channel in currents):
        yield f"battery current, which reads 0 throughout: {use}. Fit a current sensor (BATT_MONITOR)"


def _inertial(recording: Recording) -> Iterator[str]:
    """Rates and levels for vibration."""
    accels = [c for c in recording.channels if c.sensor == Sensor.ACCEL and len(c) > 1]
    periods = [float(np.median(np.diff(c.t))) for c in accels]
    fastest = max((1.0 / period for period in periods if period > 0.0), default=0.0)
    if accels and fastest < _SLOW_HZ:
        have = f"inertial samples at {_SLOW_HZ:.0f} Hz or more (it has {fastest:.0f})"
        yield _line(f"{have}: offsets, vibration", setting(recording, Logged.FAST_INERTIAL, _SLOW_HZ))
    if accels and telemetry(recording):
        yield _line("every sample: vibration, its frequencies, and clipping", ON_BOARD)
        return
    vehicle = recording.identity.autopilot is not None
    if accels and vehicle and not any(c.sensor == Sensor.VIBRATION for c in recording.channels):
        message = "vehicle_imu_status" if recording.identity.autopilot == "px4" else "VIBE"
        yield _line(f"{message}: vibration and clipping", setting(recording, Logged.INERTIAL))
    if accels and vehicle and all(c.stage in (Stage.FILTERED, Stage.DEBIASED) for c in accels):
        yield _line("unfiltered inertial samples: the frequencies of a vibration", every_sample(recording))


def _losses(recording: Recording, every: Sequence[Sampled]) -> Iterator[str]:
    """Stretches that the log itself lost."""
    gaps = lost(every)
    if gaps:
        longest = max(gaps, key=lambda gap: gap.length)
        often = "once" if len(gaps) == 1 else f"{len(gaps)} times"
        why = "the logger did not keep up. Use a faster card, or log less"
        if telemetry(recording):
            why = "the link lost them. Use a better link, or ask for fewer messages"
        yield f"all sensors, {often}, for up to {longest.length:.1f} s at {longest.start:.1f} s: {why}"
    dropped = [event for event in recording.events if event.kind == "drop"]
    if len(dropped) == 1:
        yield f"a part of the log: {dropped[0].text}"
    elif dropped:
        yield f"{len(dropped)} stretches that the logger lost, the first at {dropped[0].t:.1f} s"
