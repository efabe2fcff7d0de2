"""Traces of a recording beside its references, with the noise learned from its companions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import IncomparableError, InvalidInputError
from mavcal.calib.gap.problem import FaultyInstances, GapProblem, ReferenceInfo, ReferenceKind, Trace
from mavcal.calib.gap.reference.best_reference import BestReferences, best_references, refusals
from mavcal.calib.gap.reference.channels import (
    SAME_RATE,
    as_slow_as,
    as_uneven_as,
    corrected,
    not_undone,
    offset_changed,
    sensors_of,
)
from mavcal.calib.gap.reference.checks import Checked, Refusal, check_vehicles, checked, fragmented
from mavcal.calib.gap.reference.expected_noise import (
    age_noise_of,
    age_of,
    motor_noise_of,
    movement_of,
    with_age_noise,
    with_aged_noise,
    with_heave_noise,
    with_motor_noise,
    with_movement_noise,
    with_sway_noise,
    without_aged_samples,
)
from mavcal.calib.gap.reference.ideal import Ideal, continuous, trace_of, with_unit_noise
from mavcal.calib.gap.reference.noise import ResidualSpectrum, learned_spectrum, pooled, with_noise
from mavcal.calib.gap.reference.redundant import differences, faulty_instances_of
from mavcal.calib.gap.reference.resolution import steps_of, with_simulated_step
from mavcal.calib.gap.reference.signals import Signal
from mavcal.calib.gap.reference.simulator import error_sd, mean_deviations, with_reference_error, with_simulated_offset
from mavcal.calib.recording import Channel, Recording, Sensor

Array = NDArray[np.float64]

_NO_REFERENCE = "nothing says what an ideal sensor would have read"
_NEED = (
    "add ref_* or q_* columns, give --sim of the same trajectory, or a log with GPS velocity, or with several "
    "instances of a sensor"
)
_NO_OVERLAP = "the recording and its reference have no sensor in common, or do not overlap in time: check their clocks"
_FAST_HZ = 100.0
"""Rate, Hz, of a gyroscope above which turns between samples are hardly more than noise. Chosen, not measured: ten
times the 10 Hz up to which a vehicle moves as a whole."""
_OTHER = "the simulator's or a nominal recording"
_REDUNDANT = "The instances of the vehicle are compared with each other."


def build(
    real: Recording,
    sim: Recording | None = None,
    nominal: Sequence[Recording] = (),
    *,
    nuisance: Callable[[Sequence[Trace]], tuple[Trace, ...]] = tuple,
    companion: Recording | None = None,
) -> GapProblem:
    """Every sensor of `real` beside its best reference.

    Parameters
    ----------
    real
        The recording whose gap is asked for.
    sim
        A simulator's recording of the same trajectory, or of another flight of the same kind.
    nominal
        Recordings without an effect, from which the noise and the Earth's field are learned.
    nuisance
        Adds known effects to the ideal readings of a companion's traces, so that they do not count as noise.
    companion
        The companion with these effects: `sim` or one of `nominal`; None: none.

    Raises
    ------
    IncomparableError
        If `real` has no sensor, or nothing to compare it with.
    InvalidInputError
        If the recordings have nothing in common.
    """
    return prepared(real, sim, nominal).problem(nuisance, companion)


@dataclass(frozen=True, eq=False)
class PreparedProblem:
    """Every sensor beside its reference, before noise is learned.

    `single` and `pairs` are the traces of the real recording against the reference and against each other; `judged`
    those of each of the `companions`, in order, empty if none has a reference. `refused` are sensors of the recording
    that cannot be compared with anything.
    """

    real: Recording
    sim: Recording | None
    companions: tuple[Recording, ...]
    channels: tuple[Channel, ...]
    chosen: BestReferences | None
    single: tuple[Trace, ...]
    pairs: tuple[Trace, ...]
    judged: tuple[tuple[Recording, Checked], ...]
    worse: dict[Sensor, FaultyInstances]
    refused: tuple[Refusal, ...] = ()

    def problem(
        self,
        nuisance: Callable[[Sequence[Trace]], tuple[Trace, ...]] = tuple,
        companion: Recording | None = None,
    ) -> GapProblem:
        """The problem with the noise of the companions beside `nuisance`; parameters as in :func:`build`."""
        chosen, channels = self.chosen, self.channels
        useless = chosen is not None and chosen.ideal.info.useless
        of_readings = {} if chosen is None or useless else chosen.ideal.noise
        sim, single, pairs, judged = self.sim, self.single, self.pairs, list(self.judged)
        if companion is not None and judged:
            known = (c is companion for c in self.companions)
            judged = [
                (n, replace(f, traces=nuisance(f.traces)) if k else f) for (n, f), k in zip(judged, known, strict=True)
            ]
        ages = ages_of([t for _, found in judged for t in found.traces])
        clean = [(n, tuple(_without_old_samples(t, ages) for t in found.traces)) for n, found in judged]
        info = _reference_info(chosen)
        steps = steps_of(c for n, _ in clean for c in sensors_of(n))
        total, own = noise_of([trace for n, traces in clean for trace in traces if n is not sim or not of_readings])
        total |= {s: with_reference_error(total[s], noise) if s in total else noise for s, noise in of_readings.items()}
        offsets = mean_deviations([t for n, traces in clean if n is sim for t in traces if t.against is None])
        sound = checked(single + pairs)
        rounded = [with_simulated_step(t, steps.get(t.sensor, 0.0)) for t in sound.traces]
        total = _at_same_rate(total, of_readings, sound.traces)
        rounded = [replace(t, ideal_sd=error_sd(n)) if (n := of_readings.get(t.sensor)) else t for t in rounded]
        rounded = [with_unit_noise(t, info) for t in rounded]
        companion_traces = [trace for _, its in clean for trace in its]
        noisy = [with_noise(_without_old_samples(t, ages), total.get(t.sensor), own.get(t.sensor)) for t in rounded]
        driven = motor_noise_of(companion_traces)
        posed, single_nominal = info.kind is ReferenceKind.POSE, [t for t in companion_traces if t.against is None]
        moved = movement_of(single_nominal) if posed else {}
        noisy = [with_motor_noise(_with_more_noise(t, ages, companion_traces), driven) for t in noisy]
        aged = {} if posed else age_noise_of(companion_traces)
        noisy = [with_aged_noise(with_movement_noise(t, moved), aged) for t in noisy]
        traces = tuple(with_simulated_offset(with_heave_noise(t, info), offsets) for t in noisy)
        warnings = (
            *not_undone(channels, self.real),
            *offset_changed(channels, self.real),
            *(() if chosen is None else chosen.ideal.warnings),
            *(reason for _, reason, _ in (*self.refused, *sound.refused)),
            *dict.fromkeys(
                f"nothing was learned of {r[0]} from {_OTHER}: {r[1]}" for _, f in judged for r in f.refused
            ),
        )
        duration = max((float(t.t[-1] - t.t[0]) for t in single + pairs), default=_span(channels))
        refused = (*(refusals(info, (c.sensor for c in channels)) if useless else ()), *self.refused, *sound.refused)
        alone = info.kind is ReferenceKind.ESTIMATOR and not self.companions
        return GapProblem(
            *(traces, info, duration),
            warnings=warnings,
            not_testable=refused,
            nominal=tuple(single_nominal),
            worse=self.worse,
            alone=alone,
            own_attitude=_logged_attitude(self.real) if alone else None,
        )


def prepared(real: Recording, sim: Recording | None = None, nominal: Sequence[Recording] = ()) -> PreparedProblem:
    """The part of :func:`build` that does not depend on nuisance effects; same parameters and errors."""
    companions = (*nominal, *(() if sim is None else (sim,)))
    given, real = real, corrected(real)
    sim = None if sim is None else real if sim is given else corrected(sim)
    check_vehicles(real, companions)
    if sim is not None and sim is not real:
        real = as_uneven_as(real, sim)
    real, fragments = _without_fragmented(real)
    channels = sensors_of(real)
    if fragments and not channels:
        raise IncomparableError(fragments[0][1], need=fragments[0][2])
    if not channels:
        raise IncomparableError(
            "the recording has no accelerometer, gyroscope or magnetometer", need="a log of the sensors' own samples"
        )
    chosen = best_references(real, sim, [corrected(n) for n in nominal])
    useless = chosen is not None and chosen.ideal.info.useless
    ideal = None if chosen is None or useless else chosen.ideal
    single = () if ideal is None else single_traces(real, channels, ideal)
    pairs = differences(real, ideal, single)
    worse = faulty_instances_of(single, _simulator_traces(sim, chosen), _tilt_sd(chosen))
    single = informative(single, pairs)
    if not single and not pairs and not useless:
        raise InvalidInputError(_NO_OVERLAP) if ideal is not None else IncomparableError(_NO_REFERENCE, need=_NEED)
    judged = () if chosen is None else tuple((n, nominal_traces(as_slow_as(n, real), its)) for n, its in chosen.nominal)
    return PreparedProblem(real, sim, companions, tuple(channels), chosen, single, pairs, judged, worse, fragments)


def _without_fragmented(real: Recording) -> tuple[Recording, tuple[Refusal, ...]]:
    """The recording without fragmented channels, and why these are refused."""
    found = {c.key: why for c in sensors_of(real) if (why := fragmented(c)) is not None}
    if not found:
        return real, ()
    return real.with_channels(c for c in real.channels if c.key not in found), tuple(found.values())


def _logged_attitude(real: Recording) -> tuple[Array, Array] | None:
    """The longest attitude that the vehicle logged."""
    found = (s for c in real.find(Sensor.ATTITUDE) if (s := Signal.of(c)) is not None)
    best = max(found, key=lambda s: float(s.t[-1] - s.t[0]), default=None)
    return None if best is None else (best.t, continuous(best.values))


def _tilt_sd(chosen: BestReferences | None) -> float:
    """Standard deviation of a re-estimated attitude about an axis, rad; 0 for any other reference."""
    if chosen is None or chosen.ideal.info.kind is not ReferenceKind.ESTIMATOR:
        return 0.0
    return math.radians(chosen.ideal.info.att_sigma_deg)


def _reference_info(chosen: BestReferences | None) -> ReferenceInfo:
    """Description of the reference; a useless one has no bandwidth, since nothing is judged by it."""
    if chosen is None:
        return ReferenceInfo(ReferenceKind.REDUNDANT, text=_REDUNDANT)
    info = chosen.ideal.info
    return replace(info, bandwidth_hz=math.inf) if info.useless else info


def _span(channels: Sequence[Channel]) -> float:
    return max((float(c.t[-1] - c.t[0]) for c in channels if len(c)), default=0.0)


def ages_of(nominal: Sequence[Trace]) -> dict[Sensor, float]:
    """Variance of the age of samples, for each sensor that is judged by differences only; nonzero ones."""
    alone = {t.sensor for t in nominal} - {t.sensor for t in nominal if t.against is None}
    found = {s: age_of([t for t in nominal if t.sensor is s]) for s in alone}
    return {sensor: age for sensor, age in found.items() if age > 0.0}


def _simulator_traces(sim: Recording | None, chosen: BestReferences | None) -> tuple[Trace, ...]:
    """Each instance of a simulator's recording against its own reference, if it has one."""
    own = None if chosen is None else next((its for n, its in chosen.nominal if n is sim), None)
    return () if sim is None or own is None else single_traces(sim, sensors_of(sim), own)


def _without_old_samples(trace: Trace, ages: Mapping[Sensor, float]) -> Trace:
    age = ages.get(trace.sensor) if trace.against is not None else None
    return trace if age is None else without_aged_samples(trace, age)


def _with_more_noise(trace: Trace, ages: Mapping[Sensor, float], nominal: Sequence[Trace]) -> Trace:
    if trace.against is None:
        return trace
    same_sensor = [t for t in nominal if t.sensor is trace.sensor]
    age = ages.get(trace.sensor)
    if age is not None:
        return with_age_noise(trace, age, same_sensor)
    if trace.sensor is Sensor.MAG:
        return trace
    return with_sway_noise(trace, [t for t in same_sensor if t.against is not None])


def _at_same_rate(
    total: dict[Sensor, ResidualSpectrum], of_readings: Mapping[Sensor, ResidualSpectrum], traces: Sequence[Trace]
) -> dict[Sensor, ResidualSpectrum]:
    """Learned noise without sensors of another rate, whose readings may be averaged or decimated."""
    rates = {t.sensor: t.fs for t in traces}
    other = {s for s, n in of_readings.items() if s in rates and abs(math.log(rates[s] / n.fs)) > SAME_RATE}
    return {s: noise for s, noise in total.items() if s not in other}


def informative(single: tuple[Trace, ...], pairs: tuple[Trace, ...]) -> tuple[Trace, ...]:
    """Traces without gyroscopes whose reference was interpolated from their own few samples, if a difference exists."""
    paired = {pair.sensor for pair in pairs}
    return tuple(t for t in single if t.rate_known or t.sensor is not Sensor.GYRO or t.sensor not in paired)


def nominal_traces(recording: Recording, ideal: Ideal | None) -> Checked:
    """The usable traces of a nominal recording, against the reference and of instances against each other."""
    single = () if ideal is None else single_traces(recording, sensors_of(recording), ideal)
    pairs = differences(recording, ideal, single)
    return checked(informative(single, pairs) + pairs)


def noise_of(nominal: Sequence[Trace]) -> tuple[dict[Sensor, ResidualSpectrum], dict[Sensor, ResidualSpectrum]]:
    """Learned noise by sensor: against the reference, and of instances against each other."""
    total: dict[Sensor, list[ResidualSpectrum]] = {}
    own: dict[Sensor, list[ResidualSpectrum]] = {}
    for trace in nominal:
        if (noise := learned_spectrum(trace)) is not None:
            (total if trace.against is None else own).setdefault(trace.sensor, []).append(noise)
    return {s: pooled(n) for s, n in total.items()}, {s: pooled(n) for s, n in own.items()}


def single_traces(real: Recording, channels: list[Channel], ideal: Ideal) -> tuple[Trace, ...]:
    """Each of `channels` beside the ideal reading of its kind, if known."""
    made = [trace_of(c, ideal.readings[c.sensor], ideal, real) for c in channels if c.sensor in ideal.readings]
    return tuple(replace(t, rate_known=_rate_known(t, ideal.info)) for t in made if t.observed.sum() > 1)


def _rate_known(trace: Trace, reference: ReferenceInfo) -> bool:
    """Whether the reference follows fast changes: forces up to its bandwidth, turns at the gyroscope's log rate."""
    if math.isinf(reference.bandwidth_hz) or trace.sensor is Sensor.MAG:
        return True
    return trace.sensor is Sensor.GYRO and trace.fs > _FAST_HZ
