"""Joint maximum over all values of the mean, by Gauss-Newton steps.

A shape whose tangent does not improve the fit is held, while amplitudes and other shapes continue.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.model.joint import (
    Joint,
    Model,
    Normal,
    amplitudes,
    jacobian,
    limits_of,
    normal_equations,
    with_residual,
)
from mavcal.calib.gap.model.normal_equations import solved
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_WORTH_A_STEP = 1e-3
"""Least predicted gain of a step that is tried, and actual gain for another to follow, in twice the log-likelihood.
Source: numerical; no decision depends on so little."""
_STEPS = 8
"""Gauss-Newton steps of one fit. Chosen, not measured: Gauss-Newton steps near the best value need few."""
_SHORTENED = 4
"""Number of lengths tried for a step. Chosen, not measured: a step that needs more does not help."""


def coupled_terms(model: Model, sensors: Collection[Sensor]) -> tuple[int, ...]:
    """Indices of the terms of some sensors and of those coupled with them."""
    near = coupled_sensors(model, sensors)
    return tuple(i for i, t in enumerate(model.terms) if t.effect.shared or t.effect.sensor in near)


def coupled_sensors(model: Model, sensors: Collection[Sensor]) -> frozenset[Sensor]:
    """`sensors`, or all sensors if a shared term or an error of the reference couples them."""
    tied = model.ridge is not None or any(t.effect.shared for t in model.terms)
    return frozenset(view.sensor for view in model.setting.views) if tied else frozenset(sensors)


def refined(model: Model, members: tuple[int, ...] | None = None, *, hold: bool = False) -> tuple[Model, Joint]:
    """The joint maximum over the mean at the present noise; discontinuous shapes are held.

    Over the terms `members`; None: over all. With `hold` one step of the amplitudes alone.
    """
    members = tuple(range(len(model.terms))) if members is None else members
    joint = Joint(np.zeros((0, 0)), (), Normal(np.zeros((0, 0)), np.zeros(0), ()))
    if not members and model.ridge is None:
        return model, joint
    own = [model.terms[i].effect for i in members]
    linear = all((e.shape is None or e.discontinuous) and e.exact is None for e in own)
    shaped = frozenset(i for i, e in zip(members, own, strict=True) if e.shape is not None and not e.discontinuous)
    stuck = shaped if hold else frozenset()
    for _ in range(1 if linear or hold else _STEPS):
        terms = [model.terms[i] for i in members]
        blocks = [(amplitudes if hold else jacobian)(term, model.setting) for term in terms]
        normal = normal_equations(blocks, model.y, model.weight, model.ridge)
        joint = Joint(solved(normal.gram, normal.right)[1], normal.slices[: len(blocks)], normal)
        rows = dict(zip(members, joint.slices, strict=True))
        model, gained = _after_step(model, joint, rows, shaped - stuck)
        if gained < _WORTH_A_STEP and shaped and not hold:
            before, stuck = stuck, _held_shapes(model, joint, rows, shaped, stuck)
            if stuck != before:
                model, gained = _after_step(model, joint, rows, shaped - stuck)
        if gained < _WORTH_A_STEP:
            break
    return model, joint


def _after_step(model: Model, joint: Joint, rows: Mapping[int, slice], free: Collection[int]) -> tuple[Model, float]:
    """The model after a Gauss-Newton step of amplitudes and `free` shapes, if it promises enough, and the gain."""
    step = _gauss_newton_step(model, joint, rows, free)
    if float(step @ joint.normal.right) < _WORTH_A_STEP:
        return model, 0.0
    return _line_search(model, step, rows)


def _held_shapes(
    model: Model, joint: Joint, rows: Mapping[int, slice], shaped: frozenset[int], stuck: frozenset[int]
) -> frozenset[int]:
    """Shapes to hold in the next step, after a step with `stuck` ones held failed.

    Far from its best value the tangent of a shape is misleading (a frequency between two peaks). One such shape spoils
    the step of all. The others may still gain, and the shape may be freed later.
    """
    step = _gauss_newton_step(model, joint, rows, shaped)
    if not float(step @ joint.normal.right) >= _WORTH_A_STEP:
        return stuck
    asked = stuck or shaped
    leading = frozenset(i for i in asked if _line_search(model, step, {i: rows[i]})[1] > 0.0)
    return stuck - leading if stuck else shaped - leading or shaped


def _gauss_newton_step(model: Model, joint: Joint, rows: Mapping[int, slice], free: Collection[int]) -> Array:
    """The Gauss-Newton step; shapes that are not `free` are held."""
    normal = joint.normal
    shaped = {i for i in rows if model.terms[i].effect.shape is not None}
    still = {rows[i].stop - 1 for i in shaped.difference(free)}
    if not still:
        return np.asarray(joint.covariance @ normal.right)
    moved = np.array([k for k in range(len(normal.right)) if k not in still], np.intp)
    step = np.zeros(len(normal.right))
    step[moved] = solved(normal.gram[moved[:, None], moved], normal.right[moved])[0]
    return step


def _line_search(model: Model, step: Array, rows: Mapping[int, slice]) -> tuple[Model, float]:
    """The model after the step, shortened until it is no worse, and the gain in twice the log-likelihood."""
    parts = _misfits(model)
    level = _total_misfit(parts, model)
    for _ in range(_SHORTENED):
        moved = list(model.terms)
        for i, own in rows.items():
            if step[own].any():
                moved[i] = moved[i].moved(step[own], limits_of(moved[i], model.setting))
        ridge = model.ridge
        if ridge is not None:
            ridge = replace(ridge, value=ridge.value + step[len(step) - len(ridge.value) :])
        trial = with_residual(replace(model, terms=tuple(moved), ridge=ridge))
        new = _total_misfit(_misfits(trial, (model, parts)), trial)
        if new < level:
            return trial, level - new
        step = 0.3 * step
    return model, 0.0


def misfit(model: Model) -> float:
    """Weighted sum of squares of the residual, and of the ridge against its prior."""
    return _total_misfit(_misfits(model), model)


def _misfits(model: Model, before: tuple[Model, Sequence[float]] | None = None) -> list[float]:
    """Weighted sums of squares by axis, taken from `before` if neither bins nor weights changed."""
    found = []
    for axis, (w, y) in enumerate(zip(model.weight, model.y, strict=True)):
        if before is not None and before[0].y[axis] is y and before[0].weight[axis] is w:
            found.append(before[1][axis])
        else:
            found.append(float(w @ y**2))
    return found


def _total_misfit(parts: Sequence[float], model: Model) -> float:
    total = sum(parts)
    if model.ridge is not None:
        total += float(model.ridge.precision @ model.ridge.value**2)
    return total
