"""Noise by its spectrum: white, flicker, random walk (IEEE Std 952-1997, annex C), in the units of the Allan deviation.

On cosine-transform bins ``w`` (rad per sample) a sample's variance has three parts. White noise has ``N^2 fs``.
Flicker, half an integration of white noise of standard deviation B, has ``B^2 / (2 sin(w/2))``. A walk with steps of
``K / sqrt(fs)`` has ``K^2 / (4 fs sin^2(w/2))``. The amplitudes are the sensor's, before the firmware's own filter
where the trace knows one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects.base import CatalogueEffect, NoiseEffect
from mavcal.calib.gap.effects.parts import TRIADS, per_axis
from mavcal.calib.gap.effects.traits import SensorTerm, Trait
from mavcal.calib.gap.problem import UNIT, Trace
from mavcal.calib.gap.reference.channels import filter_gain
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_LONG = 30.0
"""Least duration, s, to tell a walk from a bias. Chosen, not measured: a shorter recording shows little more of a walk
than its mean."""


def white_density(trace: Trace, omega: Array, _theta: float) -> Array:
    """Flat: ``fs`` for a density of one."""
    return (trace.fs * filter_power_gain(trace, omega))[None]


def flicker_density(trace: Trace, omega: Array, _theta: float) -> Array:
    """``1 / (2 sin(w/2))``, with the lowest positive bin in place of zero frequency."""
    return (0.5 / np.sin(0.5 * _positive(omega)) * filter_power_gain(trace, omega))[None]


def walk_density(trace: Trace, omega: Array, _theta: float) -> Array:
    """``1 / (4 fs sin^2(w/2))``, with the lowest positive bin in place of zero frequency."""
    return (0.25 / (trace.fs * np.sin(0.5 * _positive(omega)) ** 2) * filter_power_gain(trace, omega))[None]


def filter_power_gain(trace: Trace, omega: Array) -> Array:
    """Power gain (K,) of the firmware's filter at `omega`, rad per sample."""
    return filter_gain(omega * (trace.fs / (2.0 * np.pi)), trace.low_pass_hz) ** 2


def _positive(omega: Array) -> Array:
    """`omega` with half the lowest positive frequency in place of zero."""
    lowest = float(omega[omega > 0.0].min())
    return np.where(omega > 0.0, omega, 0.5 * lowest)


def _missing_duration(trace: Trace) -> tuple[str, str] | None:
    duration = float(trace.t[-1] - trace.t[0])
    return None if duration >= _LONG else (f"{duration:.0f} s of data", ">= 30 s, better ten minutes at rest")


def _effects_of(sensor: Sensor) -> tuple[CatalogueEffect, ...]:
    unit = UNIT[sensor]
    return (
        NoiseEffect(
            f"{sensor}_noise",
            sensor,
            per_axis("density", f"{unit}/sqrt(Hz)", squared=True),
            "any recording",
            "a minute at rest with the motors off, and one with them on",
            density=white_density,
            plain="more white noise",
            rivals=(f"{sensor}_rotor_noise", f"{sensor}_quantisation", f"{sensor}_flicker"),
            traits=frozenset({Trait.BROADBAND}),
            term=SensorTerm.WHITE_NOISE,
        ),
        NoiseEffect(
            f"{sensor}_flicker",
            sensor,
            per_axis("instability", unit, squared=True),
            "minutes of data",
            "ten minutes or more at rest at a constant temperature",
            _missing_duration,
            density=flicker_density,
            plain="1/f noise",
            rivals=(f"{sensor}_random_walk", f"{sensor}_noise"),
            traits=frozenset({Trait.WANDERING}),
            term=SensorTerm.FLICKER,
        ),
        NoiseEffect(
            f"{sensor}_random_walk",
            sensor,
            per_axis("random_walk", f"{unit}*sqrt(Hz)", squared=True),
            "minutes of data",
            "ten minutes or more at rest at a constant temperature",
            _missing_duration,
            density=walk_density,
            plain="an offset that wanders",
            rivals=(f"{sensor}_flicker", f"{sensor}_temp_linear", f"{sensor}_step", "reference_attitude"),
            traits=frozenset({Trait.WANDERING}),
            term=SensorTerm.RANDOM_WALK,
        ),
    )


EFFECTS: tuple[CatalogueEffect, ...] = tuple(effect for sensor in TRIADS for effect in _effects_of(sensor))
