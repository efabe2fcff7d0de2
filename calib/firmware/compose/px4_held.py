"""Drift polynomial that PX4 can store: unsaved coefficients are fixed, and the others refitted.

PX4 saves no coefficient within FLT_EPSILON of zero (:mod:`calib.firmware.values`). Over 30 degC a cubic term of that
size is worth 0.003 in the unit of the sensor, so it is not just left out. It becomes zero, or the smallest number that
is saved, whichever costs less. The free coefficients are fitted again by least squares to the measured curve, with
equal weight over the range of temperature. ``p(t_ref) = 0`` stays. What remains is the cost.
"""

from __future__ import annotations

import dataclasses
import itertools
from dataclasses import dataclass
from typing import Final

import numpy as np

from mavcal.calib.firmware import losses
from mavcal.calib.firmware.compose.draft import Subject
from mavcal.calib.firmware.values import FLT_EPSILON, LEAST_KEPT
from mavcal.calib.fit import AXES, FitResult
from mavcal.calib.triad import Array, ThermalPolynomial

ORDINALS: Final = ("linear", "quadratic", "cubic")
NODES: Final = 201
"""Temperatures at which the curves are compared."""


@dataclass(frozen=True, eq=False)
class HeldDrift:
    """A temperature drift that PX4 can store completely, and the error that the change causes."""

    fit: FitResult
    """With the covariance of the free coefficients; fixed ones have none."""
    fixed: tuple[tuple[str, tuple[str, ...]], ...]
    """Axes, and the orders of each that could not be held as they were measured."""
    cost: float
    """Largest difference to the measured curve over its range, as the length of the vector, in the fit's unit."""

    def text(self, about: Subject) -> str:
        """One sentence for the operator."""
        polynomial = self.fit.model.polynomial
        assert polynomial is not None
        terms = "; ".join(f"{axis}: {' and '.join(orders)}" for axis, orders in self.fixed)
        return (
            f"{about}: PX4 saves no number within {FLT_EPSILON:.2g} of zero, so terms of its drift cannot be held "
            f"({terms}). The others were fitted again: up to {self.cost:.2g} {self.fit.unit} stay between "
            f"{polynomial.t_min:.0f} and {polynomial.t_max:.0f} degC"
        )


def held_drift(fit: FitResult) -> HeldDrift:
    """The fit with the coefficients that PX4 keeps over a restart, and its cost: 0 if it keeps all of them."""
    polynomial = fit.model.polynomial
    assert polynomial is not None
    grid = np.linspace(polynomial.t_min, polynomial.t_max, NODES) - polynomial.t_ref
    powers = grid[:, None] ** np.arange(1, fit.degree + 1)
    coefficients, covariance = polynomial.coefficients.copy(), fit.covariance.copy()
    fixed = []
    for axis, letter in enumerate(AXES):
        if _kept(coefficients[axis]):
            continue
        choice, coefficients[axis] = _nearest(powers, coefficients[axis])
        rows = losses.POLYNOMIAL + axis * fit.degree + np.arange(fit.degree)
        carry = np.eye(len(covariance))
        carry[np.ix_(rows, rows)] = _carry(powers, choice)
        covariance = carry @ covariance @ carry.T
        orders = tuple(ORDINALS[k] for k in range(fit.degree) if not choice[k])
        if polynomial.coefficients[axis].any():
            fixed.append((letter, orders))
    difference = powers @ (coefficients - polynomial.coefficients).T
    model = dataclasses.replace(
        fit.model,
        polynomial=ThermalPolynomial(polynomial.t_ref, polynomial.t_min, polynomial.t_max, coefficients),
    )
    held = dataclasses.replace(fit, model=model, covariance=covariance)
    return HeldDrift(held, tuple(fixed), float(np.linalg.norm(difference, axis=1).max()))


def _kept(coefficients: Array) -> bool:
    single = coefficients.astype(np.float32)
    return bool(np.all((single == 0.0) | (np.abs(single) > np.float32(FLT_EPSILON))))


def _nearest(powers: Array, wanted: Array) -> tuple[tuple[bool, ...], Array]:
    """Orders that stay free, and the coefficients that can be held with the smallest mean square difference."""
    curve = powers @ wanted
    best: tuple[float, tuple[bool, ...], Array] | None = None
    for pinned in itertools.product((None, 0.0, LEAST_KEPT, -LEAST_KEPT), repeat=len(wanted)):
        free = [k for k, value in enumerate(pinned) if value is None]
        found = np.array([0.0 if value is None else value for value in pinned])
        if free:
            found[free] = np.linalg.lstsq(powers[:, free], curve - powers @ found, rcond=None)[0]
        if not _kept(found):
            continue
        cost = float(np.mean((powers @ found - curve) ** 2))
        if best is None or cost < best[0]:
            best = cost, tuple(value is None for value in pinned), found
    assert best is not None  # all zero can always be held
    return best[1], best[2]


def _carry(powers: Array, free: tuple[bool, ...]) -> Array:
    """Derivative (k, k) of the free coefficients by the measured ones; zero for the fixed ones."""
    chosen = [k for k, value in enumerate(free) if value]
    matrix = np.zeros((len(free), len(free)))
    if chosen:
        matrix[chosen] = np.linalg.lstsq(powers[:, chosen], powers, rcond=None)[0]
    return matrix
