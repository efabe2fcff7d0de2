"""A simulated flight whose truth is known: what the smoother makes of it without being told."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from mavcal.calib import logs
from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.problem import ReferenceKind
from mavcal.calib.gap.reference import build
from mavcal.calib.gap.reference.bordered import BorderedEquations
from mavcal.calib.gap.reference.re_estimated import (
    _FOLLOWED_HZ,
    STEP_S,
    _contradicted_intervals,
    _median_instance,
    best_trajectory,
)
from mavcal.calib.gap.reference.signals import Signal
from mavcal.calib.gap.reference.strapdown import WARMTH_UNIT, Increments
from mavcal.calib.gap.reference.trajectory import (
    ACCEL_DRIFT,
    CONSTANTS,
    GYRO_BIAS,
    GYRO_DRIFT,
    NODE,
    WALK,
    Aiding,
    _attitudes,
    initial_state,
)
from mavcal.calib.recording import Channel, ParameterTimeline, Recording, Sensor, Stage

from .test_recorded import by_sensor, channel

RATE, SECONDS = 100.0, 60.0
EARTH = np.array([22.0, 5.0, -52.0])
G = np.array([0.0, 0.0, 9.80665])


def path(t):
    """Attitude and velocity of a vehicle that turns through all headings and moves about."""
    velocity = np.column_stack([3.0 * np.sin(0.5 * t), 2.0 * np.cos(0.35 * t), 0.5 * np.sin(0.8 * t)])
    angles = np.column_stack([0.15 * t, 0.25 * np.sin(0.6 * t), 0.2 * np.sin(0.9 * t + 1.0)])
    return Rotation.from_euler("ZYX", angles), velocity


@functools.cache
def flight(bias=(0.0, 0.0, 0.0), gyro_bias=(0.0, 0.0, 0.0), per_ampere=(0.0, 0.0, 0.0), instances=1, seed=3):
    """IMU at 100 Hz, compass at 10 Hz, GPS at 5 Hz, 0.12 s late; the attitude in the log hides the bias."""
    rng = np.random.default_rng(seed)
    t, h = np.arange(int(RATE * SECONDS)) / RATE, 1e-4
    turn, _ = path(t)
    ahead, after = path(t + h)
    _, before = path(t - h)
    force = turn.inv().apply((after - before) / (2.0 * h) - G)
    rate = (turn.inv() * ahead).as_rotvec() / h
    channels: list[Channel] = []
    for i in range(instances):
        off = 1.0 if i == 0 else 0.0
        accel = force + off * np.array(bias) + 0.02 * rng.standard_normal(force.shape)
        gyro = rate + off * np.array(gyro_bias) + 0.001 * rng.standard_normal(rate.shape)
        channels += [channel(Sensor.ACCEL, t, accel, i, "IMU"), channel(Sensor.GYRO, t, gyro, i, "IMU")]
    slow = t[::10]
    current = 10.0 + 5.0 * np.sin(0.2 * slow) * (slow > 10.0)
    field = path(slow)[0].inv().apply(EARTH) + current[:, None] * np.array(per_ampere)
    channels.append(channel(Sensor.MAG, slow, field + 0.2 * rng.standard_normal(field.shape), 0, "MAG"))
    channels.append(channel(Sensor.CURRENT, slow, current))
    gps = t[::20]
    velocity = path(gps)[1] + 0.03 * rng.standard_normal((len(gps), 3))
    channels.append(Channel(Sensor.VELOCITY, 0, gps + 0.12, velocity, "m/s", Stage.RAW, "GPS"))
    hidden = path(slow)[0] * Rotation.from_rotvec(np.radians([2.5, -1.5, 4.0]))
    channels.append(channel(Sensor.ATTITUDE, slow, hidden.as_quat()[:, [3, 0, 1, 2]], 0, "ATT"))
    return Recording(tuple(channels))


def moved(recording, sensor, by):
    """The same with the samples of a sensor stamped `by` seconds after they were true."""
    return recording.with_channels(
        dataclasses.replace(c, t=c.t + by) if c.sensor == sensor else c for c in recording.channels
    )


def error_deg(found):
    turn, _ = path(found.state.t)
    return np.degrees((turn.inv() * found.state.attitude).as_rotvec())


@pytest.mark.long
def test_a_bias_that_the_log_hides_is_found():
    problem = build(flight(bias=(0.3, -0.2, 0.15), gyro_bias=(0.01, -0.015, 0.008)))
    assert problem.reference.kind == ReferenceKind.ESTIMATOR
    traces = by_sensor(problem)
    assert traces[Sensor.ACCEL].residual.mean(axis=0) == pytest.approx([0.3, -0.2, 0.15], abs=0.03)
    assert traces[Sensor.GYRO].residual.mean(axis=0) == pytest.approx([0.01, -0.015, 0.008], abs=5e-4)


@pytest.mark.long
def test_the_attitude_is_as_good_as_it_is_said_to_be():
    found = best_trajectory(flight())
    error = error_deg(found)
    assert np.sqrt((error**2).mean()) < 2.0 * np.degrees(found.state.att_sd)
    assert np.sqrt((error**2).mean()) < 0.3
    assert found.state.constants[9] == pytest.approx(0.12, abs=0.01)


@pytest.mark.long
def test_the_field_of_the_motors_is_no_attitude():
    found = best_trajectory(flight(per_ampere=(0.3, -0.2, 0.4)))
    assert found.state.constants[3:6] == pytest.approx([0.3, -0.2, 0.4], abs=0.03)
    assert np.abs(error_deg(found).mean(axis=0)).max() < 0.5


@pytest.mark.long
def test_a_compass_that_is_late_bends_neither_the_field_nor_the_attitude():
    late = moved(flight(), Sensor.MAG, 0.06)
    found = best_trajectory(late)
    assert found.state.constants[10] == pytest.approx(0.06, abs=0.01)
    assert np.abs(found.state.earth - EARTH).max() < 0.3
    assert np.abs(error_deg(found).mean(axis=0)).max() < 0.2


def changed(recording, sensor, matrix):
    """The same with what every instance of a sensor reads multiplied by a matrix."""
    return recording.with_channels(
        dataclasses.replace(c, values=c.values @ np.asarray(matrix).T) if c.sensor == sensor else c
        for c in recording.channels
    )


@pytest.mark.long
@pytest.mark.parametrize(
    ("sensor", "matrix"),
    [
        (Sensor.GYRO, np.diag([1.04, 0.97, 1.0])),  # it turns about z too evenly to tell a scale from a bias
        (Sensor.GYRO, Rotation.from_rotvec([0.05, 0.03, -0.04]).as_matrix()),
        (Sensor.ACCEL, Rotation.from_rotvec([0.05, 0.03, -0.04]).as_matrix()),
        (Sensor.ACCEL, np.diag([1.03, 0.98, 1.02])),
        (Sensor.MAG, [[0.95, 0.03, 0.0], [0.03, 1.06, -0.04], [0.0, -0.04, 0.98]]),
    ],
)
def test_scales_and_axes_of_all_units_do_not_bend_the_trajectory(sensor, matrix):
    real = changed(flight(instances=2), sensor, matrix)
    assert np.abs(error_deg(best_trajectory(real)).mean(axis=0)).max() < 0.4
    traces = [t for t in build(real).traces if t.sensor == sensor and t.against is None]
    for trace in traces:
        known = trace.observed
        design = np.column_stack([trace.ideal[known], np.ones(known.sum())])
        found = np.linalg.lstsq(design, trace.measured[known])[0][:3].T
        assert found == pytest.approx(np.asarray(matrix), abs=0.012)


def warmed(recording, instance, gyro, accel, seconds=SECONDS):
    """The same with a unit that warms from 20 to 50 degrees, and biases that follow it, per degree from 35."""
    t = np.arange(int(seconds)) * 1.0
    temperature = channel(Sensor.TEMPERATURE, t, 20.0 + 30.0 * (1.0 - np.exp(-t / 25.0)), instance)

    def drift(c):
        own = {Sensor.GYRO: gyro, Sensor.ACCEL: accel}.get(c.sensor)
        if own is None or c.instance != instance:
            return c
        degrees = np.interp(c.t, t, temperature.values[:, 0]) - 35.0
        return dataclasses.replace(c, values=c.values + np.outer(degrees, own))

    return recording.with_channels([*map(drift, recording.channels), temperature])


@pytest.mark.long
def test_biases_that_follow_the_temperature_do_not_bend_the_trajectory():
    gyro, accel = [3e-4, -2e-4, 1.5e-4], [8e-3, -5e-3, 12e-3]
    found = best_trajectory(warmed(flight(), 0, gyro, accel))
    assert np.abs(error_deg(found).mean(axis=0)).max() < 0.4
    assert found.state.constants[GYRO_DRIFT][:3] / WARMTH_UNIT == pytest.approx(gyro, abs=1e-4)
    assert found.state.constants[ACCEL_DRIFT][:3] / WARMTH_UNIT == pytest.approx(accel, abs=3e-3)


@pytest.mark.long
def test_a_temperature_that_drives_nothing_frees_nothing():
    found = best_trajectory(warmed(flight(), 0, np.zeros(3), np.zeros(3)))
    assert found.imu.warmth.any()
    assert np.abs(found.state.constants[GYRO_DRIFT.start :]).max() < 1e-6


@pytest.mark.long
def test_a_bias_that_wanders_does_not_bend_the_trajectory():
    recording, each = flight(), 2e-3
    rng = np.random.default_rng(11)

    def wandering(c):
        step = each * np.sqrt(1.0 / RATE) * rng.standard_normal(c.values.shape)
        return dataclasses.replace(c, values=c.values + np.cumsum(step, axis=0)) if c.sensor == Sensor.GYRO else c

    found = best_trajectory(recording.with_channels(map(wandering, recording.channels)))
    error = error_deg(found)
    assert np.sqrt((error**2).mean()) < 2.0 * np.degrees(found.state.att_sd)
    assert np.abs(found.state.gyro_matrix - np.eye(3)).max() < 0.012
    assert found.state.walk[GYRO_BIAS] == pytest.approx(1e-3)  # of 1e-5, 1e-4, 1e-3 and 1e-2 the nearest


def loud(recording):
    """The same with a unit louder than PX4's SIH, each axis by itself; each sample the mean of two, as PX4 integrates.

    Half of such samples are as good as all, so that sampling tells nothing of their noise.
    """
    rng = np.random.default_rng(12)
    each = {Sensor.GYRO: [0.3, 0.15, 0.05], Sensor.ACCEL: [1.0, 3.0, 3.0]}

    def noisy(c):
        noise = np.array(each.get(c.sensor, [0.0])) * rng.standard_normal((len(c) + 1, c.values.shape[1]))
        return dataclasses.replace(c, values=c.values + 0.5 * (noise[1:] + noise[:-1])) if c.sensor in each else c

    return recording.with_channels(map(noisy, recording.channels))


@pytest.mark.long
def test_a_loud_unit_bends_neither_its_axes_nor_the_attitude():
    """Scales were 1.09, of what the noise adds to each turn."""
    found = best_trajectory(loud(flight()))
    assert np.sqrt((error_deg(found) ** 2).mean()) < 2.0 * np.degrees(found.state.att_sd) < 3.0
    assert np.abs(found.state.gyro_matrix - np.eye(3)).max() < 0.06


@pytest.mark.long
def test_a_loud_unit_beside_a_simulators_attitude_is_compared_everywhere():
    """Four fifths of such a flight were left out, as if it had crashed all the time."""
    whole = loud(flight())
    t = np.arange(0.0, SECONDS, 0.01)
    truth = channel(Sensor.ATTITUDE, t, path(t)[0].as_quat()[:, [3, 0, 1, 2]])
    found = best_trajectory(dataclasses.replace(whole, reference=(truth,)), with_truth=True)
    assert found.true
    assert found.state.walk[0] > 10.0 * WALK[0]
    assert found.state.walk[0] > 2.0 * found.state.walk[2]
    assert np.array_equal(found.state.walk[GYRO_BIAS], WALK[GYRO_BIAS])
    between = found.state.interval_motion(found.imu)
    assert not _contradicted_intervals(found.state, found.imu, between).any()


def test_a_compass_is_read_where_the_vehicle_was_between_the_nodes():
    """Fast turns about z: straight lines between the nodes were 2 degrees off, and nodes overshot the turns by 4 %."""
    fine, nodes = np.arange(0.0, 10.0, 0.002), np.arange(0.0, 9.9, STEP_S)
    phase = 2.0 * np.pi * 1.5
    rate = np.outer(0.4 * phase * np.cos(phase * fine), [0.0, 0.0, 1.0])
    imu = Increments.of(Signal(fine, rate), Signal(fine, np.tile(-G, (len(fine), 1))), nodes)

    def turn(t):
        return Rotation.from_rotvec(np.outer(0.4 * np.sin(phase * t), [0.0, 0.0, 1.0]))

    none = np.zeros((0, 3))
    aiding = Aiding(nodes, np.zeros((len(nodes), 3)), none[:, 0], none, none[:, 0], EARTH)
    state = initial_state(nodes, turn(nodes), aiding)
    t = np.random.default_rng(13).uniform(0.0, nodes[-1], 500)
    _, body_from_ned, told = _attitudes(t, STEP_S, state.interval_motion(imu), state)
    assert np.degrees((body_from_ned * turn(t)).magnitude()).max() < 0.1
    assert told[:, 2] == pytest.approx(0.4 * phase * np.cos(phase * t), abs=0.3)


@pytest.mark.long
def test_a_bias_that_stays_is_given_no_more_freedom():
    assert np.array_equal(best_trajectory(flight(gyro_bias=(0.01, -0.015, 0.008))).state.walk, WALK)


def test_the_determinant_is_that_of_the_whole_matrix():
    rng, n = np.random.default_rng(2), 3
    size = n * NODE + CONSTANTS
    root = rng.normal(size=(size, size))
    whole = root @ root.T + size * np.eye(size)
    for i in range(n):
        for j in range(n):
            if abs(i - j) > 1:
                whole[i * NODE : (i + 1) * NODE, j * NODE : (j + 1) * NODE] = 0.0
    normal = BorderedEquations(n, NODE, CONSTANTS, np.arange(CONSTANTS))
    for i in range(n):
        own = slice(i * NODE, (i + 1) * NODE)
        normal.diagonal[i], normal.border[i] = whole[own, own], whole[own, n * NODE :]
        if i + 1 < n:
            normal.beside[i] = whole[own, own.stop : own.stop + NODE]
    normal.corner[:] = whole[n * NODE :, n * NODE :]
    assert normal.log_determinant == pytest.approx(np.linalg.slogdet(whole)[1])


@pytest.mark.long
def test_of_two_gyroscopes_the_trajectory_turns_with_the_one_that_is_not_late():
    whole = flight(instances=2)
    first = best_trajectory(whole).instance

    def delayed(c):
        late = c.sensor is Sensor.GYRO and c.instance == first
        return dataclasses.replace(c, values=Signal.of(c).at(c.t - 0.013)) if late else c

    assert best_trajectory(whole.with_channels(map(delayed, whole.channels))).instance != first


@pytest.mark.long
def test_no_axes_are_turned_to_explain_a_crash():
    whole = flight(instances=2)
    crash = [
        dataclasses.replace(c, values=np.where(((c.t > 30.0) & (c.t < 30.3))[:, None], 80.0, c.values))
        if c.sensor == Sensor.ACCEL
        else c
        for c in whole.channels
    ]
    state = best_trajectory(whole.with_channels(crash)).state
    assert state.constants[11:] == pytest.approx(np.zeros(CONSTANTS - 11), abs=1e-5)
    assert np.array_equal(state.walk, WALK)


@pytest.mark.long
def test_the_delay_of_the_firmwares_own_filters_is_no_delay_of_other_sensors():
    late = np.sqrt(2.0) / (2.0 * np.pi * 5.0)
    real = moved(moved(flight(), Sensor.GYRO, late), Sensor.ACCEL, late)
    filtered = [
        dataclasses.replace(c, stage=Stage.FILTERED) if c.sensor in {Sensor.GYRO, Sensor.ACCEL} else c
        for c in real.channels
    ]
    identity = dataclasses.replace(real.identity, autopilot="ardupilot")
    parameters = ParameterTimeline.constant({"INS_GYRO_FILTER": 5.0, "INS_ACCEL_FILTER": 5.0})
    real = dataclasses.replace(real.with_channels(filtered), identity=identity, parameters=parameters)
    found = best_trajectory(real)
    assert found.late == pytest.approx((late, late))
    assert found.state.constants[9] == pytest.approx(0.12, abs=0.01)
    assert found.state.constants[10] == pytest.approx(0.0, abs=0.01)
    gyro = by_sensor(build(real))[Sensor.GYRO]
    assert gyro.residual.std(axis=0).max() < 0.004


@pytest.mark.long
def test_the_unit_with_the_smaller_errors_drives_the_trajectory():
    real = flight(bias=(0.4, 0.3, -0.2), gyro_bias=(0.02, 0.0, -0.01), instances=2)
    assert best_trajectory(real).instance == 1
    pairs = [t for t in build(real).traces if t.against is not None]
    assert {(t.instances, t.against) for t in pairs} == {((0,), 1)}


@pytest.mark.long
def test_a_hole_does_not_bend_the_trajectory():
    whole = flight()
    cut = [c.take((c.t < 25.0) | (c.t > 31.0)) if c.sensor != Sensor.VELOCITY else c for c in whole.channels]
    found = best_trajectory(whole.with_channels(cut))
    beside = (found.state.t < 24.5) | (found.state.t > 31.5)
    assert np.sqrt((error_deg(found)[beside] ** 2).mean()) < 0.5


def test_without_gps_there_is_no_trajectory():
    real = flight()
    assert best_trajectory(real.with_channels(c for c in real.channels if c.sensor != Sensor.VELOCITY)) is None


def test_increments_of_a_cone_are_those_of_the_attitudes():
    t = np.arange(0.0, 2.0, 0.0025)
    angles = np.column_stack([0.3 * np.sin(7.0 * t), 0.3 * np.cos(7.0 * t), 0.5 * t])
    turn = Rotation.from_euler("ZYX", angles[:, ::-1])
    ahead = Rotation.from_euler(
        "ZYX",
        np.column_stack([0.3 * np.sin(7.0 * (t + 1e-5)), 0.3 * np.cos(7.0 * (t + 1e-5)), 0.5 * (t + 1e-5)])[:, ::-1],
    )
    gyro = Signal(t, (turn.inv() * ahead).as_rotvec() / 1e-5)
    accel = Signal(t, turn.inv().apply([1.0, 2.0, 3.0]))
    nodes = np.arange(0.0, 1.95, 0.1)
    zero = np.zeros((len(nodes) - 1, 3))
    between = Increments.of(gyro, accel, nodes).integrated(zero, zero)
    at = turn[np.rint(nodes / 0.0025).astype(int)]
    error = (between.turn.inv() * (at[:-1].inv() * at[1:])).as_rotvec()
    assert np.abs(error).max() < 1e-3
    assert at[:-1].apply(between.velocity) == pytest.approx(np.tile([0.1, 0.2, 0.3], (len(zero), 1)), abs=2e-4)


@pytest.mark.long
def test_a_crash_is_left_out_and_a_quiet_flight_is_not(shared_data):
    path = shared_data / "df_log171_triple_imu_mag" / "log171.bin"
    single = [t for t in build(logs.read(path)).traces if t.against is None]
    for trace in single:
        crash = (trace.t > 238.0) & (trace.t < 241.0)
        assert not trace.observed[crash].any()
        assert trace.observed.mean() > 0.7
    assert all(trace.observed.mean() > 0.99 for trace in by_sensor(build(flight())).values())


def thinned(recording, step):
    """The same with every `step`-th sample of the inertial units."""
    kept = {Sensor.ACCEL, Sensor.GYRO}
    return recording.with_channels(
        c.take(slice(None, None, step)) if c.sensor in kept else c for c in recording.channels
    )


@pytest.mark.long
def test_a_re_estimated_reference_is_asked_only_for_what_it_follows():
    traces = by_sensor(build(thinned(flight(), 2)))
    assert not traces[Sensor.ACCEL].rate_known
    assert not traces[Sensor.GYRO].rate_known
    assert traces[Sensor.MAG].rate_known
    delays = {e.id: e for e in catalogue() if e.id in {"accel_delay", "gyro_low_pass", "mag_delay"}}
    lacks = {name: effect.missing(traces[effect.sensor]) for name, effect in delays.items()}
    assert "does not follow" in lacks["accel_delay"][0]
    assert "does not follow" in lacks["gyro_low_pass"][0]
    assert lacks["mag_delay"] is None or "does not follow" not in lacks["mag_delay"][0]


@pytest.mark.parametrize(("times", "missed"), [(1.0, 0.017), (2.0, 0.30)])
def test_an_acceleration_is_followed_as_far_as_is_said(times, missed):
    """A sine at a multiple of the limit, its velocity known at the nodes: rms that the spline's derivative misses."""
    nodes, between = np.arange(0.0, 60.0, STEP_S), np.linspace(10.0, 50.0, 20_001)
    w = 2.0 * np.pi * times * _FOLLOWED_HZ
    off = CubicSpline(nodes, np.sin(w * nodes))(between, 1) / w - np.cos(w * between)
    assert np.sqrt(2.0 * np.mean(off**2)) == pytest.approx(missed, rel=0.02)


@pytest.mark.sampled
@pytest.mark.parametrize("seconds", [0.02, 0.2, 1.0])
def test_the_error_of_slow_samples_adds_up_as_far_as_is_said(seconds):
    """A band of rates up to 1 Hz, summed over 20 s, beside what samples so far apart make of it."""
    fine, h, lasting = np.arange(0.0, 400.0, 0.01), 0.1, 200
    rng = np.random.default_rng(4)
    hz, phase = rng.uniform(0.02, 1.0, (60, 3)), rng.uniform(0.0, 2.0 * np.pi, (60, 3))
    rates = np.cos(2.0 * np.pi * hz * fine[:, None, None] + phase).sum(axis=1) / np.sqrt(30.0)
    step = round(seconds / 0.01)
    nodes = np.arange(0.0, 398.0, h)
    true, slow = (Increments.of(*[Signal(fine[::k], 0.01 * rates[::k])] * 2, nodes) for k in (1, step))
    off = np.cumsum((slow.angle - true.angle).sum(axis=1), axis=0)
    grown = float(np.sqrt(np.mean((off[lasting:] - off[:-lasting]) ** 2)))
    assert grown < 1.2 * float(np.sqrt(np.mean(slow.sampling[0] ** 2))) * np.sqrt(lasting)


@pytest.mark.long
def test_gyroscopes_of_a_slow_log_are_compared_with_each_other_only():
    gyros = [t for t in build(thinned(flight(instances=2), 2)).traces if t.sensor == Sensor.GYRO]
    assert gyros
    assert all(t.against is not None for t in gyros)


@pytest.mark.parametrize("stepped", [0, 1, 2])
@pytest.mark.parametrize("first", [True, False])
def test_of_three_compasses_one_with_a_step_in_a_third_of_its_samples_is_not_typical(stepped, first):
    # Without the step it would be the best of all: it is between both others.
    rng = np.random.default_rng(2)
    t = np.arange(0.0, 60.0, 0.1)
    field = path(t)[0].inv().apply(EARTH)
    on = t < 20.0 if first else t >= 40.0
    beside = np.insert([0.5, -0.5], stepped, 0.0)

    def compasses(step):
        made = {}
        for i, offset in enumerate(beside):
            off = np.outer(on, [step, -step, 0.5 * step]) if i == stepped else 0.0
            values = field + offset + off + 0.1 * rng.standard_normal(field.shape)
            made[i] = channel(Sensor.MAG, t, values, i, "MAG")
        return made

    assert _median_instance(compasses(0.0)) == stepped
    assert _median_instance(compasses(15.0)) != stepped
