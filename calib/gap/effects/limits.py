"""Saturation and dead bands before the noise and the converter: in a mechanism or an analogue stage.

The samples show no lattice (:mod:`calib.gap.effects.lattice` finds what the converter does); the mean changes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects.base import CatalogueEffect, EffectParameter, EffectShape, MeanEffect, Missing
from mavcal.calib.gap.effects.parts import TRIADS
from mavcal.calib.gap.effects.traits import SensorTerm, Trait
from mavcal.calib.gap.problem import UNIT, Trace
from mavcal.calib.gap.remembered import remembered
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_TRIED = 26
"""Values of a limit or a width that are tried at most. Chosen, not measured: steps of a factor of 1.7 over the six
decades of `_MOST`."""
_LEAST, _MOST = 4.0, 1e6
"""Least evidence of a value that is tried, and largest evidence relative to it. Chosen, not measured: 4 is two standard
errors, and a million times as much is beyond doubt."""
_BELOW_LIMIT = 0.9
"""Largest limit relative to the largest reading: a limit leaves some readings unchanged, an offset none. Chosen, not
measured: a tenth is beyond any noise."""
_OUTSIDE = 0.02
"""Least fraction of the readings that must lie inside a dead band, and outside it. Chosen, not measured: fewer than one
in fifty are single moments."""
_BLURRED = 5.0
"""Distance from zero or from the limit, in standard deviations of the reference's noise, below which the reference
cannot tell the expected reading. Source: decision 41."""


def clipped_column(trace: Trace, limit: float) -> Array:
    """Change of the ideal reading by a range that ends at +-`limit`."""
    return (np.clip(trace.ideal, -limit, limit) - trace.ideal)[None]


def dead_column(trace: Trace, width: float) -> Array:
    """Change of the ideal reading by a dead band of half width `width`.

    Zero where the reference is too noisy: the dead band would remove the reference's own noise there.
    """
    size = np.abs(trace.ideal)
    return np.where((size < width) & (size >= _BLURRED * trace.unit_sd), -trace.ideal, 0.0)[None]


def _noise(trace: Trace) -> float:
    """Noise of one sample on the quietest axis."""
    if trace.sigma is not None:
        return float(np.min(trace.sigma))
    steps = np.diff(trace.residual[trace.observed], axis=0)
    return float(np.sqrt(0.5 * steps.var(axis=0)).min()) if len(steps) else 0.0


def _at_energy_steps(values: Array, energy: Array, noise: float) -> Array:
    """The ascending `values` at which the removed `energy` passes geometrically spaced levels."""
    seen = _LEAST * noise**2
    top = float(energy[-1])
    if not (noise > 0.0 and top > seen):
        return values[-1:]
    wanted = np.geomspace(seen, min(top, _MOST * seen), _TRIED)
    return np.unique(values[np.minimum(np.searchsorted(energy, wanted), len(values) - 1)])


@remembered(16)
def candidate_limits(trace: Trace) -> Array:
    """Limits to try, ascending, in the unit of the readings."""
    size = np.sort(np.abs(trace.ideal[trace.observed]).ravel())[::-1]
    count = np.arange(1, len(size) + 1)
    energy = np.cumsum(size**2) - 2.0 * size * np.cumsum(size) + count * size**2  # what lies above each of them
    tried = np.sort(_at_energy_steps(size, np.maximum.accumulate(energy), _noise(trace)))
    below = tried[tried <= size[0] - _BLURRED * trace.ideal_sd]
    return below if len(below) else tried[:1]


@remembered(16)
def candidate_widths(trace: Trace) -> Array:
    """Half widths to try, ascending, in the unit of the readings."""
    size = np.sort(np.abs(trace.ideal[trace.observed]).ravel())
    tried = _at_energy_steps(size, np.cumsum(size**2), _noise(trace))
    beyond = tried[tried > _BLURRED * max(trace.ideal_sd, trace.unit_sd)]
    return beyond if len(beyond) else size[-1:]


def _within_noise(size: Array, trace: Trace) -> bool:
    """Whether no ideal reading, of sizes (n, 3), exceeds the noise."""
    return 0.0 < float(size.max(initial=0.0)) < _noise(trace)


def _missing_range(sensor: Sensor) -> Missing:
    def missing(trace: Trace) -> tuple[str, str] | None:
        size = np.abs(trace.ideal[trace.observed])
        if not len(size) or float(size.max()) <= 0.0:
            return f"the ideal {sensor.value} reads zero", "movement up to the end of the range"
        if _within_noise(size, trace):
            return f"the ideal {sensor.value} stays within the noise", "movement up to the end of the range"
        if (size.max(axis=1) < _BELOW_LIMIT * size.max()).mean() < _OUTSIDE:
            return f"the ideal {sensor.value} is as large throughout", "movement that comes and goes"
        return None

    return missing


def _missing_zero_crossing(sensor: Sensor) -> Missing:
    def missing(trace: Trace) -> tuple[str, str] | None:
        ideal = np.abs(trace.ideal[trace.observed])
        if _within_noise(ideal, trace):
            return f"the ideal {sensor.value} stays within the noise", "slow movement through zero"
        if len(ideal) and (ideal < 0.5 * ideal.max()).mean() > _OUTSIDE and float(ideal.max()) > 0.0:
            return None
        return f"the ideal {sensor.value} stays away from zero", "slow movement through zero"

    return missing


_KINDS = (
    (
        "saturation",
        EffectParameter("limit", ""),
        candidate_limits,
        clipped_column,
        "readings up to the end of the range",
        "a larger range; less violent movement",
        _missing_range,
        "a range that is too small",
        frozenset[Trait](),
        SensorTerm.FULL_SCALE,
    ),
    (
        "dead_band",
        EffectParameter("half_width", ""),
        candidate_widths,
        dead_column,
        "readings about zero",
        "slow movement through zero",
        _missing_zero_crossing,
        "small values read as zero",
        frozenset({Trait.DEAD_BAND}),
        None,
    ),
)


def _effects_of(sensor: Sensor) -> tuple[CatalogueEffect, ...]:
    return tuple(
        MeanEffect(
            f"{sensor}_{name}",
            sensor,
            (),
            excites,
            manoeuvre,
            missing(sensor),
            EffectShape(replace(parameter, unit=UNIT[sensor]), grid),
            columns=column,
            fixed=True,
            plain=plain,
            traits=traits,
            term=term,
            rivals=(f"{sensor}_scale" if sensor != Sensor.MAG else "mag_soft_iron",),
        )
        for name, parameter, grid, column, excites, manoeuvre, missing, plain, traits, term in _KINDS
    )


EFFECTS: tuple[CatalogueEffect, ...] = tuple(effect for sensor in TRIADS for effect in _effects_of(sensor))
