"""Sensors with less noise than is declared: no effect of a sensor, but a simulator whose noise is too much."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from mavcal.calib.gap.model.joint import Model
from mavcal.calib.gap.model.noise_fit import declared

_MOST_POWER_RATIO = 0.75
"""Ratio of powers above which it is said: below, a drone's own seldom repeats from flight to flight. Chosen, not
measured: 14 % less in amplitude (sqrt(0.75))."""
_SURE = 6.0
"""Standard errors. Chosen, not measured: noise in flights is not normal, so six instead of three."""


def overstated_noise(model: Model) -> Iterator[str]:
    """A sentence for every series that a model leaves with less noise than nominal recordings or a simulator have."""
    labels = dict.fromkeys(view.label for view in model.setting.views)
    for label in labels:
        found = [(v, view) for v, view in enumerate(model.setting.views) if view.label == label]
        view = found[0][1].whole
        if any(declared(band) is None for _, band in found) or len(view.weights) != 1:
            continue
        squares, counts, variance = 0.0, 0.0, 0.0
        for v, band in found:
            power = np.asarray(declared(band))
            squares += float((band.spectra(model.residual[v]).T ** 2 / power).sum())
            variance += float(power.sum() / band.gain)
            counts += power.size
        ratio = squares / counts
        error = math.sqrt(2.0 / counts + 2.0 / (3.0 * view.dof))
        if ratio < _MOST_POWER_RATIO and 1.0 - ratio > _SURE * error:
            instance = next(iter(view.weights)) + 1
            sd = math.sqrt(variance / counts)
            yield (
                f"{view.sensor.value} of instance {instance} has less noise than is declared: "
                f"{math.sqrt(ratio) * sd:.3g} {view.any_trace.unit} a sample beside {sd:.3g}; a "
                f"simulator that has it is {1.0 / math.sqrt(ratio):.2g} times too noisy"
            )
