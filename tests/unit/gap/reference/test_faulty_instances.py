"""Which of two instances has it: more noise in a band, or a level of its own, however the vehicle moves."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter

from mavcal.calib.gap.problem import FaultyInstances, Trace
from mavcal.calib.gap.reference.redundant import faulty_instances_of
from mavcal.calib.recording import Sensor

RATE, ROWS, SIGMA = 100.0, 4000, 0.003
SEEDS = range(6)
EQUAL = (SIGMA, SIGMA)
UNLIKE = (4.0 * SIGMA, SIGMA)
TOWARDS = np.array([1.0, -0.7, 0.4])
OFFSET = 30.0 * SIGMA * np.tile(TOWARDS, (ROWS, 1))
RAMP = 60.0 * SIGMA * np.outer(np.linspace(0.0, 1.0, ROWS), TOWARDS)


def coloured(rng, size):
    """A movement of standard deviation `size` that stays the same for about a second, (ROWS, 3)."""
    keeps = np.exp(-1.0 / RATE)
    return size * np.sqrt(1.0 - keeps**2) * lfilter([1.0], [1.0, -keeps], rng.normal(size=(ROWS, 3)), axis=0)


def instances(seed, sigma=EQUAL, added=(0.0, 0.0), *, rate=RATE):
    """Instances of a sensor that move together, each with white noise `sigma`, against one inexact reference.

    `added`: the size of more noise, or (ROWS, 3) that an instance reads beside it.
    """
    rng = np.random.default_rng(seed)
    movement = coloured(rng, 100.0 * SIGMA)
    t = np.arange(ROWS) / rate
    ideal = movement + coloured(rng, SIGMA)
    traces = []
    for i, (own, more) in enumerate(zip(sigma, added, strict=True)):
        beside = more if isinstance(more, np.ndarray) else more * rng.normal(size=movement.shape)
        measured = movement + own * rng.normal(size=movement.shape) + beside
        traces.append(Trace(Sensor.GYRO, (i,), t, measured, ideal, np.ones(ROWS, dtype=bool)))
    return tuple(traces)


def told(real, sim=()):
    return faulty_instances_of(real, sim).get(Sensor.GYRO, FaultyInstances())


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("with_sim", [False, True])
@pytest.mark.parametrize(("louder", "whose"), [((1, 0), (0,)), ((0, 1), (1,)), ((1, 1), (0, 1))])
def test_more_noise_is_that_of_the_instances_that_have_it(seed, with_sim, louder, whose):
    sim = instances(seed + 100) if with_sim else ()
    real = instances(seed, added=tuple(3.0 * SIGMA * one for one in louder))
    assert told(real, sim).fast == whose
    assert told(real[::-1], sim[::-1]).fast == whose


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("quieter", [0, 1])
def test_an_instance_that_is_less_loud_than_the_other_is_loud_as_well(seed, quieter):
    """ArduPilot's simulator gives the second gyroscope nine times the power of noise for the same parameter."""
    sizes = [9.0 * SIGMA, 9.0 * SIGMA]
    sizes[quieter] = 3.0 * SIGMA
    assert told(instances(seed, added=tuple(sizes)), instances(seed + 100)).fast == (0, 1)


@pytest.mark.parametrize("seed", range(20))
def test_one_that_is_very_loud_does_not_make_the_other_loud(seed):
    for added, whose in (((9.0 * SIGMA, 0.0), (0,)), ((0.0, 9.0 * SIGMA), (1,))):
        assert told(instances(seed, added=added), instances(seed + 100)).fast == whose


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("sigma", [EQUAL, UNLIKE])
def test_what_the_simulator_has_as_well_is_nobodys(seed, sigma):
    assert faulty_instances_of(instances(seed, sigma), instances(seed + 100, sigma)) == {}


@pytest.mark.parametrize("seed", SEEDS)
def test_alike_instances_without_a_simulator_do_not_become_a_wrong_one(seed):
    assert told(instances(seed)).fast in (None, (0, 1))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("louder", "whose"), [((1, 0), (0,)), ((0, 1), (1,)), ((1, 1), (0, 1))])
def test_more_noise_is_told_from_an_asymmetry_that_is_declared(seed, louder, whose):
    real = instances(seed, UNLIKE, tuple(4.0 * SIGMA * one for one in louder))
    assert told(real, instances(seed + 100, UNLIKE)).fast == whose


def test_where_only_the_simulators_instances_differ_nobody_has_more():
    for seed in SEEDS:
        assert told(instances(seed), instances(seed + 100, UNLIKE)).fast is None


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("own", [OFFSET, RAMP, -RAMP], ids=["offset", "ramp", "falling ramp"])
@pytest.mark.parametrize("which", [0, 1])
def test_the_one_that_is_off_the_reference_is_named(seed, own, which):
    real = instances(seed, added=(own, 0.0) if which == 0 else (0.0, own))
    assert told(real).slow == (which,)
    assert told(real[::-1]).slow == (which,)
    assert told(real, instances(seed + 100)) == FaultyInstances(slow=(which,))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("added", [(OFFSET, OFFSET), (RAMP, RAMP), (OFFSET, -OFFSET), (2.0 * OFFSET, OFFSET)])
def test_where_both_are_off_the_reference_nothing_says_which(seed, added):
    assert told(instances(seed, added=added)).slow is None


@pytest.mark.parametrize("seed", SEEDS)
def test_noise_of_one_and_an_offset_of_the_other_are_told_apart(seed):
    real = instances(seed, added=(3.0 * SIGMA, OFFSET))
    assert told(real, instances(seed + 100)) == FaultyInstances(slow=(1,), fast=(0,))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_simulator_at_another_rate_says_nothing_about_bands(seed):
    real = instances(seed, added=(3.0 * SIGMA, OFFSET))
    assert told(real, instances(seed + 100, rate=2.0 * RATE)) == FaultyInstances(slow=(1,))
    assert told(real, instances(seed + 100, rate=1.01 * RATE)).fast == (0,)


@pytest.mark.parametrize("sigma", [(SIGMA,), (SIGMA, SIGMA, SIGMA)])
def test_of_one_or_of_three_instances_nothing_is_said(sigma):
    added = (OFFSET, *[0.0] * (len(sigma) - 1))
    for sim in ((), instances(2)):
        assert faulty_instances_of(instances(1, sigma, added), sim) == {}


def test_sensors_are_told_apart():
    loud = instances(1, added=(3.0 * SIGMA, 0.0))
    alike = [dataclasses.replace(t, sensor=Sensor.ACCEL) for t in instances(2)]
    sim = instances(3)
    usual = [dataclasses.replace(t, sensor=Sensor.ACCEL) for t in instances(4)]
    assert faulty_instances_of([*alike, *loud], [*usual, *sim]) == {Sensor.GYRO: FaultyInstances(fast=(0,))}


def test_rows_that_either_has_not_are_left_out():
    one, other = instances(1, added=(3.0 * SIGMA, OFFSET))
    spoilt = one.measured.copy()
    spoilt[1000:1100] = 50.0
    spoilt[2000] = np.nan
    hole = np.arange(ROWS) // 100 != 10
    real = (dataclasses.replace(one, measured=spoilt), dataclasses.replace(other, observed=hole))
    assert told(real, instances(2)) == FaultyInstances(slow=(1,), fast=(0,))


def cut(trace, rows):
    return dataclasses.replace(
        trace, t=trace.t[rows], measured=trace.measured[rows], ideal=trace.ideal[rows], observed=trace.observed[rows]
    )


@pytest.mark.parametrize(
    ("early", "late"),
    [(slice(ROWS // 2), slice(ROWS // 2, ROWS)), (slice(ROWS - 1), slice(1, ROWS)), (slice(ROWS), slice(1, ROWS))],
    ids=["halves", "shifted", "longer"],
)
def test_instances_whose_rows_are_of_different_times_are_not_compared(early, late):
    one, other = instances(1, added=(3.0 * SIGMA, OFFSET))
    assert faulty_instances_of((cut(one, early), cut(other, late)), instances(2)) == {}
    assert faulty_instances_of((cut(one, early), cut(other, late))) == {}


def test_instances_without_a_common_row_are_not_compared():
    one, other = instances(1, added=(3.0 * SIGMA, OFFSET))
    first = np.arange(ROWS) < ROWS // 2
    apart = (dataclasses.replace(one, observed=first), dataclasses.replace(other, observed=~first))
    assert faulty_instances_of(apart, instances(2)) == {}
    assert told(instances(3, added=(3.0 * SIGMA, 0.0)), apart).fast == (0,)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("error", [0.03, -0.03])
def test_a_scale_error_goes_with_the_movement_and_says_nothing_of_noise(seed, error):
    one, other = instances(seed)
    scaled = dataclasses.replace(one, measured=(1.0 + error) * one.measured)
    assert told((scaled, other), instances(seed + 100)).fast is None


TILT = np.radians(2.0)
GRAVITY = np.array([0.0, 0.0, -9.80665])


def at_rest(first, second=(0.0, 0.0, 0.0)):
    """Two accelerometers at rest with an offset each, beside an attitude that is levelled by the first of them."""
    rng = np.random.default_rng(9)
    first, second = np.array(first), np.array(second)
    levelled = GRAVITY + first * [1.0, 1.0, 0.0]
    ideal = np.tile(levelled * 9.80665 / np.linalg.norm(levelled), (ROWS, 1))
    noise = SIGMA * rng.normal(size=(2, ROWS, 3))
    return tuple(
        Trace(Sensor.ACCEL, (i,), np.arange(ROWS) / RATE, GRAVITY + own + noise[i], ideal, np.ones(ROWS, dtype=bool))
        for i, own in enumerate((first, second))
    )


def of_accelerometers(real, tilt_sd=TILT):
    return faulty_instances_of(real, (), tilt_sd).get(Sensor.ACCEL, FaultyInstances())


@pytest.mark.parametrize("second", [(0.0, 0.0, 0.0), (0.0, 0.0, 0.01)])
def test_of_two_accelerometers_beside_an_uncertain_tilt_gravity_says_which_is_off(second):
    found = of_accelerometers(at_rest((0.3, -0.2, 0.15), second))
    assert (found.slow, found.certain) == ((0,), True)
    assert of_accelerometers(at_rest(second, (0.3, -0.2, 0.15))).slow == (1,)


def test_where_the_tilt_hides_all_of_it_nothing_says_which_accelerometer_is_off():
    assert of_accelerometers(at_rest((0.3, -0.2, 0.0))).slow is None


def test_an_attitude_that_is_known_well_says_which_accelerometer_is_off_by_all_axes():
    real = tuple(dataclasses.replace(t, ideal=np.tile(GRAVITY, (ROWS, 1))) for t in at_rest((0.3, -0.2, 0.0)))
    for tilt_sd in (0.0, 0.1 * np.hypot(0.3, 0.2) / 9.80665):
        found = of_accelerometers(real, tilt_sd)
        assert (found.slow, found.certain) == ((0,), False)


def test_in_free_fall_no_tilt_hides_anything():
    real = tuple(dataclasses.replace(t, ideal=np.zeros((ROWS, 3))) for t in at_rest((0.3, -0.2, 0.0)))
    assert not of_accelerometers(real).certain
