from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavcal.calib.accel.rest_reference import SensorTolerances, angles_of, attitude_from_vectors, fit_rest_reference
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus, parameter_names
from mavcal.calib.recording import Channel, Sensor, Stage
from tests.examples import examples
from tests.fields import field_of

G = 9.80665
FIELD = np.array([20.0, 0.0, 45.0])


def channel(sensor, values, unit):
    return Channel(sensor, 0, np.arange(len(values)) / 50.0, values, unit, Stage.RAW, "test")


def at_rest(attitude, rng, n=150, accel_noise=0.02, mag_noise=0.3, accel_unit="m/s2", scale=1.0):
    back = attitude.inv()
    accel = back.apply([0.0, 0.0, -G]) + accel_noise * rng.normal(size=(n, 3))
    mag = back.apply(FIELD) + mag_noise * rng.normal(size=(n, 3))
    return channel(Sensor.ACCEL, scale * accel, accel_unit), channel(Sensor.MAG, mag, "uT")


@pytest.mark.parametrize(
    ("angles_deg", "accel", "mag"),
    [
        ((0, 0, 0), (0, 0, -G), (20, 0, 45)),
        ((0, 0, 90), (0, 0, -G), (0, -20, 45)),
        ((90, 0, 0), (0, -G, 0), (20, 45, 0)),
        ((0, 30, 0), (G / 2, 0, -G * math.cos(math.pi / 6)), None),
    ],
)
def test_literal_attitudes(angles_deg, accel, mag):
    attitude = attitude_from_vectors(np.array(accel, dtype=float), None if mag is None else np.array(mag, dtype=float))
    assert np.degrees(angles_of(attitude)) == pytest.approx(angles_deg, abs=1e-9)


def test_the_means_are_those_of_the_first_hundred_samples():
    rng = np.random.default_rng(1)
    accel, mag = at_rest(Rotation.from_euler("ZYX", [40, 5, -3], degrees=True), rng)
    fit = fit_rest_reference(accel, mag)
    assert fit.native["accel"] == pytest.approx(accel.values[:100].mean(axis=0))
    assert fit.native["mag"] == pytest.approx(mag.values[:100].mean(axis=0))
    assert fit.n_used == 100
    json.dumps({**fit.native, **fit.quality}, allow_nan=False)


def test_nothing_of_it_is_a_calibration():
    fit = fit_rest_reference(*at_rest(Rotation.identity(), np.random.default_rng(2)))
    assert fit.status == FitStatus.PARTIAL
    assert fit.undetermined == parameter_names()
    assert "mag-ellipsoid" in fit.movements["offset_x"]


@pytest.mark.long
def test_the_stated_uncertainty_holds():
    rng = np.random.default_rng(3)
    attitude = Rotation.from_euler("ZYX", [40, 12, -9], degrees=True)
    z = []
    for _ in range(150):
        accel, mag = at_rest(attitude, rng)
        accel = channel(Sensor.ACCEL, accel.values + 0.05 * rng.normal(size=3), "m/s2")
        mag = channel(Sensor.MAG, mag.values + 0.4 * rng.normal(size=3), "uT")
        fit = fit_rest_reference(accel, mag, sensors=SensorTolerances(0.05, 0.4))
        z.append(
            [
                (fit.native[f"{name}_deg"] - truth) / fit.quality[f"{name}_sd_deg"]
                for name, truth in (("roll", -9), ("pitch", 12), ("heading", 40))
            ]
        )
    assert np.mean(np.square(z), axis=0) == pytest.approx(1.0, abs=4.0 * math.sqrt(2.0 / 150))


@settings(max_examples=examples(25))
@given(
    yaw=st.floats(-179.0, 179.0), pitch=st.floats(-80.0, 80.0), roll=st.floats(-179.0, 179.0), scale=st.floats(0.1, 1e4)
)
def test_any_attitude_in_any_unit_comes_back(yaw, pitch, roll, scale):
    attitude = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True)
    rng = np.random.default_rng(4)
    accel, mag = at_rest(attitude, rng, accel_noise=1e-6, mag_noise=1e-6, accel_unit="counts", scale=scale)
    fit = fit_rest_reference(accel, mag)
    found = Rotation.from_quat(fit.native["q_nb"], scalar_first=True)
    assert (found * attitude.inv()).magnitude() < 1e-5
    assert fit.native["roll_deg"] == pytest.approx(roll, abs=1e-3)
    assert (fit.native["heading_deg"] - yaw + 180.0) % 360.0 == pytest.approx(180.0, abs=1e-3)
    assert fit.native["dip_deg"] == pytest.approx(math.degrees(math.atan2(45, 20)), abs=1e-3)


def test_declination_makes_the_heading_true():
    accel, mag = at_rest(Rotation.identity(), np.random.default_rng(5), mag_noise=1e-9)
    field = field_of(50.0, 1.1, math.radians(7.0))
    fit = fit_rest_reference(accel, mag, field=field)
    assert fit.native["heading_deg"] == pytest.approx(7.0, abs=0.1)
    assert fit.native["north"] == "true"


def test_without_a_magnetometer_the_heading_is_open():
    accel, _ = at_rest(Rotation.from_euler("x", 3, degrees=True), np.random.default_rng(6))
    fit = fit_rest_reference(accel, None)
    assert fit.native["heading_deg"] is None
    assert fit.native["roll_deg"] == pytest.approx(3.0, abs=0.1)
    assert fit.quality["attitude_sd_deg"] == pytest.approx(math.degrees(0.002 / G), rel=0.5)


@pytest.mark.parametrize("pitch", [90.0, -90.0])
def test_a_nose_that_points_up_has_no_heading(pitch):
    accel, mag = at_rest(Rotation.from_euler("y", pitch, degrees=True), np.random.default_rng(7))
    fit = fit_rest_reference(accel, mag)
    assert fit.native["heading_deg"] is None
    assert fit.native["R_nb"] is not None
    assert abs(fit.native["pitch_deg"]) == pytest.approx(90.0, abs=0.5)
    assert fit_rest_reference(accel, None).native["roll_deg"] is None


def test_a_vertical_field_gives_no_heading():
    accel, _ = at_rest(Rotation.identity(), np.random.default_rng(8))
    mag = channel(Sensor.MAG, np.tile([0.1, 0.0, 50.0], (150, 1)), "uT")
    assert fit_rest_reference(accel, mag).native["heading_deg"] is None


@pytest.mark.parametrize(
    ("values", "word"),
    [
        (np.tile([0.0, 0.0, -G], (50, 1)), "50 finite samples"),
        (np.full((200, 3), np.nan), "0 finite samples"),
        (np.zeros((200, 3)), "reads nothing"),
        (np.random.default_rng(9).normal(size=(200, 3)) * 5.0 - [0, 0, G], "it moved"),
    ],
)
def test_refused(values, word):
    fit = fit_rest_reference(channel(Sensor.ACCEL, values, "m/s2"), None)
    assert fit.status == FitStatus.REFUSED
    assert word in fit.message


@pytest.mark.parametrize(
    "options", [{"samples": 1}, {"sensors": SensorTolerances(-1.0)}, {"sensors": SensorTolerances(0.0, math.nan)}]
)
def test_impossible_options(options):
    accel, mag = at_rest(Rotation.identity(), np.random.default_rng(10))
    with pytest.raises(InvalidInputError):
        fit_rest_reference(accel, mag, **options)
