"""A pose that errs by a share of the movement is expected to err more where more moves."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.problem import ReferenceInfo, ReferenceKind, Trace
from mavcal.calib.gap.reference.expected_noise import movement_of, with_heave_noise, with_movement_noise
from mavcal.calib.gap.reference.noise import learned_spectrum, with_noise
from mavcal.calib.recording import Sensor

FS, N = 100.0, 16000
JITTER_S = 0.003


def moving(seed, size, jitter=JITTER_S, white=0.002):
    """Turns about 1 Hz, sampled at stamps that are off by `jitter` at random."""
    rng = np.random.default_rng(seed)
    t = np.arange(N) / FS
    hz, phase = rng.uniform(0.5, 1.5, (20, 3)), rng.uniform(0.0, 6.0, (20, 3))

    def rate(at):
        return size * np.sin(2.0 * np.pi * hz[None] * at[:, None, None] + phase[None]).sum(axis=1)

    measured = rate(t + jitter * rng.standard_normal(N)) + white * rng.standard_normal((N, 3))
    return Trace(Sensor.GYRO, (0,), t, measured, rate(t), np.ones(N, dtype=bool))


def expected(trace, nominal):
    known = with_noise(trace, learned_spectrum(nominal), None)
    return with_movement_noise(known, movement_of([nominal]))


def around(trace, hz):
    near = np.abs(trace.psd_hz - hz) < 0.3
    return trace.psd[near].mean(axis=0)


def in_band(trace):
    """Mean power of the residual where it moves, variance of a sample."""
    spectrum = np.abs(np.fft.rfft(trace.residual, axis=0)) ** 2 / N
    hz = np.fft.rfftfreq(N, 1.0 / FS)
    return spectrum[(hz > 0.6) & (hz < 1.4)].mean(axis=0)


def flexing(seed, size):
    """A body that bends by three percent, with no fixed phase."""
    trace = moving(seed, size, jitter=0.0)
    wander = np.cumsum(np.random.default_rng(seed + 50).standard_normal((N, 3)), axis=0)
    part = 0.03 * np.sin(0.05 * wander)
    return dataclasses.replace(trace, measured=trace.measured + part * trace.ideal)


@pytest.mark.parametrize("seed", range(3))
def test_a_livelier_recording_is_expected_to_be_worse_by_as_much(seed):
    calm, lively = flexing(seed, 0.05), flexing(seed + 10, 0.5)
    told = around(expected(lively, calm), 1.0)
    assert (np.abs(np.log(told / in_band(lively))) < np.log(2.0)).all()
    assert (around(with_noise(lively, learned_spectrum(calm), None), 1.0) < 0.05 * told).all()


def test_where_nothing_moves_nothing_is_added():
    calm, lively = flexing(1, 0.05), flexing(11, 0.5)
    known = with_noise(lively, learned_spectrum(calm), None)
    assert around(expected(lively, calm), 30.0) == pytest.approx(around(known, 30.0), rel=0.05)


def test_a_calmer_recording_is_not_expected_to_be_quieter():
    calm, lively = flexing(1, 0.05), flexing(11, 0.5)
    known = with_noise(calm, learned_spectrum(lively), None)
    found = expected(calm, lively)
    for hz in (0.1, 1.0, 10.0):
        assert around(found, hz) == pytest.approx(around(known, hz), rel=0.2)
    assert (in_band(calm) < around(found, 1.0)).all()


def test_no_more_than_the_movement_itself_is_expected():
    still, lively = moving(1, 1e-6, white=0.05), moving(11, 0.05)
    found = expected(lively, still)
    movement = dataclasses.replace(lively, measured=lively.ideal + lively.ideal)
    band = (found.psd_hz > 0.6) & (found.psd_hz < 1.4)
    assert (found.psd[band].mean(axis=0) < 2.0 * (in_band(movement) + 0.05**2)).all()


def test_white_noise_becomes_a_spectrum_where_it_must():
    calm, lively = moving(1, 1e-4, jitter=0.0), moving(11, 0.5, jitter=0.0)
    white = dataclasses.replace(lively, sigma=np.full(3, 0.002), sigma_dof=1e4)
    found = with_movement_noise(white, movement_of([calm]))
    assert around(found, 30.0) == pytest.approx(0.002**2, rel=0.05)
    assert (around(found, 1.0) > 0.002**2).all()


def test_what_is_held_against_another_instance_or_has_no_noise_stays():
    calm, lively = moving(1, 0.05), moving(11, 0.5)
    usual = movement_of([calm])
    pair = dataclasses.replace(with_noise(lively, learned_spectrum(calm), None), against=1)
    assert with_movement_noise(pair, usual) is pair
    assert with_movement_noise(lively, usual) is lively
    known = with_noise(lively, learned_spectrum(calm), None)
    assert with_movement_noise(known, {}) is known


FOLLOWED = ReferenceInfo(ReferenceKind.ESTIMATOR, bandwidth_hz=2.0, turns_hz=20.0)


def heaving(hz, size):
    """An accelerometer that feels a gust at `hz`, which its reference does not have."""
    t = np.arange(N) / FS
    rng = np.random.default_rng(8)
    felt = size * np.sin(2.0 * np.pi * hz * t)[:, None] * [0.1, 0.1, 1.0]
    measured = felt + 0.01 * rng.standard_normal((N, 3))
    return Trace(Sensor.ACCEL, (0,), t, measured, 0.0 * measured, np.ones(N, dtype=bool))


@pytest.mark.parametrize(("hz", "excused"), [(5.5, True), (30.0, False), (1.0, False)])
def test_what_a_reference_cannot_follow_of_a_body_is_expected_and_nothing_else(hz, excused):
    calm = heaving(hz, 0.0)
    known = dataclasses.replace(calm, psd=np.full((2, 3), 1e-4), psd_hz=np.array([0.01, 50.0]))
    lively = dataclasses.replace(known, measured=heaving(hz, 0.2).measured)
    made = with_heave_noise(lively, FOLLOWED)
    assert bool(np.interp(hz, made.psd_hz, made.psd[:, 2]) > 5e-4) is excused
    assert with_heave_noise(lively, ReferenceInfo(ReferenceKind.POSE)) is lively


@pytest.mark.parametrize(("sensor", "at_rest"), [(Sensor.ACCEL, False), (Sensor.GYRO, False), (Sensor.ACCEL, True)])
def test_what_shakes_a_flight_is_expected_unless_it_is_as_loud_at_rest(sensor, at_rest):
    """Turbulence is felt by a single unit, and is no noise of it."""
    t = np.arange(N) / FS
    rng = np.random.default_rng(9)
    flies = t > 0.2 * t[-1]
    shaken = np.ones(N) if at_rest else 1.0 * flies
    measured = 0.05 * shaken[:, None] * rng.standard_normal((N, 3)) + 0.01 * rng.standard_normal((N, 3))
    trace = Trace(sensor, (0,), t, measured, 0.0 * measured, np.ones(N, dtype=bool), throttle=0.4 * flies)
    lively = dataclasses.replace(trace, psd=np.full((2, 3), 1e-4), psd_hz=np.array([0.01, 50.0]))
    made = with_heave_noise(lively, FOLLOWED)
    assert bool(np.interp(35.0, made.psd_hz, made.psd[:, 2]) > 5e-4) is not at_rest
