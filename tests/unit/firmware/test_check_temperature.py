"""Readings beyond the calibrated temperatures say nothing: there the firmware clamps and the sensor drifts on."""

from __future__ import annotations

import numpy as np
import pytest

from calib.firmware.check import within
from calib.firmware.evidence import Reading
from calib.triad import ThermalPolynomial

CURVE = ThermalPolynomial(35.0, 20.0, 50.0, [[1e-3], [0.0], [0.0]])


def reading(temperature):
    return Reading(0.0, np.zeros(3), np.eye(3), temperature)


@pytest.mark.parametrize(
    ("temperature", "kept"),
    [(20.0, True), (50.0, True), (50.2, True), (51.0, False), (12.0, False), (None, True)],
)
def test_only_temperatures_that_were_calibrated_count(temperature, kept):
    assert bool(within(CURVE, (reading(temperature),))) is kept


def test_without_a_drift_every_temperature_counts():
    assert within(None, (reading(99.0),))
