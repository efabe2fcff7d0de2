"""The age of samples, and the noise that it makes where a reading changes fast.

A log writes the latest sample of every unit under one time. Each is older by up to a period of its own driver (SITL
runs its inertial units at 1000 and 760 Hz). Their difference then has noise in proportion to how fast the reading
changes, which no steady spectrum holds. A nominal recording shows the variance of that age. Samples in which it exceeds
the other noise say nothing about the sensor; in the others it is expected.

A single unit beside the trajectory of its vehicle has the same noise. Its spectrum is that of the driver's beats. A
flight that turns faster has more of it, also about an axis that the nominal one did not turn.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from mavcal.calib.gap.likelihood import AmplitudeFit, fit_amplitudes
from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.reference.noise import FEWEST, UNSTEADY, hz_of, learned, own_on, psd_of, squares_of, with_more
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]


def slopes_squared(trace: Trace) -> Array:
    """Square of the change of the reading in a second, (N, 3): mean of the steps to the samples before and after."""
    known = trace.observed[1:] & trace.observed[:-1]
    steps = np.where(known[:, None], (np.diff(trace.measured, axis=0) * trace.fs) ** 2, 0.0)
    total = np.vstack([steps, np.zeros(3)]) + np.vstack([np.zeros(3), steps])
    return np.asarray(total / np.maximum(np.convolve(known, [1.0, 1.0]), 1.0)[:, None])


def age_of(nominal: Sequence[Trace]) -> float:
    """Variance (s2) of the age of one unit's samples against the other's, the largest of differences `nominal`.

    Zero where the noise does not follow the change of the reading.
    """
    return max((_age(trace) for trace in nominal if trace.observed.sum() >= FEWEST), default=0.0)


def _age(trace: Trace, change: Array | None = None) -> float:
    """Variance of the age by the squares (N, 3) of a `change` in a second; None: of the trace's own readings."""
    squares = slopes_squared(trace) if change is None else change
    slopes = squares[trace.observed].T.ravel()
    steady = _fitted(trace, np.zeros(len(slopes)), ())
    if not slopes.any() or steady is None:
        return 0.0
    unit = float(squares_of(trace).mean() / slopes.mean())
    aged = _fitted(trace, np.zeros(len(slopes)), (unit * slopes,))
    if aged is None or chdtrc(1, max(steady.deviance - aged.deviance, 0.0)) > UNSTEADY:
        return 0.0
    return unit * float(aged.amplitudes[3])


def _fitted(trace: Trace, base: Array, more: Sequence[Array]) -> AmplitudeFit | None:
    """Steady noise of each axis, in units of its mean square, beside `base` and variances `more`, all (3 n,)."""
    squares = squares_of(trace)
    if not squares.any(axis=0).all():
        return None
    steady = np.kron(np.diag(squares.mean(axis=0)), np.ones(len(squares)))
    return fit_amplitudes(squares.T.ravel(), np.ones(squares.size), base, [*steady, *more])


def without_aged_samples(trace: Trace, age: float) -> Trace:
    """`trace` without the samples in which an `age` of that variance (s2) is more than the noise beside it."""
    expected = age * slopes_squared(trace)
    rest = _fitted(trace, expected[trace.observed].T.ravel(), ())
    if rest is None:
        return trace
    noise = rest.amplitudes * squares_of(trace).mean(axis=0)
    return dataclasses.replace(trace, observed=trace.observed & ~(expected > noise).any(axis=1))


def with_age_noise(trace: Trace, age: float, nominal: Sequence[Trace]) -> Trace:
    """`trace` with the noise that its faster movement adds to what the `nominal` ones show, all of them settled."""
    nominal_slopes = np.mean([slopes_squared(n)[n.observed].mean(axis=0) for n in nominal], axis=0)
    more = age * np.maximum(slopes_squared(trace)[trace.observed].mean(axis=0) - nominal_slopes, 0.0)
    return with_more(trace, more)


@dataclasses.dataclass(frozen=True, eq=False)
class AgeNoise:
    """Noise of units against a reference that follows the change of their reading, in another flight.

    `density` (K,) at `hz` (K,) is the power in a bin of the cosine transform for each square of the change, s2;
    `change` (3,) the mean square of the change in a second.
    """

    hz: Array
    density: Array
    change: Array


def age_noise_of(nominal: Sequence[Trace]) -> dict[tuple[Sensor, bool], AgeNoise]:
    """Noise by the age of samples in `nominal` flights, by sensor; True: against the trajectory, False: against a unit.

    Every axis is as old as the others: one that did not move has the noise of those that did.
    """
    found: dict[tuple[Sensor, bool], list[AgeNoise]] = {}
    for trace in nominal:
        if trace.rate_known and (one := _aged(trace)) is not None:
            found.setdefault((trace.sensor, trace.against is None), []).append(one)
    return {kind: max(each, key=lambda one: float(one.density.mean())) for kind, each in found.items()}


def _aged(trace: Trace) -> AgeNoise | None:
    spectrum = learned(trace)
    ideal = dataclasses.replace(trace, measured=trace.ideal)
    if spectrum is None or trace.observed.sum() < FEWEST or not (age := _age(trace, slopes_squared(ideal))):
        return None
    change = slopes_squared(ideal)[trace.observed].mean(axis=0)
    there = spectrum.psd.sum(axis=1)
    size = float(spectrum.dof @ there / spectrum.dof.sum())
    return AgeNoise(spectrum.hz, there / size * min(age, size / float(change.sum())), change)


def with_aged_noise(trace: Trace, found: Mapping[tuple[Sensor, bool], AgeNoise]) -> Trace:
    """`trace` with the noise expected that its reading has for changing faster than in other flights.

    A calmer recording is not expected to have less noise.
    """
    aged = found.get((trace.sensor, trace.against is None))
    if aged is None or (trace.psd is None and trace.sigma is None):
        return trace
    now = slopes_squared(dataclasses.replace(trace, measured=trace.ideal))[trace.observed].mean(axis=0)
    faster = np.maximum(now - aged.change, 0.0)
    if not faster.any():
        return trace
    hz = np.unique(np.concatenate([hz_of(trace), aged.hz[aged.hz < 0.5 * trace.fs]]))
    more = np.interp(hz, aged.hz, aged.density)[:, None] * faster
    own = own_on(trace, hz)
    return dataclasses.replace(
        trace, psd=psd_of(trace, hz) + more, psd_hz=hz, own_psd=None if own is None else own + more
    )
