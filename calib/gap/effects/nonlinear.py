"""Quadratic nonlinearity: an error with the square of the reading (IEEE Std 1293, coefficient K2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects.base import CatalogueEffect, MeanEffect
from mavcal.calib.gap.effects.parts import per_axis
from mavcal.calib.gap.effects.traits import Trait
from mavcal.calib.gap.problem import Trace
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_LEAST_FORCE = 25.0
"""Least force on an axis, m/s2 (2.5 times gravity): below it, offset and scale absorb nearly all of the square. Chosen,
not measured: the force beyond gravity is then larger than gravity."""
_OFTEN = 0.01
"""Least fraction of the samples beyond it. Chosen, not measured: fewer are single shocks."""


def squared_columns(trace: Trace, _theta: float) -> Array:
    """The square of each axis' ideal reading on that axis, m2/s4."""
    columns = np.zeros((3, *trace.ideal.shape))
    for axis in range(3):
        columns[axis, :, axis] = trace.ideal[:, axis] ** 2
    return columns


def _missing_force(trace: Trace) -> tuple[str, str] | None:
    need = f"forces beyond {_LEAST_FORCE:g} m/s2 along an axis: a centrifuge, a launch"
    seen = np.abs(trace.ideal[trace.observed])
    if len(seen) and (seen > _LEAST_FORCE).mean(axis=0).max() >= _OFTEN:
        return None
    return f"the specific force reaches {float(seen.max()) if len(seen) else 0.0:.3g} m/s2", need


EFFECTS: tuple[CatalogueEffect, ...] = (
    MeanEffect(
        "accel_nonlinearity",
        Sensor.ACCEL,
        per_axis("quadratic", "1/(m/s2)"),
        "forces far beyond gravity",
        "forces of both signs beyond 2.5 g, as on a centrifuge",
        _missing_force,
        columns=squared_columns,
        plain="readings that bend at large forces",
        rivals=("accel_scale", "accel_bias", "accel_saturation"),
        traits=frozenset({Trait.STEADY}),
    ),
)
