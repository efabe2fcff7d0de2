"""Thermal effects: recovered with the reference temperature of whoever made them; the lag against an integration."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mavcal.calib.gap.effects import by_id
from mavcal.calib.recording import Sensor

from .conftest import make
from .recovery import fitted, noisy

K = np.array([0.02, -0.01, 0.03])


@pytest.mark.parametrize("t_ref", [25.0, 35.0, 12.0])
def test_a_slope_is_recovered_whatever_its_reference_temperature(t_ref):
    trace = make(Sensor.ACCEL)
    effect = by_id()["accel_temp_linear"]
    found, beta, sd = fitted(effect, noisy(trace, np.outer(trace.temperature - t_ref, K), 0.05, 1))
    assert found == pytest.approx(t_ref, abs=0.3)
    np.testing.assert_allclose(beta, K, atol=5.0 * 0.05 * sd.max() + 1e-9)


@pytest.mark.parametrize("cubic", [(0.0, 0.0, 0.0), (4e-6, 0.0, -6e-6)])
def test_a_parabola_and_a_cubic_are_recovered(cubic):
    trace = make(Sensor.GYRO)
    d = trace.temperature - 35.0
    bent = np.array([1e-4, -2e-4, 3e-4])
    change = np.outer(d, K) + np.outer(d**2, bent) + np.outer(d**3, cubic)
    effect = by_id()["gyro_temp_poly"]
    found, beta, sd = fitted(effect, noisy(trace, change, 0.01, 2))
    assert found == pytest.approx(35.0, abs=0.1)
    moved = np.polynomial.Polynomial([found - 35.0, 1.0])
    for axis in range(3):
        about = np.polynomial.Polynomial([0.0, K[axis], bent[axis], cubic[axis]])(moved).coef
        assert (np.abs(beta[axis::3] - np.pad(about[1:], (0, 4 - len(about)))) < 4.0 * 0.01 * sd[axis::3]).all()


def test_a_scale_with_temperature_is_recovered():
    trace = make(Sensor.MAG)
    s = np.array([1e-3, -2e-3, 5e-4])
    effect = by_id()["mag_temp_scale"]
    found, beta, _ = fitted(effect, noisy(trace, trace.ideal * s * (trace.temperature - 20.0)[:, None], 0.1, 3))
    assert found == pytest.approx(20.0, abs=0.5)
    np.testing.assert_allclose(beta, s, rtol=0.03)


@pytest.mark.parametrize("t_ref", [25.0, 40.0])
def test_a_late_die_is_recovered(t_ref):
    trace = make(Sensor.ACCEL, fs=50.0)

    def die(t, y):
        return (np.interp(t, trace.t, trace.temperature) - y) / 7.0

    T = solve_ivp(die, (0.0, trace.t[-1]), trace.temperature[:1], t_eval=trace.t, max_step=0.02).y[0]
    effect = by_id()["accel_thermal_lag"]
    lag, beta, _ = fitted(effect, noisy(trace, np.outer(T - t_ref, K), 0.02, 4))
    assert lag == pytest.approx(7.0, rel=0.02)
    np.testing.assert_allclose(beta, K, rtol=0.02)


@pytest.mark.parametrize("kind", ["temp_linear", "temp_poly", "temp_scale", "thermal_lag"])
@pytest.mark.parametrize("sensor", list(Sensor)[:3])
def test_a_constant_or_unknown_temperature_is_named(sensor, kind):
    effect, trace = by_id()[f"{sensor}_{kind}"], make(sensor)
    assert effect.missing(trace) is None
    steady = np.where(np.arange(len(trace.t)) % 2, 30.0, 30.4)
    lack = effect.missing(dataclasses.replace(trace, temperature=steady))
    assert lack is not None
    assert lack[0] == "temperature span 0.4 C"
    assert "span >= 15 C" in lack[1]
    unknown = effect.missing(dataclasses.replace(trace, temperature=None))
    assert unknown is not None
    assert unknown[0] == "no temperature recorded"
