from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError, UndeterminedError
from mavcal.calib.fit import FitStatus
from mavcal.calib.gyro.thread import fit_thread, thread_scale, turning_spans
from mavcal.calib.logs import read
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Channel, Segment, Sensor, Stage

SCALE, BIAS = 0.98, np.array([0.01, -0.02, 0.03])  # true = k (read - b)
HZ = 100.0


def swung(rng, turns=4, sd=0.002, cross=0.01):
    """Whole turns about z, sped up and slowed down as a thread does, one way and back, with a distorted compass."""
    profile = np.sin(np.linspace(0.0, np.pi, int(12 * HZ))) ** 2
    profile *= 2.0 * np.pi * turns * HZ / profile.sum()
    rest = np.zeros(int(3 * HZ))
    rate = np.concatenate([rest, profile, rest, -profile * 12 / 12, rest])
    angle = np.cumsum(rate) / HZ
    true = np.outer(rate, [cross, 0.0, 1.0])
    t = np.arange(len(rate)) / HZ
    gyro = true / SCALE + BIAS + sd * rng.normal(size=true.shape)
    field = np.column_stack([20.0 * np.cos(angle), -20.0 * np.sin(angle), np.full(len(t), 40.0)])
    iron = np.array([[1.1, 0.1, 0.0], [0.1, 0.9, 0.0], [0.0, 0.0, 1.0]])
    mag = (field @ iron.T + [15.0, -8.0, 3.0] + 0.2 * rng.normal(size=field.shape))[::4]
    return (
        Channel(Sensor.GYRO, 0, t, gyro, "rad/s", Stage.RAW, "test"),
        Channel(Sensor.MAG, 0, t[::4], mag, "uT", Stage.RAW, "test"),
    )


def test_the_worked_digits():
    offset, scale = thread_scale(10, 64.3141357875468, 20.0, -63.8641357875468, 25.0)
    assert offset == pytest.approx(0.01, abs=1e-13)
    assert scale == pytest.approx(0.98, abs=1e-13)
    with pytest.raises(UndeterminedError, match="did not turn"):
        thread_scale(10, 1.0, 10.0, 1.0, 10.0)
    with pytest.raises(InvalidInputError, match="time"):
        thread_scale(10, 1.0, 0.0, -1.0, 0.0)


def test_stated_turns():
    gyro, _ = swung(np.random.default_rng(1))
    spans = turning_spans(gyro)
    assert len(spans) == 2
    fit = fit_thread(gyro, turns=4)
    assert fit.status == FitStatus.PARTIAL
    assert fit.model.offset == pytest.approx(BIAS, abs=4e-4)
    assert fit.native["k"] == pytest.approx(SCALE, abs=1e-3)
    assert abs(fit.model.matrix[2, 2] - SCALE) < 4.0 * fit.sd[11]
    assert abs(fit.native["columns"]["z"][0] - 0.01 / SCALE) < 1e-3
    assert set(fit.undetermined) == {f"matrix_{a}{b}" for a in "xyz" for b in "xy"}
    assert "about x" in fit.movements["matrix_xx"]


def test_a_compass_counts_the_turns_whatever_iron_distorts_it():
    gyro, mag = swung(np.random.default_rng(2))
    cut = tuple(Segment(label, *span) for label, span in (("forth", (5.0, 13.5)), ("back", (20.0, 28.5))))
    fit = fit_thread(gyro, mag=mag, segments=cut)
    assert fit.native["turns_plus"] == pytest.approx(3.0, abs=1e-9)  # almost four: three whole ones
    assert abs(fit.model.matrix[2, 2] - SCALE) < 4.0 * fit.sd[11]
    assert abs(fit.model.offset[2] - BIAS[2]) < 4.0 * fit.sd[2]
    assert fit.sd[11] < 5e-3


def test_whole_turns_from_rest_to_rest_are_counted_without_bias():
    """A running maximum of the noise at rest is no phase: 0.05 % of scale at three turns."""
    deviations = []
    for seed in range(8):
        gyro, mag = swung(np.random.default_rng(seed), turns=3, sd=0.001, cross=0.0)
        cut = tuple(Segment(label, *span) for label, span in (("forth", (2.0, 16.0)), ("back", (17.0, 31.0))))
        fit = fit_thread(gyro, mag=mag, segments=cut)
        deviations.append((fit.model.matrix[2, 2] - SCALE) / fit.sd[11])
    assert abs(np.mean(deviations)) < 3.5 / np.sqrt(8)


def test_a_wrong_count_is_refused():
    gyro, mag = swung(np.random.default_rng(3))
    fit = fit_thread(gyro, turns=5, mag=mag)
    assert fit.status == FitStatus.REFUSED
    assert "the compass sees 4" in fit.message
    twice = fit_thread(gyro, turns=12)
    assert twice.status == FitStatus.REFUSED
    assert "check the rate" in twice.message


def test_an_angle_that_is_not_whole_widens_the_scale():
    gyro, _ = swung(np.random.default_rng(4))
    sd = fit_thread(gyro, turns=4, angle_sd=0.1).sd[11]
    assert sd == pytest.approx(SCALE * 0.1 / (8.0 * np.pi) / np.sqrt(2.0), rel=0.2)


def test_what_cannot_be_told_is_refused():
    gyro, mag = swung(np.random.default_rng(5))
    assert fit_thread(gyro.between(0.0, 16.0), turns=4).status == FitStatus.REFUSED
    with pytest.raises(InvalidInputError, match="counted"):
        fit_thread(gyro)
    with pytest.raises(InvalidInputError, match="positive"):
        fit_thread(gyro, turns=-1)
    still = dataclasses.replace(mag, values=np.tile(mag.values[:1], (len(mag), 1)))
    fit = fit_thread(gyro, mag=still)
    assert fit.status == FitStatus.REFUSED
    assert "does not go round" in fit.message
    beyond = fit_thread(gyro, turns=4, segments=(Segment("a", 100.0, 110.0), Segment("b", 110.0, 120.0)))
    assert beyond.status == FitStatus.REFUSED
    assert beyond.movements


@pytest.mark.shared
def test_turns_of_real_firmware_counted_by_its_compass(shared_data):
    (fit,) = METHODS["gyro-thread"].run(read(shared_data / "px4_captures/bench_turn.tlog"))
    assert abs(fit.model.matrix[0, 0] - 1.0 / 1.03) < 3.0 * fit.sd[3]
    assert fit.native["axis"] == "x"
    assert abs(fit.model.offset[0] - 0.0132) < 3.0 * fit.sd[0]
