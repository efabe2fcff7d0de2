"""What of a model is not of the catalogue, and what is left over beside it.

Shapes, noise that is no sensor's own, jumps that are no single events, bands that nothing explains, and what held-out
data took back. None of it is named as an effect: a wrong name looks right.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from calib.gap.attribution import Attribution
from calib.gap.hypotheses import Key
from calib.gap.impostors import Unexplained, impostors, unsteady
from calib.gap.model import Model
from calib.gap.schema import HiddenDriver, Unknown
from calib.gap.switching import switching
from calib.gap.transitions import events_of
from calib.gap.views import View
from calib.recording import Sensor

_JUMPS = 3
"""Jumps of one sensor from which on they are no single events."""
NOT_LASTING = "a deviation that no effect describes throughout the recording"
_MATERIAL = 0.03
"""Share of the gap from which on something unknown is said."""
_LEFT = 0.1
"""The same of what is left over on one sensor: of a long recording no model explains the last hundredth."""
_LEFTOVER = 1e-7
"""Chance, over all bands of all axes, below which noise alone has no such power."""
_MINUTES_DIFFER = 2.0
"""Times a learned spectrum, up to which power may be that of other minutes."""
_GROUPS = 24
"""Bands of a series, of a constant ratio of frequencies."""


@dataclass(frozen=True, eq=False)
class Stranger:
    """Terms of a model that stand for something that has no name."""

    keys: tuple[Key, ...]
    text: str
    driver: HiddenDriver | None = None


def strangers_in(model: Model, attributions: Sequence[Attribution]) -> tuple[Stranger, ...]:
    """Every stranger among the terms of a model, and every effect in whose place one is likelier."""
    shapes = [t.hypothesis for t in model.terms if t.hypothesis.effect.nameless]
    levels = [Stranger(found.keys, found.text) for found in switching(model, attributions)]
    taken = {key for two in levels for key in two.keys}
    drifts = [Stranger((found.key,), found.text, found.driver) for found in impostors(model) if found.key not in taken]
    known = taken | {h.key for h in shapes} | {key for drift in drifts for key in drift.keys}
    doubted = [a for a in attributions if a.doubted and a.key not in known]
    return (
        *(Stranger((h.key,), h.effect.excited_by) for h in shapes),
        *levels,
        *drifts,
        *(Stranger((a.key,), f"{a.shape}, or {a.key[0]}") for a in doubted),
        *_swarms(model),
    )


def _swarms(model: Model) -> list[Stranger]:
    """Jumps of one sensor that are too many to be events."""
    found = []
    for sensor in dict.fromkeys(view.sensor for view in model.setting.views):
        events = events_of(model, sensor)
        own = [term for event in events for term in event]
        if len(events) >= _JUMPS:
            when = ", ".join(f"{t.theta:.1f} s" for t in own)
            found.append(Stranger(tuple(t.hypothesis.key for t in own), f"{len(own)} jumps on {sensor.value}: {when}"))
    return found


def unknown_of(
    model: Model,
    attributions: Sequence[Attribution],
    strangers: Sequence[Stranger],
    unexplained: Sequence[Unexplained],
    bandwidth_hz: float = math.inf,
    floor: Mapping[Sensor, float] | None = None,
) -> Unknown:
    """What is not of the catalogue: strangers in the model, bands that are left over, and what did not last.

    Each is held against the gap of its own sensor: a large effect on another one hides nothing.

    Parameters
    ----------
    model, attributions, strangers
        The model, what its effects are worth, and which of them have no name.
    unexplained
        What is in no effect of the model.
    bandwidth_hz
        Up to which the reference knows how the vehicle moves.
    floor
        Twice the nats by sensor that the reference's own flaws make (:mod:`calib.gap.baseline`).
    """
    worth = _Worth.of(model, attributions)
    strange = worth.but({key for s in strangers for key in s.keys})
    texts = [s.text for s in strangers]
    share, part = worth.shares(strange)
    for one in (*leftover(model, bandwidth_hz, floor or {}), *unsteady(model), *unexplained):
        whole, own = (one.nats / (other + one.nats) for other in (worth.whole, worth.on(one.sensor)))
        if whole > _MATERIAL or own > _LEFT:
            texts.append(one.text)
            share += whole * (1.0 - share)
            part = max(part, own)
    driver = next((s.driver for s in strangers if s.driver is not None), None)
    probability = max((a.unknown_probability for a in attributions), default=0.0)
    flag = part > _MATERIAL
    return Unknown(flag, share, "; ".join(dict.fromkeys(texts)), driver, max(probability, 0.95 if flag else 0.0))


@dataclass(frozen=True)
class _Worth:
    """Nats of effects by key, and on which sensors each of them is seen."""

    nats: Mapping[Key, float]
    seen: Mapping[Key, frozenset[Sensor]]

    @classmethod
    def of(cls, model: Model, attributions: Sequence[Attribution]) -> _Worth:
        gap = 0.5 * sum(a.gain for a in attributions)
        views = model.setting.views
        seen = {t.hypothesis.key: frozenset(v.sensor for v in views if t.hypothesis.touches(v)) for t in model.members}
        return cls({a.key: a.share * gap for a in attributions}, seen)

    @property
    def whole(self) -> float:
        """Of all effects."""
        return sum(self.nats.values())

    def on(self, sensor: Sensor) -> float:
        """Of the effects that are seen on a sensor."""
        return sum(n for key, n in self.nats.items() if sensor in self.seen[key])

    def but(self, keys: Collection[Key]) -> _Worth:
        """Of some of them alone."""
        return _Worth({key: n for key, n in self.nats.items() if key in keys}, self.seen)

    def shares(self, part: _Worth) -> tuple[float, float]:
        """Which share of the whole a `part` of it is, and the largest that it is of what is seen on one sensor."""
        each = [part.on(sensor) / max(self.on(sensor), 1e-300) for sensor in Sensor]
        return part.whole / max(self.whole, 1e-300), max(each)


def leftover(
    model: Model, bandwidth_hz: float = math.inf, floor: Mapping[Sensor, float] | None = None
) -> list[Unexplained]:
    """By sensor, nats that single bands still show above the noise, and where; those of chance are not among them.

    Above `bandwidth_hz` an accelerometer feels movement of which the reference does not know; a sensor that has less
    than its `floor` left over shows the reference's flaws.
    """
    by_sensor: dict[Sensor, list[_Excess]] = {}
    for one in _excesses(model, bandwidth_hz):
        by_sensor.setdefault(one.sensor, []).append(one)
    found = []
    for sensor, excesses in by_sensor.items():
        nats = sum(one.nats for one in excesses)
        if 2.0 * nats > (floor or {}).get(sensor, 0.0):
            found.append(Unexplained(nats, min(excesses, key=lambda one: (one.p, one.text)).text, sensor))
    return found


@dataclass(frozen=True)
class _Excess:
    """A band of an axis with more power than its noise: worth `nats`, and `p` that chance makes one, over all bands."""

    sensor: Sensor
    p: float
    nats: float
    text: str


def _excesses(model: Model, bandwidth_hz: float) -> Iterator[_Excess]:
    """Every band that noise alone does not explain."""
    for a in range(model.setting.axes):
        if model.ridge is not None and a in model.ridge.columns.parts:
            continue  # the error of the reference is known only up to the last of its cosines
        view = model.setting.views[a // 3]
        ratio = view.spectra(model.residual[a // 3])[a % 3] ** 2 / model.noise[a].power
        for low, high in _bands(view, bandwidth_hz):
            count, square = high - low, float(ratio[low:high].sum())
            p = float(chdtrc(count, square)) * _GROUPS * model.setting.axes
            # A learned spectrum is that of other minutes: twice as much is none of this recording's.
            if p < _LEFTOVER and (view.density is None or square > _MINUTES_DIFFER * count):
                nats = 0.5 * (square - count - count * math.log(square / count))
                yield _Excess(view.sensor, p, nats, _said(view, low, high, "xyz"[a % 3]))


def _bands(view: View, bandwidth_hz: float) -> Iterator[tuple[int, int]]:
    """First bins of bands of a series, and those behind their last, as far as its reference knows of movement."""
    known = bandwidth_hz if view.reference_error and view.sensor is Sensor.ACCEL else math.inf
    edges = np.unique(np.geomspace(4, view.count, _GROUPS + 1).astype(np.intp))
    for low, high in itertools.pairwise(edges.tolist()):
        if (high + view.first) * _bin_hz(view) > known:
            break
        yield low, high


def _bin_hz(view: View) -> float:
    return 0.5 * view.fs / view.n


def _said(view: View, low: int, high: int, axis: str) -> str:
    start, end = ((k + view.first) * _bin_hz(view) for k in (low, high))
    return f"power from {start:.3g} to {end:.3g} Hz on {view.sensor.value}.{axis}"
