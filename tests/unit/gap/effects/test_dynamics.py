"""Lever arm and g-sensitivity."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from mavcal.calib.gap.effects import by_id
from mavcal.calib.recording import Sensor

from .conftest import make
from .recovery import amplitudes, noisy


def test_a_lever_feels_the_acceleration_of_its_end():
    trace = make(Sensor.ACCEL, fs=200.0)
    arm = np.array([0.12, -0.3, 0.08])
    w, x, y, z = trace.attitude.T
    ned_from_body = Rotation.from_quat(np.stack([x, y, z, w], axis=1))
    end = ned_from_body.apply(arm)
    second = np.gradient(np.gradient(end, trace.t, axis=0), trace.t, axis=0)
    change = ned_from_body.inv().apply(second)
    columns = by_id()["accel_lever_arm"].columns(trace, np.nan)
    inner = slice(5, -5)
    np.testing.assert_allclose(np.einsum("j,jni->ni", arm, columns)[inner], change[inner], atol=2e-3)
    beta, sd, _ = amplitudes(by_id()["accel_lever_arm"], noisy(trace, change, 0.02, 1), np.nan)
    assert (np.abs(beta - arm) < 4.0 * 0.02 * sd + 2e-3).all()


def test_a_gyroscope_that_feels_force_is_recovered_element_by_element():
    trace = make(Sensor.GYRO)
    effect = by_id()["gyro_g_sensitivity"]
    G = np.arange(1.0, 10.0).reshape(3, 3) * 1e-4
    beta, sd, _ = amplitudes(effect, noisy(trace, trace.force @ G.T, 0.003, 2), np.nan)
    named = np.array([G["xyz".index(p.name[-2]), "xyz".index(p.name[-1])] for p in effect.parameters])
    assert (np.abs(beta - named) < 4.0 * 0.003 * sd).all()
    assert (0.003 * sd < 5e-5).all()


def test_a_turned_vehicle_has_its_lever_turned():
    turn = Rotation.from_rotvec([0.4, -1.0, 0.3])
    here, there = (make(Sensor.ACCEL, seconds=5.0, turn=q) for q in (None, turn))
    arm, Q = np.array([0.1, 0.2, -0.3]), turn.as_matrix()
    columns = by_id()["accel_lever_arm"].columns
    left = np.einsum("j,jni->ni", Q @ arm, columns(there, np.nan))
    np.testing.assert_allclose(left, np.einsum("j,jni->ni", arm, columns(here, np.nan)) @ Q.T, atol=1e-9)


def test_what_is_missing_is_named():
    lever, g = by_id()["accel_lever_arm"], by_id()["gyro_g_sensitivity"]
    still = make(Sensor.ACCEL, "static")
    assert "metre" in lever.missing(still)[0]
    assert lever.missing(dataclasses.replace(still, spin=None))[0] == "angular rate unknown"
    assert lever.missing(make(Sensor.ACCEL)) is None
    assert "varies by" in g.missing(make(Sensor.GYRO, "static"))[0]
    assert g.missing(dataclasses.replace(make(Sensor.GYRO), force=None))[0] == "specific force unknown"
    assert g.missing(make(Sensor.GYRO)) is None
