from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.gyro.g_sensitivity import fit_g_sensitivity
from mavcal.calib.gyro.turns import EARTH_RATE
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Channel, Recording, Segment, Sensor, Stage

G = 9.80665
K = 1e-4 * np.array([[2.0, -0.5, 0.3], [0.4, -3.0, 0.2], [-0.6, 0.1, 1.5]])
B = np.array([0.01, -0.02, 0.005])
FACES = [sign * G * np.eye(3)[axis] for axis in range(3) for sign in (1.0, -1.0)]


def rested(rng, faces=FACES, seconds=10.0, sd=0.002, earth=None, drift=0.0):
    count = int(seconds * 50.0)
    force = np.repeat(np.array(faces), count, axis=0)
    t = np.arange(len(force)) / 50.0
    rate = B + force @ K.T + sd * rng.normal(size=force.shape) + drift * t[:, None]
    if earth is not None:
        rate = rate + earth * force / G
    accel = force + [0.1, -0.05, 0.2] + 0.03 * rng.normal(size=force.shape)
    spans = np.array([[k * seconds, (k + 1) * seconds] for k in range(len(faces))])
    return (
        Channel(Sensor.GYRO, 0, t, rate, "rad/s", Stage.RAW, "test"),
        Channel(Sensor.ACCEL, 0, t, accel, "m/s2", Stage.RAW, "test"),
        spans,
    )


def test_k_and_the_offset_of_six_faces():
    fit = fit_g_sensitivity(*rested(np.random.default_rng(1)))
    assert fit.status == FitStatus.OK
    assert np.abs((np.array(fit.native["K"]) - K) / fit.native["K_sd"]).max() < 4.0
    leaked = K @ [0.1, -0.05, 0.2]  # the accelerometer's own offset, 1e-5 rad/s
    assert np.abs((fit.model.offset + leaked - B) / fit.sd[:3]).max() < 4.0
    assert fit.native["offset_level"] == pytest.approx(B + K @ [0, 0, -G], abs=3e-4)
    assert fit.quality["dof"] == 6
    assert fit.quality["p_value"] > 1e-3
    assert any("--latitude" in text for text in fit.warnings)


def test_the_stated_uncertainty_holds():
    squares = []
    for seed in range(25):
        fit = fit_g_sensitivity(*rested(np.random.default_rng([2, seed]), seconds=4.0), latitude=0.0)
        squares.append(((np.array(fit.native["K"]) - K) / fit.native["K_sd"]) ** 2)
    assert 0.7 < np.mean(squares) < 1.3  # 225 of them


def test_the_earth_is_taken_off_where_the_latitude_is_known():
    rng = np.random.default_rng(3)
    channels = rested(rng, earth=EARTH_RATE, sd=1e-5)
    unknown, known = (fit_g_sensitivity(*channels, latitude=latitude) for latitude in (None, 90.0))
    excess = np.array(unknown.native["K"]) - np.array(known.native["K"])
    assert excess == pytest.approx(np.eye(3) * EARTH_RATE / G, abs=2e-7)
    assert np.array(known.native["K"]) == pytest.approx(K, abs=5e-6)


def test_a_drift_of_the_offset_is_noticed_and_can_be_fitted():
    order = [*range(6), *reversed(range(6))]
    channels = rested(np.random.default_rng(4), faces=[FACES[k] for k in order], drift=2e-5)
    plain = fit_g_sensitivity(*channels)
    assert any("contradict" in text for text in plain.warnings)
    fitted = fit_g_sensitivity(*channels, drift=True)
    assert fitted.native["drift_per_s"] == pytest.approx(np.full(3, 2e-5), rel=0.15)
    assert fitted.quality["p_value"] > 1e-3
    assert np.abs((np.array(fitted.native["K"]) - K) / fitted.native["K_sd"]).max() < 4.0


def test_what_cannot_be_told_is_refused():
    gyro, accel, spans = rested(np.random.default_rng(5))
    few = fit_g_sensitivity(gyro, accel, spans[:3])
    assert few.status == FitStatus.REFUSED
    assert few.movements["offset_x"]
    alike = fit_g_sensitivity(*rested(np.random.default_rng(6), faces=[FACES[k] for k in (0, 1, 2, 3)]))
    assert alike.status == FitStatus.REFUSED
    assert "too much alike" in alike.message
    in_g = fit_g_sensitivity(gyro, dataclasses.replace(accel, values=accel.values / G), spans)
    assert in_g.status == FitStatus.REFUSED
    assert "--gravity" in in_g.message
    assert fit_g_sensitivity(gyro, dataclasses.replace(accel, values=accel.values / G), spans, gravity=1.0).status == (
        FitStatus.OK
    )
    with pytest.raises(InvalidInputError, match="gravity"):
        fit_g_sensitivity(gyro, accel, spans, gravity=0.0)


def test_the_method_takes_labelled_rests():
    gyro, accel, spans = rested(np.random.default_rng(7))
    segments = tuple(Segment(str(k), *span) for k, span in enumerate(spans))
    (fit,) = METHODS["gyro-g-sensitivity"].run(Recording((gyro, accel), segments=segments), {"latitude": 48.0})
    assert np.array(fit.native["K"]) == pytest.approx(K, abs=5e-5)
    with pytest.raises(InvalidInputError, match="no accelerometer"):
        METHODS["gyro-g-sensitivity"].run(Recording((gyro,), segments=segments))
