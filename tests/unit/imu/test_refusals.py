"""Why an inertial unit gets no fit, or a part of one: the reason by its number, and the movement that helps."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.imu import fit_imu

G = 9.80665


@pytest.fixture
def unit(recorded):
    return recorded(np.random.default_rng(20), poses=12, hold=1.5, move=0.6)


def reason(accel, gyro, **options):
    """The refusal that both sensors share."""
    fits = fit_imu(accel, gyro, **options)
    assert [fit.status for fit in fits] == [FitStatus.REFUSED] * 2
    assert fits[0].message == fits[1].message
    return fits[0].message


def scaled(channel, factor, **more):
    return dataclasses.replace(channel, values=channel.values * factor, **more)


@pytest.mark.parametrize("seconds", [4.9, 5.1])
def test_five_seconds_together_are_the_least(unit, seconds):
    accel, gyro = unit
    late = dataclasses.replace(gyro, t=gyro.t + accel.t[-1] - seconds)
    said = reason(accel, late)
    assert ("4.9 s" in said) is (seconds < 5.0)
    assert ("still poses" in said) is (seconds > 5.0)


def test_numbers_that_no_sensor_measures_are_named(unit):
    accel, gyro = unit
    huge = scaled(gyro, 1e200)
    said = reason(accel, huge)
    assert "the gyro " in said
    assert f"{np.abs(huge.values).max():.3g} rad/s" in said


def test_time_that_stands_still_is_named_with_what_to_give(unit):
    accel, gyro = unit
    halves = np.repeat([0.0, 30.0], [len(gyro) - 10, 10])
    said = reason(accel, dataclasses.replace(gyro, t=halves))
    assert "the gyro " in said
    assert "time" in said
    assert "--rate" in said


def test_the_axes_that_stand_are_named(unit):
    accel, gyro = unit
    stuck = scaled(accel, [1.0, 0.0, 0.0])
    said = reason(stuck, gyro)
    assert "the accel " in said
    assert "y, z:" in said


def test_an_accelerometer_in_g_is_told_from_gravity(unit):
    accel, gyro = unit
    said = reason(scaled(accel, 1.0 / G), gyro)
    assert "(9.81)" in said
    assert "unit" in said


def test_poses_that_are_alike_are_told_to_be_one(recorded):
    still = Rotation.from_rotvec(0.02 * np.random.default_rng(3).normal(size=(8, 3)))
    spans = np.column_stack([3.0 * np.arange(8) + 0.2, 3.0 * np.arange(8) + 1.8])
    said = reason(*recorded(np.random.default_rng(21), attitudes=still), spans=spans)
    assert "8 poses" in said
    assert "the same" in said


def test_a_gyroscope_in_counts_needs_turns_about_every_axis(recorded):
    about_x = Rotation.from_rotvec(np.outer(np.linspace(0.0, 5.0, 10), [1.0, 0.0, 0.0]))
    accel, gyro = recorded(np.random.default_rng(22), attitudes=about_x)
    said = reason(accel, scaled(gyro, 900.0, unit="counts"))
    assert "gyroscope" in said
    assert "in counts" in said
    assert "every axis" in said


def test_degrees_that_pass_for_radians_are_told_by_their_factor(unit):
    accel, gyro = unit
    fits = fit_imu(accel, scaled(gyro, 180.0 / np.pi))
    assert fits[1].status == FitStatus.REFUSED
    factor = float(fits[1].message.split(" times the rate at which gravity turns")[0].split("reads ")[1])
    assert factor == pytest.approx(57.3, rel=0.05)
    assert "its unit or its range is another one" in fits[1].message
    assert set(fits[1].movements.values()) == {"state its --unit-gyro"}
    assert fits[0].status == FitStatus.OK  # the accelerometer does not suffer for it


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"gravity": 0.0}, "gravity must be positive, not 0.0"),
        ({"gravity": np.inf}, "gravity must be positive, not inf"),
        ({"cross_sd": -0.01}, r"the sd of misalignments must be positive, not -0\.01"),
        ({"cross_sd": np.nan}, "the sd of misalignments must be positive, not nan"),
    ],
)
def test_settings_that_are_impossible_are_errors(unit, options, said):
    with pytest.raises(InvalidInputError, match=said):
        fit_imu(*unit, **options)


def test_channels_of_other_shapes_and_times_are_errors(unit):
    accel, gyro = unit
    with pytest.raises(InvalidInputError, match="the gyro needs three columns, not 2"):
        fit_imu(accel, dataclasses.replace(gyro, values=gyro.values[:, :2]))
    t = gyro.t.copy()
    t[7] = np.nan
    with pytest.raises(InvalidInputError, match="the time of the gyro goes back or is not finite"):
        fit_imu(accel, dataclasses.replace(gyro, t=t))


def test_turns_about_one_axis_leave_the_others_open_with_their_movements(recorded):
    about_y = Rotation.from_euler("y", np.linspace(0.0, 330.0, 12)[:, None], degrees=True)
    accel, gyro = fit_imu(*recorded(np.random.default_rng(23), attitudes=about_y))
    assert gyro.status == FitStatus.PARTIAL
    assert {f"matrix_{a}{b}" for a in "xyz" for b in "xyz"} - set(gyro.undetermined) == {"matrix_yy"}
    assert gyro.movements["matrix_xx"] == (
        "turn it about x by 90 degrees or more, that axis level, between still poses, both ways"
    )
    assert gyro.movements["matrix_zx"] == (
        "turn it about x by 90 degrees or more with z level, between still poses, both ways"
    )
    assert accel.status == FitStatus.REFUSED  # gravity never leaves a plane
    assert "do not determine the accelerometer's offset_x, offset_y, offset_z, matrix_xx" in accel.message


def test_six_faces_leave_the_cross_terms_of_the_accelerometer_open(recorded):
    faces = [(0, 0), (180, 0), (0, 90), (0, -90), (90, 0), (-90, 0)] * 2
    accel, _ = fit_imu(*recorded(np.random.default_rng(26), attitudes=Rotation.from_euler("xy", faces, degrees=True)))
    assert {"matrix_xy", "matrix_yx"} <= set(accel.undetermined)
    assert not {"matrix_xx", "matrix_yy", "matrix_zz", "offset_x"} & set(accel.undetermined)
    assert accel.movements["matrix_xy"] == accel.movements["matrix_yx"]
    assert accel.movements["matrix_xy"].startswith("hold poses with x and y both 45 degrees from vertical")
    assert accel.movements["matrix_xy"].endswith("and turn about z in between")


def test_few_poses_are_fitted_and_said_to_be_few(recorded):
    few = fit_imu(*recorded(np.random.default_rng(24), poses=8))[0]
    said = [text for text in few.warnings if "residuals more than unknowns" in text]
    assert said == ["only 4 residuals more than unknowns: hold more poses to test the fit"]
    assert few.quality["joint_dof"] == 8 + 2 * 7 + 3 - 21


def test_the_rate_of_the_earth_is_in_the_sd_of_an_offset(recorded):
    """It turns with the body, by 15 degrees an hour: the offset of a quiet gyroscope is known no better."""
    quiet = fit_imu(*recorded(np.random.default_rng(25), poses=12, gyro_sd=1e-6))[1]
    assert quiet.sd[:3] == pytest.approx(np.full(3, 7.292115e-5 / np.sqrt(3.0 * 12.0)), rel=0.15)


def test_the_form_of_imu_tk_is_the_same_model(unit):
    fit = fit_imu(*unit, form="upper")[0]
    native = fit.native["imu_tk"]
    misalignment, scale = np.array(native["misalignment"]), np.array(native["scale"])
    assert np.diag(misalignment).tolist() == [1.0, 1.0, 1.0]
    assert misalignment @ np.diag(scale) == pytest.approx(fit.model.matrix)
    assert native["bias"] == fit.model.offset.tolist()
    assert fit.native["units_per_si"] == pytest.approx(1.0 / scale)
    assert not np.tril(fit.model.matrix, -1).any()


def test_gravity_of_another_place_scales_the_accelerometer_alone(unit):
    one, other = fit_imu(*unit), fit_imu(*unit, gravity=9.78)
    assert other[0].model.matrix == pytest.approx(one[0].model.matrix * 9.78 / G, rel=1e-6, abs=1e-7)
    assert other[0].model.offset == pytest.approx(one[0].model.offset, abs=1e-6)
    assert other[1].model.matrix == pytest.approx(one[1].model.matrix, abs=1e-6)
