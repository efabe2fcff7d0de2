"""Round trips through the forms of other programs, and the digits of METHODS."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.conventions import (
    Magcal,
    accelcal_from_model,
    imu_tk_from_model,
    kalibr_from_model,
    magcal_from_model,
)
from mavcal.calib.converted import (
    Convention,
    ardupilot_from_model,
    converted,
    model_from_ardupilot,
    model_from_px4,
    px4_from_model,
)
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitBuilder, FitResult, FitStatus
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import ThermalPolynomial, TriadModel

numbers = st.floats(-0.2, 0.2)


@st.composite
def models(draw, *, symmetric=False, diagonal=False):
    """Corrections within a fifth of the neutral one, offsets of the order of a hundred."""
    entries = np.array(draw(st.lists(numbers, min_size=9, max_size=9))).reshape(3, 3)
    matrix = np.eye(3) + (0.5 * (entries + entries.T) if symmetric else entries)
    if diagonal:
        matrix = np.diag(np.diag(matrix))
    if np.linalg.det(matrix) < 0.2 or np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[0] < 0.1:
        matrix = np.eye(3)
    return TriadModel(np.array(draw(st.lists(st.floats(-100.0, 100.0), min_size=3, max_size=3))), matrix)


def same(a, b):
    np.testing.assert_allclose(a.offset, b.offset, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(a.matrix, b.matrix, rtol=1e-9, atol=1e-9)


def model_from_magcal(form, strength=None):
    """The model whose corrected vectors are `strength` long; None: `expmfs` long, as with MATLAB."""
    factor = 1.0 if strength is None else strength / form.expmfs
    return TriadModel(form.b, np.asarray(factor * form.A.T, dtype=np.float64))


def model_from_accelcal(A, b):
    """The model of ``C = U A + b`` by rows."""
    matrix = np.asarray(A, dtype=np.float64).T
    offset = -np.linalg.solve(matrix, np.asarray(b, dtype=np.float64))
    return TriadModel(np.asarray(offset, dtype=np.float64), matrix)


def model_from_imu_tk(T, K, B):
    """The model of ``T K (m - B)``."""
    matrix = np.asarray(T, dtype=np.float64) @ np.asarray(K, dtype=np.float64)
    return TriadModel(np.asarray(B, dtype=np.float64), matrix)


def model_from_kalibr(M, C_i, b):
    """The model of ``m = M C_i truth + b``."""
    sensitivity = np.asarray(M, dtype=np.float64) @ np.asarray(C_i, dtype=np.float64)
    return TriadModel(np.asarray(b, dtype=np.float64), np.asarray(np.linalg.inv(sensitivity), dtype=np.float64))


def test_the_digits_of_magcal():
    """METHODS 3.1: centre (-50, 20, 100), radii (30, 20, 50)."""
    model = TriadModel([-50.0, 20.0, 100.0], 48.0 * np.diag([1 / 30, 1 / 20, 1 / 50]))
    form = magcal_from_model(model, 48.0)
    np.testing.assert_allclose(np.diag(form.A), [1.0357441687, 1.553616253, 0.6214465012], atol=1e-10)
    assert form.expmfs == pytest.approx(31.0723, abs=5e-5)
    rows = model.invert(48.0 * np.eye(3))
    np.testing.assert_allclose(np.linalg.norm((rows - form.b) @ form.A, axis=1), form.expmfs)
    same(model_from_magcal(form, 48.0), model)
    np.testing.assert_allclose(np.linalg.norm(model_from_magcal(form).apply(rows), axis=1), form.expmfs)


@given(model=models(), strength=st.floats(1.0, 1000.0))
def test_magcal_and_back(model, strength):
    form = magcal_from_model(model, strength)
    assert np.linalg.det(form.A) == pytest.approx(1.0)
    same(model_from_magcal(Magcal(form.A, form.b, form.expmfs), strength), model)


@given(model=models())
def test_accelcal_and_back(model):
    A, b = accelcal_from_model(model)
    rows = np.arange(9.0).reshape(3, 3)
    np.testing.assert_allclose(rows @ A + b, model.apply(rows), atol=1e-9)
    same(model_from_accelcal(A, b), model)


@given(model=models())
def test_imu_tk_and_back(model):
    T, K, B = imu_tk_from_model(model)
    assert np.diag(T) == pytest.approx(1.0)
    assert np.count_nonzero(K - np.diag(np.diag(K))) == 0
    same(model_from_imu_tk(T, K, B), model)


@given(model=models())
def test_kalibr_and_back(model):
    M, C_i, b = kalibr_from_model(model)
    assert np.triu(M, 1) == pytest.approx(0.0, abs=1e-15)
    assert (np.diag(M) > 0).all()
    np.testing.assert_allclose(C_i @ C_i.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(C_i) == pytest.approx(1.0)
    np.testing.assert_allclose(M @ C_i @ [1.0, 2.0, 3.0] + b, model.invert([1.0, 2.0, 3.0]), atol=1e-9)
    same(model_from_kalibr(M, C_i, b), model)


@given(model=models(symmetric=True), instance=st.integers(0, 2))
def test_a_compass_of_both_autopilots_and_back(model, instance):
    same(model_from_ardupilot(ardupilot_from_model(model, Sensor.MAG, instance), Sensor.MAG, instance), model)
    same(model_from_px4(px4_from_model(model, Sensor.MAG, instance), Sensor.MAG, instance), model)


@given(model=models(diagonal=True), instance=st.integers(0, 2))
def test_an_accelerometer_of_both_autopilots_and_back(model, instance):
    same(model_from_ardupilot(ardupilot_from_model(model, Sensor.ACCEL, instance), Sensor.ACCEL, instance), model)
    same(model_from_px4(px4_from_model(model, Sensor.ACCEL, instance), Sensor.ACCEL, instance), model)


def test_the_names_and_signs_of_the_parameters():
    model = TriadModel([10.0, -20.0, 5.0], np.diag([1.1, 0.9, 1.0]))
    compass = ardupilot_from_model(model, Sensor.MAG, 1)
    assert compass["COMPASS_OFS2_X"] == pytest.approx(-100.0)  # added, mGauss
    assert compass["COMPASS_DIA2_Y"] == pytest.approx(0.9)
    assert compass["COMPASS_SCALE2"] == 1.0
    assert px4_from_model(model, Sensor.MAG)["CAL_MAG0_XOFF"] == pytest.approx(0.1)  # subtracted, Gauss
    assert ardupilot_from_model(model, Sensor.ACCEL)["INS_ACCOFFS_Y"] == -20.0
    assert ardupilot_from_model(model, Sensor.ACCEL)["INS_ACCSCAL_X"] == pytest.approx(1.1)
    assert set(ardupilot_from_model(model, Sensor.GYRO)) == {f"INS_GYROFFS_{a}" for a in "XYZ"}


def fit_of(model, sensor=Sensor.MAG, unit="uT", **changes):
    size = 12 + (0 if model.polynomial is None else model.polynomial.coefficients.size)
    return FitResult(
        **{
            "method": "test",
            "sensor": sensor,
            "instance": 0,
            "status": FitStatus.OK,
            "message": "",
            "model": model,
            "covariance": np.zeros((size, size)),
            "unit": unit,
            "n_samples": 1,
            "n_used": 1,
            "residual_rms": 0.0,
            "condition_number": 1.0,
            **changes,
        }
    )


CROSSED = TriadModel([1.0, 2.0, 3.0], np.array([[1.0, 0.1, 0.0], [0.02, 0.9, 0.0], [0.0, 0.0, 1.1]]))


def test_what_a_firmware_cannot_hold_is_said():
    compass = converted(fit_of(CROSSED), Convention.ARDUPILOT)
    assert len(compass.lost) == 1
    assert "rotation of 2.4" in compass.lost[0]
    accel = converted(fit_of(CROSSED, Sensor.ACCEL, "m/s2"), "px4")
    assert any("entries of the matrix up to 0.0" in text for text in accel.lost)
    assert not converted(fit_of(TriadModel([1.0, 2.0, 3.0])), "px4").lost


@pytest.mark.parametrize("convention", list(Convention))
@pytest.mark.parametrize("sensor", [Sensor.ACCEL, Sensor.GYRO, Sensor.MAG])
def test_every_form_of_every_sensor(convention, sensor):
    unit = {Sensor.ACCEL: "m/s2", Sensor.GYRO: "rad/s", Sensor.MAG: "uT"}[sensor]
    found = converted(fit_of(CROSSED, sensor, unit), convention)
    assert found.convention == convention
    assert found.values
    assert found.form


def test_the_field_strength_of_magcal_is_that_of_the_samples():
    fit = fit_of(CROSSED, quality=MappingProxyType({"radius": 500.0}))
    assert converted(fit, "matlab").values["expmfs"] == pytest.approx(500.0)
    assert converted(fit_of(CROSSED), "matlab").values["expmfs"] is None


def test_the_sensitivity_to_acceleration_of_kalibr():
    K = np.array([[1e-4, 2e-4, 0.0], [0.0, -1e-4, 3e-4], [0.0, 0.0, 5e-5]])
    fit = fit_of(CROSSED, Sensor.GYRO, "rad/s", native=MappingProxyType({"K": K.tolist()}))
    values = converted(fit, "kalibr").values
    np.testing.assert_allclose(np.array(values["A"]) @ np.array(values["C_gyro_i"]), K, atol=1e-15)


def test_what_is_open_or_depends_on_temperature_is_said():
    warm = TriadModel([1.0, 2.0, 3.0], np.eye(3), ThermalPolynomial(25.0, 10.0, 40.0, np.ones((3, 1))))
    lost = converted(fit_of(warm, status=FitStatus.PARTIAL, undetermined=("offset_x",)), "imu_tk").lost
    assert any("offset_x" in text for text in lost)
    assert any("25 degC" in text for text in lost)


def test_no_form():
    refusal = FitBuilder("test", Sensor.MAG, 0, "uT", 0).refused("nothing")
    with pytest.raises(InvalidInputError, match="refused fit"):
        converted(refusal, "matlab")
    with pytest.raises(InvalidInputError, match="in counts"):
        converted(fit_of(CROSSED, unit="counts"), "px4")
    with pytest.raises(InvalidInputError, match="no form for the temperature"):
        converted(fit_of(CROSSED, Sensor.TEMPERATURE), "matlab")
    with pytest.raises(InvalidInputError, match="zero on its diagonal"):
        imu_tk_from_model(TriadModel(np.zeros(3), np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])))
