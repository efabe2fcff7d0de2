"""Noise that is there for a while only: somebody handles the vehicle, a bag is put beside it. No noise of a sensor."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects.base import NoiseEffect
from mavcal.calib.gap.model.hypotheses import Key
from mavcal.calib.gap.model.joint import Model, NoiseTerm

Array = NDArray[np.float64]

_WINDOW_S = 1.0
"""Seconds of a window. Source: decision 34 counts seconds."""
_FEWEST = 20
"""Windows of a recording, below which nothing is said of their differences. Chosen, not measured: a quarter of them is
then five."""
_MOST = 0.25
"""Part of the windows that a burst takes at most; noise of a sensor is in all of them. Source: decision 34."""
_OF_MEAN = 0.5
"""Part of the mean excess above which a window has the noise. Chosen, not measured: half of the mean is beyond the
scatter of a window without it."""
_ONE = 3.0
"""Seconds between loud windows up to which they are one burst. Chosen, not measured: a person who handles a vehicle
pauses for as long."""
_LISTED = 3
"""Bursts whose times are said. Chosen, not measured: a sentence that a person reads."""


def bursts(model: Model) -> Iterator[tuple[Key, str]]:
    """Noise of a model that is there in a small part of the recording, and in words when."""
    for term in model.noise_terms:
        effect = term.hypothesis.effect
        if not isinstance(effect, NoiseEffect) or effect.drifts or effect.variance is not None or effect.shape:
            continue
        if (spans := _loud(model, term)) is not None:
            when = ", ".join(f"{start:.0f} to {end:.0f} s" for start, end in spans[:_LISTED])
            more = f" and {len(spans) - _LISTED} more times" if len(spans) > _LISTED else ""
            yield term.hypothesis.key, f"noise on {effect.sensor.value} from {when}{more} only"


def _loud(model: Model, term: NoiseTerm) -> list[tuple[float, float]] | None:
    """Where the noise of a term is, s, the longest first; None: throughout, or nobody knows."""
    edges, excess = _excess(model, term)
    mean = float(excess.mean()) if len(excess) >= _FEWEST else 0.0
    loud = np.flatnonzero(excess > _OF_MEAN * mean)
    if mean <= 0.0 or not 0 < len(loud) <= _MOST * len(excess):
        return None
    breaks = np.flatnonzero(np.diff(loud) > _ONE / _WINDOW_S)
    groups = np.split(loud, breaks + 1)
    spans = [(float(edges[g[0]]), float(edges[g[-1] + 1])) for g in groups]
    return sorted(spans, key=lambda span: span[0] - span[1])


def _excess(model: Model, term: NoiseTerm) -> tuple[Array, Array]:
    """Edges (m + 1,) of windows of a second, and (m,) by how much more power they have than without the term."""
    touched = [v for v, view in enumerate(model.setting.views) if term.hypothesis.touches(view)]
    times = [model.setting.views[v].t for v in touched]
    first, last = min(float(t[0]) for t in times), max(float(t[-1]) for t in times)
    edges = first + _WINDOW_S * np.arange(int((last - first) / _WINDOW_S) + 1)
    squares, counts = np.zeros(max(len(edges) - 1, 0)), np.zeros(max(len(edges) - 1, 0))
    names = {term.name(j) for j in range(len(term.hypothesis.effect.parameters))}
    for v in touched:
        view = model.setting.views[v]
        at = np.searchsorted(edges, view.t, side="right") - 1
        inside = (at >= 0) & (at < len(squares))
        for c in range(3):
            noise = model.noise[3 * v + c]
            own = sum((noise.amplitudes[n] * noise.densities[n] for n in names & noise.densities.keys()), 0.0)
            bare = np.maximum(noise.power - own, 1e-300)
            white = view.whitened(view.spectra(model.residual[v])[c] / np.sqrt(bare))
            squares += np.bincount(at[inside], white[inside] ** 2, len(squares))
            counts += np.bincount(at[inside], None, len(squares)) * (view.count / view.n)
    return np.asarray(edges, dtype=np.float64), squares - counts
