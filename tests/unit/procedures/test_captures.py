"""Captures of the real firmwares, replayed: the injected truth is recovered within the stated uncertainty."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.earth import EarthField, earth_field
from mavcal.calib.firmware.in_force.undo import undo
from mavcal.calib.logs.tlog import read_tlog
from mavcal.calib.procedures.protocol import Done, GaveUp
from mavcal.calib.procedures.registry import replay
from mavcal.calib.procedures.spec import ProcedureContext
from mavcal.calib.recording import Sensor

pytestmark = pytest.mark.shared

ACCEL_OFFSET = np.array([0.31, -0.22, 0.17])
ACCEL_SCALE = np.array([1.021, 0.984, 1.013])
AP_GYRO = np.array([0.0132, -0.0084, 0.0057])
PX4_GYRO = np.array([0.0132, -0.0284, 0.0057])


def results(path, kind, *, field=None, **options):
    recording = undo(read_tlog(path))
    context = ProcedureContext(recording.identity, parameters=recording.parameters.final(), earth_field=field)
    outcome = replay(kind, options, context, recording)
    assert isinstance(outcome, Done), outcome
    return {(f.sensor, f.instance): f for f in outcome.results}


def assert_true(fit, values, rows):
    error = (fit.values[rows] - np.asarray(values).ravel()) / fit.sd[rows]
    assert (np.abs(error) < 4.5).all(), error


@pytest.mark.long
def test_six_faces_of_ardupilot(shared_data):
    fits = results(shared_data / "sitl_captures" / "six_faces.tlog", "accel")
    injected, clean = fits[Sensor.ACCEL, 0], fits[Sensor.ACCEL, 1]
    assert_true(injected, ACCEL_OFFSET, slice(0, 3))
    assert_true(injected, np.diag(ACCEL_SCALE), slice(3, 12))
    assert_true(clean, np.zeros(3), slice(0, 3))
    assert_true(clean, np.eye(3), slice(3, 12))
    assert not injected.relative


def test_bench_faces_of_px4(shared_data):
    (fit,) = results(shared_data / "px4_captures" / "bench_faces.tlog", "accel").values()
    assert_true(fit, ACCEL_OFFSET, slice(0, 3))
    assert_true(fit, np.diag(1.0 / ACCEL_SCALE), slice(3, 12))
    assert fit.temperature == pytest.approx(34.0)


@pytest.mark.long
def test_tumbling_ardupilot(shared_data):
    field = earth_field(-35.363, 149.165, 584.0, 2025.8)  # where SITL starts
    fit = results(shared_data / "sitl_captures" / "tumble.tlog", "mag", field=field)[Sensor.MAG, 0]
    truth = np.array([[1.06, 0.03, -0.02], [0.03, 0.95, 0.015], [-0.02, 0.015, 1.03]])
    assert_true(fit, [-9.0, 5.5, -3.5], slice(0, 3))
    np.testing.assert_allclose(fit.model.offset, [-9.0, 5.5, -3.5], atol=0.01)
    scale = np.cbrt(np.linalg.det(fit.model.matrix) / np.linalg.det(truth))
    np.testing.assert_allclose(fit.model.matrix / scale, truth, atol=1e-3)
    assert fit.quality["orientation"]["verdict"] == "as_stated"


@pytest.mark.long
def test_tumbling_px4(shared_data):
    field = EarthField(np.array([21.7, 1.3, 43.0]))
    (fit,) = results(shared_data / "px4_captures" / "bench_tumble.tlog", "mag", field=field, uncertainty=0.1).values()
    sensitivity = np.array([[1.06, 0.03, -0.02], [0.03, 0.95, 0.015], [-0.02, 0.015, 1.03]])
    truth = np.linalg.inv(sensitivity)
    truth *= np.cbrt(np.linalg.det(fit.model.matrix) / np.linalg.det(truth))
    assert_true(fit, [9.0, -5.5, 3.5], slice(0, 3))
    assert_true(fit, truth, slice(3, 12))


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("path", "t_ref", "gyro", "accel_drift", "gyro_drift"),
    [
        (
            "sitl_captures/warm_up.tlog",
            35.0,
            AP_GYRO,
            [[7e-3, 6e-5, 0.0], [-4e-3, -3e-5, 0.0], [9e-3, 4e-5, 0.0]],
            [[3.5e-4, 0.0, 0.0], [-2.5e-4, 0.0, 0.0], [1.5e-4, 0.0, 0.0]],
        ),
        (
            "px4_captures/bench_warm.tlog",
            25.0,
            PX4_GYRO,
            [[7e-3, 6e-5, 0.0], [-4e-3, -3e-5, 0.0], [9e-3, 4e-5, 0.0]],
            [[3.5e-4, 0.0, 0.0], [-2.5e-4, 0.0, 0.0], [1.5e-4, 0.0, 0.0]],
        ),
    ],
)
def test_warming_up(shared_data, path, t_ref, gyro, accel_drift, gyro_drift):
    fits = results(shared_data / path, "thermal", span=30.0)
    for sensor, drift in ((Sensor.ACCEL, np.array(accel_drift)), (Sensor.GYRO, np.array(gyro_drift))):
        shift = 35.0 - t_ref  # the fit's polynomial is about 35 degC
        recentred = drift.copy()
        recentred[:, 0] += 2.0 * drift[:, 1] * shift
        assert_true(fits[sensor, 0], recentred, slice(12, 21))
    constant = gyro + np.array(gyro_drift)[:, 0] * (35.0 - t_ref)
    assert_true(fits[Sensor.GYRO, 0], constant, slice(0, 3))


def test_gyro_at_rest_of_px4_has_no_offset(shared_data):
    (fit,) = results(shared_data / "px4_captures" / "rest.tlog", "gyro").values()
    assert_true(fit, np.zeros(3), slice(0, 3))
    assert np.degrees(fit.sd[:3].max()) <= 0.01


@pytest.mark.sampled
@pytest.mark.parametrize("path", ["sitl_captures/turntable.tlog", "px4_captures/bench_turn.tlog"])
def test_a_turntable_is_no_rest(shared_data, path):
    recording = undo(read_tlog(shared_data / path))
    context = ProcedureContext(recording.identity, parameters=recording.parameters.final())
    outcome = replay("gyro", {}, context, recording)
    assert isinstance(outcome, GaveUp)  # eight seconds of steady turning are no rest, the stops between are too short
    assert "the recording ends" in outcome.cause
