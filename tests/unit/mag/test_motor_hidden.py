"""What a term gains on samples that were hidden from the fit, and how blocks and stretches cut a flight."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.earth import EarthField
from mavcal.calib.mag.flight_input import prepared
from mavcal.calib.mag.flight_path import Turning
from mavcal.calib.mag.motor_drives import Drive, DriveKind
from mavcal.calib.mag.motor_hidden import BLOCK, STRETCHES, Hidden, blocks_of, by_log
from mavcal.calib.mag.result import MagContext
from mavcal.calib.recording import Channel, Sensor, Stage

FIELD = np.array([21.0, 2.0, 43.0])
OFFSET = np.array([4.0, -7.0, 2.0])
TERM = np.array([[0.3, -0.2, 0.4]])


@pytest.mark.parametrize(
    ("seconds", "blocks"), [(20.0, 5), (75.0, 5), (89.9, 5), (90.1, 6), (149.0, 9), (150.5, 10), (900.0, 10)]
)
def test_a_flight_has_a_block_each_quarter_of_a_minute_five_to_ten(seconds, blocks):
    found = blocks_of(np.linspace(100.0, 100.0 + seconds, 1000))
    assert BLOCK == 15.0
    assert np.unique(found).tolist() == list(range(blocks))
    assert (np.diff(found) >= 0).all()
    assert np.bincount(found).min() >= 1000 // blocks - 2  # the last sample belongs to the last block


def test_a_residual_far_beyond_the_others_counts_as_five_of_them():
    lengths = np.concatenate([np.full(99, 2.0), [1e3]])
    hidden = Hidden.of(lengths, np.zeros(100, dtype=np.intp))
    assert hidden.lengths.max() == 10.0
    assert hidden.rms == pytest.approx(np.sqrt((99 * 4.0 + 100.0) / 100.0))


def test_the_score_of_a_block_is_its_mean_square():
    hidden = Hidden(np.array([1.0, 3.0, 2.0, 2.0, 4.0]), np.array([0, 0, 2, 2, 3]))
    assert hidden.scores.tolist() == [5.0, 4.0, 16.0]


def test_every_stretch_tells_its_gain_and_how_sure_it_is():
    rng = np.random.default_rng(1)
    block = np.repeat(np.arange(6), 200)
    plain = 3.0 + 0.5 * rng.normal(size=1200)
    better = Hidden(plain - np.repeat([1.0, 0.0, -1.0], 400) - 0.2 * rng.normal(size=1200), block)
    gains, sds = better.gains_over(Hidden(plain, block))
    assert len(gains) == STRETCHES
    assert gains == pytest.approx([1.0, 0.0, -1.0], abs=0.04)
    assert sds == pytest.approx(np.full(3, 0.2 / np.sqrt(400.0)), rel=0.2)
    back, _ = Hidden(plain, block).gains_over(better)
    assert back == pytest.approx(-gains)


def test_residuals_that_hang_together_make_a_gain_less_sure():
    rng = np.random.default_rng(2)
    block = np.repeat(np.arange(6), 200)
    white, slow = rng.normal(size=1200), np.repeat(rng.normal(size=60), 20)
    plain = Hidden(np.full(1200, 9.0), block)
    sd_white = Hidden(9.0 - white, block).gains_over(plain)[1]
    sd_slow = Hidden(9.0 - slow, block).gains_over(plain)[1]
    assert (sd_slow > 2.5 * sd_white).all()


@pytest.fixture(scope="module")
def flight():
    """A flight whose log has the true attitude, with a current that comes and goes."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 100.0, 0.1)
    angles = np.column_stack([0.2 * t, 0.3 * np.sin(0.5 * t), 0.3 * np.cos(0.4 * t)])
    attitude = Rotation.from_euler("ZYX", angles)
    amperes = 10.0 + 8.0 * np.sin(0.21 * t)
    drive = Drive.of(DriveKind.CURRENT, Channel(Sensor.CURRENT, 0, t, amperes[:, None], "A", Stage.RAW, "made"))
    slow = drive.columns(t)[:, :1]
    seen = attitude.inv().apply(FIELD) + OFFSET + slow @ TERM + 0.2 * rng.normal(size=(len(t), 3))
    said = Channel(Sensor.ATTITUDE, 0, t, attitude.as_quat()[:, [3, 0, 1, 2]], "1", Stage.RAW, "made")
    mag = Channel(Sensor.MAG, 0, t, seen, "uT", Stage.RAW, "made")
    return prepared(mag, Turning(None, said), None, drive, 0.0, MagContext()), drive


@pytest.mark.parametrize("known", [True, False])
def test_the_logs_attitude_finds_term_and_offset_within_their_sd(flight, known):
    data, drive = flight
    context = MagContext(field=EarthField(FIELD)) if known else MagContext()
    found = by_log(data, drive, TERM, np.eye(3), context)
    assert (np.abs(found.term - TERM) < 4.0 * found.term_sd).all()
    assert found.term_sd.max() < 0.01
    assert found.offset == pytest.approx(OFFSET, abs=0.5)
    assert found.rms == pytest.approx(0.2 * np.sqrt(3.0), rel=0.05)
    assert found.hidden.rms == pytest.approx(found.rms, rel=0.05)


def test_the_right_term_predicts_hidden_samples_better_than_none(flight):
    data, drive = flight
    context = MagContext(field=EarthField(FIELD))
    right = by_log(data, drive, TERM, np.eye(3), context).hidden
    none = by_log(data, None, np.zeros((0, 3)), np.eye(3), context).hidden
    wrong = by_log(data, drive, -TERM, np.eye(3), context).hidden
    gains, sds = right.gains_over(none)
    assert (gains > 2.0 * sds).all()
    assert right.rms < 0.3 * none.rms
    assert wrong.rms > 1.5 * none.rms


def test_what_is_in_force_scales_term_and_offset(flight):
    data, drive = flight
    context = MagContext(field=EarthField(0.5 * FIELD))
    found = by_log(data, drive, 0.5 * TERM, 0.5 * np.eye(3), context)
    assert found.term == pytest.approx(0.5 * TERM, abs=0.01)
    assert found.offset == pytest.approx(0.5 * OFFSET, abs=0.1)


def test_a_log_without_an_attitude_says_nothing(flight):
    data, drive = flight
    blind = dataclasses.replace(data, turning=Turning(None, None))
    assert by_log(blind, drive, TERM, np.eye(3), MagContext()) is None
