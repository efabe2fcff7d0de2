"""Every form of a fit corrects samples as the fit does, and says what it cannot hold."""

from __future__ import annotations

import dataclasses
import re
from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavcal.calib.converted import (
    Convention,
    ardupilot_from_model,
    c_header,
    converted,
    model_from_ardupilot,
    model_from_px4,
    px4_from_model,
)
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import ThermalPolynomial, TriadModel
from tests.examples import examples

UNITS = {Sensor.ACCEL: "m/s2", Sensor.GYRO: "rad/s", Sensor.MAG: "uT"}
RAW = np.random.default_rng(1).normal(scale=10.0, size=(20, 3))
WARM = ThermalPolynomial(25.0, 10.0, 40.0, np.ones((3, 1)))


def fit_of(model, sensor=Sensor.MAG, **changes):
    size = 12 + (0 if model.polynomial is None else model.polynomial.coefficients.size)
    known = {"method": "test", "sensor": sensor, "instance": 0, "status": FitStatus.OK, "message": "", "model": model}
    numbers = {"n_samples": 9, "n_used": 9, "residual_rms": 0.0, "condition_number": 1.0}
    return FitResult(**{**known, "covariance": np.zeros((size, size)), "unit": UNITS[sensor], **numbers, **changes})


@st.composite
def models(draw):
    entries = np.array(draw(st.lists(st.floats(-0.15, 0.15), min_size=9, max_size=9))).reshape(3, 3)
    return TriadModel(np.array(draw(st.lists(st.floats(-50.0, 50.0), min_size=3, max_size=3))), np.eye(3) + entries)


@settings(max_examples=examples(20), deadline=None)
@given(model=models(), radius=st.floats(20.0, 70.0))
def test_matlab_s_magnetometer_corrects_by_rows(model, radius):
    fit = fit_of(model, quality=MappingProxyType({"radius": radius}))
    values = converted(fit, "matlab").values
    corrected = (RAW - np.array(values["b"])) @ np.array(values["A"])
    np.testing.assert_allclose(np.cbrt(np.linalg.det(model.matrix)) * corrected, model.apply(RAW), atol=1e-9)
    assert np.linalg.det(values["A"]) == pytest.approx(1.0)
    assert values["expmfs"] == pytest.approx(radius)


@settings(max_examples=examples(20), deadline=None)
@given(model=models(), sensor=st.sampled_from([Sensor.ACCEL, Sensor.GYRO]))
def test_matlab_s_other_sensors_are_an_affine_map_by_rows(model, sensor):
    values = converted(fit_of(model, sensor), Convention.MATLAB).values
    np.testing.assert_allclose(RAW @ np.array(values["A"]) + np.array(values["b"]), model.apply(RAW), atol=1e-9)


@settings(max_examples=examples(20), deadline=None)
@given(model=models(), sensor=st.sampled_from(list(UNITS)))
def test_imu_tk_and_kalibr_correct_as_the_fit_does(model, sensor):
    fit = fit_of(model, sensor)
    values = converted(fit, "imu_tk").values
    T, K, B = (np.array(values[name]) for name in "TKB")
    np.testing.assert_allclose((RAW - B) @ (T @ K).T, model.apply(RAW), atol=1e-9)
    values = converted(fit, "kalibr").values
    turn = np.array(values.get("C_gyro_i", values.get("C_i", np.eye(3))))
    M, b = np.array(values["M"]), np.array(values["b"])
    np.testing.assert_allclose(np.linalg.solve(M @ turn, (RAW - b).T).T, model.apply(RAW), atol=1e-7)


@settings(max_examples=examples(20), deadline=None)
@given(model=models(), instance=st.integers(0, 2), sensor=st.sampled_from(list(UNITS)))
def test_what_the_autopilots_keep_of_a_model_is_what_they_keep_of_that_again(model, instance, sensor):
    for write, read in ((ardupilot_from_model, model_from_ardupilot), (px4_from_model, model_from_px4)):
        kept = read(write(model, sensor, instance), sensor, instance)
        again = read(write(kept, sensor, instance), sensor, instance)
        np.testing.assert_allclose(again.matrix, kept.matrix, atol=1e-9)
        np.testing.assert_allclose(kept.offset, model.offset, atol=1e-9)


@pytest.mark.parametrize("convention", ["ardupilot", "px4"])
def test_a_rotation_is_lost_and_told_in_degrees(convention):
    turned = Rotation.from_euler("z", 3.0, degrees=True).as_matrix()
    found = converted(fit_of(TriadModel(np.zeros(3), turned)), convention)
    assert found.lost == ("the rotation of 3 deg in the matrix",)
    assert converted(fit_of(TriadModel(np.zeros(3), np.diag([1.1, 0.9, 1.0]))), convention).lost == ()


def test_a_gyroscope_of_an_autopilot_keeps_its_offsets_and_tells_the_rest():
    scaled = TriadModel([0.01, -0.02, 0.03], np.diag([1.02, 1.0, 1.0]))
    found = converted(fit_of(scaled, Sensor.GYRO), "ardupilot")
    assert found.values == {"INS_GYROFFS_X": 0.01, "INS_GYROFFS_Y": -0.02, "INS_GYROFFS_Z": 0.03}
    assert found.lost == ("entries of the matrix up to 0.02: only offsets (and a diagonal) are stored",)


def test_kalibr_has_a_rotation_of_the_gyroscope_alone():
    turned = TriadModel(np.zeros(3), Rotation.from_euler("x", 2.0, degrees=True).as_matrix())
    gyro = converted(fit_of(turned, Sensor.GYRO), "kalibr")
    assert gyro.lost == ()
    assert "C_i" not in gyro.values
    accel = converted(fit_of(turned, Sensor.ACCEL), "kalibr")
    assert accel.lost == ("Kalibr has no rotation for the accel: C_i, 2 deg",)
    assert "C_gyro_i" not in accel.values
    straight = converted(fit_of(TriadModel(np.zeros(3)), Sensor.ACCEL), "kalibr")
    assert (straight.lost, sorted(straight.values)) == ((), ["M", "b"])


def test_what_was_not_determined_and_a_drift_are_told_in_every_form():
    partly = fit_of(
        TriadModel(np.zeros(3), np.eye(3), WARM), status=FitStatus.PARTIAL, undetermined=("offset_x", "offset_y")
    )
    for convention in Convention:
        lost = converted(partly, convention).lost
        assert any("offset_x, offset_y" in text for text in lost)
        assert any("drift" in text and "25 degC" in text for text in lost)
    turned = TriadModel(np.zeros(3), Rotation.from_euler("z", 3.0, degrees=True).as_matrix())
    rotation, offset = converted(fit_of(turned, status=FitStatus.PARTIAL, undetermined=("offset_x",)), "px4").lost
    assert "3 deg" in rotation
    assert "offset_x" in offset


def test_a_form_that_nobody_knows_is_refused():
    with pytest.raises(ValueError, match="'ros' is not a valid Convention"):
        converted(fit_of(TriadModel(np.zeros(3))), "ros")


@pytest.mark.parametrize(("convention", "whose"), [("ardupilot", "ArduPilot"), ("px4", "PX4")])
def test_counts_are_no_parameters(convention, whose):
    counts = fit_of(TriadModel(np.zeros(3)), unit="counts")
    with pytest.raises(
        InvalidInputError, match=f"{whose}'s parameters are in physical units, and this fit is in counts"
    ):
        converted(counts, convention)
    assert converted(counts, "matlab").values


def arrays(header):
    found = {}
    for name, body in re.findall(r"static const double (\w+)\[4\]\[4\] = \{\n(.*?)\};", header, re.DOTALL):
        rows = [[float(cell) for cell in row.split(", ")] for row in re.findall(r"\{(.*?)\}", body)]
        found[name] = np.array(rows)
    return found


def test_a_header_of_c_corrects_samples_as_the_fits_do():
    rng = np.random.default_rng(2)
    fits = []
    for sensor in UNITS:
        matrix = np.eye(3) + 0.1 * rng.normal(size=(3, 3))
        fits.append(fit_of(TriadModel(rng.normal(size=3), matrix), sensor, instance=1))
    header = c_header(fits)
    found = arrays(header)
    assert list(found) == ["accel_1", "gyro_1", "mag_1"]
    for fit, H in zip(fits, found.values(), strict=True):
        padded = np.column_stack([RAW, np.ones(len(RAW))])
        np.testing.assert_allclose((padded @ H.T)[:, :3], fit.model.apply(RAW), atol=1e-12)
        np.testing.assert_array_equal(H[3], [0.0, 0.0, 0.0, 1.0])
    assert header.startswith("/* corrected = H [x y z 1], row by row; from mavcal */\n")
    assert "/* test, m/s2 */" in header
    assert "relative" not in header
    relative = c_header([dataclasses.replace(fits[0], relative=True)])
    assert "/* test, m/s2, relative to the calibration in force when it was recorded */" in relative


PLAIN = TriadModel(np.zeros(3))


@pytest.mark.parametrize(
    ("fit", "said"),
    [
        (
            fit_of(PLAIN, status=FitStatus.PARTIAL, undetermined=("offset_x",)),
            "mag_0 is not exported as an array: it is partial",
        ),
        (fit_of(TriadModel(np.zeros(3), np.eye(3), WARM)), "it is ok, with a drift with temperature"),
        (
            fit_of(PLAIN, Sensor.GYRO, instance=2, status=FitStatus.REFUSED, message="Too few."),
            r"gyro_2 .* refused\. Too few\.",
        ),
    ],
)
def test_what_a_constant_array_would_hide_is_not_exported(fit, said):
    with pytest.raises(InvalidInputError, match=said):
        c_header([fit_of(PLAIN), fit])
