"""A fit of a compass against the Earth: its field has 22 to 67 uT anywhere, whatever the position."""

from __future__ import annotations

import dataclasses
from typing import Final

from mavcal.calib.earth import STRONGEST_UT, WEAKEST_UT, beyond_earth
from mavcal.calib.fit import FitResult, FitStatus, parameter_names
from mavcal.calib.mag.context import MagContext

_SAID: Final = 0.12  # beyond the range, relative: a sensor's scale and the crust explain as much
_GROSS: Final = 0.35  # of the Earth's field: as far off the health of a log calls a compass faulty


def plausible_field(radius: float) -> bool:
    """Whether a field of `radius` uT may be the Earth's, by a sensor whose scale is off and at a bent site."""
    return beyond_earth(radius) <= _GROSS


def earthly(fit: FitResult, context: MagContext) -> FitResult:
    """`fit` of samples in uT with a warning where no place has such a field, refused where it is far off.

    A fit whose scale is tied to a stated field keeps it: there a sensor may read in any unit.
    """
    radius = fit.quality.get("radius")
    if fit.unit != "uT" or fit.status == FitStatus.REFUSED or radius is None:
        return fit
    off = beyond_earth(float(radius))
    if off <= _SAID:
        return fit
    text = (
        f"the measured field of {radius:.3g} uT is none of the Earth's, which has {WEAKEST_UT:.0f} to "
        f"{STRONGEST_UT:.0f} uT anywhere: steel or a magnet is near, the unit is another one, or the scale is off"
    )
    if off <= _GROSS or context.field is not None:
        return dataclasses.replace(fit, warnings=(text, *fit.warnings))
    remedy = "keep away from steel and magnets, or state the unit of the samples (--unit-mag) or the field (--field)"
    return context.made(fit.method, fit.n_samples).refused(
        f"{text}; {remedy}", parameter_names(), remedy, quality=fit.quality
    )
