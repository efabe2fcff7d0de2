"""Sampling of the sensors: rates, gaps of single sensors, frozen values, rejected samples.

Messages and rates that a log lacks are named with their use, and with the parameter that logs them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mavcal.calib.firmware.log_options import Logged, how_to_log, how_to_stream
from mavcal.calib.firmware.stream.auxiliary import telemetry
from mavcal.calib.flight.craft import craft_of
from mavcal.calib.flight.rest import Ground, TimeSpan, how_to_rest
from mavcal.calib.health import limits
from mavcal.calib.health.finding import HealthFinding, HealthVerdict, judged_value
from mavcal.calib.health.limits import STUCK
from mavcal.calib.logs.inspection import GAP_PERIODS, STUCK_PERIODS, Gap, constant_run, pauses
from mavcal.calib.preflight.installed import Key
from mavcal.calib.recording import Channel, Oddity, Recording, Sensor, Stage

SENSORS: Final = (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG)
_BUS: Final = "Check its bus and power; replace it if it comes back."
_BATCHES: Final = "ISBD"
_SELECTED: Final = "sensor_combined"
"""Sources that contain a sensor only part of the time by design: batches, and the unit selected at the time."""
_TURN: Final = float(np.radians(30.0))
"""Turn during which a stuck compass repeats one value; an offset of 5 deg/s fakes less in five seconds."""
_MARGIN_PERIODS: Final = 2.0
"""Margin at both ends of a gap in periods of the slower sensor: two sensors need not stop at the same sample."""
_SLOW_HZ: Final = 20.0
ON_BOARD: Final = "Take the log on board: no telemetry carries every sample."
_BATCH_SWITCH: Final = "INS_LOG_BAT_MASK 1"
"""ArduPilot's batch sampling: short stretches of every sample."""


@dataclass(frozen=True, eq=False)
class Sampled:
    """Sampling of one sensor: its densest channel, the median period, s, and its gaps."""

    channel: Channel
    period: float
    gaps: tuple[Gap, ...]


def sampled(recording: Recording) -> tuple[Sampled, ...]:
    """Every accelerometer, gyroscope and compass that has a rate; pauses of the whole recording are no gaps."""
    paused = pauses(recording)
    found = []
    for sensor in SENSORS:
        selected = sum(c.sensor == sensor and c.source == _SELECTED for c in recording.channels)
        left_out = (_BATCHES, _SELECTED) if selected > 1 else (_BATCHES,)
        for instance in recording.instances(sensor):
            channel = max(
                (c for c in recording.find(sensor, instance) if c.source not in left_out), key=len, default=None
            )
            if channel is None or len(channel) < 3:
                continue
            steps = np.diff(channel.t)
            period = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
            if not period:
                continue
            wide = np.flatnonzero(steps > max(limits.SILENT.suspicious, GAP_PERIODS * period)).tolist()
            gaps = [Gap(float(channel.t[i]), float(steps[i])) for i in wide]
            gaps += _fell_silent(recording, channel, GAP_PERIODS * period)
            found.append(Sampled(channel, period, tuple(g for g in gaps if not _paused(g, paused))))
    return tuple(found)


def _fell_silent(recording: Recording, channel: Channel, least: float) -> list[Gap]:
    """The time from the last sample of a sensor in any channel to the end of the other sensors."""
    of = channel.sensor, channel.instance
    last = max(float(c.t[-1]) for c in recording.find(*of))
    end = max((float(c.t[-1]) for c in recording.channels if c.sensor in SENSORS and len(c)), default=last)
    return [Gap(last, end - last)] if end - last > max(limits.SILENT.suspicious, least) else []


def lost(every: Sequence[Sampled]) -> tuple[Gap, ...]:
    """Gaps that all sensors share, by the one with most samples: they are the logger's."""
    densest = max(every, key=lambda one: len(one.channel), default=None)
    return () if densest is None else tuple(gap for gap in densest.gaps if not _went_on(gap, densest, every))


def sampling_findings(
    recording: Recording, every: Sequence[Sampled], running: Sequence[TimeSpan] = ()
) -> Iterator[HealthFinding]:
    """Rate and gaps of every sensor in `every`, and values that stood still; `running` are the spans with motors on."""
    for one in every:
        yield _gaps(one, every, _left_out(recording, one.channel))
        yield from _stuck(recording, one, running)
    yield from _distrusted(recording)


def _paused(gap: Gap, paused: Sequence[Gap]) -> bool:
    return any(gap.start < p.start + p.length and p.start < gap.start + gap.length for p in paused)


def _went_on(gap: Gap, one: Sampled, every: Sequence[Sampled]) -> bool:
    """Whether another sensor than `one` was sampled in the middle of the gap."""
    for other in every:
        margin = _MARGIN_PERIODS * max(other.period, one.period)
        first, last = np.searchsorted(other.channel.t, (gap.start + margin, gap.start + gap.length - margin))
        if gap.length > 2.0 * margin and last > first:
            return True
    return False


def _left_out(recording: Recording, channel: Channel) -> tuple[Gap, ...]:
    """Spans in which the reader left out samples of the sensor; they do not count as silence."""
    of = channel.sensor, channel.instance
    odd = [(e.t, e.odd) for e in recording.events if e.odd is not None and (e.odd.sensor, e.odd.instance) == of]
    return tuple(Gap(t - 1.0, max((found.until or t) - t, 0.0) + 2.0) for t, found in odd)


def _gaps(one: Sampled, every: Sequence[Sampled], left_out: Sequence[Gap]) -> HealthFinding:
    channel = one.channel
    own = [gap for gap in one.gaps if _went_on(gap, one, every) and not _paused(gap, left_out)]
    longest = max(own, key=lambda gap: gap.length, default=None)
    rate = f"{1.0 / one.period:.3g} Hz"
    key = "sampling", channel.sensor, channel.instance
    streamed = channel.source.isupper() and "_" in channel.source  # a message of MAVLink, not of a log on board
    if longest is None or streamed:
        lost_too = "; the gaps are those of the link or the logger" if one.gaps else ", no gap"
        text = f"sampled at {rate}{lost_too}"
        return HealthFinding(*key, HealthVerdict.OK, text, value=0.0, limit=limits.SILENT)
    verdict = judged_value(longest.length, 0.0, limits.SILENT)
    often = "once" if len(own) == 1 else f"{len(own)} times"
    text = (
        f"was silent {often} while others went on, for up to {longest.length:.1f} s at {longest.start:.1f} s ({rate})"
    )
    if longest.start >= channel.t[-1]:
        text = f"fell silent at {longest.start:.1f} s while others went on for {longest.length:.1f} s ({rate})"
    return HealthFinding(
        *(*key, verdict, text, _BUS if verdict != HealthVerdict.OK else "", longest.length, None, limits.SILENT),
        start=own[0].start,
        end=own[-1].start + own[-1].length,
    )


def _stuck(recording: Recording, one: Sampled, running: Sequence[TimeSpan]) -> Iterator[HealthFinding]:
    """A unit that repeats itself to the last digit while its channel otherwise changes.

    A compass at rest and coarse values may repeat: for them only repetition during a turn counts.
    """
    channel, run = one.channel, constant_run(one.channel)
    if run is not None and (channel.sensor == Sensor.MAG or channel.quantum):
        end = run.start + run.length
        moving = [Gap(max(run.start, s.start), min(end, s.end) - max(run.start, s.start)) for s in running]
        run = max(moving, key=lambda gap: gap.length, default=None)
        least = STUCK.faulty or STUCK.suspicious
        run = run if run is not None and run.length > least and _turned(recording, channel, run) else None
    if run is None or run.length <= max(STUCK.suspicious, STUCK_PERIODS * one.period):
        return
    verdict = judged_value(run.length, 0.0, STUCK)
    text = f"repeats one value for {run.length:.1f} s from {run.start:.1f} s on"
    yield HealthFinding(
        *("stuck", channel.sensor, channel.instance, verdict, text, _BUS, run.length, 0.0, STUCK),
        start=run.start,
        end=run.start + run.length,
    )


def _turned(recording: Recording, but: Channel, run: Gap) -> bool:
    """Whether every gyroscope but `but` turned by `_TURN` in `run`, one that is alone beyond its usual rate.

    An offset is not a turn: other units do not share it, and a single unit has it all the time.
    """
    seen: dict[int, bool] = {}
    for channel in recording.channels:
        if channel.sensor != Sensor.GYRO or channel.unit != "rad/s":
            continue
        part = channel.between(run.start, run.start + run.length)
        if (channel.sensor, channel.instance) == (but.sensor, but.instance) or len(part) < 3:
            continue
        alone = len(recording.instances(Sensor.GYRO)) == 1
        usual = np.median(np.nan_to_num(channel.values), axis=0) if alone else np.zeros(3)
        rates = np.nan_to_num(part.values) - usual
        angle = np.cumsum(0.5 * (rates[1:] + rates[:-1]) * np.diff(part.t)[:, None], axis=0)
        turned = float(np.ptp(angle, axis=0).max()) > _TURN
        seen[channel.instance] = seen.get(channel.instance, False) or turned
    return bool(seen) and all(seen.values())


def _distrusted(recording: Recording) -> Iterator[HealthFinding]:
    """Samples that the autopilot itself called unhealthy, or that no such sensor can read."""
    texts = {
        Oddity.UNHEALTHY: "was called unhealthy by the autopilot",
        Oddity.UNREADABLE: "gave values that no such sensor can read",
    }
    for event in recording.events:
        odd = event.odd
        if odd is None or odd.what not in texts or not odd.total:
            continue
        if odd.what == Oddity.UNHEALTHY and odd.count == odd.total:
            continue  # :mod:`calib.health.dead` has it
        share = odd.count / odd.total
        verdict = judged_value(share, 0.0, limits.UNHEALTHY)
        text = f"{texts[odd.what]} in {odd.count} of {odd.total} samples, first at {event.t:.1f} s"
        action = "" if verdict == HealthVerdict.OK else _BUS
        if odd.sensor in SENSORS:
            yield HealthFinding(
                *("unhealthy", odd.sensor, odd.instance, verdict, text, action, share, None, limits.UNHEALTHY),
                start=event.t,
                end=odd.until,
            )


def setting(recording: Recording, what: Logged, rate: float = 0.0) -> str:
    """The setting that records `what` at `rate` Hz or more; empty: not known."""
    if telemetry(recording):
        return how_to_stream(what, recording.identity, recording.parameters.final(), rate)
    return how_to_log(what, recording.identity, recording.parameters.final())


def every_sample(recording: Recording) -> str:
    """The action that logs every sample of an accelerometer; empty where it is not known."""
    if telemetry(recording):
        return ON_BOARD
    found = setting(recording, Logged.RAW_INERTIAL)
    if recording.identity.autopilot != "ardupilot":
        return found
    raw = f", or {found[0].lower()}{found[1:]}" if found.startswith("Set") else "."
    return f"Set {_BATCH_SWITCH} (batch sampling){raw}"


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
    """Missing data on the magnetic field of the motors."""
    currents = recording.find(Sensor.CURRENT)
    use = "interference of the motors with the compass"
    if not currents and not recording.find(Sensor.THROTTLE):
        yield _line(f"battery current or throttle: {use}", setting(recording, Logged.CURRENT))
    elif currents and not any(np.nan_to_num(channel.values).any() for channel in currents):
        yield f"battery current, which reads 0 throughout: {use}. Fit a current sensor (BATT_MONITOR)"


def _inertial(recording: Recording) -> Iterator[str]:
    """Missing inertial data: rates and vibration levels."""
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
    """Periods that are missing for all sensors, lost by the logger or the link."""
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
