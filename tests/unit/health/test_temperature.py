"""Temperatures against the range of the calibration in force."""

from __future__ import annotations

import dataclasses

import pytest

from mavcal.calib.health.finding import HealthVerdict
from mavcal.calib.health.report import health
from mavcal.calib.methods.overview import overview
from mavcal.calib.recording import ParameterTimeline, Sensor
from tests.unit.health.made import CALIBRATED, flight


def found(parameters, sensor=Sensor.ACCEL):
    """Unit 1 of a flight that warms from 30 to 39 degC."""
    made = dataclasses.replace(flight(1), parameters=ParameterTimeline.constant({**CALIBRATED, **parameters}))
    unit = next(s for s in health(made).sensors if (s.sensor, s.instance) == (sensor, 0))
    return next(f for f in unit.findings if f.check == "temperature")


def corrected(low, high, enabled=1):
    return {"INS_TCAL1_ENABLE": enabled, "INS_TCAL1_TMIN": low, "INS_TCAL1_TMAX": high}


def test_a_flight_beyond_its_temperature_calibration_is_suspicious_and_says_when():
    made = found(corrected(0.0, 34.0))
    assert made.verdict == HealthVerdict.SUSPICIOUS
    assert made.value == pytest.approx(5.0, abs=0.1)
    assert made.start == pytest.approx(80.0, abs=2.0)
    assert made.end == pytest.approx(180.0, abs=1.0)
    assert "covers 0 to 34 degC (the temperature calibration in force): 5 degC beyond it" in made.text
    assert "thermal-poly" in made.action
    assert found(corrected(0.0, 34.0), Sensor.GYRO).verdict == HealthVerdict.SUSPICIOUS


@pytest.mark.parametrize("parameters", [corrected(0.0, 60.0), corrected(0.0, 37.5), {"INS_ACC1_CALTEMP": 25.0}])
def test_inside_the_range_or_hardly_outside_is_ok(parameters):
    assert found(parameters).verdict == HealthVerdict.OK


def test_an_accelerometer_far_from_its_one_calibration_temperature_is_suspicious_and_a_gyroscope_is_not():
    cold = {"INS_ACC1_CALTEMP": 5.0, "INS_GYR1_CALTEMP": 5.0}
    assert found(cold).verdict == HealthVerdict.SUSPICIOUS
    assert found(cold, Sensor.GYRO).verdict == HealthVerdict.CANNOT_SAY


@pytest.mark.parametrize("parameters", [{}, corrected(0.0, 34.0, enabled=0), {"INS_ACC1_CALTEMP": -300.0}])
def test_without_a_temperature_calibration_nothing_is_claimed(parameters):
    made = found(parameters)
    assert made.verdict == HealthVerdict.CANNOT_SAY
    assert made.text == "was at 30 to 39 degC; no temperature calibration is in force: its drift is not corrected"


@pytest.mark.parametrize("enabled", [0, 1, 2])
def test_a_unit_that_learns_its_temperature_calibration_is_warned_of(enabled):
    parameters = ParameterTimeline.constant({**CALIBRATED, **corrected(0.0, 60.0, enabled)})
    document = overview(dataclasses.replace(flight(1), parameters=parameters))
    warned = [text for text in document["warnings"] if text.startswith("INS_TCAL1_ENABLE is 2")]
    assert len(warned) == (enabled == 2)
    assert ("it learns one from the next start on" in found(corrected(0.0, 60.0, enabled)).text) == (enabled == 2)
