"""Compass jobs recorded against a real ArduCopter: every parameter within three of its stated standard deviations."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from mavcal.calib.firmware.in_force.undo import undo
from mavcal.calib.logs import read
from mavcal.calib.methods import METHODS
from mavcal.calib.procedures.protocol import Done
from mavcal.calib.procedures.registry import create, replay
from mavcal.calib.recording import ParameterTimeline, Recording
from mavcal.service.jobs.calibrate.digest import context_of, field_of
from tests.unit.mag.turned import deviations

pytestmark = pytest.mark.shared

AT = datetime(2025, 11, 15, tzinfo=UTC).timestamp()
SECOND = ((-58.2, 37.4, 81.6), (0.961, 1.052, 1.017), (-0.022, 0.033, -0.012))
THIRD = ((24.1, -95.5, -12.8), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
IRON = (1.083, 0.937, 1.041), (0.041, -0.027, 0.019)
QUARTER = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # body from chip: yaw 270
RUNS = {
    # file: end of the job's capture, s; compasses; whether the first one is mounted otherwise than stated
    "ardupilot_mag_turned.tlog": (48.3, (((113.7, -71.3, 46.9), *IRON), SECOND, THIRD), False),
    "ardupilot_mag_yaw270.tlog": (137.4, (((-88.3, 132.9, -41.7), *IRON), SECOND, THIRD), True),
}


def numbers(offset, diagonal, cross, turned=False):
    """Offset in uT, diagonal and cross terms of the matrix with determinant 1, in the axes that were streamed."""
    matrix = np.diag(diagonal)
    matrix[(0, 0, 1), (1, 2, 2)] = matrix[(1, 2, 2), (0, 0, 1)] = cross
    bias = -np.array(offset) / 10.0
    if turned:
        matrix, bias = QUARTER.T @ matrix @ QUARTER, QUARTER.T @ bias
    matrix /= np.cbrt(np.linalg.det(matrix))
    return np.concatenate([bias, matrix[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]])


@pytest.fixture(params=RUNS)
def run(request, shared_data):
    end, compasses, turned = RUNS[request.param]
    whole = read(shared_data / "firmware_runs" / request.param)
    entries = tuple(e for e in whole.parameters.entries if e.t < end)
    captured = whole.with_channels(c.take(c.t < end) for c in whole.channels)
    captured = Recording(captured.channels, ParameterTimeline(entries), identity=whole.identity)
    truth = [numbers(*c, turned=turned and k == 0) for k, c in enumerate(compasses)]
    return captured, truth


def test_every_parameter_of_every_compass_of_the_job_is_within_three_stated_sd(run):
    captured, truth = run
    context = context_of("mag", captured.identity, captured.parameters.final(), field_of(captured, AT))
    done = replay("mag", {}, context, undo(captured))
    assert isinstance(done, Done), done
    assert len(done.results) == 3
    for fit in done.results:
        assert np.abs(deviations(fit, truth[fit.instance])).max() < 3.0, fit.instance
    first = done.results[0]  # streamed with all its digits by HIGHRES_IMU
    assert np.abs(first.model.offset - truth[0][:3]).max() < 0.004
    assert done.results[0].n_samples <= 125


def test_the_job_gives_the_same_digits_in_pieces_as_they_came_and_replayed(run):
    captured, _ = run
    context = context_of("mag", captured.identity, captured.parameters.final(), field_of(captured, AT))
    raw = undo(captured)
    live = create("mag", {}, context)
    start, end = raw.span
    for k in np.arange(start, end + 0.3, 0.3):
        live.feed(raw.between(k, k + 0.3))
    live.end()
    again = replay("mag", {}, context, raw)
    for one, other in zip(live.outcome.results, again.results, strict=True):
        np.testing.assert_array_equal(one.values, other.values)
        np.testing.assert_array_equal(one.sd, other.sd)


@pytest.mark.long
@pytest.mark.parametrize("method", ["mag-ellipsoid", "mag-gyro", "mag-align"])
def test_the_whole_capture_fitted_by_a_method_is_within_three_stated_sd(run, method):
    captured, truth = run
    fits = METHODS[method].run(captured, {})
    assert sorted(f.instance for f in fits) == [0, 1, 2]
    for fit in fits:
        if fit.instance == 0 and method != "mag-ellipsoid" and truth[0][0] > 0.0:
            continue  # mounted otherwise than stated: these methods give the axes of the gyro or accelerometer
        assert np.abs(deviations(fit, truth[fit.instance])).max() < 3.0, fit.instance
