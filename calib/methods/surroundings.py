"""Stretches of a recording with the same magnetic surroundings, so that one model holds for them.

A bench and a flight differ: steel nearby, the field of motors that run, a battery that was changed. A recording is
taken apart where the vehicle was armed or disarmed and where it paused; the stretch that determines the compass best is
the measure of the others.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.mag.result import plausible_field
from mavcal.calib.methods.source import Source
from mavcal.calib.recording import Channel, Recording

Array = NDArray[np.float64]

_PAUSE = 10.0
"""s without a sample, and twenty intervals: what surrounded the compass may be other things afterwards."""
_FEWEST = 30  # samples of a stretch that is looked at
_BORDERS = ("armed", "disarmed", "reboot")  # kinds of events between which surroundings stay
_WORSE = 1.5  # times the residual of the measure that a stretch of the same surroundings may have
_VISIBLE = 0.005  # of the field: less is no other surroundings


@dataclass(frozen=True)
class _Part:
    """Some of the samples of a compass, in one piece, and what is fitted to them."""

    mag: Channel
    fit: FitResult

    @property
    def text(self) -> str:
        return f"{self.mag.t[0]:.0f} to {self.mag.t[-1]:.0f} s"


def of_one_surroundings(source: Source, mag: Channel, fit: Callable[[Channel], FitResult]) -> FitResult:
    """The fit of those stretches of `mag` that had the same surroundings, and what was left out in its warnings."""
    parts = _parts(source, mag)
    if len(parts) < 2:
        return fit(mag)
    alone = [_Part(part, fit(part)) for part in parts]
    known = [part for part in alone if part.fit.status != FitStatus.REFUSED and _plausible(part.fit)]
    if not known:
        return fit(mag)
    measure = min(known, key=lambda part: float(part.fit.quality["heading_sd_deg"]))
    own = _departure(measure.fit, measure.mag, measure.mag)
    limit = max(_WORSE * own, float(np.hypot(own, _VISIBLE)))
    off = [_departure(measure.fit, measure.mag, part.mag) for part in alone]
    same = [part for part, by in zip(alone, off, strict=True) if by <= limit]
    other = [(part, by) for part, by in zip(alone, off, strict=True) if by > limit]
    if not other:
        return fit(mag)
    found = fit(_joined([part.mag for part in same])) if len(same) > 1 else measure.fit
    listed = ", ".join(f"{part.text} by {100.0 * by:.1f} %" for part, by in other)
    note = (
        f"only {', '.join(part.text for part in same)} was used: the field of other stretches departs from it "
        f"({listed}). Bench and flight differ so. --from and --until choose another stretch"
    )
    return dataclasses.replace(found, n_samples=len(mag), warnings=(note, *found.warnings))


def _plausible(fit: FitResult) -> bool:
    return fit.unit != "uT" or plausible_field(float(fit.quality["radius"]))


def _parts(source: Source, mag: Channel) -> list[Channel]:
    """The stretches between which the surroundings may have changed, those of some samples."""
    if not source.timed or len(mag) < 2 * _FEWEST:
        return []
    steps = np.diff(mag.t)
    pause = max(_PAUSE, 20.0 * float(np.median(steps)))
    borders = [float(t) for t in mag.t[1:][steps > pause]] + _events(source.recording)
    edges = [-np.inf, *sorted(borders), np.inf]
    parts = [mag.between(a, b) for a, b in pairwise(edges)]
    return [part for part in parts if len(part) >= _FEWEST]


def _events(recording: Recording) -> list[float]:
    return [event.t for event in recording.events if event.kind in _BORDERS]


def _departure(fit: FitResult, measure: Channel, part: Channel) -> float:
    """How far the field of `part` is from one length, relative, by the model of `fit`; robust against a few."""
    length = float(np.median(np.linalg.norm(fit.model.apply(measure.values), axis=1)))
    off = np.abs(np.linalg.norm(fit.model.apply(part.values), axis=1) / length - 1.0)
    return float(np.sqrt(np.mean(np.minimum(off, np.percentile(off, 95.0)) ** 2)))


def _joined(parts: Sequence[Channel]) -> Channel:
    zero = [part.zero_bin for part in parts]
    return dataclasses.replace(
        parts[0],
        t=np.concatenate([part.t for part in parts]),
        values=np.concatenate([part.values for part in parts]),
        zero_bin=np.concatenate([z for z in zero if z is not None]) if all(z is not None for z in zero) else None,
    )
