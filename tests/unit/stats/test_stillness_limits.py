"""What counts as still, each limit from both sides, and what a pose takes from the sensors beside it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.recording import Channel, Recording, Sensor, Stage
from mavcal.calib.stats.still_limits import HELD, RESTING, StillnessLimits
from mavcal.calib.stats.stillness import LONGEST_S, Still, StillnessDetector, find_still, pose_means

G = 9.80665
RATE = 64.0  # Hz; times that binary numbers hold exactly
DOWN = np.array([0.0, 0.0, -G])


def made(sensor: Sensor, values: np.ndarray, unit: str) -> Channel:
    values = np.asarray(values, dtype=float)
    return Channel(sensor, 0, np.arange(len(values)) / RATE, values, unit, Stage.RAW, "made")


def accel(values: np.ndarray) -> Channel:
    return made(Sensor.ACCEL, values, "m/s2")


def gyro(values: np.ndarray) -> Channel:
    return made(Sensor.GYRO, values, "rad/s")


def level(seconds: float) -> np.ndarray:
    return np.tile(DOWN, (int(seconds * RATE), 1))


def alternating(n: int, size: float) -> np.ndarray:
    """A column of scatter `size` without trend or mean."""
    return size * np.where(np.arange(n) % 2, 1.0, -1.0)


def reason_after(limits: StillnessLimits, a: np.ndarray | None, w: np.ndarray | None) -> str:
    detector = StillnessDetector(limits, accel=a is not None, gyro=w is not None)
    detector.feed(None if a is None else accel(a), None if w is None else gyro(w))
    return detector.reason


@pytest.mark.parametrize("limits", [HELD, RESTING])
@pytest.mark.parametrize(("share", "said"), [(0.9, ""), (1.1, "the accelerometer shakes")])
def test_an_accelerometer_may_shake_by_a_share_of_gravity(limits, share, said):
    shaken = level(2.0)
    shaken[:, 0] = alternating(len(shaken), share * limits.accel_scatter * G)
    assert reason_after(limits, shaken, None) == said


@pytest.mark.parametrize("limits", [HELD, RESTING])
@pytest.mark.parametrize(("share", "said"), [(0.9, ""), (1.1, "the gyroscope shakes")])
def test_a_gyroscope_may_shake_by_its_own_limit(limits, share, said):
    shaken = np.zeros((128, 3))
    shaken[:, 2] = alternating(128, share * limits.gyro_scatter)
    assert reason_after(limits, None, shaken) == said


def test_the_scatter_of_three_axes_counts_together():
    """Each axis shakes by seven tenths of the limit: their length is above it."""
    each = np.column_stack([alternating(128, 0.7 * HELD.gyro_scatter)] * 3)
    assert reason_after(HELD, None, each) == "the gyroscope shakes"
    each[:, 1:] = 0.0
    assert reason_after(HELD, None, each) == ""


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("share", "said"), [(0.98, ""), (1.02, "it turns")])
def test_a_rate_may_be_as_large_as_a_bias(axis, share, said):
    turning = np.zeros((128, 3))
    turning[:, axis] = -share * HELD.rate
    assert reason_after(HELD, None, turning) == said


@pytest.mark.parametrize("limits", [HELD, RESTING])
@pytest.mark.parametrize(("share", "said"), [(0.95, ""), (1.05, "it tilts")])
def test_gravity_may_turn_by_the_tilt_within_one_window(limits, share, said):
    angle = share * limits.tilt * np.arange(32) / (RATE * limits.window)
    tilting = G * np.column_stack([np.sin(angle), np.zeros(32), -np.cos(angle)])
    assert reason_after(limits, np.vstack([tilting, tilting[-1:]]), None) == said


def test_counts_of_any_size_have_the_same_limits():
    shaken = level(2.0)
    shaken[:, 1] = alternating(len(shaken), 0.9 * HELD.accel_scatter * G)
    assert reason_after(HELD, 1e4 * shaken, None) == ""
    shaken[:, 1] *= 1.2
    assert reason_after(HELD, 1e4 * shaken, None) == "the accelerometer shakes"


@pytest.mark.parametrize(("per_window", "said"), [(4, ""), (3, "samples are missing")])
def test_a_window_needs_four_samples(per_window, said):
    t = np.arange(60) * HELD.window / per_window
    channel = Channel(Sensor.ACCEL, 0, t, np.tile(DOWN, (60, 1)), "m/s2", Stage.RAW, "made")
    detector = StillnessDetector(HELD, gyro=False)
    detector.feed(channel, None)
    assert detector.reason == said


@pytest.mark.parametrize(("share", "spans"), [(0.9, 1), (1.1, 2)])
def test_a_reading_that_leaves_its_span_begins_another(share, spans):
    moved = level(8.0)
    moved[256:, 0] = share * RESTING.accel_drift * G
    limits = dataclasses.replace(RESTING, tilt=1.0, accel_scatter=1.0)  # the step itself is no motion
    found = find_still(Recording((accel(moved),)), limits=limits)
    assert len(found) == spans
    if spans == 2:
        assert found[0].end <= found[1].start


@pytest.mark.parametrize(("share", "spans"), [(0.9, 1), (1.1, 2)])
def test_a_bias_that_leaves_its_span_begins_another(share, spans):
    moved = np.zeros((512, 3))
    moved[256:, 1] = share * RESTING.gyro_drift
    limits = dataclasses.replace(RESTING, gyro_scatter=1.0)
    assert len(find_still(Recording((gyro(moved),)), limits=limits)) == spans


def test_a_slow_change_is_named():
    slowly = level(2.0)
    slowly[64:, 0] = 2.0 * RESTING.accel_drift * G
    limits = dataclasses.replace(RESTING, tilt=1.0, accel_scatter=1.0)
    detector = StillnessDetector(limits, gyro=False)
    reasons = set()
    for k in range(0, len(slowly), 4):
        detector.feed(accel(slowly).take(slice(k, k + 4)), None)
        reasons.add(detector.reason)
    assert any("slowly" in reason for reason in reasons)


@pytest.mark.parametrize(("seconds", "spans"), [(0.875, 0), (1.0, 1)])
def test_a_span_is_as_long_as_asked_for_or_none(seconds, spans):
    n = int(seconds * RATE) + 1
    assert len(find_still(Recording((accel(level(4.0)[:n]),)))) == spans


def test_half_a_window_is_taken_off_where_motion_borders():
    """Windows that touch the motion are judged by it; the ones beside them may have caught its edge."""
    rates = np.zeros((640, 3))
    rates[256:384] = 3.0
    first, second = find_still(Recording((gyro(rates),)))
    assert first.start == 0.0
    assert 4.0 - HELD.window <= first.end <= 4.0 - 0.5 * HELD.window + HELD.window / 4.0
    assert 6.0 + 0.25 * HELD.window <= second.start <= 6.0 + HELD.window
    assert second.end == pytest.approx(639.0 / RATE, abs=HELD.window / 4.0)


def test_a_span_has_the_means_of_its_windows():
    rng = np.random.default_rng(4)
    a, w = level(4.0) + 0.01 * rng.normal(size=(256, 3)), 0.02 + 0.001 * rng.normal(size=(256, 3))
    (still,) = find_still(Recording((accel(a), gyro(w))))
    assert still.accel == pytest.approx(a.mean(axis=0), abs=0.002)
    assert still.gyro == pytest.approx(w.mean(axis=0), abs=2e-4)
    assert still.duration == still.end - still.start
    (alone,) = find_still(Recording((accel(a),)))
    assert alone.gyro is None


def test_a_sensor_that_is_not_fed_holds_the_judgement_back():
    detector = StillnessDetector(HELD)
    assert detector.feed(accel(level(4.0)), None) == ()
    assert detector.reason == "no samples yet"
    detector.feed(None, gyro(np.zeros((128, 3))))
    assert detector.current.end == pytest.approx(2.0, abs=HELD.window / 4.0)  # as far as both have come


def test_finishing_closes_the_open_span_once():
    detector = StillnessDetector(HELD, gyro=False)
    detector.feed(accel(level(4.0)), None)
    assert len(detector.finish()) == 1
    assert detector.finish() == ()
    assert detector.current is None


def test_time_that_stands_is_no_other_boot():
    t = np.repeat(np.arange(0.0, 4.0, 0.05), 2)
    channel = Channel(Sensor.ACCEL, 0, t, np.tile(DOWN, (len(t), 1)), "m/s2", Stage.RAW, "made")
    assert len(find_still(Recording((channel,)))) == 1


@pytest.mark.parametrize(("seconds", "fails"), [(0.99 * LONGEST_S, False), (1.01 * LONGEST_S, True)])
def test_a_century_is_the_longest_recording(seconds, fails):
    a = accel(level(4.0))
    later = dataclasses.replace(a, t=a.t + seconds)
    detector = StillnessDetector(HELD, gyro=False)
    detector.feed(a, None)
    if fails:
        with pytest.raises(InvalidInputError, match="the samples span 101 years: give t in seconds"):
            detector.feed(later, None)
    else:
        assert len(detector.feed(later, None)) == 1  # the hole ends the first span


def test_an_accelerometer_in_counts_is_judged_about_the_centre_of_its_poses():
    """A far offset would hide what gravity is, and with it every limit."""
    rng = np.random.default_rng(6)
    faces = np.concatenate([np.eye(3), -np.eye(3)])
    held = np.concatenate([np.repeat(face[None], 192, axis=0) for face in faces])
    counts = 16_384.0 * held + 30.0 * rng.normal(size=held.shape)
    centred = find_still(Recording((made(Sensor.ACCEL, counts, "counts"),)), limits=RESTING)
    far = find_still(Recording((made(Sensor.ACCEL, counts + np.array([9e4, -2e5, 5e4]), "counts"),)), limits=RESTING)
    assert len(centred) == 6
    assert [(s.start, s.end) for s in far] == [(s.start, s.end) for s in centred]


@pytest.mark.parametrize(("samples", "poses"), [(7, 0), (8, 1)])
def test_eight_samples_make_a_pose(samples, poses):
    end = (samples - 0.5) / RATE
    assert len(pose_means(accel(level(2.0)), (Still(0.0, end, None, None),))) == poses


def test_rows_without_numbers_do_not_count_in_a_pose():
    values = level(2.0)
    values[3, 1] = np.nan
    values[64:, 0] = np.inf
    (pose,) = pose_means(accel(values), (Still(0.0, 2.0, None, None),))
    assert pose.n == 63
    assert pose.mean == pytest.approx(DOWN)


def test_a_gyroscope_of_unknown_unit_tells_neither_rate_nor_tremor():
    tremor = np.sin(2.0 * np.pi * np.arange(128) / 16.0)[:, None] * [500.0, 0.0, 0.0]
    spans = (Still(0.0, 2.0, None, None),)
    (plain,) = pose_means(accel(level(2.0)), spans)
    (beside,) = pose_means(accel(level(2.0)), spans, gyro=made(Sensor.GYRO, tremor, "counts"))
    assert beside.rate is None
    assert beside.mean.tolist() == plain.mean.tolist()


def test_tremor_shortens_gravity_across_its_axis_alone():
    """Angles of variance S about x: y and z are short by S/2, x is not."""
    omega, amplitude = 2.0 * np.pi * 4.0, 0.03
    t = np.arange(128) / RATE
    rates = np.outer(omega * amplitude * np.cos(omega * t), [1.0, 0.0, 0.0])
    tilted = np.tile([3.0, 4.0, -8.0], (128, 1))
    (pose,) = pose_means(accel(tilted), (Still(0.0, 2.0, None, None),), gyro=gyro(rates))
    grown = pose.mean / tilted[0] - 1.0
    assert grown[0] == pytest.approx(0.0, abs=1e-9)
    assert grown[1:] == pytest.approx(np.full(2, 0.25 * amplitude**2), rel=0.1)


@pytest.mark.parametrize(("times", "said"), [((0.5, 1.0), 25.0), ((5.0,), 20.0), ((), None)])
def test_a_pose_is_as_warm_as_the_last_thermometer_said(times, said):
    readings = np.array([20.0, 30.0])[: len(times)]
    warmth = Channel(Sensor.TEMPERATURE, 0, np.array(times), readings[:, None], "degC", Stage.RAW, "made")
    (pose,) = pose_means(accel(level(2.0)), (Still(0.0, 2.0, None, None),), temperature=warmth)
    assert pose.temperature == said


def test_a_thermometer_that_reads_no_number_says_nothing():
    warmth = Channel(Sensor.TEMPERATURE, 0, np.array([0.5]), np.array([[np.nan]]), "degC", Stage.RAW, "made")
    (pose,) = pose_means(accel(level(2.0)), (Still(0.0, 2.0, None, None),), temperature=warmth)
    assert pose.temperature is None
