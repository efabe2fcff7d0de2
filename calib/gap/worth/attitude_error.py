"""Errors of amplitudes due to the error of a re-estimated trajectory, and effects that do not exceed it.

A constant tilt looks like a bias of the accelerometer and an offset of the compass, a growing one like a bias of the
gyroscope. An error of the gyroscope matrix inside the trajectory looks like misalignment of the sensor, one of an
accelerometer's scale like a scale. The noise of the samples does not contain these errors. From a minute of data, a
bias would seem a thousand times more accurate than the tilt allows.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.gap.effects.affine import rotation_columns
from mavcal.calib.gap.effects.magnetic import earth_columns
from mavcal.calib.gap.model.hypotheses import HypothesisColumns, Key, Part, add_block, columns_of
from mavcal.calib.gap.model.joint import Joint, Model, Setting, jacobian, normal_equations
from mavcal.calib.gap.model.views import View
from mavcal.calib.gap.reference.trajectory import BIAS
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_TILTS, _MATRIX, _FIELD, _SCALES = slice(0, 6), slice(6, 15), slice(15, 18), slice(18, 21)
"""Columns of the possible errors: constant and growing rotations, the gyroscope's matrix, the Earth's field, the
accelerometer's scales."""
_ERRORS = 21
_REFERENCE_CHANCE = 0.005
"""P-value above which the reference's own error explains an effect. Source: decision 34."""
_PRIOR_TILT = float(BIAS[-1]) / STANDARD_GRAVITY
"""Tilt, rad, from the expected accelerometer bias in the trajectory. Source: its prior of that bias."""
_RANK = 1e-9
"""Variance, relative to the largest, below which a direction of amplitudes was not fitted. Source: rounding of a
covariance, 1e-16, with a margin."""


def variance_from_attitude(model: Model, joint: Joint) -> Array:
    """Variance that the trajectory's error adds to each value of `joint`, (p,)."""
    return np.asarray((_amplitude_errors(model, joint) ** 2).sum(axis=1))


def below_reference(model: Model, joint: Joint) -> frozenset[Key]:
    """Effects on the mean that the trajectory's error may explain."""
    moved = _amplitude_errors(model, joint)
    if not moved.any():
        return frozenset()
    found = set()
    for term, rows in zip(model.terms, joint.slices, strict=False):
        values = term.values
        free = len(values) - (term.effect.shape is not None and not term.effect.fixed)
        own = slice(rows.start, rows.start + free)
        if not moved[own].any():
            continue
        squares, count = _deviation(values[:free], joint.covariance[own, own] + moved[own] @ moved[own].T)
        if chdtrc(count, squares) > _REFERENCE_CHANCE:
            found.add(term.hypothesis.key)
    return frozenset(found)


def on_uncertain_unit(model: Model) -> dict[Key, float]:
    """Effects that the other of two units may have instead, with opposite sign; and the probability of the stated unit.

    The difference of the units is certain. The other unit has the effect if an error of the trajectory imitates it on
    both units. The value compares the likelihood of no error with that of this error. Effects are left out if the error
    is improbable. The prior of the bias does not matter: it is the same for both units.
    """
    views = model.setting.views
    tilt = max((view.att_sd for view in views if view.reference_error), default=0.0)
    if tilt == 0.0:
        return {}
    errors = _error_columns(model.setting, tilts=model.ridge is None)
    measured = max(1.0 - (tilt / _PRIOR_TILT) ** 2, 0.0)
    found = {}
    for term in model.terms:
        own = term.hypothesis
        units = {i for view in views if view.sensor is own.effect.sensor for i in view.weights}
        if own.effect.shared or len(own.instances) != 1 or len(units) != 2:
            continue
        both = replace(own, instances=tuple(sorted(units)))
        columns = columns_of(both, term.theta, views, model.setting.frames)
        gram = normal_equations([columns, errors], model.y, model.weight).gram
        precision, cross = gram[: columns.p, : columns.p], gram[: columns.p, columns.p :]
        inverse = np.linalg.pinv(precision, hermitian=True)
        moved = inverse @ cross
        values = term.values[: columns.p]
        second_order = (tilt * np.linalg.norm(values)) ** 2 * np.eye(columns.p)
        squares, count = _deviation(values, inverse + moved @ moved.T + second_order)
        if moved.any() and chdtrc(count, squares) > _REFERENCE_CHANCE:
            found[own.key] = 1.0 / (1.0 + math.exp(-0.5 * measured * squares))
    return found


def _deviation(values: Array, covariance: Array) -> tuple[float, int]:
    """Squared distance of values (p,) from zero in standard deviations, and along how many directions."""
    scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    variances, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    seen = variances > _RANK * variances[-1]
    along = axes.T @ (values / scale)
    return float((along[seen] ** 2 / variances[seen]).sum()), int(seen.sum())


def _amplitude_errors(model: Model, joint: Joint) -> Array:
    """Change of each value of `joint` by each error of the trajectory of one standard deviation, (p, errors).

    The attitude is rotated by :attr:`View.att_sd` about each axis; half of the variance is constant, half grows over
    the recording. :attr:`View.inside_sd` are errors of values estimated inside the trajectory. To first order the
    change is ``C X' W R``, with `R` the change of the readings. If the wandering attitude is in the model, only the
    latter are used.
    """
    count = len(joint.covariance)
    known = all(view.att_sd == 0.0 for view in model.setting.views if view.reference_error)
    if known or not count:
        return np.zeros((count, 0))
    blocks = [jacobian(term, model.setting) for term in model.terms]
    if model.ridge is not None:
        blocks.append(model.ridge.columns)
    errors = _error_columns(model.setting, tilts=model.ridge is None)
    gram = normal_equations([*blocks, errors], model.y, model.weight).gram
    return np.asarray(joint.covariance @ gram[:count, count:])


def _error_columns(setting: Setting, *, tilts: bool) -> HypothesisColumns:
    """Change of the readings by each error of one standard deviation."""
    times = [view.t for view in setting.views]
    first, last = min(float(t[0]) for t in times), max(float(t[-1]) for t in times)
    parts: dict[int, Part] = {}
    for v, view in enumerate(setting.views):
        if view.reference_error:
            block = np.zeros((_ERRORS, view.n, 3))
            if tilts:
                block[_TILTS] = math.sqrt(0.5) * view.att_sd * _rotation_errors(view, first, last)
            if view.inside_sd and view.sensor is Sensor.GYRO:
                block[_MATRIX] = _matrix_errors(view)
            if view.inside_sd and view.sensor is Sensor.MAG:
                block[_FIELD] = _field_errors(view)
            if view.inside_sd and view.sensor is Sensor.ACCEL:
                block[_SCALES] = _scale_errors(view)
            add_block(parts, v, block, setting.frames[v])
    return HypothesisColumns(_ERRORS, parts)


def _rotation_errors(view: View, first: float, last: float) -> Array:
    """Columns (6, n, 3) of constant rotations of the reference about x, y, z, and of growing ones.

    The growing ones have unit variance between `first` and `last`.
    """
    root = math.sqrt(3.0)
    if view.sensor is Sensor.GYRO:
        weight = sum(view.weights.values())
        rate = np.broadcast_to(np.eye(3)[:, None, :] * (2.0 * root / (last - first)), (3, view.n, 3))
        return weight * np.concatenate([np.zeros((3, view.n, 3)), rate])
    turn = np.add.reduce([w * rotation_columns(view.traces[i], math.nan) for i, w in view.weights.items()])
    turn = turn[:, view.keep]
    growing = root * (2.0 * (view.t - first) / (last - first) - 1.0)
    return np.concatenate([turn, turn * growing[None, :, None]])


def _matrix_errors(view: View) -> Array:
    """Columns (9, n, 3) of the elements of a gyroscope's matrix by rows."""
    ideal = view.ideal
    block = np.zeros((9, view.n, 3))
    for k, sd in enumerate(view.inside_sd):
        row, column = divmod(k, 3)
        block[k, :, row] = sd * ideal[:, column]
    return block


def _scale_errors(view: View) -> Array:
    """Columns (3, n, 3) of an accelerometer's scales; its bias absorbs their effect on a constant force."""
    ideal = view.ideal
    moving = (ideal - ideal.mean(axis=0)) * np.array(view.inside_sd)
    return np.asarray(np.eye(3)[:, None, :] * moving[None])


def _field_errors(view: View) -> Array:
    """Columns (3, n, 3) of the Earth's field north, east, down; zero without an attitude."""
    if any(trace.attitude is None for trace in view.traces.values()):
        return np.zeros((3, view.n, 3))
    columns = np.add.reduce([w * earth_columns(view.traces[i], math.nan) for i, w in view.weights.items()])
    return np.asarray(columns[:, view.keep] * np.array(view.inside_sd)[:, None, None])
