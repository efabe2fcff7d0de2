"""What an error of a re-estimated attitude makes of the amplitudes of effects.

A tilt that stays reads like an accelerometer's bias and an offset of the compass, one that grows like a bias of the
gyroscope. The noise of the samples says nothing of it: a minute of them would state a bias to a part in a thousand of
what the tilt leaves open.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects.affine import rotation_columns
from mavcal.calib.gap.hypotheses import HypothesisColumns, Part, add_block
from mavcal.calib.gap.model import Joint, Model, Setting, jacobian, normal_equations
from mavcal.calib.gap.views import View
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]


def variance_of_tilt(model: Model, joint: Joint) -> Array:
    """What the reference's attitude adds to the variance of each number of `joint`, (p,).

    The attitude is off by a rotation of standard deviation :attr:`View.att_sd` about each axis, half of its variance
    constant and half growing evenly over the recording. It moves the amplitudes by ``C X' W R`` times that (first
    order), `R` being the readings' change with it. Nothing where the error is itself in the model.
    """
    count = len(joint.covariance)
    size = max((view.att_sd for view in model.setting.views if view.reference_error), default=0.0)
    if size == 0.0 or model.ridge is not None or not count:
        return np.zeros(count)
    blocks = [jacobian(term, model.setting) for term in model.terms]
    gram = normal_equations([*blocks, _turned(model.setting)], model.y, model.weight).gram
    moved = joint.covariance @ gram[:count, count:]
    return np.asarray(0.5 * size**2 * (moved**2).sum(axis=1))


def _turned(setting: Setting) -> HypothesisColumns:
    """What readings change by a rotation of the reference about x, y, z, at first constant, then growing."""
    times = [view.t for view in setting.views]
    first, last = min(float(t[0]) for t in times), max(float(t[-1]) for t in times)
    parts: dict[int, Part] = {}
    for v, view in enumerate(setting.views):
        if view.reference_error:
            add_block(parts, v, _of_view(view, first, last), setting.frames[v])
    return HypothesisColumns(6, parts)


def _of_view(view: View, first: float, last: float) -> Array:
    """Columns (6, n, 3) of a series, the growing ones of unit variance between `first` and `last`."""
    root = math.sqrt(3.0)
    if view.sensor is Sensor.GYRO:
        weight = sum(view.weights.values())
        rate = np.broadcast_to(np.eye(3)[:, None, :] * (2.0 * root / (last - first)), (3, view.n, 3))
        return weight * np.concatenate([np.zeros((3, view.n, 3)), rate])
    turn = np.add.reduce([w * rotation_columns(view.traces[i], math.nan) for i, w in view.weights.items()])
    turn = turn[:, view.keep]
    growing = root * (2.0 * (view.t - first) / (last - first) - 1.0)
    return np.concatenate([turn, turn * growing[None, :, None]])
