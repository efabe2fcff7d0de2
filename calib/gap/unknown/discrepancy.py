"""Tests whether whitened residuals are white noise: bursts of noise, and waves of any form.

A bet is an e-value: a likelihood averaged over alternatives, divided by the largest likelihood of a model without them.
If that model is true, its mean is at most one. It then exceeds ``1 / a`` with a probability of at most `a`, for any
average (Ville 1939; Wasserman, Ramdas & Balakrishnan 2020). No simulation is needed, and the mean of bets is a bet.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft
from scipy.special import logsumexp

from mavcal.calib.gap.model.joint import Model
from mavcal.calib.gap.model.views import View
from mavcal.calib.gap.unknown.misattributed_noise import Unexplained, has_modulated_noise, is_coarsely_quantised

Array = NDArray[np.float64]

BURSTS, WAVES = "noise that is louder at times", "a non-sinusoidal wave of"
"""Descriptions of winning bets."""
_CHANCE = 2e-3
"""False-alarm probability of all bets together on white noise. Source: decision 37 derives the limits from it. The
value is chosen, not measured: a fifth of the 1 % of false alarms that GAP 6 allows."""
_AXES = ((0, 1, 2), (0,), (1,), (2,))
"""Sets of axes for one bet: all together, and each alone."""
_RAISED = np.array([0.3, 0.8, 2.0, 6.0])
"""Relative increases of the variance during a burst. Chosen, not measured: a factor of 2.5 to 3 from one to the
next."""
_LASTS = np.array([8.0, 30.0, 120.0, 500.0, 2000.0])
"""Mean durations of a burst, samples. Chosen, not measured: a factor of four from one to the next, from a shock to
seconds."""
_DUTY = np.array([0.02, 0.1, 0.3])
"""Fractions of the time in bursts. Chosen, not measured: a factor of 3 to 5 from one to the next."""
_BLOCKS = 7000
"""Most averages of a series in the search for bursts. Chosen, not measured: it bounds the time."""
_SINGLE = 4
"""Samples per average up to which single loud samples are sought too. Chosen, not measured: an average of more hides
them."""
_LONGEST = 20_000
"""Most averages of a series in the search for waves: faster ones of a long recording are lines. Chosen, not measured:
it bounds the time."""
_ROUNDS = 40
"""Rounds of a fit of two variances. Chosen, not measured: it bounds the time."""
_STARTS = ((0.02, 4.0), (0.2, 1.5))
"""Initial fractions and variances of the louder samples, one pair per fit. Chosen, not measured: few loud samples, and
many moderate ones; one of the fits finds either."""
_PERIODS = 4
"""Least number of periods of a wave in the recording. Chosen, not measured: drift has fewer."""
_PAD = 8
"""Zero-padding factor: it brings overtone k nearer to its bin than to the next. Chosen, not measured: an eighth of a
bin is near enough for most overtones."""
_OVERTONES = (1, 2, 4, 8, 16)
"""Numbers of waves in a comb. Chosen, not measured: powers of two; numbers in between win with the next larger one."""
_SIZES = np.geomspace(1.0, 200.0, 8)
"""Prior variances of a wave's amplitude, relative to the noise. Chosen, not measured: a factor of two from one to the
next."""


def bets_of(model: Model) -> tuple[Unexplained, ...]:
    """Every bet on the residual of a model, for each series with declared white noise; nats are log bets."""
    return tuple(bet for v in range(len(model.setting.views)) for bet in _bets(model, v))


def winning_bets(bets: Sequence[Unexplained]) -> list[Unexplained]:
    """Bets that are significant among all."""
    needed = math.log(max(len(bets), 1) / _CHANCE)
    return [bet for bet in bets if bet.nats > needed]


def log_odds(bets: Sequence[Unexplained]) -> float | None:
    """The log of the mean of all bets; None without bets."""
    return _log_mean(np.array([bet.nats for bet in bets])) if bets else None


def _bets(model: Model, v: int) -> Iterator[Unexplained]:
    view = model.setting.views[v]
    # The error of the reference is known only up to the last of its cosines.
    if model.wanders_in(v) or not _is_white(view):
        return
    power = np.array([model.noise[3 * v + c].power for c in range(3)])
    white = np.stack([view.whitened(axis) for axis in view.spectra(model.residual[v]) / np.sqrt(power)])
    name = view.sensor.value
    if not has_modulated_noise(model, view):
        yield Unexplained(burst_bet(white), f"{BURSTS} on {name}", view.sensor)
    nats, periods = wave_bet(white)
    yield Unexplained(nats, f"{WAVES} {periods * view.fs / view.n:.3g} Hz on {name}", view.sensor)


def _is_white(view: View) -> bool:
    """Whether the noise of a series is known to be white; spectra learned from flights are averages."""
    return view.density is None and view.variance is not None and not view.first and not is_coarsely_quantised(view)


def burst_bet(white: Array) -> float:
    """Log of the bet that the variance of white series (p, n) switches between two values.

    The bet is on a Markov chain of two states against loud samples in random order: heavy tails are no bursts.
    """
    width = -(-white.shape[1] // _BLOCKS)
    count = white.shape[1] // width
    square = white[:, : count * width] ** 2
    energy = square.reshape(len(white), count, width).sum(axis=2)
    each = [axes for axes in _AXES if max(axes) < len(white)]
    chains = _chain_likelihoods(
        np.array([energy[list(axes)].sum(axis=0) for axes in each]), width * np.array([*map(len, each)])
    )
    bets = []
    for axes, chain in zip(each, chains, strict=True):
        own = list(axes)
        if chain > 0.0:  # else no more than a draw, whatever it is compared with
            alone = _mixture_likelihood(square[own].ravel(), 1) if width <= _SINGLE else 0.0
            chain -= max(alone, _mixture_likelihood(energy[own].sum(axis=0), width * len(own)))
        bets.append(chain)
    return _log_mean(np.array(bets))


def _chain_likelihoods(energy: Array, freedom: NDArray[np.intp]) -> Array:
    """Log-likelihood (k,) of Markov chains of two variances, averaged over chains, against unit variance.

    `energy` (k, n): sums of `freedom` (k,) squares each. The first state has unit variance.
    """
    width = freedom.min()  # of an axis alone: samples of a block
    raised, lasts, duty = (a.ravel() for a in np.meshgrid(_RAISED, _LASTS, _DUTY, indexing="ij"))
    end = np.minimum(width / lasts, 1.0)
    begin = np.minimum(end * duty / (1.0 - duty), 1.0)
    calm, loud = (np.broadcast_to(p, (len(energy), len(end))).copy() for p in (1.0 - duty, duty))
    level = -0.5 * freedom[:, None] * np.log1p(raised)
    slope = 0.5 * raised / (1.0 + raised)
    total = np.zeros_like(calm)
    for now in energy.T:
        ratio = level + slope * now[:, None]
        top = np.maximum(ratio, 0.0)
        calm, loud = calm * np.exp(-top), loud * np.exp(ratio - top)
        both = calm + loud
        total += np.log(both) + top
        loud = loud / both
        loud = loud * (1.0 - end) + (1.0 - loud) * begin
        calm = 1.0 - loud
    return np.asarray(logsumexp(total, axis=1) - math.log(total.shape[1]))


def _mixture_likelihood(energy: Array, freedom: int) -> float:
    """Largest log-likelihood of sums (n,) with one of two variances each, against unit variance.

    Each is a sum of `freedom` squares; by expectation and maximisation, each sum independently.
    """
    best = 0.0
    for part, variance in _STARTS:
        v = np.array([1.0, variance])
        for _ in range(_ROUNDS):
            each = 0.5 * energy[:, None] * (1.0 - 1.0 / v) - 0.5 * freedom * np.log(v) + np.log([1.0 - part, part])
            whole = np.logaddexp(each[:, 0], each[:, 1])
            own = np.exp(each - whole[:, None])
            weight = np.maximum(own.sum(axis=0), 1e-9)
            v = np.maximum(own.T @ energy / (freedom * weight), 1e-9)
            part = float(np.clip(weight[1] / len(energy), 1e-9, 1.0 - 1e-9))
        best = max(best, float(whole.sum()))
    return best


def wave_bet(white: Array) -> tuple[float, float]:
    """Log of the bet that white series (p, n) contain a periodic wave, and the number of its likeliest periods.

    At each frequency a wave and its overtones are tried, with a common prior on their size. Periodograms are summed
    over overtones as by de Jager, Raubenheimer & Swanepoel 1989.
    """
    width = -(-white.shape[1] // _LONGEST)
    n = white.shape[1] // width
    white = white[:, : n * width].reshape(len(white), n, width).mean(axis=2)
    level = np.maximum((white**2).mean(axis=1, keepdims=True), 1e-300)  # louder noise is no wave
    power = 2.0 * np.abs(rfft(white, n=_PAD * n, axis=1)) ** 2 / (n * level)  # chi-square of two degrees of freedom
    at = np.arange(_PAD * _PERIODS, power.shape[1] // 2)
    if not len(at):
        return -math.inf, 0.0
    bets, best = [], (-math.inf, 0)
    for axes in (axes for axes in _AXES if max(axes) < len(white)):
        own = power[list(axes)].sum(axis=0)
        gain, rank, done = np.zeros(len(at)), np.zeros(len(at)), 0
        for most in _OVERTONES:
            for k in range(done + 1, most + 1):
                there = at[k * at < len(own) - 1]
                gain[: len(there)] += own[k * there]
                rank[: len(there)] += 2 * len(axes)
            done = most
            size = _SIZES[:, None]
            worth = 0.5 * (gain * size / (1.0 + size) - rank * np.log1p(size))
            bets.append(_log_mean(worth.ravel()))
            j = int(worth.argmax()) % len(at)
            best = max(best, (float(worth.max()), int(at[j])))
    return _log_mean(np.array(bets)), best[1] / _PAD


def _log_mean(bets: Array) -> float:
    """Log of the mean of bets that are given as logs."""
    return float(logsumexp(bets) - math.log(len(bets)))
