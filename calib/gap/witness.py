"""Effects of a sensor that other units, or the readings at rest, contradict.

An effect that two inertial units show equally, and only in flight, is of the airframe or the air (AIRFRAME 5.6).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.gap.effects import by_id
from mavcal.calib.gap.effects.base import CatalogueEffect, MeanEffect, NoiseEffect
from mavcal.calib.gap.effects.replay import with_effects_in
from mavcal.calib.gap.effects.traits import SensorTerm, Trait
from mavcal.calib.gap.effects.vibration import RUNNING_THROTTLE
from mavcal.calib.gap.export.sensor_errors import matrix_of, vector
from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.reference.resolution import EQUAL
from mavcal.calib.gap.sampling_jitter import is_sampling_jitter
from mavcal.calib.gap.schema import FIRST, EffectEstimate, GapReport, SeriesFit
from mavcal.calib.recording import Channel, Recording, Sensor

Array = NDArray[np.float64]

_INERTIAL: Final = (Sensor.ACCEL, Sensor.GYRO)
_AT_REST: Final = (SensorTerm.BIAS, SensorTerm.SCALE)
"""Terms of an accelerometer that gravity at rest shows."""
_OF_A_PART: Final = (SensorTerm.MISALIGNMENT, SensorTerm.ROTATION)
_OWN: Final = 0.25
"""Least variance of the difference of two units, relative to the residual's, for the noise to be a unit's own. Chosen,
not measured: half of what independent noise would have."""
_FOLLOWS: Final = 0.5
"""Least slope of the difference of two units on an effect for the difference to follow it. Source: nearer to 1, the
prediction of the effect, than to 0."""
_SEEN: Final = 5.0
"""Least slope in its standard errors for white noise. Chosen, not measured: it is not white."""
_SAME_TIME_S: Final = 0.003
"""Time, s, between samples of two units that count as simultaneous. Source: one loop at 400 Hz."""
_CONSTANT: Final = 0.01
"""Variation relative to its mean below which an effect is constant. Chosen, not measured: a hundredth shows nothing."""
_REST: Final = 0.03
"""Largest difference, m/s2, of the norm at rest from gravity. Source: local gravity."""
_BEFORE_S, _LONGEST_S, _FEWEST = 0.5, 30.0, 20
"""Time, s, left out before a start, in which somebody may touch the vehicle; longest rest, s, that is used; and its
least samples. Chosen, not measured: a vehicle that waits longer may be carried."""


def of_no_sensor(report: GapReport, real: Recording, sim: Recording | None) -> tuple[EffectEstimate, ...]:
    """Effects that all units show equally and only in flight, that rest contradicts, or that are sampling jitter."""
    late = tuple(effect for effect in report.effects if is_sampling_jitter(effect, real))
    return (*not_borne_out(report, real), *refuted_at_rest(report, real, sim), *late)


def not_borne_out(report: GapReport, real: Recording) -> tuple[EffectEstimate, ...]:
    """Effects of inertial sensors that all units show equally, and only in flight."""
    return tuple(
        effect for effect in report.effects if effect.sensor in _INERTIAL and not _borne_out(effect, report, real)
    )


def refuted_at_rest(report: GapReport, real: Recording, sim: Recording | None) -> tuple[EffectEstimate, ...]:
    """Effects of accelerometers that gravity at rest contradicts."""
    return tuple(effect for effect in report.effects if _refuted(effect, real, sim))


def _refuted(effect: EffectEstimate, real: Recording, sim: Recording | None) -> bool:
    """Whether an accelerometer with the effect would read gravity at rest differently, relative to the simulator."""
    known = by_id().get(effect.id)
    if effect.sensor != Sensor.ACCEL or known is None or known.term not in _AT_REST:
        return False
    bias, matrix = vector(effect, "bias"), np.eye(3)
    if known.term is SensorTerm.SCALE:
        matrix += matrix_of(effect)
    for instance in (i - FIRST for i in effect.instances):
        reads = _at_rest(real, instance)
        if reads is None:
            continue
        down = np.linalg.solve(matrix, reads - bias)  # a bias across gravity tilts what is read
        ideal = down * (STANDARD_GRAVITY / float(np.linalg.norm(down)))
        told = float(np.linalg.norm(matrix @ ideal + bias)) - STANDARD_GRAVITY
        simulated = None if sim is None else _at_rest(sim, instance)
        right = STANDARD_GRAVITY if simulated is None else float(np.linalg.norm(simulated))
        if abs(float(np.linalg.norm(reads)) - right - told) > max(_REST, _FOLLOWS * abs(told)):
            return True
    return False


def _at_rest(recording: Recording, instance: int) -> Array | None:
    """Median reading (3,) of an accelerometer before the vehicle arms, or its motors run, for the first time."""
    begins = [e.t for e in recording.events if e.kind == "armed"]
    begins += [
        float(c.t[r.argmax()])
        for c in recording.find(Sensor.MOTOR)
        if (r := c.values.max(axis=1) > RUNNING_THROTTLE).any()
    ]
    if instance not in recording.instances(Sensor.ACCEL) or not begins:
        return None
    accel = recording.channel(Sensor.ACCEL, instance)
    still = accel.values[(accel.t < min(begins) - _BEFORE_S) & (accel.t > min(begins) - _LONGEST_S)]
    return np.asarray(np.median(still, axis=0)) if len(still) >= _FEWEST else None


def _borne_out(effect: EffectEstimate, report: GapReport, real: Recording) -> bool:
    sensor = effect.sensor
    assert sensor is not None
    units = {c.instance: c for c in _best(real, sensor)}
    own = [i - FIRST for i in effect.instances if i - FIRST in units]
    others = [i for i in units if i not in own]
    series = [s for s in report.series if s.sensor == sensor and set(s.instances) & set(effect.instances)]
    if not own or not series:
        return True
    known = by_id().get(effect.id)
    if isinstance(known, NoiseEffect):
        return _of_one_unit(units, own, others or own[1:], series)
    if others:
        apart = _follows(units[own[0]], units[others[0]], series[0], effect.id)
    else:
        apart = not (len(own) > 1 and _of_a_part(known)) and not _gravity_only(series[0])
    if sensor == Sensor.ACCEL and known is not None and known.term in _AT_REST and not (others and apart):
        return any(_off_at_rest(i, real) for i in own)
    return apart


def _of_a_part(effect: CatalogueEffect | None) -> bool:
    """Whether an effect belongs to a single part: units do not share it, as they share a filter or a clock."""
    return effect is not None and (effect.term in _OF_A_PART or Trait.JUMPING in effect.traits)


def _gravity_only(series: SeriesFit) -> bool:
    """Whether an accelerometer's reference is gravity alone, from which every force of flight differs."""
    if series.sensor != Sensor.ACCEL or series.ideal is None:
        return False
    size = np.linalg.norm(series.ideal, axis=1)
    return bool(np.nanmax(size) - np.nanmin(size) < _REST)


def as_simulated(report: GapReport, real: Recording, sim: Recording) -> tuple[EffectEstimate, ...]:
    """Biases by which the simulator's units differ from each other too, which are therefore not a gap."""
    return tuple(e for e in report.effects if e.sensor in _INERTIAL and _simulated(e, real, sim))


def in_both_flights(report: GapReport, companion: Sequence[Trace]) -> tuple[EffectEstimate, ...]:
    """Effects that the `companion` flight of the simulator shows as well, by about as much."""
    return tuple(e for e in report.effects if e.sensor is not None and _in_companion(e, companion))


def _in_companion(effect: EffectEstimate, companion: Sequence[Trace]) -> bool:
    """Whether the companion's residual follows what the effect would add to it."""
    if not isinstance(by_id().get(effect.id), MeanEffect):
        return False
    with_it, _ = with_effects_in(companion, (effect,))
    product = power = 0.0
    for before, after in zip(companion, with_it, strict=True):
        says = (after.ideal - before.ideal)[before.observed]
        if np.abs(says).max(initial=0.0) <= EQUAL * np.abs(before.ideal).max(initial=0.0):
            continue
        steady = says.std(axis=0) < _CONSTANT * np.abs(says.mean(axis=0))  # else an offset says nothing of it
        left = before.residual[before.observed]
        x, y = (np.where(steady, v, v - v.mean(axis=0)) for v in (says, left))
        # a unit that equals another one to the last digit follows nothing that only one of them has
        weight = 1.0 / np.maximum((y**2).mean(axis=0), EQUAL * (x**2).mean(axis=0) + np.finfo(float).tiny)
        product += float((x * y * weight).sum())
        power += float((x * x * weight).sum())
    return power > 0.0 and max(_FOLLOWS, _SEEN / math.sqrt(power)) < product / power < 1.0 / _FOLLOWS


def _simulated(effect: EffectEstimate, real: Recording, sim: Recording) -> bool:
    known, sensor = by_id().get(effect.id), effect.sensor
    assert sensor is not None
    if known is None or known.term is not SensorTerm.BIAS or isinstance(known, NoiseEffect):
        return False
    own = [i - FIRST for i in effect.instances]
    values = np.array([p.value for p in effect.params])
    differences = []
    for recording in (real, sim):
        units = {c.instance: c for c in _best(recording, sensor)}
        others = [i for i in units if i not in own]
        if len(own) != 1 or own[0] not in units or not others:
            return False
        found = _difference(units[own[0]], units[others[0]])
        if found is None or values.shape != (3,):
            return False
        differences.append(found[1].mean(axis=0))
    return bool(np.linalg.norm(differences[0] - differences[1]) < _FOLLOWS * np.linalg.norm(values))


def _best(real: Recording, sensor: Sensor) -> Iterable[Channel]:
    for instance in real.instances(sensor):
        yield real.channel(sensor, instance)


def _of_one_unit(units: dict[int, Channel], own: list[int], beside: list[int], series: list[SeriesFit]) -> bool:
    """Whether the units' difference has a considerable part of the residual of the effect's unit."""
    if not beside:
        return True
    difference = _difference(units[own[0]], units[beside[0]])
    if difference is None:
        return True
    t, d = difference
    inside = (t >= series[0].t[0]) & (t <= series[0].t[-1])
    left = series[0].residual - series[0].modelled
    if inside.sum() < 50:
        return True
    return bool(np.nanvar(d[inside], axis=0).sum() > _OWN * np.nanvar(left, axis=0).sum())


def _difference(first: Channel, second: Channel) -> tuple[Array, Array] | None:
    """Times and first minus second unit (N, 3) at their common sample times; None where these are too few."""
    rows = np.clip(np.searchsorted(first.t, second.t), 1, max(len(first) - 1, 1))
    before = np.abs(first.t[rows - 1] - second.t) < np.abs(first.t[rows] - second.t)
    rows = rows - before
    same = np.abs(first.t[rows] - second.t) < _SAME_TIME_S
    if same.sum() < 50:
        return None
    return second.t[same], first.values[rows[same]] - second.values[same]


def _follows(own: Channel, other: Channel, series: SeriesFit, id_: str) -> bool:
    """Whether the difference of the units follows the effect's contribution to its unit."""
    part = next((p for name, p in series.parts.items() if name.startswith(id_)), None)
    difference = _difference(own, other)
    if part is None or difference is None or not np.abs(part).any():
        return True
    t, d = difference
    inside = (t >= series.t[0]) & (t <= series.t[-1])
    says = np.column_stack([np.interp(t[inside], series.t, part[:, k]) for k in range(3)])
    steady = np.abs(says.mean(axis=0)) > says.std(axis=0)
    x = np.where(steady, says, says - says.mean(axis=0)).ravel()
    y = np.where(steady, d[inside], d[inside] - d[inside].mean(axis=0)).ravel()
    size = float(x @ x)
    error = np.sqrt(float((y**2).mean()) / size) if size > 0.0 else 0.0
    return size == 0.0 or float(x @ y) / size > max(_FOLLOWS, _SEEN * error)


def _off_at_rest(instance: int, real: Recording) -> bool:
    """Whether the unit misreads gravity at rest; True where that is unknown."""
    reads = _at_rest(real, instance)
    return reads is None or bool(abs(float(np.linalg.norm(reads)) - STANDARD_GRAVITY) > _REST)
