from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.blind.airframe.flight import LOOP_S
from mavcal.calib.blind.airframe.logs import (
    Logging,
    coloured,
    columns_of,
    draw_errors,
    draw_units,
    recording_of,
)
from mavcal.calib.blind.airframe.vehicle import GRAVITY
from mavcal.calib.recording import Sensor

LOGGING = Logging(
    hz=200, attitude_hz=100, velocity_hz=25, cutoff=40.0, velocity_sd=0.03, velocity_s=2.0, attitude_sd=0.002
)


@pytest.fixture(scope="module")
def columns(flown, vehicle):
    rng = np.random.default_rng(4)
    units = draw_units(rng)
    errors = draw_errors(rng, len(flown.t), LOGGING, units[0])
    return columns_of(flown, vehicle, units, errors, LOGGING, rng)


def rate_of(columns, name: str) -> float:
    t = columns["t"][np.isfinite(columns[name])]
    return 1.0 / float(np.median(np.diff(t)))


def test_every_message_has_its_rate(columns):
    for name, hz in {"accel_x": 200, "motor_1": 200, "q_w": 100, "vel_n": 25, "voltage": 10, "height": 20}.items():
        assert rate_of(columns, name) == pytest.approx(hz)
    assert round(rate_of(columns, "accel2_x")) in {100, 50}
    assert len({len(values) for values in columns.values()}) == 1


def test_at_rest_both_units_read_gravity(columns):
    rest = columns["t"] - columns["t"][0] < 0.9
    for name in ("accel", "accel2"):
        read = [np.nanmean(columns[f"{name}_{axis}"][rest]) for axis in "xyz"]
        assert read == pytest.approx([0.0, 0.0, -GRAVITY], abs=0.05)


def test_the_estimator_is_off_by_as_much_as_it_should(columns, flown):
    there = np.isfinite(columns["vel_n"])
    truth = flown.velocity[::2][there]
    error = np.stack([columns[f"vel_{k}"][there] for k in "ned"], axis=1) - truth
    assert 0.01 < error.std() < 0.06
    q = np.stack([columns[f"q_{k}"] for k in "wxyz"], axis=1)
    have = np.isfinite(q[:, 0])
    assert np.linalg.norm(q[have], axis=1) == pytest.approx(np.ones(have.sum()))


def test_coloured_noise_has_its_deviation_and_its_time():
    noise = coloured(np.random.default_rng(1), 800_000, [0.3], 0.5)[:, 0]
    assert noise.std() == pytest.approx(0.3, rel=0.05)
    lag = round(0.5 / LOOP_S)
    assert np.corrcoef(noise[:-lag], noise[lag:])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.06)


def test_the_recording_says_its_frame_and_what_the_autopilot_knows(columns, vehicle):
    made = recording_of(columns, vehicle.frame, "real")
    known = {Sensor.ATTITUDE, Sensor.VELOCITY, Sensor.VOLTAGE, Sensor.HEIGHT, Sensor.AIR}
    assert {c.sensor for c in made.dynamics} == known
    assert made.channel(Sensor.MOTOR).values.shape[1] == len(vehicle.rotors)
    assert made.instances(Sensor.GYRO) == (0, 1)
    assert made.parameters.final()["FRAME_CLASS"] == 1
    assert "FRAME_TYPE" in made.parameters.final()
    assert recording_of({"t": columns["t"], "height": columns["height"]}, "quad-x", "").channels == ()
