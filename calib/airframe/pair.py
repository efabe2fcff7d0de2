"""Evidence from two flights for differences of the real from the simulated vehicle, for :mod:`calib.inference`.

Both flights are fitted with one model. Most parameters are common: what both flights show is an error of the model, not
a gap. Sensor offsets and the position of the unit are each flight's own. An effect changes parameters of the real
flight. The model itself is accurate to some per cent only (:class:`calib.airframe.fit.Reference`), however long the
flight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.airframe.effects import AirframeEffect, applied
from mavcal.calib.airframe.fit import SAG_SPAN, FlightFit, FlightLikelihood, expanded, fitted
from mavcal.calib.airframe.nameless import PREFIX
from mavcal.calib.airframe.physics import AXES
from mavcal.calib.airframe.priors import prior_of
from mavcal.calib.inference.model import Block, Model, Posterior, Term, laplace
from mavcal.calib.inference.quadratic import Quadratic

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

OWN: Final = ("bias", "lever", "scale")
"""Families of parameters that are each flight's own."""
_ONLY_REAL: Final = ("weak_", "pulse_", "load", PREFIX)
"""Parameters that only the real flight has; a nameless effect in the simulated one is left out (:func:`shown_by`)."""
STAMPS_S: Final = 0.0025
"""Standard deviation of the time offset between commands and gyroscope, s. Source: one loop at 400 Hz, in which either
is stamped (AIRFRAME 3.2)."""
TRIMS: Final = 5e-4
"""Repeatability of a trim, as a fraction of a full differential command. Measured: 20 pairs of flights with foreign
physics, no effect and different winds. Roll and pitch trims differ by 7e-4 beyond their errors; this is the part of
each flight."""
DAMPED: Final = 0.03
"""Relative error of the model's damping. Measured: in one flight the ratios of drag and damping differ by 4 % (d13)."""
_LOOSEST: Final = 1e-4
"""Precision of an unbounded discrepancy relative to the prior's: a hundred times as wide."""


@dataclass(frozen=True, eq=False)
class Side:
    """One flight: its likelihood and its expansion."""

    likelihood: FlightLikelihood
    fit: FlightFit

    @cached_property
    def own(self) -> Mask:
        """Mask of the parameters that are this flight's own."""
        names = self.fit.layout.names
        return np.array([n.rsplit("_", 1)[0] in OWN or n in OWN for n in names])

    @property
    def wind(self) -> Array:
        """Velocity of the air, north and east (2,), m/s."""
        return np.array([self.fit.value("wind_north"), self.fit.value("wind_east")])

    @cached_property
    def says(self) -> Quadratic:
        """Log-likelihood of the common parameters; the flight's own are integrated out."""
        whole = Quadratic(self.fit.theta, self.fit.gradient, self.fit.curvature, 0.0)
        return whole.without(self.own, *self.likelihood.priors)

    @cached_property
    def discrepancy(self) -> Array:
        """Inverse covariance of the common parameters due to the model's own errors."""
        names, place = self.fit.layout.names, self.fit.layout.place
        loosest = np.diag([_LOOSEST / prior_of(n)[1] ** 2 for n in names])
        found = (self.fit.trusted + loosest)[np.ix_(~self.own, ~self.own)]
        apart = {"delay": STAMPS_S} | {f"torque_{a}": TRIMS * abs(self.fit.value(f"gain_{a}")) for a in AXES}
        apart |= {f"damping_{a}": DAMPED * abs(self.fit.value(f"damping_{a}")) for a in AXES}
        apart = {name: sd for name, sd in apart.items() if sd > 0.0}
        rows = [int(np.count_nonzero(~self.own[: place[name]])) for name in apart]
        # (A^-1 + D)^-1 where D has a few parameters only (Woodbury)
        across = found[:, rows]
        inner = np.diag([sd**-2.0 for sd in apart.values()]) + found[np.ix_(rows, rows)]
        return np.asarray(found - across @ np.linalg.solve(inner, across.T))


@dataclass(frozen=True, eq=False)
class PairEvidence:
    """The :class:`calib.inference.model.Evidence` of a real and a simulated flight.

    `slewed` is the real flight with its rate limit, where one was found.
    """

    real: Side
    sim: Side
    effects: tuple[AirframeEffect, ...]
    slewed: Side | None = None

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """The blocks of the effects."""
        return tuple(Block(e.block, e.sd, e.odds, e.nameless, e.exclusive) for e in self.effects)

    @cached_property
    def _places(self) -> NDArray[np.intp]:
        """Indices of the parameters that both flights have in common."""
        return np.flatnonzero(~self.sim.own)

    @cached_property
    def _common(self) -> tuple[NDArray[np.intp], Array, Array]:
        """Positions among the common parameters of those that may differ from zero, with prior mean and sd."""
        names = [self.sim.fit.layout.names[r] for r in self._places]
        # no motor is weak in both flights, and a constant voltage does not determine a simulator's sag
        still = self.sim.likelihood.airframe.voltage_span < SAG_SPAN
        none = {"sag"} if still else set()
        rows = np.array([k for k, n in enumerate(names) if n not in none and not n.startswith(_ONLY_REAL)])
        mean, sd = (np.array([prior_of(names[r])[i] for r in rows]) for i in (0, 1))
        return rows, mean, sd

    def chosen(self, model: Model) -> tuple[AirframeEffect, ...]:
        """The effects of a model, in the catalogue's order."""
        return tuple(e for e in self.effects if e.block in model)

    def side_of(self, model: Model) -> Side:
        """The real flight's side under a model."""
        slew = any(e.slew for e in self.chosen(model))
        return self.slewed if slew and self.slewed is not None else self.real

    @cached_property
    def _reals(self) -> dict[bool, Quadratic]:
        made = {False: self.real.says.with_discrepancy(self.real.discrepancy)}
        if self.slewed is not None:
            better = self.slewed.says.with_discrepancy(self.slewed.discrepancy)
            # both are expansions of one flight; the slew limit gains their difference at their own centres
            gain = self.slewed.likelihood.loglik(self.slewed.fit.theta, self.real.fit.spectra)
            gain -= self.real.likelihood.loglik(self.real.fit.theta, self.real.fit.spectra)
            made[True] = replace(better, constant=better.constant + gain)
        return made

    @cached_property
    def _sim(self) -> Quadratic:
        return self.sim.says.with_discrepancy(self.sim.discrepancy)

    def posterior(self, model: Model) -> Posterior:
        """The posterior of the model with these effects."""
        chosen = self.chosen(model)
        rows, mean, sd = self._common
        places, layout = self._places, self.sim.fit.layout
        slewed = self.side_of(model) is self.slewed
        count, width, common = len(layout.names), sum(len(e.names) for e in chosen), len(places)

        def as_real(z: Array) -> tuple[Array, Array]:
            theta = np.zeros(count)
            theta[places[rows]] = z[: len(rows)]
            found, slope = applied(layout, theta, chosen, z[len(rows) :])
            kept = np.concatenate([places[rows], count + np.arange(width)])
            return found[places], slope[np.ix_(places, kept)]

        def as_sim(z: Array) -> tuple[Array, Array]:
            theta, slope = np.zeros(common), np.zeros((common, len(rows) + width))
            theta[rows], slope[rows, np.arange(len(rows))] = z[: len(rows)], 1.0
            return theta, slope

        terms = (Term(self._reals[slewed], as_real), Term(self._sim, as_sim))
        of_effects = [s for e in chosen for s in e.sd]
        expected = [e.mean for e in chosen for _ in e.names]
        start = np.concatenate([self.sim.fit.theta[places[rows]], expected])
        value, z, covariance = laplace(terms, start, np.concatenate([mean, expected]), np.concatenate([sd, of_effects]))
        where, at = {}, len(rows)
        for effect in chosen:
            where[effect.block] = slice(at, at + len(effect.names))
            at += len(effect.names)
        return Posterior(value, z, covariance, where)

    def parameters(self, model: Model, posterior: Posterior) -> tuple[Array, Array]:
        """Parameters of the real and of the simulated flight (P,) under a model; own ones as they were fitted."""
        rows, _, _ = self._common
        places, layout = self._places, self.sim.fit.layout
        sim = self.sim.fit.theta.copy()
        sim[places] = 0.0
        sim[places[rows]] = posterior.amplitudes[: len(rows)]
        found, _ = applied(layout, sim, self.chosen(model), posterior.amplitudes[len(rows) :])
        real = self.side_of(model).fit.theta.copy()
        real[places] = found[places]
        return real, sim

    def refined(self, model: Model) -> PairEvidence:
        """Both flights expanded about that model's best point, with the residual noise there."""
        real, sim = self.parameters(model, self.posterior(model))
        side = self.side_of(model)
        there = about(side, real)
        here = about(self.sim, sim)
        if side is self.real:
            return replace(self, real=there, sim=here)
        return replace(self, sim=here, slewed=there)


def about(side: Side, theta: Array) -> Side:
    """The flight expanded about `theta`, once its own parameters have been fitted to it."""
    layout = side.fit.layout
    fixed = {n: float(theta[k]) for k, n in enumerate(layout.names) if not side.own[k]}
    own = fitted(side.likelihood, theta, fixed, rounds=2, expand=False)
    free = np.ones(len(theta), dtype=bool) & side.likelihood.possible
    return Side(side.likelihood, expanded(side.likelihood, own.theta, free))


def shown_by(side: Side, effect: AirframeEffect) -> bool:
    """Whether a flight shows a nameless effect by itself: it is then a model error, not a difference of two flights.

    Marginal likelihoods of the flight with and without the effect are compared, about its own best point.
    """
    names = [n for n, own in zip(side.fit.layout.names, side.own, strict=True) if not own]
    says = side.says.with_discrepancy(side.discrepancy)
    mean, sd = (np.array([prior_of(n)[k] for n in names]) for k in (0, 1))
    columns = {c.parameter for c in effect.changes}
    base = np.array([not n.startswith(_ONLY_REAL) for n in names])
    known = base | np.array([n in columns for n in names])

    def evidence(rows: Mask) -> float:
        slope = says.gradient[rows] - ((says.centre - mean) / sd**2)[rows]
        bend = says.curvature[np.ix_(rows, rows)] + np.diag(1.0 / sd[rows] ** 2)
        _, size = np.linalg.slogdet(bend * np.outer(sd[rows], sd[rows]))
        return 0.5 * float(slope @ np.linalg.solve(bend, slope)) - 0.5 * float(size)

    return evidence(known) > evidence(base)


def by_itself(
    likelihood: FlightLikelihood, start: Array | None = None, rounds: int | None = None, *, load: bool = False
) -> Array:
    """Best parameters (P,) of a flight alone, without weak motors and nameless effects.

    `load`: with a step of the mass.
    """
    layout, flight = likelihood.airframe.layout, likelihood.airframe.flight
    if start is None:
        start = layout.start(float(np.median(flight.c)), flight.gravity)
    held = {n: 0.0 for n in layout.names if n.startswith((*_ONLY_REAL, "fall")) and not (load and n == "load")}
    many = {} if rounds is None else {"rounds": rounds}
    return fitted(likelihood, start, held, expand=False, **many).theta
