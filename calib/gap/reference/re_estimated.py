"""Ideal sensors along a trajectory that is re-estimated from the recording itself (GAP 3.5b).

The logged attitude was made from the sensors under test and hides their errors; it is only the initial value.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.spatial.transform import Rotation

from mavcal.calib.earth import earth_field
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.gap.problem import ReferenceInfo, ReferenceKind
from mavcal.calib.gap.reference.channels import TELLING_CURRENT, filter_delay, filter_in_force, sensors_of
from mavcal.calib.gap.reference.ideal import Ideal, continuous, true_attitude
from mavcal.calib.gap.reference.posed import GRAVITY_NED, rotation
from mavcal.calib.gap.reference.signals import Signal, interpolated, slow_values
from mavcal.calib.gap.reference.strapdown import STEPS, Increments, IntervalMotion
from mavcal.calib.gap.reference.trajectory import (
    ACCEL_SCALE,
    ATTITUDE,
    EARTH,
    GYRO,
    GYRO_BIAS,
    ITERATIONS,
    LATE_GPS,
    VELOCITY,
    Aiding,
    TrajectoryState,
    initial_state,
    log_evidence,
    smooth,
    with_accuracy,
)
from mavcal.calib.recording import Channel, Recording, Sensor

Array = NDArray[np.float64]

STEP_S = 0.1
"""Step between nodes, s: the bandwidth of the ideal accelerometer is half of 1 / STEP_S. Chosen, not measured: vehicles
are steered up to 5 Hz, and nodes cost time."""
_STRAIN = 6.0
"""Standard deviations above which an interval is contradicted. Chosen, not measured: far beyond normal errors in a
flight of any length."""
_LOUD, _WORST = 0.3, 0.1
"""Median difference between unit and trajectory, in standard deviations, above which the unit may be noisier than
assumed. Then the fraction of such a flight that is left out, so that a crash does not count as noise. Source: measured
for the first; 0.01 to 0.03 with ArduPilot's simulator, 0.8 with PX4's SIH. The other is chosen: crashes are shorter."""
_AROUND = 10
"""Intervals on either side that are excluded too. Chosen, not measured: a second at `STEP_S`."""
_FOLLOWED_HZ = 0.2 / STEP_S
"""Frequency, Hz, up to which a spline through the nodes' velocities follows an acceleration. Source: computed for a
sine; 1.7 % (rms) of the acceleration is missed there, 30 % at twice this frequency."""
_TURNS_HZ = 0.25 * STEPS / STEP_S
"""Frequency, Hz, up to which turns between the steps are followed: four steps a period. Source: twice the Nyquist
minimum of two samples a period."""
_TRIALS = 3
"""Iterations after which the inertial units can be compared. Chosen, not measured: costs then change by far less than
`_CLOSE`."""
_FEWEST_GPS = 20
"""Least number of GPS velocities. Chosen, not measured: two to four seconds of a usual receiver."""
_SHORTEST_S = 10.0
"""Shortest trajectory, s. Chosen, not measured: shorter ones hardly tell attitude from biases."""
_LONGEST_S = 1800.0
"""Longest trajectory, s. Chosen, not measured: it bounds time and memory, and most flights are shorter."""
_DEFAULT_YEAR = 2025.0
"""Year of the Earth's field, where a recording has no date. Chosen, not measured: the field changes by less than 0.1 uT
a year at most places."""
_MODEL_SD, _GUESS_SD = 1.0, 20.0
"""Standard deviation of the Earth's field, uT, of a model and of a guess from the readings. Chosen, not measured:
crustal fields are about 0.2 uT, buildings more; a guess is off by two fifths."""
_CLOSE = 200.0
"""Largest difference in twice the log-likelihood of units that fit equally well. Chosen, not measured: an offset costs
some sixty, and three of them should not decide."""
_LATE_S, _MOSTLY = 0.002, 0.5
"""Least delay between gyroscopes, s, and largest fraction of their difference that remains without it. Chosen, not
measured: 2 ms are a sample at 500 Hz, and half is most of it."""
_MEAN_S = 0.1
"""Averaging time, s, of their readings before the comparison. Chosen, not measured: vibration averages out."""
_WARMER = 40.0
"""Least gain of thermal or wandering biases, in twice the log-likelihood. Source: decision 9."""
_FURTHER, _LOUDER, _WALKS = 10.0, 10.0**0.5, 6
"""Factors by which a gyroscope's bias walk and a unit's noise are raised at each trial, and the most trials. Source:
decision 9 for the first. The others are chosen, not measured: PX4's SIH is 30 times as noisy as assumed.
"""
_DECISIVE = 10.0
"""Least gain of a larger noise, in twice the log-likelihood. Source: Kass and Raftery 1995, odds of 150 to 1."""
_GAIN_SD, _GAIN_DEFINED = 0.1, 1e-3
"""Standard deviation of a magnetometer's mean gain, where that field is known and where it is not. Source: decision 8;
where the field is not known the gain is one."""


@dataclass(frozen=True, eq=False)
class SmoothedTrajectory:
    """A trajectory, and the instances that it was made with.

    `late` are the delays of gyroscope and accelerometer in the firmware's filters, s. They are removed from the
    trajectory and restored in the ideal readings.
    """

    state: TrajectoryState
    imu: Increments
    instance: int
    mag_instance: int | None
    true: bool
    late: tuple[float, float] = (0.0, 0.0)


def re_estimated(recording: Recording, *, with_truth: bool = False) -> Ideal | None:
    """Ideal sensors along the smoothed trajectory of `recording`; `with_truth`: with a simulator's attitude.

    None without GPS velocity, a gyroscope and an accelerometer over the same ten seconds. Of several inertial units and
    magnetometers the best-fitting ones are used.
    """
    found = best_trajectory(recording, with_truth=with_truth)
    return None if found is None else _ideal_along(found)


@dataclass(frozen=True, eq=False)
class _Given:
    """Input of the smoother: nodes, aiding, compass, and the accelerometer and gyroscope of each unit."""

    t: Array
    aiding: Aiding
    compass: Channel | None
    units: Mapping[int, tuple[Channel, Channel]]

    def guess(self, recording: Recording) -> Rotation:
        """Initial attitudes at the nodes."""
        accel, gyro = next(iter(self.units.values()))
        return _initial_attitude(recording, gyro, accel, self.aiding, self.t)


def _given(recording: Recording) -> _Given | None:
    """None without GPS velocity and an inertial unit over the same ten seconds."""
    channels = sensors_of(recording)
    velocity = next((s for c in recording.find(Sensor.VELOCITY) if (s := Signal.of(c)) is not None), None)
    gyros, accels, mags = (
        {c.instance: c for c in channels if c.sensor == s} for s in (Sensor.GYRO, Sensor.ACCEL, Sensor.MAG)
    )
    units = {unit: (accels[unit], gyros[unit]) for unit in sorted(set(gyros) & set(accels))}
    if velocity is None or len(velocity.t) < _FEWEST_GPS or not units:
        return None
    start, end = _span(next(iter(units.values())), velocity)
    if not _SHORTEST_S <= end - start <= _LONGEST_S:
        return None
    t: Array = start + STEP_S * np.arange(int((end - start) / STEP_S) + 1, dtype=np.float64)
    compass = mags.get(_median_instance(mags)) if mags else None
    return _Given(t, _aiding(recording, velocity, compass, t), compass, units)


def plain_trajectory(recording: Recording) -> TrajectoryState | None:
    """The smoothed trajectory of the first unit, with its calibration accepted except for biases; None without one."""
    given = _given(recording)
    if given is None:
        return None
    accel, gyro = (Signal.of(c) for c in next(iter(given.units.values())))
    if accel is None or gyro is None:
        return None
    start = initial_state(given.t, given.guess(recording), given.aiding)
    return smooth(Increments.of(gyro, accel, given.t), given.aiding, start)


def best_trajectory(recording: Recording, *, with_truth: bool = False) -> SmoothedTrajectory | None:
    """The smoothed trajectory with the best-fitting inertial unit and magnetometer; None without one."""
    given = _given(recording)
    if given is None:
        return None
    t, aiding, compass, units = given.t, given.aiding, given.compass, given.units
    truth = true_attitude(recording) if with_truth else None
    if truth is not None:
        seen = truth.known(truth.t) & (truth.t >= t[0]) & (truth.t <= t[-1])
        aiding = dataclasses.replace(aiding, truth_t=truth.t[seen], truth=rotation(truth.values[seen]))
    guess = given.guess(recording)
    made = []
    for unit, (accel_channel, gyro_channel) in units.items():
        gyro, accel = Signal.of(gyro_channel), Signal.of(accel_channel)
        if gyro is not None and accel is not None:
            late = tuple(filter_delay(filter_in_force(c, recording)) for c in (gyro_channel, accel_channel))
            warmth = slow_values(recording.find(Sensor.TEMPERATURE, unit), t)
            temperature = None if warmth is None else warmth[:, 0]
            imu = Increments.of(gyro.shifted(-late[0]), accel.shifted(-late[1]), t, temperature)
            state = smooth(imu, aiding, initial_state(t, guess, aiding), _TRIALS if len(units) > 1 else ITERATIONS)
            mag = compass.instance if compass else None
            made.append(SmoothedTrajectory(state, imu, unit, mag, truth is not None, (late[0], late[1])))
    best = min(made, key=lambda s: s.state.cost, default=None)
    if best is None:
        return None
    close = [m for m in made if m.state.cost < best.state.cost + _CLOSE]
    return _with_unit_errors(_unit_without_delay(best, close, {u: gyro for u, (_, gyro) in units.items()}), aiding)


def _unit_without_delay(
    best: SmoothedTrajectory, close: Sequence[SmoothedTrajectory], gyros: Mapping[int, Channel]
) -> SmoothedTrajectory:
    """Of units that fit about equally, the one whose gyroscope is not late: no sensor can be early."""
    for other in close:
        first, second = (Signal.of(gyros[m.instance]) for m in (other, best))
        if first is None or second is None or other is best:
            continue
        width = max(1, round(_MEAN_S / float(np.median(np.diff(second.t)))))
        ahead, behind = (uniform_filter1d(w, width, axis=0) for w in (first.at(second.t), second.values))
        apart, slope = behind - ahead, np.gradient(ahead, second.t, axis=0)
        apart = apart - apart.mean(axis=0)
        late = -float((apart * slope).sum()) / max(float((slope**2).sum()), 1e-300)
        left = float(((apart + late * slope) ** 2).sum()) / max(float((apart**2).sum()), 1e-300)
        if late > _LATE_S and left < _MOSTLY:
            return other
    return best


def _with_unit_errors(found: SmoothedTrajectory, aiding: Aiding) -> SmoothedTrajectory:
    """The trajectory with the unit's errors estimated, and with its noise if that has more evidence."""
    imu = found.imu
    state = smooth(imu, aiding, found.state)
    calm, loud = _calm(imu, state)
    best = _with_matrix_errors(imu, aiding, state, loud=False)
    if loud and (louder := _with_noise(imu, calm, aiding, state)) is not state:
        other = _with_matrix_errors(imu, aiding, louder, loud=True)
        best = max((best, other), key=lambda e: log_evidence(calm, aiding, e.state, **e.free))
    return dataclasses.replace(found, state=with_accuracy(imu, aiding, best.state, **best.free))


@dataclass(frozen=True, eq=False)
class _Estimated:
    """A trajectory, and which parameters of the unit were free."""

    state: TrajectoryState
    matrices: bool
    drifts: bool

    @property
    def free(self) -> dict[str, bool]:
        """As options of :func:`smooth`."""
        return {"matrices": self.matrices, "drifts": self.drifts}


def _with_matrix_errors(imu: Increments, aiding: Aiding, state: TrajectoryState, *, loud: bool) -> _Estimated:
    """The trajectory with scales and misalignments, and thermal or wandering biases if those fit far better.

    Unchanged if the estimates are implausible because they explain something else, such as a crash. Noise of a loud
    unit also biases its axes: these are then free only if the evidence supports it.
    """
    free = _Estimated(smooth(imu, aiding, state, matrices=True), matrices=True, drifts=False)
    kept = _Estimated(state, matrices=False, drifts=False)
    asked = not loud or log_evidence(imu, aiding, free.state, **free.free) > log_evidence(imu, aiding, state)
    best = free if free.state.plausible and asked else kept
    if imu.warmth.any():
        warm = _Estimated(smooth(imu, aiding, state, matrices=asked, drifts=True), matrices=asked, drifts=True)
        if warm.state.plausible and warm.state.cost < best.state.cost - _WARMER:
            best = warm
    if aiding.truth is not None:
        return best
    return dataclasses.replace(best, state=_with_bias_walk(imu, aiding, best.state, **best.free))


def _calm(imu: Increments, state: TrajectoryState) -> tuple[Increments, bool]:
    """Increments without contradicted intervals, as in a crash; and whether the unit may be noisier than assumed.

    In that case the worst tenth is left out as well, since it may contain a crash.
    """
    between = state.interval_motion(imu)
    strain = _strain(state, imu, between)
    out, loud = _contradicted_intervals(state, imu, between), float(np.median(strain)) > _LOUD
    if loud:
        worst = strain > np.quantile(strain, 1.0 - _WORST)
        out = worst if out.mean() > _MOSTLY else out | worst
    return (dataclasses.replace(imu, known=imu.known & ~out) if out.any() else imu), loud


def _with_noise(imu: Increments, calm: Increments, aiding: Aiding, state: TrajectoryState) -> TrajectoryState:
    """`state`, or the trajectory with larger noise of attitude or velocity on some axes, if that has more evidence."""
    best = start = state if calm is imu else smooth(calm, aiding, state)
    for _ in range(_WALKS):
        louder, evidence = best, log_evidence(calm, aiding, best)
        for axis in range(ATTITUDE.start, VELOCITY.stop):
            walk = louder.walk.copy()
            walk[axis] *= _LOUDER
            tried = dataclasses.replace(louder, walk=walk)
            if 2.0 * ((found := log_evidence(calm, aiding, tried)) - evidence) > _DECISIVE:
                louder, evidence = tried, found
        if louder is best:
            break
        best = smooth(calm, aiding, louder)
    if best is start:
        return state
    return best if calm is imu else smooth(imu, aiding, dataclasses.replace(state, walk=best.walk))


def _with_bias_walk(
    imu: Increments, aiding: Aiding, state: TrajectoryState, *, matrices: bool, drifts: bool
) -> TrajectoryState:
    """`state`, or a trajectory whose gyroscope bias wanders as much as the data show.

    A bias that wanders more than the smoother assumes turns the attitude, and looks like errors of axes, scales and the
    Earth's field. Contradicted intervals, as in a crash, do not count.
    """
    calm, _ = _calm(imu, state)
    best = state if calm is imu else smooth(calm, aiding, state, matrices=matrices, drifts=drifts)
    evidence = log_evidence(calm, aiding, best, matrices=matrices, drifts=drifts)
    for _ in range(_WALKS):
        walk = best.walk.copy()
        walk[GYRO_BIAS] *= _FURTHER
        other = smooth(calm, aiding, dataclasses.replace(best, walk=walk), matrices=matrices, drifts=drifts)
        gained = log_evidence(calm, aiding, other, matrices=matrices, drifts=drifts) - evidence
        if not other.plausible or 2.0 * gained < _WARMER:
            break
        best, evidence = other, evidence + gained
    if np.array_equal(best.walk, state.walk):
        return state
    freed = dataclasses.replace(state, walk=best.walk)
    return best if calm is imu else smooth(imu, aiding, freed, matrices=matrices, drifts=drifts)


def _span(channels: Sequence[Channel], velocity: Signal) -> tuple[float, float]:
    starts = [float(c.t[0]) for c in channels] + [float(velocity.t[0]) - 1.0]
    ends = [float(c.t[-1]) for c in channels] + [float(velocity.t[-1]) + 1.0]
    return max(starts), min(ends)


def _median_instance(mags: dict[int, Channel]) -> int:
    """The instance with the smallest total distance to all others; of two, the first."""

    def apart(i: int) -> float:
        signal = Signal.of(mags[i])
        if signal is None:
            return np.inf
        return sum(float(np.mean(np.abs(signal.at(m.t) - m.values))) for j, m in mags.items() if j != i)

    return min(sorted(mags), key=apart)


def _aiding(recording: Recording, velocity: Signal, compass: Channel | None, t: Array) -> Aiding:
    seen = (velocity.t >= t[0] + 0.3) & (velocity.t <= t[-1])
    field = None if compass is None else Signal.of(compass)
    if field is None:
        none = np.zeros((0, 3))
        return Aiding(
            velocity.t[seen], velocity.values[seen], none[:, 0], none, none[:, 0], np.array([20.0, 0.0, 40.0])
        )
    inside = (field.t >= t[0]) & (field.t <= t[-1])
    amperes = slow_values(recording.find(Sensor.CURRENT), field.t[inside])
    current = np.zeros(int(inside.sum())) if amperes is None or amperes.std() < TELLING_CURRENT else amperes[:, 0]
    earth, sd, gain = _expected_field(recording, field)
    return Aiding(
        velocity.t[seen], velocity.values[seen], field.t[inside], field.values[inside], current, earth, sd, gain
    )


def _expected_field(recording: Recording, field: Signal) -> tuple[Array, float, float]:
    """The field of the World Magnetic Model at the place, its standard deviation, uT, and that of the gain.

    Without a position: a field of the measured size, north and down as in middle latitudes.
    """
    place = next((c for c in recording.find(Sensor.POSITION) if len(c)), None)
    if place is not None:
        latitude, longitude, altitude = np.median(place.values, axis=0)
        try:
            known = earth_field(float(latitude), float(longitude), float(altitude), _year(recording))
            return known.north_east_down, _MODEL_SD, _GAIN_SD
        except InvalidInputError:
            pass
    return np.array([0.45, 0.0, 0.9]) * float(np.median(np.linalg.norm(field.values, axis=1))), _GUESS_SD, _GAIN_DEFINED


def _year(recording: Recording) -> float:
    said = next((e.text for e in recording.events if e.kind == "utc"), "")
    try:
        return float(said[:4]) + (float(said[5:7]) - 0.5) / 12.0
    except ValueError:
        return _DEFAULT_YEAR


def _initial_attitude(recording: Recording, gyro: Channel, accel: Channel, aiding: Aiding, t: Array) -> Rotation:
    """Initial attitudes: the estimator's, else levelled at the start and integrated from the gyroscope."""
    estimate = next((s for c in recording.find(Sensor.ATTITUDE) if (s := Signal.of(c)) is not None), None)
    if estimate is not None and estimate.t[0] < t[0] + 2.0 and estimate.t[-1] > t[-1] - 2.0:
        return rotation(interpolated(estimate.t, continuous(estimate.values), t))
    rates, forces = Signal.of(gyro), Signal.of(accel)
    assert rates is not None
    assert forces is not None
    imu = Increments.of(rates, forces, t)
    zero = np.zeros((len(t) - 1, 3))
    turns = imu.integrated(zero, zero).turn
    attitude = _levelled_attitude(accel, aiding, t[0])
    found = [attitude]
    for k in range(len(turns)):
        attitude = attitude * turns[k]
        found.append(attitude)
    return Rotation.concatenate(found)


def _levelled_attitude(accel: Channel, aiding: Aiding, start: float) -> Rotation:
    """Attitude from the first second: gravity is down, and the magnetometer along the Earth's field."""
    early = accel.values[accel.t <= start + 1.0].mean(axis=0)
    body, world = [early / np.linalg.norm(early)], [np.array([0.0, 0.0, -1.0])]
    if len(aiding.mag_t):
        field = aiding.mag[:10].mean(axis=0)
        east_b, east_n = np.cross(field, body[0]), np.cross(aiding.earth, world[0])
        body.append(east_b / np.linalg.norm(east_b))
        world.append(east_n / np.linalg.norm(east_n))
    turn, _ = Rotation.align_vectors(np.array(world), np.array(body), weights=np.array([np.inf, 1.0][: len(body)]))
    return turn


def _ideal_along(found: SmoothedTrajectory) -> Ideal:
    state, imu = found.state, found.imu
    between = state.interval_motion(imu)
    slip = (state.attitude[1:].inv() * state.attitude[:-1] * between.turn).inv().as_rotvec()
    steps = []
    for j, within in enumerate(between.within):
        steps.append(state.attitude[:-1] * within * Rotation.from_rotvec(slip * (j / STEPS)))
    fine_t = imu.t[0] + imu.dt / STEPS * np.arange(len(slip) * STEPS)
    q = np.stack([s.as_quat() for s in steps], axis=1).reshape(-1, 4)[:, [3, 0, 1, 2]]
    rate = (between.rate + slip[:, None, :] / imu.dt).reshape(-1, 3)
    held = np.repeat(~_contradicted_intervals(state, imu, between), STEPS)
    attitude = Signal(fine_t, continuous(q))
    if not held.any():  # nowhere do trajectory and inertial unit agree: the attitude is known nowhere
        return Ideal(dataclasses.replace(_reference_info(found), att_sigma_deg=np.inf), {}, attitude)
    down = CubicSpline(imu.t, state.velocity, axis=0)(fine_t, 1) - GRAVITY_NED
    body_from_ned = rotation(q).inv()
    readings = {
        Sensor.ACCEL: Signal(fine_t[held] + found.late[1], body_from_ned.apply(down)[held]),
        Sensor.GYRO: Signal(fine_t[held] + 0.5 * imu.dt / STEPS + found.late[0], rate[held]),
    }
    if found.mag_instance is not None:
        readings[Sensor.MAG] = Signal(fine_t[held], body_from_ned.apply(np.tile(state.earth, (len(fine_t), 1)))[held])
    return Ideal(_reference_info(found), readings, attitude)


def _contradicted_intervals(state: TrajectoryState, imu: Increments, between: IntervalMotion) -> NDArray[np.bool_]:
    """Intervals in which trajectory and inertial unit contradict each other: a crash, a clipped sensor."""
    return np.asarray(maximum_filter1d(_strain(state, imu, between), 2 * _AROUND + 1) > _STRAIN)


def _strain(state: TrajectoryState, imu: Increments, between: IntervalMotion) -> Array:
    """Standard deviations by which trajectory and inertial unit differ over each interval (K,), of the worst axis."""
    here, there = state.attitude[:-1], state.attitude[1:]
    turned = (there.inv() * here * between.turn).as_rotvec()
    moved = state.velocity[:-1] + here.apply(between.velocity) + GRAVITY_NED * imu.dt - state.velocity[1:]
    sd = np.sqrt(state.walk[:6].reshape(2, 3) ** 2 * imu.dt + imu.sampling**2)
    return np.asarray(np.maximum(np.abs(turned / sd[0]).max(axis=1), np.abs(moved / sd[1]).max(axis=1)))


def _reference_info(found: SmoothedTrajectory) -> ReferenceInfo:
    sources = (
        "GPS velocity and the inertial unit"
        if found.mag_instance is None
        else "GPS velocity, inertial unit and compass"
    )
    if found.true:
        text = "The attitude in a simulator's log, and the velocities between."
        known_deg = float(np.degrees(found.state.att_sd))
        return ReferenceInfo(ReferenceKind.SIM, known_deg, 10.0, text, _FOLLOWED_HZ, _TURNS_HZ)
    text = (
        f"A trajectory re-estimated from {sources} with their errors inside (inertial unit {found.instance + 1}"
        + ("" if found.mag_instance is None else f", compass {found.mag_instance + 1}")
        + f"; GPS {found.state.constants[LATE_GPS]:.2f} s late); the log's own attitude is not used as truth."
    )
    att_sd = float(np.degrees(found.state.att_sd))
    inside = (tuple(map(float, found.state.constants_sd[part])) for part in (GYRO, EARTH, ACCEL_SCALE))
    return ReferenceInfo(ReferenceKind.ESTIMATOR, att_sd, 10.0, text, _FOLLOWED_HZ, _TURNS_HZ, *inside)
