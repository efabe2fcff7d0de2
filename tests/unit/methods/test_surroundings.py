"""Stretches of other magnetic surroundings do not mix, and slow sampling does not pass for noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Channel, Event, Recording, Sensor, Stage

FIELD = 49.0 * np.array([np.cos(1.15), 0.0, np.sin(1.15)])
BENCH, FLIGHT = np.array([6.0, -4.0, 9.0]), np.array([6.9, -3.2, 8.4])
"""uT: offsets on the bench, and with the motors running: 13.5 mG apart."""
RATE = np.array([0.35, 0.62, 0.75])  # rad/s


def tumbled(t):
    return Rotation.from_rotvec(np.outer(t, [0.0, 0.0, RATE[2]])) * Rotation.from_rotvec(
        np.outer(t, [RATE[0], RATE[1], 0])
    )


def flown(t, number):
    roll, pitch = 0.25 * np.sin(0.9 * t + number), 0.2 * np.sin(0.7 * t)
    return Rotation.from_euler("ZYX", np.column_stack([0.08 * t + number, pitch, roll]))


def read(attitude, offset, rng):
    return attitude.inv().apply(FIELD) + offset + 0.3 * rng.normal(size=(len(attitude), 3))


def telemetry(seed, *, flights=6, events=True):
    """A tumble on the bench, then flights, one sample a second."""
    rng = np.random.default_rng(seed)
    t, values, said = [np.arange(0.0, 150.0)], [], []
    values.append(read(tumbled(t[0]), BENCH, rng))
    for number in range(flights):
        start = 200.0 + 150.0 * number
        since = np.arange(0.0, 120.0)
        t.append(start + since)
        values.append(read(flown(since, number), FLIGHT, rng))
        said += [Event(start - 1.0, "armed", ""), Event(start + 120.5, "disarmed", "")]
    mag = Channel(Sensor.MAG, 0, np.concatenate(t), np.vstack(values), "uT", Stage.RAW, "test")
    return Recording((mag,), events=tuple(said) if events else ())


@pytest.mark.parametrize("seed", range(4))
def test_a_tumble_on_the_bench_is_not_mixed_with_flights(seed):
    (fit,) = METHODS["mag-ellipsoid"].run(telemetry(seed))
    assert fit.status == FitStatus.OK
    assert np.abs((fit.model.offset - BENCH) / fit.sd[:3]).max() < 3.0
    assert fit.n_used <= 150
    assert any("only 0 to 149 s was used" in text for text in fit.warnings)


def test_flights_of_one_surroundings_are_fitted_together():
    recording = telemetry(5)
    (fit,) = METHODS["mag-sphere"].run(recording, {"from": 199.0})
    assert np.abs((fit.model.offset - FLIGHT) / fit.sd[:3]).max() < 3.0
    assert fit.n_used == 6 * 120
    assert not any("was used" in text for text in fit.warnings)


def test_a_span_that_is_asked_for_is_all_that_is_used():
    (fit,) = METHODS["mag-ellipsoid"].run(telemetry(6), {"until": 100.0})
    assert fit.n_samples == 101
    with pytest.raises(
        InvalidInputError, match=r"no sample lies from 5000 s and until 6000 s: the recording has 0\.0 to"
    ):
        METHODS["mag-ellipsoid"].run(telemetry(6), {"from": 5000.0, "until": 6000.0})


def test_sampling_slower_than_the_turning_has_a_floor():
    """A blur of a tenth of a second makes 0.04 % of the field, however quiet the compass is."""
    rng = np.random.default_rng(7)
    slow = np.arange(0.0, 3000.0)
    fits = []
    for t in (slow[:300], slow):
        values = tumbled(t).inv().apply(FIELD) + BENCH + 0.03 * rng.normal(size=(len(t), 3))
        mag = Channel(Sensor.MAG, 0, t, values, "uT", Stage.RAW, "test")
        fits.append(METHODS["mag-ellipsoid"].run(Recording((mag,)))[0])
    few, many = (fit.quality["heading_sd_deg"] for fit in fits)
    assert many > 0.5 * few  # ten times the samples do not make it three times better
    assert any("read more slowly than it turned" in text for text in fits[1].warnings)


def test_residuals_that_contradict_the_model_widen_the_intervals():
    """The surroundings change while it is turned, and nothing says when."""
    rng = np.random.default_rng(8)
    t = np.arange(0.0, 200.0, 0.1)
    slowly = Rotation.from_rotvec(np.outer(t, [0.0, 0.0, 0.25])) * Rotation.from_rotvec(np.outer(t, [0.1, 0.17, 0]))
    values = read(slowly, BENCH, rng) + np.where(t > 120.0, 1.0, 0.0)[:, None] * 3.0 * (FLIGHT - BENCH)
    mag = Channel(Sensor.MAG, 0, t, values, "uT", Stage.RAW, "test")
    (fit,) = METHODS["mag-ellipsoid"].run(Recording((mag,)))
    for truth in (BENCH, BENCH + 3.0 * (FLIGHT - BENCH)):
        assert np.abs((fit.model.offset - truth) / fit.sd[:3]).max() < 3.0
