"""Real recordings with a known answer, which others made: certificates, published values, independent fits."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.recording import Channel, Recording, Segment, Sensor, Stage
from tests.unit.real import inertial, others
from tests.unit.real.ferraris import ferraris
from tests.unit.real.finding import Compared

OF = Compared("r", "m")


def test_a_number_agrees_within_what_is_known_and_twice_its_own_sd():
    def at(ours: float, sd: float) -> bool:
        return OF.number("q", (1.0, 2.0), (ours, 2.0), sd, 0.1, "known").agrees

    assert at(1.09, 0.0)
    assert not at(1.11, 0.0)
    assert at(1.29, 0.1)
    assert not at(1.31, 0.1)
    assert not at(np.nan, 1.0)


def test_ferraris_finds_a_sensor_that_was_put_in():
    rate = 100.0
    M = np.array([[1.02, 0.01, -0.02], [0.0, 0.97, 0.03], [0.005, 0.0, 1.1]])
    W = np.array([[0.98, 0.02, 0.0], [0.01, 1.03, 0.0], [0.0, -0.02, 1.0]])
    accel_bias, gyro_bias, n = np.array([0.3, -0.2, 0.1]), np.array([1.0, -2.0, 0.5]), 200
    accel, gyro, segments = [], [], []

    def add(label: str, up: np.ndarray, rotation: np.ndarray) -> None:
        start = len(segments) * n / rate
        accel.append(np.tile(M @ (9.81 * up) + accel_bias, (n, 1)))
        gyro.append(np.tile(np.radians(W @ rotation + gyro_bias), (n, 1)))
        segments.append(Segment(label, start, start + n / rate))

    for k, axis in enumerate("xyz"):
        add(f"{axis}_p", np.eye(3)[k], np.zeros(3))
        add(f"{axis}_a", -np.eye(3)[k], np.zeros(3))
    for k, axis in enumerate("xyz"):
        add(f"{axis}_rot", np.eye(3)[k], -180.0 * np.eye(3)[k])
    t = np.arange(9 * n) / rate
    recording = Recording(
        (
            Channel(Sensor.ACCEL, 0, t, np.concatenate(accel), "m/s2", Stage.RAW, "t"),
            Channel(Sensor.GYRO, 0, t, np.concatenate(gyro), "rad/s", Stage.RAW, "t"),
        ),
        segments=tuple(segments),
    )
    answer = ferraris(recording, rate)
    np.testing.assert_allclose(answer["K_a"] @ answer["R_a"], M, atol=1e-12)
    np.testing.assert_allclose(answer["K_g"] @ answer["R_g"], W, atol=1e-12)
    np.testing.assert_allclose(answer["b_a"], accel_bias, atol=1e-12)
    np.testing.assert_allclose(answer["b_g"], gyro_bias, atol=1e-12)
    np.testing.assert_allclose(answer["K_ga"], 0.0, atol=1e-12)


@pytest.mark.long
@pytest.mark.shared
@pytest.mark.parametrize("part", [inertial, others], ids=lambda part: part.__name__.rpartition(".")[2])
def test_every_known_answer_is_met(part, shared_data):
    differing = [f"{f.recording}: {f.quantity}: {f.ours}" for f in part.findings() if f.agrees is False]
    assert differing == []
