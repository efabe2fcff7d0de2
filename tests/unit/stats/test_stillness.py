from __future__ import annotations

import dataclasses
import doctest

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mavcal.calib.stats.stillness
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.recording import Channel, Recording, Sensor, Stage
from mavcal.calib.stats.still_limits import HELD, RESTING
from mavcal.calib.stats.stillness import Still, StillnessDetector, find_still, pose_means
from tests.examples import examples

G = 9.80665


def accel_and_gyro(force, rates, rate=50.0, noise=(0.02, 0.001), seed=0):
    """Channels of given specific force and rates (N, 3) with noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(len(force)) / rate
    a = np.asarray(force, dtype=float) + noise[0] * rng.normal(size=(len(t), 3))
    w = np.asarray(rates, dtype=float) + noise[1] * rng.normal(size=(len(t), 3))
    return (
        Channel(Sensor.ACCEL, 0, t, a, "m/s2", Stage.RAW, "test"),
        Channel(Sensor.GYRO, 0, t, w, "rad/s", Stage.RAW, "test"),
    )


def level(n):
    return np.tile([0.0, 0.0, -G], (n, 1))


def test_every_held_pose_is_found_between_the_turns(held_poses):
    stills = find_still(held_poses(np.random.default_rng(1)))
    assert len(stills) == 10
    for k, still in enumerate(stills):
        held = (k * 4.5, k * 4.5 + 3.0)
        assert held[0] - 0.15 <= still.start < still.end <= held[1] + 0.15
        assert still.duration > 2.3


@pytest.mark.parametrize("noise", [(0.1, 0.01), (0.001, 0.00005)])
def test_noisy_and_quiet_sensors_rest_alike(noise):
    accel, gyro = accel_and_gyro(level(500), np.zeros((500, 3)), noise=noise)
    (still,) = find_still(Recording((accel, gyro)), limits=RESTING)
    assert still.start == 0.0
    assert still.duration > 9.5
    assert still.accel == pytest.approx([0.0, 0.0, -G], abs=0.03)


@settings(max_examples=examples(25), deadline=None)
@given(st.lists(st.integers(1, 400), min_size=1, max_size=30))
def test_spans_do_not_depend_on_the_chunks(sizes):
    force = np.concatenate([level(300), level(100) + np.array([3.0, 0.0, 1.0]), level(300)])
    rates = np.concatenate([np.zeros((300, 3)), np.full((100, 3), 0.9), np.zeros((300, 3))])
    accel, gyro = accel_and_gyro(force, rates)
    whole = find_still(Recording((accel, gyro)))
    detector = StillnessDetector(HELD)
    found, at = [], 0
    for size in [*sizes, len(accel)]:
        rows = slice(at, at + size)
        found += detector.feed(accel.take(rows), gyro.take(rows))
        at += size
    found += detector.finish()
    assert [(s.start, s.end) for s in found] == [(s.start, s.end) for s in whole]
    assert len(whole) == 2


def test_the_open_span_and_the_reason_are_told_live():
    accel, gyro = accel_and_gyro(np.concatenate([level(200), level(50)]), [*np.zeros((200, 3)), *np.full((50, 3), 2.0)])
    detector = StillnessDetector(HELD)
    assert detector.current is None
    assert detector.reason == "no samples yet"
    detector.feed(accel.take(slice(0, 200)), gyro.take(slice(0, 200)))
    assert detector.current is not None
    assert detector.current.duration > 3.0
    assert detector.reason == ""
    (ended,) = detector.feed(accel.take(slice(200, 250)), gyro.take(slice(200, 250)))
    assert ended.end < 4.1
    assert detector.current is None
    assert detector.reason == "it turns"


def test_a_slow_tilt_is_not_rest():
    angle = np.radians(3.0) * np.arange(500) / 50.0
    force = np.column_stack([G * np.sin(angle), 0 * angle, -G * np.cos(angle)])
    accel, gyro = accel_and_gyro(force, np.tile([0.0, np.radians(3.0), 0.0], (500, 1)))
    assert find_still(Recording((accel, gyro)), limits=RESTING) == ()


def test_shaking_is_named():
    rng = np.random.default_rng(2)
    accel, gyro = accel_and_gyro(level(200) + 3.0 * rng.normal(size=(200, 3)), np.zeros((200, 3)))
    detector = StillnessDetector(RESTING)
    detector.feed(accel, gyro)
    assert detector.current is None
    assert "accelerometer" in detector.reason
    assert "shakes" in detector.reason


def test_a_hole_in_the_samples_ends_a_span():
    accel, gyro = accel_and_gyro(level(600), np.zeros((600, 3)))
    keep = np.r_[0:250, 350:600]
    stills = find_still(Recording((accel.take(keep), gyro.take(keep))))
    assert len(stills) == 2
    assert stills[0].end <= 5.0
    assert stills[1].start >= 7.0


def test_a_changed_rate_splits_a_rest():
    rates = np.concatenate([np.zeros((250, 3)), np.tile([0.0, 0.0, 0.05], (250, 1))])
    stills = find_still(Recording(accel_and_gyro(level(500), rates)), limits=RESTING)
    assert len(stills) == 2
    assert stills[0].end <= 5.01
    assert stills[1].start >= 5.0


def test_one_sensor_is_enough_and_none_is_not():
    accel, gyro = accel_and_gyro(level(200), np.zeros((200, 3)))
    assert len(find_still(Recording((accel,)))) == 1
    assert len(find_still(Recording((gyro,)))) == 1
    with pytest.raises(InvalidInputError, match="neither"):
        find_still(Recording(()))
    with pytest.raises(InvalidInputError, match="at least one"):
        StillnessDetector(accel=False, gyro=False)


def test_a_gyroscope_in_counts_is_judged_by_its_own_floor():
    rng = np.random.default_rng(3)
    w = 32_000.0 + 5.0 * rng.normal(size=(600, 3))
    w[250:350] += 900.0
    t = np.arange(600) / 50.0
    gyro = Channel(Sensor.GYRO, 0, t, w, "counts", Stage.RAW, "test")
    stills = find_still(Recording((gyro,)))
    assert len(stills) == 2


def test_rows_without_numbers_are_skipped_and_time_may_not_go_back():
    accel, gyro = accel_and_gyro(level(300), np.zeros((300, 3)))
    holed = dataclasses.replace(accel, values=np.where(np.arange(300)[:, None] % 7 == 0, np.nan, accel.values))
    assert len(find_still(Recording((holed, gyro)))) == 1
    detector = StillnessDetector(HELD)
    detector.feed(accel, gyro)
    with pytest.raises(InvalidInputError, match="goes back"):
        detector.feed(accel, gyro)


def test_no_samples_make_no_span():
    accel, gyro = accel_and_gyro(level(5), np.zeros((5, 3)))
    assert find_still(Recording((accel, gyro))) == ()


def test_pose_means_have_the_length_of_gravity_within_their_sd(held_poses):
    z = []
    for seed in range(12):
        recording = held_poses(np.random.default_rng(seed), accel_offset=(0.0, 0.0, 0.0))
        accel, gyro = recording.channel(Sensor.ACCEL), recording.channel(Sensor.GYRO)
        for pose in pose_means(accel, find_still(recording), gyro=gyro):
            along = pose.mean / np.linalg.norm(pose.mean)
            z.append((np.linalg.norm(pose.mean) - G) / np.sqrt(along @ pose.covariance @ along))
    assert len(z) > 100
    assert 0.6 < np.mean(np.square(z)) < 1.6


def test_tremor_does_not_shorten_gravity(held_poses):
    recording = held_poses(
        np.random.default_rng(4),
        tremor_deg=0.7,
        accel_noise=0.0,
        gyro_noise=0.0,
        quantised=False,
        accel_offset=(0.0, 0.0, 0.0),
        hold=6.0,
    )
    accel, gyro = recording.channel(Sensor.ACCEL), recording.channel(Sensor.GYRO)
    stills = find_still(recording)
    plain = [G - np.linalg.norm(p.mean) for p in pose_means(accel, stills)]
    freed = [G - np.linalg.norm(p.mean) for p in pose_means(accel, stills, gyro=gyro)]
    assert np.mean(plain) > 5e-4
    assert np.abs(np.mean(freed)) < 0.1 * np.mean(plain)


def test_a_gyro_bias_that_differs_from_pose_to_pose_is_no_tremor():
    """While a sensor warms up its gyro drifts by more than a hand turns."""
    spans = tuple(Still(4.0 * k, 4.0 * k + 4.0, None, None) for k in range(5))
    bias = np.repeat(np.linspace(-0.03, 0.03, 5), 200)
    accel, gyro = accel_and_gyro(level(1000), np.outer(bias, [1.0, 0.5, 0.0]), noise=(0.0, 0.0))
    for pose in pose_means(accel, spans, gyro=gyro):
        assert np.linalg.norm(pose.mean) == pytest.approx(np.linalg.norm(level(1)), abs=1e-6)


def test_a_slow_turn_in_the_hand_does_not_shorten_gravity():
    t = np.arange(600) / 100.0
    angle = np.radians(1.5) * t / 6.0
    accel, gyro = accel_and_gyro(
        -G * np.stack([-np.sin(angle), np.zeros(600), np.cos(angle)], axis=1),
        np.tile([0.02, np.radians(0.25) + 0.01, -0.01], (600, 1)),
        rate=100.0,
        noise=(0.0, 0.0),
    )
    (plain,) = pose_means(accel, (Still(0.0, 6.0, None, None),))
    (freed,) = pose_means(accel, (Still(0.0, 6.0, None, None),), gyro=gyro)
    short = G - np.linalg.norm(plain.mean)
    assert short > 2e-4
    assert abs(G - np.linalg.norm(freed.mean)) < 0.05 * short


def test_a_pose_carries_its_temperature_and_rate():
    accel, gyro = accel_and_gyro(level(200), np.tile([0.0, 0.01, 0.0], (200, 1)))
    temperature = Channel(
        Sensor.TEMPERATURE, 0, np.array([0.0, 1.0, 2.0]), np.array([30.0, 31.0, 32.0]), "degC", Stage.RAW, "t"
    )
    (pose,) = pose_means(accel, (Still(1.0, 3.0, None, None),), gyro=gyro, temperature=temperature)
    assert pose.temperature == 31.5
    assert pose.rate == pytest.approx([0.0, 0.01, 0.0], abs=1e-3)
    assert pose.n == 100
    (later,) = pose_means(accel, (Still(3.2, 3.9, None, None),), temperature=temperature)
    assert later.temperature == 32.0
    assert later.rate is None


def test_spans_with_hardly_a_sample_make_no_pose():
    accel, _ = accel_and_gyro(level(200), np.zeros((200, 3)))
    assert pose_means(accel, (Still(1.0, 1.1, None, None),)) == ()


def test_the_example_of_the_detector():
    assert doctest.testmod(mavcal.calib.stats.stillness).failed == 0


def test_a_hole_of_years_costs_no_more_than_its_samples():
    """A damaged stamp once asked for an array of 866 TiB."""
    t = np.concatenate([np.arange(0.0, 20.0, 0.02), 2e9 + np.arange(0.0, 20.0, 0.02)])
    channel = Channel(Sensor.ACCEL, 0, t, np.tile([0.0, 0.0, -9.8], (len(t), 1)), "m/s2", Stage.RAW, "made")
    found = find_still(Recording((channel,)))
    near = [find_still(Recording((channel.between(a, a + 100.0),))) for a in (0.0, 2e9)]
    assert len(found) == 2
    for one, (alone,) in zip(found, near, strict=True):
        assert (one.start, one.end) == pytest.approx((alone.start, alone.end), abs=0.6)
    with pytest.raises(InvalidInputError, match="years"):
        find_still(Recording((dataclasses.replace(channel, t=t * 1000.0),)))


def test_judging_in_blocks_changes_no_digit(monkeypatch):
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.choice((0.01, 0.02, 0.5, 3.0), p=(0.5, 0.45, 0.04, 0.01), size=6000))
    x = np.repeat(rng.normal(scale=5.0, size=(30, 3)), 200, axis=0) + rng.normal(scale=0.02, size=(6000, 3))
    recording = Recording((Channel(Sensor.ACCEL, 0, t, x, "m/s2", Stage.RAW, "made"),))
    whole = find_still(recording)
    assert whole
    monkeypatch.setattr("mavcal.calib.stats.stillness.BLOCK", 7)
    for one, other in zip(find_still(recording), whole, strict=True):
        assert (one.start, one.end) == (other.start, other.end)
        assert repr(one) == repr(other)
