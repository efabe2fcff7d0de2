"""Effects of rotating rotors: lines at multiples of their speed, aliases of lines, noise, and rectified vibration.

A line follows one rotor as a wave and is subtracted, if rotor speeds are logged well enough to integrate the phase.
Otherwise it is power on a frequency track. With recorded rotor speeds the track is a multiple of them. It is weighted
by the fourth power of the speed, since the force of an imbalance grows with its square. Without them it is a fixed
frequency while the motors run.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.ndimage import uniform_filter1d

from mavcal.calib.gap.effects.base import (
    CatalogueEffect,
    EffectParameter,
    EffectShape,
    MeanEffect,
    Missing,
    NoiseEffect,
)
from mavcal.calib.gap.effects.noise import white_density
from mavcal.calib.gap.effects.parts import INERTIAL, TRIADS, axiswise, per_axis
from mavcal.calib.gap.effects.traits import Trait
from mavcal.calib.gap.likelihood import transform
from mavcal.calib.gap.problem import UNIT, Trace, known
from mavcal.calib.gap.reference.channels import filter_gain
from mavcal.calib.gap.reference.noise import LINE_HZ, LOWEST_ROTOR_HZ
from mavcal.calib.gap.remembered import remembered
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

RUNNING_THROTTLE = 0.05
"""Motor output or throttle, 0..1, above which a motor turns. Chosen, not measured: below the idle output of speed
controllers."""
_LOWEST = 5.0
"""Lowest vibration at a fixed frequency, Hz. Chosen, not measured: below it a vehicle moves as a whole."""
_HARMONICS = (1, 2, 3, 4)
"""Orders of a rotor's speed. Source: its unbalance, two or three blades, and the second harmonic of two."""
_FOLDED = (1, 2, 3, 4, 5, 6)
"""Orders that sampling may alias. Chosen, not measured: two more than without aliasing, since higher ones are weak."""
_DETUNED = (0.98, 1.0, 1.02)
"""Ratios to the mean speed that are tried. Chosen, not measured: rotors of one vehicle differ by a few percent in
hover."""
_ROTOR = 100.0
"""Factor that encodes a rotor and its order in one number. Source: an encoding; no order reaches a hundred."""
_CANDIDATES = 4
"""Frequencies that are tried. Chosen, not measured: it bounds the time; the strongest are the likeliest."""
_LEAST_VARIATION = 0.1
"""Least standard deviation of the rotors' power, relative to its maximum, to tell that noise follows it. Chosen, not
measured: with less, steady noise fits as well."""
_THROTTLE = "throttle 0-hover-0 twice at one attitude"
_TELEMETRY = ("no rotor speed, motor output or throttle recorded", "rotor speed in the log")


def folded(frequency: Array, fs: float) -> Array:
    """Frequency at which sampling at `fs` shows `frequency`: ``|((f + fs/2) mod fs) - fs/2|``."""
    return np.asarray(np.abs((frequency + 0.5 * fs) % fs - 0.5 * fs), dtype=np.float64)


@remembered(12)
def rotor_power(trace: Trace) -> Array | None:
    """Power of the rotors' vibration over time (N,), at most one: fourth power of speed, or square of thrust.

    None if neither is recorded.
    """
    if trace.rotor_hz is not None:
        power = np.square(np.square(np.maximum(trace.rotor_hz, 0.0))).mean(axis=1)
    elif trace.motors is not None:
        power = (np.maximum(trace.motors, 0.0) ** 2).mean(axis=1)
    elif trace.throttle is not None:
        power = np.maximum(trace.throttle, 0.0) ** 2
    else:
        return None
    largest = float(power[trace.observed].max(initial=0.0))
    return np.asarray(power / largest, dtype=np.float64) if largest > 0.0 else np.zeros(len(trace.t))


@remembered(12)
def motors_running(trace: Trace) -> NDArray[np.bool_]:
    """True (N,) while a motor turns."""
    if trace.rotor_hz is not None:
        return np.asarray((trace.rotor_hz > LOWEST_ROTOR_HZ).any(axis=1))
    if trace.motors is not None:
        return np.asarray((trace.motors > RUNNING_THROTTLE).any(axis=1))
    if trace.throttle is not None:
        return np.asarray(trace.throttle > RUNNING_THROTTLE)
    return np.ones(len(trace.t), dtype=np.bool_)


def mean_speed(trace: Trace) -> float:
    """Mean speed of the turning rotors, Hz; 0 if it is not recorded or they never turn."""
    if trace.rotor_hz is None:
        return 0.0
    turning = trace.rotor_hz[trace.rotor_hz > LOWEST_ROTOR_HZ]
    return float(turning.mean()) if len(turning) else 0.0


def line_density(trace: Trace, omega: Array, frequency: float) -> Array:
    """Power (1, K) of a line of amplitude one and mean frequency `frequency` (Hz) while the motors run.

    It is the spectrum of a wave that starts and stops with the motors, skirts included: a strong line shows far from
    its frequency. It follows the rotors if their speed is known. The amplitude is that at the sensor, before the
    firmware's filter.
    """
    power = _line_over_all_bins(trace, frequency)
    n = len(power)
    return np.asarray(np.interp(omega, np.pi * np.arange(n) / n, power), dtype=np.float64)[None]


@remembered(24)
def _line_over_all_bins(trace: Trace, frequency: float) -> Array:
    """Power of the line at all bins of the trace, (N,), cached for the other bands and contrasts of the sensor."""
    speed = mean_speed(trace)
    if speed > 0.0 and trace.rotor_hz is not None:
        track = trace.rotor_hz.mean(axis=1) * (frequency / speed)
        size = (np.maximum(trace.rotor_hz, 0.0).mean(axis=1) / speed) ** 2
    else:
        track, size = np.full(len(trace.t), frequency), np.ones(len(trace.t))
    size = np.where(motors_running(trace), size, 0.0) * filter_gain(np.maximum(track, 1e-3), trace.low_pass_hz)
    phase = 2.0 * np.pi * cumulative_trapezoid(track, dx=1.0 / trace.fs, initial=0.0)
    power = 0.5 * (transform(size * np.cos(phase)) ** 2 + transform(size * np.sin(phase)) ** 2)
    bins = max(3, round(LINE_HZ / (0.5 * trace.fs) * len(power)))
    smooth = uniform_filter1d(power, bins, mode="reflect")
    return np.asarray(np.maximum(smooth, 0.0), dtype=np.float64)  # a running sum leaves -1e-16


def running_envelope(trace: Trace) -> Array:
    """Envelope (N,) of mean one: the rotors' power if known, else whether the motors run."""
    power = rotor_power(trace) if trace.rotor_hz is not None else motors_running(trace).astype(np.float64)
    return _normalised(known(power, "throttle"), trace)


def speed_envelope(trace: Trace) -> Array:
    """Envelope (N,) of mean one for noise whose amplitude grows with the square of the speed, as air loads do."""
    return _normalised(known(rotor_power(trace), "throttle"), trace)


def _normalised(power: Array, trace: Trace) -> Array:
    mean = float(power[trace.observed].mean()) if trace.observed.any() else 0.0
    return power / mean if mean > 0.0 else np.ones_like(power)


def vibration_power(trace: Trace, _theta: float) -> Array:
    """Power of the vibration over time (1, N), one at its maximum."""
    return known(rotor_power(trace), "throttle")[None]


def lines_below_half_rate(trace: Trace) -> Array:
    """Frequencies of lines that sampling does not fold, Hz."""
    speed = mean_speed(trace)
    if speed > 0.0:
        return np.array([h * speed * d for h in _HARMONICS for d in _DETUNED if h * speed < 0.5 * trace.fs])
    return np.arange(_LOWEST, 0.5 * trace.fs - LINE_HZ, 0.5 * LINE_HZ)


def lines_beyond_half_rate(trace: Trace) -> Array:
    """Frequencies of lines that sampling folds, Hz."""
    speed = mean_speed(trace)
    return np.array([h * speed * d for h in _FOLDED for d in _DETUNED if h * speed >= 0.5 * trace.fs])


def strongest_bands(trace: Trace, residual: Array) -> Array:
    """Frequencies of unfolded lines with most power of `residual` (N, 3) above their surroundings, ascending."""
    grid = lines_below_half_rate(trace)
    if mean_speed(trace) > 0.0:
        return grid
    y = np.where(trace.observed[:, None], residual, 0.0)
    power = np.abs(np.fft.rfft(y - y.mean(axis=0), axis=0)) ** 2
    hz = trace.fs / len(y)
    band = uniform_filter1d(power, max(1, round(LINE_HZ / hz)), axis=0)
    around = np.exp(uniform_filter1d(np.log(band + np.finfo(float).tiny), max(3, round(20.0 / hz)), axis=0))
    ratio = (band / around).max(axis=1)[np.minimum((grid / hz).astype(np.intp), len(power) - 1)]
    return np.sort(grid[np.argsort(ratio)[-_CANDIDATES:]])


def rotor_wave(trace: Trace, rotor_order: float) -> Array:
    """Cosine and sine (2, N) of a multiple of one rotor's angle, growing with the square of its speed.

    `rotor_order` is 100 times the rotor's number, from 1, plus the multiple. The firmware's filter is applied at the
    mean frequency.
    """
    rotor, order = divmod(rotor_order, _ROTOR)
    speeds = known(trace.rotor_hz, "rotor speed")
    speed = np.maximum(speeds[:, int(np.clip(rotor, 1, speeds.shape[1])) - 1], 0.0)
    mean = max(float(speed.mean()), np.finfo(float).tiny)
    phase = 2.0 * np.pi * order * cumulative_trapezoid(speed, dx=1.0 / trace.fs, initial=0.0)
    wave = (speed / mean) ** 2 * np.exp(1j * phase)
    if trace.low_pass_hz is not None:
        s = 1j * order * mean / trace.low_pass_hz
        wave = wave / (1.0 + np.sqrt(2.0) * s + s * s)
    return np.stack([wave.real, wave.imag])


def orders_below(trace: Trace) -> Array:
    """Multiples of every rotor's speed that sampling does not fold."""
    return _orders(trace, _HARMONICS, lambda hz: hz < 0.5 * trace.fs)


def orders_beyond(trace: Trace) -> Array:
    """Multiples of every rotor's speed that sampling folds."""
    return _orders(trace, _FOLDED, lambda hz: hz >= 0.5 * trace.fs)


def _orders(trace: Trace, orders: tuple[int, ...], wanted: Callable[[float], bool]) -> Array:
    rotors = known(trace.rotor_hz, "rotor speed").T
    speeds = [float(s[s > LOWEST_ROTOR_HZ].mean()) if (s > LOWEST_ROTOR_HZ).any() else 0.0 for s in rotors]
    found = [_ROTOR * (k + 1) + h for k, s in enumerate(speeds) for h in orders if s > 0.0 and wanted(h * s)]
    return np.array(found, dtype=np.float64)


def _missing_order(grid: Callable[[Trace], Array]) -> Missing:
    def missing(trace: Trace) -> tuple[str, str] | None:
        if trace.rotor_hz is None:
            return "no rotor speed recorded", "rotor speed in the log"
        return None if len(grid(trace)) else ("no multiple of a rotor's speed lies there", "rotors that turn")

    return missing


_PLAIN = {
    "vibration": "vibration of the motors",
    "aliasing": "vibration beyond half the sampling rate, folded back",
}


def _wave_effect(kind: str, sensor: Sensor, grid: Callable[[Trace], Array]) -> CatalogueEffect:
    unit = UNIT[sensor]
    return MeanEffect(
        f"{sensor}_{kind}",
        sensor,
        per_axis("cos", unit) + per_axis("sin", unit),
        "running motors",
        "sweep the rotor speed: an alias moves against it, a tone stays",
        _missing_order(grid),
        EffectShape(EffectParameter("rotor_order", "100 rotor + order"), grid),
        columns=axiswise(rotor_wave),
        signals=rotor_wave,
        rivals=(f"{sensor}_tone", f"{sensor}_rotor_noise"),
        repeatable=True,
        form="~wave",
        plain=_PLAIN[kind],
        traits=frozenset({Trait.LINE}),
    )


def _missing_motors(trace: Trace) -> tuple[str, str] | None:
    if rotor_power(trace) is None:
        return _TELEMETRY
    return None if motors_running(trace)[trace.observed].any() else ("the motors never run", "motors on")


def _missing_power_variation(trace: Trace) -> tuple[str, str] | None:
    power = rotor_power(trace)
    if power is None:
        return _TELEMETRY
    size = float(power[trace.observed].std()) if trace.observed.any() else 0.0
    if size >= _LEAST_VARIATION:
        return None
    return f"the rotors' power varies by {100.0 * size:.0f} % of its maximum", f"a variation >= 10 %: {_THROTTLE}"


def _missing_line(trace: Trace) -> tuple[str, str] | None:
    if (lack := _missing_motors(trace)) is not None or len(lines_below_half_rate(trace)):
        return lack
    half = f"half the sampling rate, {0.5 * trace.fs:.0f} Hz"
    if mean_speed(trace) == 0.0:
        return f"{half}, lies below any vibration", "faster logging"
    return f"the rotors turn at {mean_speed(trace):.0f} Hz, beyond {half}", "faster logging"


def _missing_folded_line(trace: Trace) -> tuple[str, str] | None:
    if trace.rotor_hz is None:
        return "no rotor speed recorded", "rotor speed in the log"
    if mean_speed(trace) == 0.0:
        return "the rotors never turn", "motors on"
    if not len(lines_beyond_half_rate(trace)):
        highest = _FOLDED[-1] * mean_speed(trace)
        return f"harmonics up to {highest:.0f} Hz lie below half the sampling rate", "slower logging"
    return None


def _line_effect(
    kind: str, sensor: Sensor, grid: Callable[[Trace], Array], missing: Missing, rivals: tuple[str, ...]
) -> CatalogueEffect:
    screen = strongest_bands if kind == "vibration" else None
    return NoiseEffect(
        f"{sensor}_{kind}",
        sensor,
        per_axis("amplitude", UNIT[sensor], squared=True),
        "running motors",
        "sweep the rotor speed: an alias moves against it, a tone stays",
        missing,
        EffectShape(EffectParameter("frequency_hz", "Hz"), grid, screen),
        density=line_density,
        variance=running_envelope,
        rivals=tuple(f"{sensor}_{rival}" for rival in rivals),
        plain=_PLAIN[kind],
        traits=frozenset({Trait.LINE}),
    )


def _effects_of(sensor: Sensor) -> tuple[CatalogueEffect, ...]:
    noise = NoiseEffect(
        f"{sensor}_rotor_noise",
        sensor,
        per_axis("density", f"{UNIT[sensor]}/sqrt(Hz)", squared=True),
        "rotor speeds that vary",
        "a minute at rest with the motors off, and one with them on",
        _missing_power_variation,
        density=white_density,
        variance=speed_envelope,
        plain="noise that follows the rotors",
        rivals=(f"{sensor}_noise", *((f"{sensor}_vibration",) if sensor in INERTIAL else ())),
        traits=frozenset({Trait.BROADBAND}),
    )
    if sensor not in INERTIAL:
        return (noise,)
    return (
        _wave_effect("vibration", sensor, orders_below),
        _wave_effect("aliasing", sensor, orders_beyond),
        _line_effect("vibration", sensor, lines_below_half_rate, _missing_line, ("tone", "aliasing", "rotor_noise")),
        _line_effect(
            "aliasing", sensor, lines_beyond_half_rate, _missing_folded_line, ("vibration", "tone", "rotor_noise")
        ),
        noise,
        MeanEffect(
            f"{sensor}_vibration_rectification",
            sensor,
            per_axis("shift", UNIT[sensor]),
            "vibration that comes and goes",
            _THROTTLE,
            _missing_power_variation,
            columns=axiswise(vibration_power),
            signals=vibration_power,
            plain="an offset caused by vibration",
            rivals=(f"{sensor}_bias", f"{sensor}_step"),
            traits=frozenset({Trait.LEVEL}),
        ),
    )


EFFECTS: tuple[CatalogueEffect, ...] = tuple(effect for sensor in TRIADS for effect in _effects_of(sensor))
