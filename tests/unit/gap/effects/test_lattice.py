"""Levels, ends of the range, dead bands and held samples; and that plain sensors show none of them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.effects import by_id
from mavcal.calib.recording import Sensor

from .conftest import make
from .recovery import noisy, with_measured

KINDS = ("quantisation", "saturation", "dead_band", "hold")
SIGMA = {Sensor.ACCEL: 0.02, Sensor.GYRO: 0.003, Sensor.MAG: 0.3}


def _plain(sensor, kind="tumble", seed=1):
    return noisy(make(sensor, kind), np.zeros(3), SIGMA[sensor], seed)


@pytest.mark.parametrize("sensor", list(SIGMA))
@pytest.mark.parametrize("mission", ["static", "hover", "tumble"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_plain_sensor_shows_nothing(sensor, mission, kind):
    trace = _plain(sensor, mission)
    assert by_id()[f"{sensor}_{kind}"].detect(trace) is None
    short = trace.measured.astype(np.float32).astype(float)
    assert by_id()[f"{sensor}_{kind}"].detect(with_measured(trace, short)) is None


@pytest.mark.parametrize("sensor", list(SIGMA))
@pytest.mark.parametrize("steps", [0.1, 1.0, 5.0])
@pytest.mark.parametrize("mission", ["static", "tumble"])
def test_levels_are_found_unless_they_are_declared_or_simulated(sensor, steps, mission):
    trace = _plain(sensor, mission)
    q = np.array([1.0, 1.1, 0.9]) * steps * SIGMA[sensor]
    coarse = with_measured(trace, np.round(trace.measured / q) * q)
    effect = by_id()[f"{sensor}_quantisation"]
    found = effect.detect(coarse)
    assert found is not None
    found_steps = np.array(found.values)
    seen = found_steps > 0.0
    np.testing.assert_allclose(found_steps[seen], q[seen], rtol=1e-4)
    assert seen.any()
    assert not found.masked.any()
    assert effect.detect(dataclasses.replace(coarse, quantum=float(q.max()))) is None
    alike = np.round((trace.ideal + 0.5 * SIGMA[sensor] * np.sin(np.arange(len(trace.t)))[:, None]) / q) * q
    if mission == "tumble":
        assert effect.detect(dataclasses.replace(coarse, ideal=alike)) is None
    for other in ("saturation", "dead_band", "hold"):
        assert by_id()[f"{sensor}_{other}"].detect(coarse) is None


@pytest.mark.parametrize(("sensor", "limit"), [(Sensor.ACCEL, 8.0), (Sensor.GYRO, 0.6), (Sensor.MAG, 40.0)])
@pytest.mark.parametrize("q", [0.0, 0.01])
def test_an_end_of_the_range_is_found_unless_the_reference_has_it_too(sensor, limit, q):
    trace = _plain(sensor)
    levels = np.round(trace.measured / q) * q if q else trace.measured
    clipped = with_measured(trace, np.clip(levels, -limit, limit))
    found = by_id()[f"{sensor}_saturation"].detect(clipped)
    assert found is not None
    assert found.values[0] == pytest.approx(limit)
    assert (found.masked == (np.abs(clipped.measured) == limit).any(axis=1)).all()
    both = dataclasses.replace(clipped, ideal=np.clip(trace.ideal, -limit, limit))
    assert by_id()[f"{sensor}_saturation"].detect(both) is None
    assert by_id()[f"{sensor}_dead_band"].detect(clipped) is None
    assert by_id()[f"{sensor}_hold"].detect(clipped) is None


@pytest.mark.parametrize("phase", [0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
@pytest.mark.parametrize("off", [0.03, 0.5])
def test_a_quiet_sensor_that_dwells_at_its_largest_reading_is_at_no_end_of_the_range(phase, off):
    """Twenty rows of the same level beside a reference that is off, for some seconds, by `off` uT."""
    trace = _plain(Sensor.MAG)
    t = np.arange(len(trace.t)) / 10.0
    dwelling = np.clip(np.abs(t - t[-1] / 2.0) - 1.0, 0.0, None)
    true = np.array([20.0, -40.0, 45.0]) * np.cos(np.minimum(0.5 * dwelling, 1.0) + 0.003 * dwelling)[:, None]
    wandering = off * np.sin(0.4 * t + phase)[:, None]
    quiet = dataclasses.replace(trace, t=t, ideal=true + wandering, quantum=0.1)
    assert by_id()["mag_saturation"].detect(with_measured(quiet, np.round(true, 1))) is None


@pytest.mark.parametrize("sensor", [Sensor.ACCEL, Sensor.GYRO])
def test_a_dead_band_is_found(sensor):
    trace = _plain(sensor)
    width = 6.0 * SIGMA[sensor]
    measured = np.where(np.abs(trace.measured) < width, 0.0, trace.measured)
    found = by_id()[f"{sensor}_dead_band"].detect(with_measured(trace, measured))
    assert found is not None
    np.testing.assert_allclose(found.values, width, rtol=0.2)
    assert (found.masked == (measured == 0.0).any(axis=1)).all()
    assert by_id()[f"{sensor}_saturation"].detect(with_measured(trace, measured)) is None


def test_a_dead_zone_whose_edges_are_joined_is_found_with_its_width():
    trace = _plain(Sensor.GYRO)
    v = trace.measured + 0.002
    measured = np.sign(v) * np.maximum(np.abs(v) - 0.03, 0.0)
    found = by_id()["gyro_dead_band"].detect(with_measured(trace, measured))
    assert found is not None
    np.testing.assert_allclose(found.values, 0.03, rtol=0.05)


@pytest.mark.parametrize("mission", ["static", "tumble"])
def test_held_samples_are_found_with_their_time(mission):
    trace = _plain(Sensor.MAG, mission)
    held = with_measured(trace, trace.measured[np.arange(len(trace.t)) // 5 * 5])
    found = by_id()["mag_hold"].detect(held)
    assert found is not None
    assert found.values[0] == pytest.approx(0.05, rel=0.01)
    assert found.values[1] == pytest.approx(0.8, rel=0.01)
    assert found.masked.sum() == 5600
    dropped = trace.measured.copy()
    rows = np.random.default_rng(2).choice(np.arange(1, len(dropped)), 40, replace=False)
    dropped[rows] = dropped[rows - 1]
    assert by_id()["mag_hold"].detect(with_measured(trace, dropped)) is not None


def test_a_recording_in_which_the_simulator_is_held_as_well_shows_no_hold():
    trace = _plain(Sensor.MAG)
    rows = np.arange(len(trace.t)) // 2 * 2
    alike = dataclasses.replace(trace, measured=trace.measured[rows], ideal=trace.ideal[rows])
    assert by_id()["mag_hold"].detect(alike) is None


@pytest.mark.parametrize("seed", range(6))
def test_uniform_noise_on_coarse_levels_is_not_held(seed):
    trace = make(Sensor.ACCEL, "static")
    q, rng = 0.0098, np.random.default_rng(seed)
    noise = np.convolve(rng.uniform(-0.012, 0.012, 3 * len(trace.t) + 2), np.ones(3) / 3.0, "valid")
    values = trace.ideal + rng.uniform(-q, q, 3) + noise.reshape(-1, 3)
    assert by_id()["accel_hold"].detect(with_measured(trace, np.round(values / q) * q)) is None


@pytest.mark.parametrize("seed", range(3))
def test_a_few_held_rows_show_between_levels_that_repeat_by_chance(seed):
    sensor, q = Sensor.GYRO, 0.4 * SIGMA[Sensor.GYRO]
    plain = noisy(make(sensor, "tumble", fs=10.0), np.zeros(3), SIGMA[sensor], seed)
    rounded = with_measured(plain, np.round(plain.measured / q) * q)
    assert by_id()["gyro_hold"].detect(rounded) is None
    held = rounded.measured.copy()
    speed = np.abs(np.diff(plain.ideal, axis=0)).max(axis=1)
    rows = np.flatnonzero(speed > np.median(speed))[5:-5:40] + 1
    held[rows] = held[rows - 1]
    found = by_id()["gyro_hold"].detect(with_measured(rounded, held))
    assert found is not None
    assert found.masked[rows].all()


@pytest.mark.parametrize("seed", range(3))
def test_rows_that_are_held_while_the_sensor_turns_show_among_more_repeats_of_a_sensor_at_rest(seed):
    sensor, q = Sensor.GYRO, 0.9 * SIGMA[Sensor.GYRO]
    moving = make(sensor, "tumble")
    rest = np.arange(len(moving.t)) < 5 * len(moving.t) // 6
    trace = dataclasses.replace(moving, ideal=np.where(rest[:, None], moving.ideal[:1], 8.0 * moving.ideal))
    plain = noisy(trace, np.zeros(3), SIGMA[sensor], seed)
    rounded = with_measured(plain, np.round(plain.measured / q) * q)
    assert by_id()["gyro_hold"].detect(rounded) is None
    repeats = (np.diff(rounded.measured, axis=0) == 0.0).all(axis=1)
    held = rounded.measured.copy()
    rows = np.flatnonzero(~rest)[20::60]
    assert len(rows) < repeats[rest[1:]].sum()
    held[rows] = held[rows - 1]
    found = by_id()["gyro_hold"].detect(with_measured(rounded, held))
    assert found is not None
    assert found.masked[rows].all()
