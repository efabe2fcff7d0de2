"""Checks compasses: steadiness, the motors' field, the World Magnetic Model, and whether units agree."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from datetime import datetime
from itertools import combinations
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from mavcal.calib.earth import STRONGEST_UT, WEAKEST_UT, EarthField, beyond_earth, decimal_year, earth_field
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.flight.flying import usable
from mavcal.calib.health import limits
from mavcal.calib.health.channels import judged_channel, never_calibrated, why_unjudged
from mavcal.calib.health.finding import BAD, Compared, HealthFinding, HealthVerdict, judged_value
from mavcal.calib.health.support import Support, support_of
from mavcal.calib.recording import Array, Channel, Recording, Sensor
from mavcal.calib.stats.windows import finite_rows

_CALIBRATE: Final = "Calibrate the compass outdoors, away from metal."
_MOUNTING: Final = "Check how the compass is mounted and its rotation parameter, then calibrate it outdoors."
_MOTORS: Final = "Move the compass away from the power leads, or compensate: mavcal fit mag-motor."
_OWN: Final = ("COMPASS_OFS", "COMPASS_DIA", "COMPASS_ODI", "COMPASS_MOT", "COMPASS_SCALE", "CAL_MAG")
_LEAST: Final = 50
"""Least number of samples to judge steadiness."""
_MOVED: Final = {Sensor.CURRENT: 1.0, Sensor.THROTTLE: 0.05}
"""Least range of the current, A, and of the throttle, 0..1, that shows their field."""
_RELATED: Final = 0.5
"""Least correlation at which the field counts as driven by the motors."""
_YEAR: Final = 2025.5
"""Decimal year where the log has no date: the field's strength changes by a thousandth a year."""


def compass_findings(recording: Recording, support: Support | None = None) -> Iterator[HealthFinding]:
    """Every check of every compass; `support` contradicts the logged attitude; None: it is computed here."""
    yield from _corrupt(recording)
    field = _field(recording)
    attitude = next(iter(recording.find(Sensor.ATTITUDE)), None)
    if (support_of(recording, attitude) if support is None else support).tilt:
        attitude = None  # it has no vertical that a field could be held against
    found: dict[int, Channel] = {}
    for instance in recording.instances(Sensor.MAG):
        streamed = judged_channel(recording, Sensor.MAG, instance)
        if streamed is None:
            yield HealthFinding(
                "field", Sensor.MAG, instance, HealthVerdict.CANNOT_SAY, why_unjudged(recording, Sensor.MAG, instance)
            )
            continue
        channel = usable(streamed)
        found[instance] = channel
        driven = _driven(recording, channel, attitude)
        if driven is not None:
            yield driven
        steady = _steady(recording, channel)
        if driven is not None and driven.verdict in BAD and steady.verdict in BAD:  # the cause is known
            steady = dataclasses.replace(steady, action=driven.action)
        yield steady
        if len(channel) >= _LEAST:
            yield from _against_earth(recording, channel, attitude, field)
    yield from _between_compasses(found)


def _corrupt(recording: Recording) -> Iterator[HealthFinding]:
    """Compasses whose parameters are not numbers."""
    corrupt: dict[int, list[str]] = {}
    for name, value in sorted(recording.parameters.final().items()):
        if name.startswith(_OWN) and not math.isfinite(value):
            corrupt.setdefault(next((int(c) - 1 for c in name if c.isdigit()), 0), []).append(name)
    for instance, named in corrupt.items():
        listed = ", ".join(named)
        text = f"its parameter{'s' if len(named) > 1 else ''} {listed} {'are' if len(named) > 1 else 'is'} not a number"
        action = f"Set {listed} to 0 and calibrate the compass."
        yield HealthFinding("parameters", Sensor.MAG, instance, HealthVerdict.FAULTY, text, action)


def _length(channel: Channel) -> Array:
    return np.asarray(np.linalg.norm(channel.values, axis=1), dtype=np.float64)


def _steady(recording: Recording, channel: Channel) -> HealthFinding:
    length = _length(channel)
    if len(length) < _LEAST:
        text = f"{len(length)} samples: {_LEAST} are needed"
        return HealthFinding("steady", Sensor.MAG, channel.instance, HealthVerdict.CANNOT_SAY, text)
    second = np.unique(np.floor(channel.t - channel.t[0]), return_inverse=True)[1]
    means = np.bincount(second, length) / np.bincount(second)  # noise of single samples costs no heading
    low, middle, high = np.percentile(means, (2.5, 50.0, 97.5)).tolist()
    spread = 0.5 * (high - low) / max(middle, 1e-9)
    verdict = judged_value(spread, 0.0, limits.FIELD_STEADY)
    text = f"reads {middle:.1f} uT, 95 % of the time within {low:.1f} and {high:.1f} uT (+-{100 * spread:.0f} %)"
    if verdict in BAD and never_calibrated(recording, Sensor.MAG, channel.instance):
        text += ". It was never calibrated: its offsets are 0"
    return _bad("steady", channel, verdict, text, _CALIBRATE, Compared(spread, 0.0, limits.FIELD_STEADY))


def _driven(recording: Recording, channel: Channel, attitude: Channel | None) -> HealthFinding | None:
    """Dependence of the field's strength or vertical component on current or throttle; None: neither of these moved.

    Neither strength nor vertical component depends on the heading, which a bad compass corrupts in the attitude too.
    """
    parts = [("strength", _length(channel))]
    down = None if attitude is None else _down(channel, attitude)
    if down is not None:
        parts.append(("vertical part", np.einsum("ij,ij->i", channel.values, down)))
    strength, worst = max(float(np.median(_length(channel))), 1e-9), None
    for sensor, name in ((Sensor.CURRENT, "current"), (Sensor.THROTTLE, "throttle")):
        x = _drive(recording, sensor, channel) if len(channel) >= _LEAST else None
        for part, y in parts if x is not None else ():
            assert x is not None
            r = float(np.corrcoef(x, y)[0, 1]) if np.ptp(y) > 0.0 else 0.0
            low, high = np.percentile(x, (5.0, 95.0)).tolist()
            change = abs(float(np.polyfit(x - x.mean(), y, 1)[0])) * (high - low) / strength
            if worst is None or abs(r) > abs(worst[0]):
                worst = r, change, f"its {part} moves by {100 * change:.0f} % with the {name} (correlation {r:+.2f})"
    if worst is None:
        return None
    r, change, text = worst
    verdict = judged_value(change, 0.0, limits.FIELD_DRIVEN) if abs(r) >= _RELATED else HealthVerdict.OK
    return _bad("motors", channel, verdict, text, _MOTORS, Compared(change, 0.0, limits.FIELD_DRIVEN))


def _drive(recording: Recording, sensor: Sensor, channel: Channel) -> Array | None:
    """Current or throttle at the compass's samples; None where it was not recorded or did not move."""
    drive = next(iter(recording.find(sensor)), None)
    if drive is None or len(drive) < _LEAST:
        return None
    x = np.interp(channel.t, drive.t, np.nan_to_num(drive.values[:, 0]))
    low, high = np.percentile(x, (5.0, 95.0)).tolist()
    return x if high - low >= _MOVED[sensor] else None


def _field(recording: Recording) -> EarthField | None:
    position = next(iter(recording.find(Sensor.POSITION)), None)
    if position is None:
        return None
    values = position.values[finite_rows(position.values)]
    fixed = values[np.abs(values[:, :2]).max(axis=1) > 1e-6] if len(values) else values
    if not len(fixed):
        return None
    year = _YEAR
    for event in recording.events:
        if event.kind == "utc":
            year = decimal_year(datetime.fromisoformat(event.text))
    try:
        latitude, longitude, altitude = np.median(fixed, axis=0)
        return earth_field(float(latitude), float(longitude), float(altitude), year)
    except InvalidInputError:
        return None


def _against_earth(
    recording: Recording, channel: Channel, attitude: Channel | None, field: EarthField | None
) -> Iterator[HealthFinding]:
    if field is None:
        yield _anywhere(recording, channel)
        return
    north, _, down = field.north_east_down.tolist()
    expected = float(np.linalg.norm(field.north_east_down))
    measured = float(np.median(_length(channel)))
    off = abs(measured - expected) / expected
    verdict = judged_value(off, field.norm_sd / expected, limits.FIELD)
    text = f"reads {measured:.1f} uT; the World Magnetic Model has {expected:.1f} uT there"
    if verdict in BAD and never_calibrated(recording, Sensor.MAG, channel.instance):
        text += ". It was never calibrated: its offsets are 0"
    yield _bad("earth", channel, verdict, text, _CALIBRATE, Compared(off, field.norm_sd / expected, limits.FIELD))
    dip = None if attitude is None else _dip(channel, attitude)
    if dip is None:
        return
    across = float(np.linalg.norm(field.north_east_down[:2]))
    should = float(np.degrees(np.arctan2(down, max(across, abs(north), 1e-9))))
    apart = abs(dip - should)
    verdict = judged_value(apart, 1.0, limits.DIP)
    text = f"its field dips by {dip:.1f} deg; the World Magnetic Model has {should:.1f} deg there"
    yield _bad("dip", channel, verdict, text, _MOUNTING, Compared(apart, 1.0, limits.DIP))


def _anywhere(recording: Recording, channel: Channel) -> HealthFinding:
    """The strength against the range of the Earth's field; without a latitude the dip cannot be judged."""
    measured = float(np.median(_length(channel)))
    off = beyond_earth(measured)
    verdict = judged_value(off, 0.0, limits.FIELD)
    range_of = f"the Earth has {WEAKEST_UT:.0f} to {STRONGEST_UT:.0f} uT anywhere"
    if verdict == HealthVerdict.OK:
        text = f"the log has no position: {measured:.1f} uT are looked at alone, and {range_of}"
        return HealthFinding("earth", Sensor.MAG, channel.instance, HealthVerdict.CANNOT_SAY, text, "Log the GPS.")
    text = f"reads {measured:.1f} uT; {range_of}"
    if never_calibrated(recording, Sensor.MAG, channel.instance):
        text += ". It was never calibrated: its offsets are 0"
    return _bad("earth", channel, verdict, text, _CALIBRATE, Compared(off, 0.0, limits.FIELD))


def _dip(channel: Channel, attitude: Channel) -> float | None:
    """Median angle of the field below the horizon, deg."""
    down = _down(channel, attitude)
    if down is None or len(channel) < _LEAST:
        return None
    sine = np.einsum("ij,ij->i", channel.values, down) / np.maximum(_length(channel), 1e-9)
    return float(np.degrees(np.median(np.arcsin(np.clip(sine, -1.0, 1.0)))))


def _down(channel: Channel, attitude: Channel) -> Array | None:
    """Down in the body's axes at the samples of `channel`, (N, 3); None: the attitude covers too little of them."""
    q = usable(attitude)
    if len(q) < 2 or q.t[0] > channel.t[len(channel) // 4] or q.t[-1] < channel.t[-len(channel) // 4]:
        return None
    down = Rotation.from_quat(q.values, scalar_first=True).as_matrix()[:, 2, :]
    return np.column_stack([np.interp(channel.t, q.t, column) for column in down.T])


def _between_compasses(found: dict[int, Channel]) -> Iterator[HealthFinding]:
    """Angle between the fields of two compasses; of three, the one that disagrees with both is named."""
    angles = _angles(found)
    for instance, channel in found.items():
        own = {pair: angle for pair, angle in angles.items() if instance in pair}
        if own:
            yield _outlier(channel, angles) or _from_furthest(channel, own, len(found))


def _outlier(channel: Channel, angles: Mapping[tuple[int, int], float]) -> HealthFinding | None:
    """Finding on a compass that disagrees with all others; None: it does not, or fewer than two others agree."""
    own = [angle for pair, angle in angles.items() if channel.instance in pair]
    among = [angle for pair, angle in angles.items() if channel.instance not in pair]
    if len(own) < 2 or not among or max(among) > limits.FIELD_ALONE.suspicious / 3.0:
        return None
    verdict = judged_value(min(own), 0.0, limits.FIELD_ALONE)
    if verdict == HealthVerdict.OK:
        return None
    others = " and ".join(str(i + 1) for i in sorted({i for pair in angles for i in pair} - {channel.instance}))
    text = f"its field is {min(own):.0f} deg away from those of compasses {others}, which agree"
    return _bad("compasses", channel, verdict, text, _CALIBRATE, Compared(min(own), 0.0, limits.FIELD_ALONE))


def _angles(found: Mapping[int, Channel]) -> dict[tuple[int, int], float]:
    """Median angle, deg, between the fields of each two compasses with enough samples."""
    angles: dict[tuple[int, int], float] = {}
    for a, b in combinations(found, 2):
        first, second = found[a], found[b]
        if min(len(first), len(second)) < _LEAST:
            continue
        beside = np.column_stack([np.interp(first.t, second.t, column) for column in second.values.T])
        cosine = np.einsum("ij,ij->i", first.values, beside)
        cosine /= np.maximum(_length(first) * np.linalg.norm(beside, axis=1), 1e-9)
        angles[a, b] = float(np.degrees(np.median(np.arccos(np.clip(cosine, -1.0, 1.0)))))
    return angles


def _from_furthest(channel: Channel, own: Mapping[tuple[int, int], float], count: int) -> HealthFinding:
    """Finding on one of `count` compasses against the one that differs most; `own` are its angles, deg."""
    pair, angle = max(own.items(), key=lambda two: two[1])
    agrees = sum(a <= limits.FIELDS_APART.suspicious for a in own.values())
    verdict = judged_value(angle, 0.0, limits.FIELDS_APART)
    text = f"its field is {angle:.0f} deg away from that of compass {sum(pair) - channel.instance + 1}"
    if verdict != HealthVerdict.OK and agrees:
        verdict, text = HealthVerdict.OK, f"agrees with {agrees} other compass{'es' if agrees > 1 else ''}"
    elif verdict != HealthVerdict.OK and count == 2:
        verdict, text = HealthVerdict.SUSPICIOUS, f"{text}; which is off, this comparison cannot say"
    return _bad("compasses", channel, verdict, text, _CALIBRATE, Compared(angle, 0.0, limits.FIELDS_APART))


def _bad(
    check: str, channel: Channel, verdict: HealthVerdict, text: str, action: str, measured: Compared | None = None
) -> HealthFinding:
    shown = "" if verdict == HealthVerdict.OK else action
    value, sd, limit = (None, None, None) if measured is None else (measured.value, measured.sd, measured.limit)
    return HealthFinding(check, Sensor.MAG, channel.instance, verdict, text, shown, value, sd, limit)
