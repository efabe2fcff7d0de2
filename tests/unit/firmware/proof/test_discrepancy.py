"""How far two captures lie apart, and what a gyroscope may drift meanwhile."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.firmware.proof.discrepancy import BIAS_WALK, MOST_BIAS_WALK, RESTART_S, BeforeAfter, covariance
from mavcal.calib.firmware.proof.evidence import StillMean
from mavcal.calib.firmware.proof.known_drift import known_drift
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import TriadModel


def gyro(before: float, after: float, *, restarted: bool) -> BeforeAfter:
    then, now = (StillMean(t, np.zeros(3), 1e-16 * np.eye(3), 30.0, rest=0) for t in (before, after))
    drift = known_drift(Sensor.GYRO, None, None)
    return BeforeAfter(Sensor.GYRO, then, np.zeros(3), (now,), (now,), None, drift, restarted)


def allowed(capture: BeforeAfter) -> float:
    matrix = covariance(capture, TriadModel(), lambda r: np.zeros((len(r), 3)), equality=True)
    return float(np.sqrt(matrix[0, 0]))


@pytest.mark.parametrize("after", [5.0, 200.0])
def test_a_restarted_clock_counts_from_the_restart(after):
    assert gyro(100.0, after, restarted=True).gaps == pytest.approx([after + RESTART_S])


def test_the_gap_of_a_running_clock_is_its_difference():
    assert gyro(100.0, 130.0, restarted=False).gaps == pytest.approx([30.0])


def test_a_gyro_may_drift_with_the_gap_up_to_where_it_turns_round():
    assert allowed(gyro(0.0, 100.0, restarted=False)) == pytest.approx(100 * BIAS_WALK, rel=0.01)
    assert allowed(gyro(0.0, 1e4, restarted=False)) == pytest.approx(MOST_BIAS_WALK, rel=0.01)
