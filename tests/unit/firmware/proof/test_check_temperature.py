"""Readings beyond the calibrated temperatures say nothing: there the firmware clamps and the sensor drifts on."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.firmware.compose.draft import Subject
from mavcal.calib.firmware.proof.check import within
from mavcal.calib.firmware.proof.evidence import StillMean, gather
from mavcal.calib.firmware.proof.known_drift import KnownDrift
from mavcal.calib.recording import Channel, Recording, Sensor, Stage
from mavcal.calib.triad import ThermalPolynomial

CURVE = ThermalPolynomial(35.0, 20.0, 50.0, [[1e-3], [0.0], [0.0]])


def reading(temperature):
    return StillMean(0.0, np.zeros(3), np.eye(3), temperature)


@pytest.mark.parametrize(
    ("temperature", "kept"),
    [(20.0, True), (50.0, True), (50.2, True), (51.0, False), (12.0, False), (None, True)],
)
def test_only_temperatures_that_were_calibrated_count(temperature, kept):
    assert bool(within(CURVE, (reading(temperature),))) is kept


def test_without_a_drift_every_temperature_counts():
    assert within(None, (reading(99.0),))


def test_a_thermometer_that_lags_a_ramp_costs_certainty():
    drift = KnownDrift(Sensor.ACCEL, CURVE, np.zeros((3, 3)), (False, False, False))
    matrix = drift.staleness([30.0, 40.0], [0.5, 0.0], np.eye(2))
    np.testing.assert_allclose(np.sqrt(np.diag(matrix)), [5e-4, 0, 0, 0, 0, 0], atol=1e-12)


def test_how_old_a_temperature_is_shows_in_the_reading():
    t = np.arange(0.0, 5.0, 0.02)
    rng = np.random.default_rng(3)
    accel = Channel(Sensor.ACCEL, 0, t, rng.normal([0, 0, -9.8], 0.01, (len(t), 3)), "m/s2", Stage.FILTERED, "TEST")
    gyro = Channel(Sensor.GYRO, 0, t, rng.normal(0, 1e-3, (len(t), 3)), "rad/s", Stage.FILTERED, "TEST")
    heat = Channel(Sensor.TEMPERATURE, 0, t, 30.0 + 0.8 * t, "degC", Stage.RAW, "TEST")
    (one,) = gather(Recording((accel, gyro, heat))).readings[Subject(Sensor.ACCEL, 0)]
    np.testing.assert_allclose(one.temperature_sd, 0.4, rtol=0.1)
