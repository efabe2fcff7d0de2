"""Effects of magnetometers: iron on the vehicle, currents, and the local field.

``measured = (I + S) B_b + h + c I`` with ``B_b = R_bn (B_n + dB + G (p - p_0))``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects.affine import constant
from mavcal.calib.gap.effects.base import CatalogueEffect, EffectParameter, EffectShape, MeanEffect, Missing
from mavcal.calib.gap.effects.parts import (
    TUMBLE,
    axiswise,
    body_from_ned,
    first_missing,
    missing_movement,
    per_axis,
    spread,
)
from mavcal.calib.gap.effects.traits import SensorTerm, Trait
from mavcal.calib.gap.problem import Trace, known
from mavcal.calib.gap.reference.channels import TELLING_CURRENT
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

SYMMETRIC = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Row and column of a symmetric matrix' elements, in the order of their names."""
_SYMMETRIC_NAMES = ("xx", "yy", "zz", "xy", "xz", "yz")
_LEAST_THROTTLE = 0.05
"""Standard deviation of the throttle, 0..1, above which its field shows. Chosen, not measured: 5 % of full throttle,
beyond the jitter of a hover."""
_LEAST_PATH = 0.3
"""Standard deviation of the place along its widest direction, m. Chosen, not measured: a gradient of 1 uT/m then shows
0.3 uT."""
_NED = "ned"
_LONGEST_LAG = 0.3
"""Longest lag between current and field, s. Chosen, not measured: current monitors filter over tenths of a second."""
_LAGS = 25
"""Lags that are tried, early and late. Chosen, not measured: steps of 25 ms up to `_LONGEST_LAG` on either side."""

# A gradient of a field without sources in the volume is symmetric (no curl) and has no trace (no divergence).
GRADIENT = (
    np.array([[1.0, 0, 0], [0, 0, 0], [0, 0, -1.0]]),
    np.array([[0.0, 0, 0], [0, 1.0, 0], [0, 0, -1.0]]),
    np.array([[0.0, 1.0, 0], [1.0, 0, 0], [0, 0, 0]]),
    np.array([[0.0, 0, 1.0], [0, 0, 0], [1.0, 0, 0]]),
    np.array([[0.0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]]),
)
_GRADIENT_NAMES = ("nn", "ee", "ne", "nd", "ed")


def soft_iron_columns(trace: Trace, _theta: float) -> Array:
    """The six elements of a symmetric matrix."""
    columns = np.zeros((6, *trace.ideal.shape))
    for j, (row, column) in enumerate(SYMMETRIC):
        columns[j, :, row] = trace.ideal[:, column]
        columns[j, :, column] = trace.ideal[:, row]
    return columns


def current_signal(trace: Trace, _theta: float) -> Array:
    """The current in A, (1, N)."""
    return known(trace.current, "current")[None, :]


def lagged_current_signal(trace: Trace, lag: float) -> Array:
    """The current `lag` seconds earlier, A, (1, N).

    A compass averages over its interval, a current monitor filters, and both are logged at their own times.
    """
    return np.interp(trace.t - lag, trace.t, known(trace.current, "current"))[None, :]


def throttle_signal(trace: Trace, exponent: float) -> Array:
    """A power of the throttle 0..1, (1, N), for vehicles without a good current monitor (ArduPilot's COMPASS_MOTCT 1).

    A propeller's current grows with the 1.5th power of its thrust; the firmware sets the relation of throttle and
    thrust.
    """
    return np.maximum(known(trace.throttle, "throttle"), 0.0)[None, :] ** exponent


def exponents(_trace: Trace) -> Array:
    """Powers of the throttle to try."""
    return np.linspace(0.5, 3.0, 11)


def lags(_trace: Trace) -> Array:
    """Lags to try, s."""
    return np.linspace(-_LONGEST_LAG, _LONGEST_LAG, _LAGS)


def earth_columns(trace: Trace, _theta: float) -> Array:
    """North, east and down in body axes."""
    return np.ascontiguousarray(body_from_ned(known(trace.attitude, "attitude")).transpose(2, 0, 1))


def gradient_columns(trace: Trace, _theta: float) -> Array:
    """The five fields of a uniform gradient about the mean position, in body axes."""
    place = known(trace.place, "position")
    path = place - place[trace.observed].mean(axis=0)
    turn = body_from_ned(known(trace.attitude, "attitude"))
    return np.stack([np.einsum("nij,nj->ni", turn, path @ g.T) for g in GRADIENT])


def _missing_current(trace: Trace) -> tuple[str, str] | None:
    if trace.current is None:
        return "no current recorded", "a current monitor in the log, currents that vary by >= 0.5 A"
    size = spread(trace.current[:, None], trace.observed)
    if size < TELLING_CURRENT:
        return f"current varies by {size:.2g} A", "a variation >= 0.5 A: throttle 0-hover-0"
    return None


def _missing_throttle(trace: Trace) -> tuple[str, str] | None:
    if trace.throttle is None:
        return "no current and no throttle recorded", "a current monitor in the log, currents that vary by >= 0.5 A"
    size = spread(trace.throttle[:, None], trace.observed)
    if size < _LEAST_THROTTLE:
        return f"throttle varies by {100.0 * size:.2g} %", "a variation >= 5 %: throttle 0-hover-0"
    return None


def _missing_attitude(trace: Trace) -> tuple[str, str] | None:
    return None if trace.attitude is not None else ("attitude unknown", "a reference attitude")


def _missing_path(trace: Trace) -> tuple[str, str] | None:
    if trace.place is None:
        return "position unknown", "a reference position over a path of a metre or more"
    size = spread(trace.place, trace.observed)
    if size < _LEAST_PATH:
        return f"position varies by {size:.2g} m", "a variation >= 0.3 m"
    return None


def _motor_current(
    form: str,
    parameters: tuple[EffectParameter, ...],
    excited_by: str,
    missing: Missing,
    signals: Callable[[Trace, float], Array],
    shape: EffectShape | None = None,
) -> CatalogueEffect:
    """The field of the motors' current, in proportion to one signal: the current, or a substitute."""
    return MeanEffect(
        "mag_motor_current",
        Sensor.MAG,
        parameters,
        excited_by,
        "throttle 0-hover-0 twice at one attitude",
        missing,
        shape,
        columns=axiswise(signals),
        signals=signals,
        plain="the magnetic field of the motors' current",
        rivals=("mag_hard_iron", "mag_step"),
        form=form,
        traits=frozenset({Trait.LEVEL}),
    )


_ATTITUDES = "attitudes about all three axes"
_CURRENTS = "currents that vary"
_PER_AMPERE = per_axis("per_ampere", "uT/A")
_FULL_THROTTLE = per_axis("full_throttle", "uT")
_LAG = EffectShape(EffectParameter("lag_s", "s"), lags)
_EXPONENT = EffectShape(EffectParameter("exponent", "1"), exponents)

# The form with more parameters comes first: a report that has them all is replayed with it.
EFFECTS: tuple[CatalogueEffect, ...] = (
    MeanEffect(
        "mag_hard_iron",
        Sensor.MAG,
        per_axis("hard_iron", "uT"),
        "any movement, rest included",
        f"{TUMBLE}; throttle 0-hover-0 twice at one attitude",
        columns=axiswise(constant),
        signals=constant,
        plain="magnetised iron on the vehicle",
        rivals=("mag_soft_iron", "mag_motor_current", "mag_earth_field"),
        traits=frozenset({Trait.STEADY, Trait.LEVEL}),
        term=SensorTerm.HARD_IRON,
    ),
    MeanEffect(
        "mag_soft_iron",
        Sensor.MAG,
        tuple(EffectParameter(f"soft_iron.{name}", "1") for name in _SYMMETRIC_NAMES),
        _ATTITUDES,
        TUMBLE,
        missing_movement(Sensor.MAG),
        columns=soft_iron_columns,
        plain="iron that bends the field",
        rivals=("mag_hard_iron", "mag_rotation", "mag_temp_scale"),
        traits=frozenset({Trait.STEADY, Trait.SIZE}),
        term=SensorTerm.SOFT_IRON,
    ),
    _motor_current("~late", _PER_AMPERE, _CURRENTS, _missing_current, lagged_current_signal, _LAG),
    _motor_current("~throttle", _FULL_THROTTLE, "throttle that varies", _missing_throttle, throttle_signal, _EXPONENT),
    _motor_current("", _PER_AMPERE, _CURRENTS, _missing_current, current_signal),
    MeanEffect(
        "mag_earth_field",
        Sensor.MAG,
        tuple(EffectParameter(f"earth_field.{axis}", "uT") for axis in _NED),
        _ATTITUDES,
        f"{TUMBLE}; the same with the sensor turned by 180 degrees in its mounting",
        first_missing((_missing_attitude, missing_movement(Sensor.MAG))),
        columns=earth_columns,
        plain="another field of the Earth than assumed",
        rivals=("mag_rotation", "mag_hard_iron", "mag_soft_iron"),
        traits=frozenset({Trait.STEADY, Trait.SIZE, Trait.OUTSIDE}),
    ),
    MeanEffect(
        "mag_field_gradient",
        Sensor.MAG,
        tuple(EffectParameter(f"gradient.{name}", "uT/m") for name in _GRADIENT_NAMES),
        "a path through the place",
        "fly the same path at two headings, and again elsewhere",
        first_missing((_missing_attitude, _missing_path)),
        columns=gradient_columns,
        plain="a field that changes with the place",
        rivals=("mag_hard_iron", "mag_earth_field", "mag_random_walk"),
        traits=frozenset({Trait.OUTSIDE}),
    ),
)
