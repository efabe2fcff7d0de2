from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.gap.model.views import between, views_of
from mavcal.calib.gap.problem import GapProblem, ReferenceInfo, ReferenceKind
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import SIGMA, problem_of

ESTIMATOR = ReferenceInfo(ReferenceKind.ESTIMATOR, att_sigma_deg=1.0)


def test_instances_with_an_uncertain_reference_become_independent_contrasts():
    def error(truth, _sensor):
        return np.sin(truth["t"])[:, None] * np.ones(3)

    problem = problem_of(np.random.default_rng(0), (Sensor.GYRO,), instances=3, reference=ESTIMATOR, error=error)
    views = views_of(problem, {}, {})
    weights = np.array([[view.weights.get(i, 0.0) for i in range(3)] for view in views])
    assert weights @ weights.T == pytest.approx(np.eye(3))
    assert [view.reference_error for view in views] == [True, False, False]
    for view in views[1:]:
        assert view.residual.std() == pytest.approx(SIGMA[Sensor.GYRO], rel=0.05)


def test_instances_with_an_exact_reference_stay_apart():
    views = views_of(problem_of(np.random.default_rng(1), (Sensor.GYRO,), instances=2), {}, {})
    assert [view.weights for view in views] == [{0: 1.0}, {1: 1.0}]


def test_a_difference_counts_once_and_only_where_no_other_series_tells():
    problem = problem_of(np.random.default_rng(2), (Sensor.ACCEL,), instances=2)
    pair = dataclasses.replace(problem.traces[0], ideal=problem.traces[1].measured, against=1)
    assert len(views_of(dataclasses.replace(problem, traces=(*problem.traces, pair)), {}, {})) == 2
    (only,) = views_of(GapProblem((pair,), ESTIMATOR, 40.0), {}, {})
    assert only.weights == {0: 1.0, 1: -1.0}


def test_masked_and_unobserved_rows_leave():
    problem = problem_of(np.random.default_rng(3), (Sensor.MAG,))
    mask = np.zeros(2000, dtype=bool)
    mask[100:300] = True
    (view,) = views_of(problem, {0: mask}, {})
    assert view.n == 1800
    part = between(view, 0.0, 10.0)
    assert part is not None
    assert part.n == 300
    assert between(view, 0.0, 0.1) is None
