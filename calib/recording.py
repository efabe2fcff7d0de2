"""Recordings: what every reader makes and every method takes.

A :class:`Recording` holds :class:`Channel` s, each at its own rate and never forced onto one grid. It also holds the
parameters of the vehicle as a timeline, and the events of that time.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.summary import Summary, counted

if TYPE_CHECKING:
    from mavcal.calib.drawing import Drawing

Array = NDArray[np.float64]


class Sensor(StrEnum):
    """What a channel measures; the comment gives the columns and the unit."""

    ACCEL = "accel"  # x y z, m/s2
    GYRO = "gyro"  # x y z, rad/s
    MAG = "mag"  # x y z, uT
    TEMPERATURE = "temperature"  # of the inertial unit of the same instance, degC
    CURRENT = "current"  # A
    THROTTLE = "throttle"  # 0..1
    MOTOR = "motor"  # one column a motor, 0..1
    ROTOR_SPEED = "rotor_speed"  # one column a rotor, Hz
    ATTITUDE = "attitude"  # w x y z, body to north-east-down
    POSITION = "position"  # latitude deg, longitude deg, altitude m
    VELOCITY = "velocity"  # north east down, m/s
    PLACE = "place"  # north east down of a local origin, m
    VIBRATION = "vibration"  # level that the autopilot measured on an accelerometer: x y z, or one number, m/s2
    GYRO_VIBRATION = "gyro_vibration"  # the same of a gyroscope, rad/s
    CONTROL = "control"  # what the mixer is given: roll pitch yaw -1..1, throttle 0..1
    MIXER = "mixer"  # what scales the mixer: lift_max, voltage ratio, thrust limit
    VOLTAGE = "voltage"  # of the battery, V
    HEIGHT = "height"  # above the ground, measured downwards, m
    AIR = "air"  # pressure, Pa, and temperature of the barometer, degC


_LOOKED_AT = (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG, Sensor.TEMPERATURE)


class Stage(StrEnum):
    """How far the firmware had processed the samples."""

    RAW = "raw"  # no calibration in force, or undone
    CORRECTED = "corrected"  # calibration in force applied
    FILTERED = "filtered"  # corrected, then low-pass filtered
    DEBIASED = "debiased"  # an estimator's bias is subtracted too: useless for calibration


class Rounding(StrEnum):
    """How the values were quantised."""

    NONE = "none"
    NEAREST = "nearest"
    TOWARD_ZERO = "toward_zero"  # C++ float to int16: bins (k, k+1), and a zero bin of double width


@dataclass(frozen=True, eq=False)
class Channel:
    """One sensor's samples at its own time stamps.

    Parameters
    ----------
    sensor, instance
        What it measures; instances count from 0.
    t : shape (N,)
        Seconds on the vehicle's clock, non-decreasing.
    values : shape (N, k)
        One row a time stamp. Truncated streams carry the middle of their bin, so means are unbiased.
    unit : str
        ``m/s2 rad/s uT degC A 1`` or ``counts``.
    stage, source
        What the firmware did to it, and the message or column it came from.
    quantum : float
        Width of a quantisation bin in `unit`; 0 for none.
    rounding
        How the quantum came about.
    zero_bin : shape (N, k) or None
        True where a truncated sample lies in the zero bin, which is two quanta wide. None: no such bin.
    window : float
        Seconds of the sensor's own samples that each value is the mean of; 0: an instant, or not known.
    """

    sensor: Sensor
    instance: int
    t: Array
    values: Array
    unit: str
    stage: Stage
    source: str
    quantum: float = 0.0
    rounding: Rounding = Rounding.NONE
    zero_bin: NDArray[np.bool_] | None = None
    window: float = 0.0

    def __post_init__(self) -> None:
        t = np.ascontiguousarray(self.t, dtype=np.float64)
        values = np.ascontiguousarray(self.values, dtype=np.float64)
        if values.ndim == 1:
            values = values[:, None]
        if t.ndim != 1 or values.ndim != 2 or len(t) != len(values):
            raise InvalidInputError(
                f"{self.sensor} of {self.source}: {len(t)} time stamps for values of shape {values.shape}; "
                "one row a time stamp is needed"
            )
        object.__setattr__(self, "t", t)
        object.__setattr__(self, "values", values)

    def __len__(self) -> int:
        return len(self.t)

    def between(self, start: float, end: float) -> Channel:
        """The samples with ``start <= t < end``."""
        i, j = np.searchsorted(self.t, (start, end))
        return self.take(slice(int(i), int(j)))

    def take(self, rows: slice | NDArray[np.bool_] | NDArray[np.intp]) -> Channel:
        """The samples of `rows`."""
        zero_bin = None if self.zero_bin is None else self.zero_bin[rows]
        return dataclasses.replace(self, t=self.t[rows], values=self.values[rows], zero_bin=zero_bin)

    @property
    def key(self) -> tuple[Sensor, int, str]:
        """Key of the channel within one recording: sensor, instance, source."""
        return self.sensor, self.instance, self.source

    def require_ordered(self) -> None:
        """Raise InvalidInputError unless the samples are vectors in the order of their times."""
        if self.values.shape[1:] != (3,):
            raise InvalidInputError(f"the {self.sensor} needs three columns, not {self.values.shape[1]}")
        if not np.isfinite(self.t).all() or (np.diff(self.t) < 0.0).any():
            raise InvalidInputError(f"the time of the {self.sensor} goes back or is not finite: sort the samples")


@dataclass(frozen=True)
class ParameterEntry:
    """A parameter's value as it was seen at time `t` (s, vehicle clock)."""

    t: float
    name: str
    value: float | int


@dataclass(frozen=True)
class ParameterTimeline:
    """The vehicle's parameters as they were seen over time.

    `end_observed` is True when the calibration parameters were read again after the last sample, so that a change
    in the middle cannot have gone unseen.
    """

    entries: tuple[ParameterEntry, ...] = ()
    end_observed: bool = False

    def __bool__(self) -> bool:
        return bool(self.entries)

    def at(self, t: float) -> dict[str, float | int]:
        """Every parameter's last value seen up to `t`, or its first one if it was only seen later."""
        state: dict[str, float | int] = {}
        for entry in self.entries:
            if entry.t <= t or entry.name not in state:
                state[entry.name] = entry.value
        return state

    def final(self) -> dict[str, float | int]:
        """Every parameter's last value."""
        return {entry.name: entry.value for entry in self.entries}

    def changes(self, prefixes: tuple[str, ...] = ("",)) -> tuple[ParameterEntry, ...]:
        """The entries whose value differs from the one seen before under the same name."""
        seen: dict[str, float | int] = {}
        changed = []
        for entry in self.entries:
            if entry.name.startswith(prefixes):
                if entry.name in seen and seen[entry.name] != entry.value:
                    changed.append(entry)
                seen[entry.name] = entry.value
        return tuple(changed)

    @classmethod
    def constant(cls, values: Mapping[str, float | int]) -> ParameterTimeline:
        """A timeline that holds `values` from the beginning to the end."""
        return cls(tuple(ParameterEntry(-np.inf, n, v) for n, v in values.items()), end_observed=True)


class Oddity(StrEnum):
    """What was wrong with the samples that an event counts."""

    ZERO = "zero"  # exactly 0, 0, 0
    UNREADABLE = "unreadable"  # no numbers that such a sensor can read
    UNHEALTHY = "unhealthy"  # the vehicle itself called the sensor so
    CLIPPED = "clipped"  # at the end of the range


@dataclass(frozen=True)
class OddSamples:
    """How many samples of one sensor were odd.

    `total` is the number of all samples, None where it is unknown. `until` is the time of the last one, s, None where
    only the first is known.
    """

    what: Oddity
    sensor: Sensor
    instance: int
    count: int
    total: int | None = None
    until: float | None = None


@dataclass(frozen=True)
class Event:
    """Something that was said or happened at time `t` (s, vehicle clock); `odd` has the numbers of what was counted."""

    t: float
    kind: str
    """``text reboot gap drop armed disarmed utc onboard_calibration clipping damage dead left_out undo no_time``"""
    text: str
    odd: OddSamples | None = None


@dataclass(frozen=True)
class Segment:
    """A labelled span of a recording: a face, a ring, a turn."""

    label: str
    start: float
    end: float


@dataclass(frozen=True)
class Identity:
    """Whose recording it is. None: not said in the recording."""

    autopilot: str | None = None  # "ardupilot", "px4" or "other"
    vehicle_type: int | None = None  # MAV_TYPE
    firmware: tuple[int, int, int] | None = None
    uid: str | None = None  # uid2 as hexadecimal digits
    system: int | None = None
    component: int | None = None


@dataclass(frozen=True)
class Recording:
    """Channels, parameters, events and identity of one vehicle over one span of time.

    `reference` holds what is not of the vehicle's own sensors: what a simulated or ideal sensor read at the same time
    (ACCEL, GYRO, MAG), and the pose of a reference (ATTITUDE, PLACE, VELOCITY). No calibration touches it.

    `dynamics` holds what the autopilot knows of its own flight: CONTROL, MIXER, VOLTAGE, HEIGHT, AIR, and the
    estimator's ATTITUDE, VELOCITY and PLACE. Only the diagnosis of the airframe (:mod:`calib.airframe`) reads it.
    """

    channels: tuple[Channel, ...]
    parameters: ParameterTimeline = field(default_factory=ParameterTimeline)
    events: tuple[Event, ...] = ()
    segments: tuple[Segment, ...] = ()
    identity: Identity = field(default_factory=Identity)
    source: str = ""
    reference: tuple[Channel, ...] = ()
    dynamics: tuple[Channel, ...] = ()

    def instances(self, sensor: Sensor) -> tuple[int, ...]:
        """The instances of `sensor` that have samples, ascending."""
        return tuple(sorted({c.instance for c in self.channels if c.sensor == sensor and len(c)}))

    def find(self, sensor: Sensor, instance: int = 0) -> tuple[Channel, ...]:
        """Every channel of that sensor, in the order of the recording."""
        return tuple(c for c in self.channels if c.sensor == sensor and c.instance == instance and len(c))

    def channel(self, sensor: Sensor, instance: int = 0) -> Channel:
        """The best channel of that sensor: never a debiased one, finer quantum first, then more of the sensor's time.

        A few means over long windows tell more than as many instants; channels of unknown windows count their samples.

        Raises
        ------
        InvalidInputError
            If the recording has no such channel.
        """
        found = [c for c in self.find(sensor, instance) if c.stage != Stage.DEBIASED]
        if not found:
            have = sorted({f"{c.sensor}[{c.instance}]" for c in self.channels if len(c)}) or ["nothing"]
            raise InvalidInputError(
                f"the recording has no usable {sensor} of instance {instance} (it has {', '.join(have)})"
            )
        return min(found, key=lambda c: (c.quantum, -len(c) * c.window, -len(c)))

    def between(self, start: float, end: float) -> Recording:
        """Only the samples, events and segments with ``start <= t < end``; the parameters stay whole."""
        return dataclasses.replace(
            self,
            channels=tuple(c.between(start, end) for c in self.channels),
            events=tuple(e for e in self.events if start <= e.t < end),
            segments=tuple(s for s in self.segments if s.start < end and s.end > start),
            reference=tuple(c.between(start, end) for c in self.reference),
            dynamics=tuple(c.between(start, end) for c in self.dynamics),
        )

    def with_channels(self, channels: Iterable[Channel]) -> Recording:
        """The same recording with other channels."""
        return dataclasses.replace(self, channels=tuple(channels))

    @property
    def span(self) -> tuple[float, float]:
        """First and last time stamp over all channels; ``(nan, nan)`` if there is no sample."""
        ends = [(c.t[0], c.t[-1]) for c in self.channels if len(c)]
        if not ends:
            return float("nan"), float("nan")
        return float(min(e[0] for e in ends)), float(max(e[1] for e in ends))

    def plot(self, *sensors: Sensor) -> Drawing:
        """The best channel of every instance over time and as a spectrum, as a picture (SVG).

        Parameters
        ----------
        *sensors
            What to plot; none: accelerometers, gyroscopes, magnetometers and their thermometers. A picture has at most
            eight channels.

        Raises
        ------
        InvalidInputError
            If the recording has no samples of them.
        """
        found = []
        for sensor in sensors or _LOOKED_AT:
            usable = {c.instance for c in self.channels if c.sensor == sensor and c.stage != Stage.DEBIASED and len(c)}
            found += [self.channel(sensor, instance) for instance in sorted(usable)]
        from mavcal.calib.plots.recording import plotted

        return plotted(found, self.source or "recording")

    def __repr__(self) -> str:
        return self._summary().text()

    def _repr_html_(self) -> str:
        return self._summary().html()

    def _summary(self) -> Summary:
        start, end = self.span
        firmware = ".".join(map(str, self.identity.firmware or ()))
        vehicle = f"{self.identity.autopilot} {firmware}".strip() if self.identity.autopilot else "no vehicle"
        names = len({entry.name for entry in self.parameters.entries})
        length = f"{end - start:.1f} s" if start == start else "no samples"
        title = f"Recording {self.source or 'without a name'}: {length}, {vehicle}, {names} parameters"
        rows = tuple(_row(channel) for channel in self.channels if len(channel))
        beside = (f"{len(self.reference)} channels of a reference",) if self.reference else ()
        marked = (f"{len(self.segments)} labelled segments",) if self.segments else ()
        return Summary(title, ("channel", "samples", "rate", "unit", "stage", "source"), rows, (*marked, *beside))


def _row(channel: Channel) -> tuple[str, ...]:
    spent = float(channel.t[-1] - channel.t[0])
    rate = f"{(len(channel) - 1) / spent:.4g} Hz" if spent > 0.0 else "-"
    name = f"{channel.sensor} {channel.instance + 1}"
    return name, counted(len(channel)), rate, channel.unit, str(channel.stage), channel.source


def join(chunks: Iterable[Recording]) -> Recording:
    """One recording from consecutive chunks of the same vehicle; identity and parameters accumulate."""
    parts = tuple(chunks)
    if not parts:
        return Recording(())
    entries = tuple(e for p in parts for e in p.parameters.entries)
    return Recording(
        channels=_concatenated_by_key(c for p in parts for c in p.channels),
        parameters=ParameterTimeline(entries, end_observed=parts[-1].parameters.end_observed),
        events=tuple(e for p in parts for e in p.events),
        segments=tuple(s for p in parts for s in p.segments),
        identity=parts[-1].identity,
        source=parts[0].source,
        reference=_concatenated_by_key(c for p in parts for c in p.reference),
        dynamics=_concatenated_by_key(c for p in parts for c in p.dynamics),
    )


def _concatenated_by_key(channels: Iterable[Channel]) -> tuple[Channel, ...]:
    pieces: dict[tuple[Sensor, int, str], list[Channel]] = {}
    for channel in channels:
        pieces.setdefault(channel.key, []).append(channel)
    return tuple(concatenated(group) for group in pieces.values())


def concatenated(parts: Sequence[Channel]) -> Channel:
    """One channel of consecutive parts of it."""
    if len(parts) == 1:
        return parts[0]
    zero = [c.zero_bin for c in parts]
    return dataclasses.replace(
        parts[0],
        t=np.concatenate([c.t for c in parts]),
        values=np.concatenate([c.values for c in parts]),
        zero_bin=np.concatenate([z for z in zero if z is not None]) if all(z is not None for z in zero) else None,
    )
