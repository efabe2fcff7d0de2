"""A stated uncertainty is true if it is neither smaller than the errors nor more than twice as large."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.recording import Sensor
from mavcal.calib.simulate.scoring import RecoveryScore
from mavcal.service.demo.judge import DemoJudgement, SensorReport


def judged(errors_over_sd: np.ndarray) -> DemoJudgement:
    names = tuple(f"offset_{k}" for k in range(len(errors_over_sd)))
    told = RecoveryScore(names, errors_over_sd, np.eye(len(names)))
    return DemoJudgement((SensorReport(Sensor.GYRO, 0, 0.0, 0.0, 0.0, "rad/s", told),))


@pytest.mark.parametrize(("ratio", "honest"), [(0.3, False), (0.6, True), (1.0, True), (1.5, False)])
def test_the_ratio_of_errors_to_sd_decides(ratio, honest):
    errors = np.tile([1.0, -1.0, 0.5, -1.3], 25)
    errors *= ratio / np.sqrt((errors**2).mean())
    assert judged(errors).honest is honest


def test_one_error_far_beyond_its_sd_is_enough():
    errors = np.tile([0.8, -0.8], 50)
    assert judged(errors).honest
    errors[7] = 4.6
    assert not judged(errors).honest
