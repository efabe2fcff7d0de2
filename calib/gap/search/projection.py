"""Gain of columns beside a model: their Schur complement in the weighted Gram matrix."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.model.hypotheses import HypothesisColumns, Part
from mavcal.calib.gap.model.joint import Model, Normal, Ridge, jacobian, normal_equations, stacked
from mavcal.calib.gap.model.normal_equations import eigh, solved
from mavcal.calib.gap.model.refinement import misfit, refined
from mavcal.calib.gap.search import prices
from mavcal.calib.gap.search.evidence import evidence

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Gain:
    """Gain of a group of columns.

    `gain` is twice the gain of log-likelihood, `df` the degrees of freedom, `beta` the amplitudes; `evidence` is twice
    the log marginal likelihood ratio.
    """

    gain: float
    df: int
    beta: Array
    evidence: float

    @property
    def price(self) -> float:
        """The difference of gain and evidence."""
        return self.gain - self.evidence


class Projection:
    """Projection of candidates orthogonal to the columns of a model."""

    def __init__(self, model: Model, omit: Sequence[int] = ()) -> None:
        self.model = model
        self.omit = tuple(omit)
        blocks = [jacobian(t, model.setting) for i, t in enumerate(model.terms) if i not in omit]
        normal: Normal = normal_equations(blocks, model.y, model.weight, model.ridge)
        self._solution, self.covariance, _ = solved(normal.gram, normal.right)
        self._right = normal.right
        self._own = [_model_columns(a, blocks, normal.slices, model.ridge) for a in range(len(model.y))]

    @cached_property
    def misfit_without_omitted(self) -> float:
        """Misfit of the model without the omitted terms, the others at their joint maximum."""
        rest = tuple(t for i, t in enumerate(self.model.terms) if i not in self.omit)
        return misfit(refined(replace(self.model, terms=rest))[0])

    def projected(self, columns: HypothesisColumns) -> tuple[Array, Array, Array]:
        """Gram matrix, right side and original energies of `columns`, orthogonal to the model's columns."""
        return self._projected_each([columns])[0]

    def _projected_each(self, groups: Sequence[HypothesisColumns]) -> list[tuple[Array, Array, Array]]:
        """The same for several groups of columns."""
        weighted = [self._weighted(columns) for columns in groups]
        found = []
        for columns, own, cross in zip(groups, weighted, self._with_own(groups, weighted), strict=True):
            gram, right = np.zeros((columns.p, columns.p)), np.zeros(columns.p)
            for a, part in columns.parts.items():
                gram[part.index[:, None], part.index] += own[a] @ part.X.T
                right[part.index] += own[a] @ self.model.y[a]
            energy = np.diag(gram).copy()
            if len(self._right):
                gram -= cross @ self.covariance @ cross.T
                right -= cross @ self._solution
            found.append((gram, right, energy))
        return found

    def cross(self, one: HypothesisColumns, other: HypothesisColumns) -> Array:
        """Products (p, q) of two groups of columns, orthogonal to the model's columns."""
        total = np.zeros((one.p, other.p))
        left, right = self._weighted(one), self._weighted(other)
        for a in left.keys() & right.keys():
            total[one.parts[a].index[:, None], other.parts[a].index] += left[a] @ other.parts[a].X.T
        of_one, of_other = self._with_own([one, other], [left, right])
        return np.asarray(total - of_one @ self.covariance @ of_other.T)

    def _weighted(self, columns: HypothesisColumns) -> dict[int, Array]:
        return {a: part.X * self.model.weight[a] for a, part in columns.parts.items()}

    def _with_own(self, groups: Sequence[HypothesisColumns], weighted: Sequence[Mapping[int, Array]]) -> list[Array]:
        """Products (p, own) of groups of `weighted` columns with the model's columns, which are read once for all."""
        products = [np.zeros((columns.p, len(self._right))) for columns in groups]
        for a, own in enumerate(self._own):
            touched = [k for k, columns in enumerate(groups) if a in columns.parts]
            if not (own and touched):
                continue
            X = np.concatenate([weighted[k][a] for k in touched])
            ends = np.cumsum([len(weighted[k][a]) for k in touched])[:-1]
            for part in own:
                for k, rows in zip(touched, np.split(X @ part.X.T, ends), strict=True):
                    products[k][groups[k].parts[a].index[:, None], part.index] += rows
        return products

    def gain(self, columns: HypothesisColumns) -> Gain:
        """Gain of a group of columns with free amplitudes."""
        return gain_of(*self.projected(columns), columns.units)

    def free_gains(self, groups: Sequence[HypothesisColumns]) -> list[float]:
        """Gains of several groups without amplitudes and evidence, as a search for a shape needs them."""
        return [_free_gain(*found) for found in self._projected_each(groups)]

    def fixed_gain(self, columns: HypothesisColumns) -> float:
        """Gain of one column with amplitude one."""
        gram, right, _ = self.projected(columns)
        return float(2.0 * right[0] - gram[0, 0])

    def free_and_fixed_gains(self, groups: Sequence[HypothesisColumns]) -> Array:
        """Gains of single columns with a free amplitude and with amplitude one, (k, 2)."""
        found = self._projected_each(groups)
        return np.array([[_free_gain(*one), 2.0 * one[1][0] - one[0][0, 0]] for one in found])


def _model_columns(
    axis: int, blocks: Sequence[HypothesisColumns], slices: Sequence[slice], ridge: Ridge | None
) -> list[Part]:
    """Columns of a model on an axis: of its terms, and of its ridge, which is too large to be copied."""
    index, X = stacked(blocks, slices[: len(blocks)], axis)
    found = [Part(index, X)] if len(index) else []
    if ridge is not None and axis in ridge.columns.parts:
        waves = ridge.columns.parts[axis]
        found.append(Part(waves.index + slices[-1].start, waves.X))
    return found


def gain_of(gram: Array, right: Array, energy: Array, units: NDArray[np.intp]) -> Gain:
    """Gain of columns with free amplitudes of `units` (p,), from what :meth:`Projection.projected` gives."""
    basis = independent_directions(gram, energy)
    found = basis.T @ right
    return Gain(float(found @ found), basis.shape[1], basis @ found, evidence(gram, right, units))


def _free_gain(gram: Array, right: Array, energy: Array) -> float:
    found = independent_directions(gram, energy).T @ right
    return float(found @ found)


def independent_directions(gram: Array, energy: Array) -> Array:
    """Whitening basis (p, r) of the directions of a projected Gram matrix that keep some of their `energy`."""
    scale = np.sqrt(energy)
    used = scale > 0.0
    inverse = np.zeros_like(scale)
    inverse[used] = 1.0 / scale[used]
    values, vectors = eigh(gram * np.outer(inverse, inverse))
    good = values > prices.INDEPENDENT_ENERGY
    return np.asarray(inverse[:, None] * vectors[:, good] / np.sqrt(values[good]))
