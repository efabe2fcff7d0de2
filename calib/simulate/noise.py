"""Noise of three axes by its Allan deviation: white, flicker, random walk (IEEE Std 952-1997, annex C)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve, lfilter

Array = NDArray[np.float64]


def white(rng: np.random.Generator, count: int, density: Array, rate: float) -> Array:
    """White noise (count, 3) with Allan deviation ``N / sqrt(tau)``: a sample has the sd ``N sqrt(rate)``."""
    return np.asarray(rng.normal(size=(count, 3)) * density * np.sqrt(rate), dtype=np.float64)


def flicker(rng: np.random.Generator, count: int, instability: Array, poles: Array | None = None) -> Array:
    """Flicker noise (count, 3) of spectrum ``B^2 / (2 pi f)``: its Allan deviation is flat at ``B sqrt(2 ln 2 / pi)``.

    White noise of standard deviation ``B`` is half integrated, ``(1 - z^-1)^(-1/2)``. Its spectrum is then ``B^2 dt /
    (2 sin(pi f dt))`` (Kasdin 1995). Far below the rate ``1 / dt`` the spectrum does not depend on that rate. With
    `poles` the white noise is filtered by one over that polynomial instead.
    """
    if not instability.any():
        return np.zeros((count, 3))
    draws = rng.normal(size=(count, 3)) * instability
    if poles is not None:
        return np.asarray(lfilter([1.0], poles, draws, axis=0), dtype=np.float64)
    return np.asarray(fftconvolve(draws, half_integral(count)[:, None], axes=0)[:count], dtype=np.float64)


def half_integral(count: int) -> Array:
    """The first `count` terms of ``(1 - x)^(-1/2)``.

    >>> half_integral(4)
    array([1.    , 0.5   , 0.375 , 0.3125])
    """
    k = np.arange(1, count)
    return np.concatenate([[1.0], np.cumprod((k - 0.5) / k)])


def half_derivative(count: int) -> Array:
    """The first `count` terms of ``(1 - x)^(1/2)``: the poles of flicker noise.

    >>> half_derivative(4)
    array([ 1.    , -0.5   , -0.125 , -0.0625])
    """
    k = np.arange(1, count)
    return np.concatenate([[1.0], np.cumprod((k - 1.5) / k)])


def random_walk(rng: np.random.Generator, count: int, coefficient: Array, rate: float) -> Array:
    """Random walk (count, 3) from zero with Allan deviation ``K sqrt(tau / 3)``: a step has ``K / sqrt(rate)``."""
    if not coefficient.any():
        return np.zeros((count, 3))
    steps = rng.normal(size=(count, 3)) * coefficient / np.sqrt(rate)
    steps[0] = 0.0
    return np.asarray(np.cumsum(steps, axis=0), dtype=np.float64)
