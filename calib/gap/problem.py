"""The problem of a diagnosis: every sensor beside what an ideal one would have read at the same times.

References are made by :mod:`calib.gap.reference`. From here on only :class:`ReferenceInfo` tells their origin and
accuracy.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import UndeterminedError
from mavcal.calib.gap.schema import RE_ESTIMATED, EffectEstimate, is_useless
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]
UNIT = {Sensor.ACCEL: "m/s2", Sensor.GYRO: "rad/s", Sensor.MAG: "uT"}
"""Unit of the readings of each sensor."""


class UnknownQuantityError(UndeterminedError):
    """An effect follows a quantity that is not known for this sensor."""


class ReferenceKind(StrEnum):
    """Where the ideal readings come from, best first (GAP 3.5b)."""

    REDUNDANT = "redundant"  # another instance on the same vehicle: measured minus measured, free of attitude
    SIM = "sim"  # ref_* columns, a simulator's log of the same trajectory, or the truth in a simulator's log
    POSE = "pose"  # an ideal sensor driven by a reference pose
    ESTIMATOR = RE_ESTIMATED  # an ideal sensor driven by a trajectory that was re-estimated from the recording itself
    NOMINAL = "nominal"  # a simulator's log of another flight: both are compared with an ideal sensor


@dataclass(frozen=True)
class ReferenceInfo:
    """How far a reference can be believed.

    Parameters
    ----------
    kind
        Where it comes from.
    att_sigma_deg
        Standard deviation of its attitude, degrees; 0 where the attitude is exact or does not matter.
    att_time_s
        Correlation time of that error, s.
    text
        One sentence for the report.
    bandwidth_hz
        Bandwidth of its acceleration; above, an accelerometer measures more than it contains.
    turns_hz
        Bandwidth of its rotation, for a gyroscope.
    gyro_sd, field_sd, accel_sd
        Standard deviations of quantities estimated inside the reference: the gyroscope's matrix by rows (9), the
        Earth's field north, east, down (3), uT, and the accelerometer's scales (3). Empty if not estimated.
    """

    kind: ReferenceKind
    att_sigma_deg: float = 0.0
    att_time_s: float = 5.0
    text: str = ""
    bandwidth_hz: float = math.inf
    turns_hz: float = math.inf
    gyro_sd: tuple[float, ...] = ()
    field_sd: tuple[float, ...] = ()
    accel_sd: tuple[float, ...] = ()

    @property
    def useless(self) -> bool:
        """Whether the attitude is too inaccurate to judge any sensor by it."""
        return is_useless(self.kind.value, self.att_sigma_deg)


@dataclass(frozen=True, eq=False)
class Trace:
    """One sensor against its reference on a uniform grid at its own rate.

    Parameters
    ----------
    sensor
        ACCEL, GYRO or MAG.
    instances
        The instance; several if the trace is what they have in common.
    t : shape (N,)
        Uniform, s. A hole in the recording is a stretch where `observed` is False.
    measured, ideal : shape (N, 3)
        What the sensor read, and what an ideal one would have read, in the sensor's frame, SI units or uT. With a
        redundant reference `ideal` is the other instance's reading, and `against` names it.
    observed : shape (N,)
        False where there is no sample (both arrays then hold finite fill values).
    force, rate, spin, field : shape (N, 3)
        Ideal specific force (m/s2), angular rate (rad/s), its derivative (rad/s2) and magnetic field (uT) in the body
        at these times; NaN columns nowhere: where one is unknown the attribute is None.
    attitude : shape (N, 4) or None
        Body to north-east-down, w x y z.
    place : shape (N, 3) or None
        North, east, down of a local origin, m.
    temperature, current, throttle : shape (N,) or None
        degC, A, 0..1, interpolated to `t`.
    motors, rotor_hz : shape (N, m) or None
        0..1; Hz.
    sigma : shape (3,) or None
        Declared white noise of one sample, of reference and sensor together (a simulator's own noise). None: to be
        learned from a nominal recording or from the data.
    sigma_dof
        Degrees of freedom per axis from which `sigma` was estimated; infinite if it is exact.
    low_pass_hz
        Cut-off of the firmware's two-pole filter that was applied to `measured`; None: not filtered, or not known.
        Tones and noise of the sensor were larger before it.
    quantum
        Width of a quantisation bin, 0 for none.
    psd : shape (K, 3) or None
        Power spectral density per DCT bin learned from nominal recordings, in units of variance of one sample, on
        `psd_hz` (K,): all of the noise, `sigma` included.
    own_psd : shape (K, 3) or None
        The same without the error of the reference: the sensor's own noise, learned from the differences of instances
        in nominal recordings. Where it is known, `sigma` is of that noise alone.
    ideal_sd
        Standard deviation of the noise in `ideal`, of its noisiest axis; 0 where it is exact, or not known.
    unit_sd
        Standard deviation of the noise in `ideal` that comes from an inertial unit inside the reference; 0: none does.
        That noise is in the residual too, with the other sign.
    rate_known
        Whether the reference follows fast changes of the reading; False: only its level.
    """

    sensor: Sensor
    instances: tuple[int, ...]
    t: Array
    measured: Array
    ideal: Array
    observed: NDArray[np.bool_]
    force: Array | None = None
    rate: Array | None = None
    spin: Array | None = None
    field: Array | None = None
    attitude: Array | None = None
    temperature: Array | None = None
    current: Array | None = None
    throttle: Array | None = None
    motors: Array | None = None
    rotor_hz: Array | None = None
    sigma: Array | None = None
    quantum: float = 0.0
    psd: Array | None = None
    psd_hz: Array | None = None
    against: int | None = None
    place: Array | None = None
    sigma_dof: float = math.inf
    low_pass_hz: float | None = None
    own_psd: Array | None = None
    rate_known: bool = True
    ideal_sd: float = 0.0
    unit_sd: float = 0.0

    @cached_property
    def fs(self) -> float:
        """Samples per second."""
        return 1.0 / float(np.median(np.diff(self.t)))

    @cached_property
    def largest(self) -> float:
        """The largest reading on any axis."""
        return float(np.abs(self.measured).max())

    @property
    def residual(self) -> Array:
        """Measured minus ideal, shape (N, 3)."""
        return self.measured - self.ideal

    @property
    def unit(self) -> str:
        """Unit of the readings."""
        return UNIT[self.sensor]


@dataclass(frozen=True)
class FaultyInstances:
    """Which of two instances have an error: `slow`, against their common reference, and in fast bands. None: undecided.

    `certain`: the slow part was measured where the reference has no error, and overrules the likelihood of the other
    parts.
    """

    slow: tuple[int, ...] | None = None
    fast: tuple[int, ...] | None = None
    certain: bool = False


@dataclass(frozen=True)
class MinimumGain:
    """Minimum gains by sensor, in twice the log-likelihood, above the usual difference of two recordings.

    An effect may gain enough to enter the model but too little to be reported. It then stays in the model, so that no
    other effect absorbs it.

    Parameters
    ----------
    steady_entry, steady_report
        Of steady effects on the mean: to enter the model, to be reported.
    level
        Of level shifts and events.
    noise_entry, noise_report
        Of noise: to enter the model, to be reported.
    drift_entry
        Of drift noise and noise that follows the flight, to enter the model: changes of the mean look like them.
    """

    steady_entry: Mapping[Sensor, float] = field(default_factory=dict)
    steady_report: Mapping[Sensor, float] = field(default_factory=dict)
    level: Mapping[Sensor, float] = field(default_factory=dict)
    noise_entry: Mapping[Sensor, float] = field(default_factory=dict)
    noise_report: Mapping[Sensor, float] = field(default_factory=dict)
    drift_entry: Mapping[Sensor, float] = field(default_factory=dict)


@dataclass(frozen=True)
class NuisanceEffect:
    """An effect that another recording shows against its own reference, and the share of it that is uncertain here."""

    effect: EffectEstimate
    uncertain_share: float


@dataclass(frozen=True, eq=False)
class GapProblem:
    """The traces of a diagnosis with their reference, and notices about them."""

    traces: tuple[Trace, ...]
    reference: ReferenceInfo
    duration_s: float
    inputs: dict[str, str] = field(default_factory=dict)
    """sha256 of the files by role."""
    warnings: tuple[str, ...] = ()
    not_testable: tuple[tuple[str, str, str], ...] = ()
    """Effects that the recordings cannot test: id, reason, need."""
    nominal: tuple[Trace, ...] = ()
    """Sensors of recordings without an effect; an effect in the samples of both is not a gap."""
    minimum_gain: MinimumGain = field(default_factory=MinimumGain)
    nuisance: tuple[NuisanceEffect, ...] = ()
    """Effects that another recording shows against its own reference."""
    alone: bool = False
    """Whether a re-estimated trajectory is the only reference, without a simulated or a nominal recording beside it."""
    own_attitude: tuple[Array, Array] | None = None
    """The attitude that the vehicle logged: times (K,), s, and quaternions (K, 4), continuous; None: it logged none."""
    companion: tuple[Trace, ...] = ()
    """The simulator's flight, with its own effects in the ideal reading; effects that it shows too are not a gap."""
    worse: dict[Sensor, FaultyInstances] = field(default_factory=dict)
    """By sensor with two instances, which of them have an error."""


def known(quantity: Array | None, name: str) -> Array:
    """`quantity` of a trace.

    Raises
    ------
    UnknownQuantityError
        If it is None; `name` says which.
    """
    if quantity is None:
        raise UnknownQuantityError(
            f"the {name} is not known", remedy=f"record the {name}, or give a reference that has it"
        )
    return quantity
