"""Unnamed causes in a model, and the unexplained part of the gap.

These are unnamed shapes, noise of no sensor, frequent jumps, unexplained bands, and withdrawn effects. None is reported
as an effect: a wrong name would look right.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mavcal.calib.gap.effects.base import CatalogueEffect
from mavcal.calib.gap.model.hypotheses import Key
from mavcal.calib.gap.model.joint import Model, Term
from mavcal.calib.gap.schema import HiddenDriver, Unknown
from mavcal.calib.gap.unknown.discrepancy import bets_of, log_odds, winning_bets
from mavcal.calib.gap.unknown.excess_power import excess_power
from mavcal.calib.gap.unknown.misattributed_noise import Unexplained, bursts, misattributed_noise, nonstationary_noise
from mavcal.calib.gap.unknown.telegraph_noise import telegraph_noise
from mavcal.calib.gap.unknown.transitions import events_of, jump_moment
from mavcal.calib.gap.worth.attribution import Attribution
from mavcal.calib.recording import Sensor

_MANY_JUMPS = 3
"""Most jumps of one sensor that are single events. Chosen, not measured: a magnet put on and taken off makes two."""
NOT_LASTING = "a deviation that no effect describes throughout the recording"
_MATERIAL = 0.03
"""Share of the gap above which an unknown part is reported. Source: GAP 3.3."""
_MATERIAL_ON_SENSOR = 0.1
"""The same for the residual of one sensor: no model explains the last hundredth of a long recording. Chosen, not
measured: three times `_MATERIAL`, since its shape is unknown."""
_LEAST_PROBABILITY = 0.01
"""Least probability of a named effect if an unnamed cause is likelier. Chosen, not measured: a name with a probability
of one in a hundred is useless."""
_COMMON = "clock"
"""Key for effects common to all sensors."""
_BEATING, _SAME_DIRECTION = 20.0, 0.8
"""Largest difference, in periods per recording, and least similarity of direction, of two waves that are one. Chosen,
not measured: a line that wanders is as wide, and four fifths are most of a direction."""


@dataclass(frozen=True, eq=False)
class UnnamedCause:
    """Terms of a model that stand for a cause without a name."""

    keys: tuple[Key, ...]
    text: str
    driver: HiddenDriver | None = None


def unnamed_causes_in(
    model: Model, attributions: Sequence[Attribution], floor: Mapping[Sensor, float] | None = None
) -> tuple[UnnamedCause, ...]:
    """Every unnamed term of a model, and every effect with a likelier unnamed cause.

    `floor`: by sensor, the gain by which two recordings differ anyway.
    """
    shapes = [t.hypothesis for t in model.terms if t.hypothesis.effect.nameless]
    levels = [UnnamedCause(found.keys, found.text) for found in telegraph_noise(model, attributions, floor)]
    taken = {key for two in levels for key in two.keys}
    drifts = [
        UnnamedCause((found.key,), found.text, found.driver)
        for found in misattributed_noise(model)
        if found.key not in taken
    ]
    known = taken | {h.key for h in shapes} | {key for drift in drifts for key in drift.keys}
    doubted = [a for a in attributions if a.doubted and a.key not in known]
    effects = {t.hypothesis.key: t.hypothesis.effect for t in model.members}
    return (
        *(UnnamedCause((h.key,), h.effect.excited_by) for h in shapes),
        *levels,
        *drifts,
        *(UnnamedCause((a.key,), f"{a.shape}, or {effects[a.key].id}; to tell: {effects[a.key].fix}") for a in doubted),
        *_frequent_jumps(model),
        *_beating_waves(model),
        *(UnnamedCause((key,), text) for key, text in bursts(model)),
    )


def improbable_effects(
    attributions: Iterable[Attribution], effects: Mapping[Key, CatalogueEffect], *, beside_withdrawn: bool
) -> Iterable[UnnamedCause]:
    """Effects far less likely than an unnamed cause in their place, or than a withdrawn effect."""
    found: dict[str, list[Key]] = {}
    for a in attributions:
        effect = effects[a.key]
        if effect.nameless:
            continue  # it has no name to begin with
        if a.probability < _LEAST_PROBABILITY and (beside_withdrawn or a.unknown_probability > a.probability):
            found.setdefault(_COMMON if effect.shared else effect.sensor.value, []).append(a.key)
    return [
        UnnamedCause(tuple(keys), f"a difference on {name} that no effect describes") for name, keys in found.items()
    ]


def _frequent_jumps(model: Model) -> list[UnnamedCause]:
    """Jumps of a sensor that are too frequent for single events."""
    found = []
    for sensor in dict.fromkeys(view.sensor for view in model.setting.views):
        events = events_of(model, sensor)
        own = [term for event in events for term in event]
        if len(events) >= _MANY_JUMPS:
            moments = tuple(dict.fromkeys(f"{jump_moment(model, t)[0]:.1f} s" for t in own))
            text = f"{len(moments)} jumps on {sensor.value}: {', '.join(moments)}"
            found.append(UnnamedCause(tuple(t.hypothesis.key for t in own), text))
    return found


def _beating_waves(model: Model) -> list[UnnamedCause]:
    """Waves of a sensor so close in frequency that they are one wave of varying amplitude."""
    found = []
    waves = sorted((t for t in model.terms if t.effect.tonal), key=lambda t: t.theta)
    for sensor in dict.fromkeys(t.effect.sensor for t in waves):
        own = [t for t in waves if t.effect.sensor is sensor]
        edges = [0, *(k for k, pair in enumerate(itertools.pairwise(own), 1) if not _one_wave(model, *pair)), len(own)]
        for group in (own[low:high] for low, high in itertools.pairwise(edges)):
            if len(group) > 1:
                ends = " to ".join(f"{t.theta:.3g}" for t in (group[0], group[-1]))
                text = f"a wave of {ends} Hz on {sensor.value} that comes and goes"
                found.append(UnnamedCause(tuple(t.hypothesis.key for t in group), text))
    return found


def _one_wave(model: Model, one: Term, other: Term) -> bool:
    """Whether two waves agree in direction and frequency like one wave in a part of the recording."""
    if one.hypothesis.instances != other.hypothesis.instances:
        return False
    seen = [v.t for v in model.setting.views if one.hypothesis.touches(v)]
    length = max(float(t[-1]) for t in seen) - min(float(t[0]) for t in seen)
    directions = [np.linalg.svd(t.beta.reshape(2, 3))[2][0] for t in (one, other)]
    cosine = abs(float(directions[0] @ directions[1]))
    return (other.theta - one.theta) * length < _BEATING and cosine > _SAME_DIRECTION


def unknown_of(
    model: Model,
    attributions: Sequence[Attribution],
    causes: Sequence[UnnamedCause],
    unexplained: Sequence[Unexplained],
    bandwidth_hz: float = math.inf,
    floor: Mapping[Sensor, float] | None = None,
    *,
    outside: bool = False,
) -> Unknown:
    """The unexplained part of the gap: unnamed causes, unexplained power, and withdrawn effects.

    Each is compared with the gap of its own sensor, so that a large effect on another one does not hide it.

    Parameters
    ----------
    model, attributions, causes
        The model, the attributions of its effects, and those that have no name.
    unexplained
        Significant power that no effect of the model explains.
    bandwidth_hz
        Bandwidth of the reference's movement.
    floor
        By sensor, twice the nats of the reference's own nuisance effects (:mod:`calib.gap.companion.baselines`).
    outside
        Whether the reference is independent of the vehicle's sensors.
    """
    worth = _EffectNats.of(model, attributions)
    unnamed = worth.restricted_to({key for s in causes for key in s.keys})
    texts = [s.text for s in causes]
    share, part = worth.shares(unnamed)
    left = [*excess_power(model, bandwidth_hz, floor or {}, outside=outside), *nonstationary_noise(model)]
    explained, bets = {one.sensor for one in left}, bets_of(model)
    left += [one for one in winning_bets(bets) if one.sensor not in explained]
    for one in (*left, *unexplained):
        whole, own = (one.nats / (other + one.nats) for other in (worth.whole, worth.on_sensor(one.sensor)))
        if whole > _MATERIAL or own > _MATERIAL_ON_SENSOR:
            texts.append(one.text)
            share += whole * (1.0 - share)
            part = max(part, own)
    driver = next((s.driver for s in causes if s.driver is not None), None)
    return Unknown(part > _MATERIAL, share, "; ".join(dict.fromkeys(texts)), driver, log_odds(bets))


@dataclass(frozen=True)
class _EffectNats:
    """Nats of effects by key, and the sensors on which each of them acts."""

    nats: Mapping[Key, float]
    seen: Mapping[Key, frozenset[Sensor]]

    @classmethod
    def of(cls, model: Model, attributions: Sequence[Attribution]) -> _EffectNats:
        gap = 0.5 * sum(a.gain for a in attributions)
        views = model.setting.views
        seen = {t.hypothesis.key: frozenset(v.sensor for v in views if t.hypothesis.touches(v)) for t in model.members}
        return cls({a.key: a.share * gap for a in attributions}, seen)

    @property
    def whole(self) -> float:
        """Nats of all effects."""
        return sum(self.nats.values())

    def on_sensor(self, sensor: Sensor) -> float:
        """Nats of the effects on a sensor."""
        return sum(n for key, n in self.nats.items() if sensor in self.seen[key])

    def restricted_to(self, keys: Collection[Key]) -> _EffectNats:
        """The same of some effects."""
        return _EffectNats({key: n for key, n in self.nats.items() if key in keys}, self.seen)

    def shares(self, part: _EffectNats) -> tuple[float, float]:
        """Share of a `part` in the whole, and its largest share on one sensor."""
        each = [part.on_sensor(sensor) / max(self.on_sensor(sensor), 1e-300) for sensor in Sensor]
        return part.whole / max(self.whole, 1e-300), max(each)
