from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import InvalidInputError, UndeterminedError
from mavcal.calib.mag.free_rotation import angle_between
from mavcal.calib.mag.orientation import RIGHT_ANGLES, MountingVerdict, find_orientation, interpolated, rotation_matrix

DIP = math.radians(66.0)
NORTH_EAST_DOWN = 49.0 * np.array([math.cos(DIP), 0.0, math.sin(DIP)])


def moved(rng: np.random.Generator, count: int, tilt_deg: float = 180.0, dip: float = DIP) -> tuple[Any, Any]:
    """Field in uT and specific force in the body, (count, 3) each, with 0.5 uT and 0.1 m/s2 of noise."""
    tilt = np.radians(rng.uniform(-tilt_deg, tilt_deg, (count, 2)))
    attitude = Rotation.from_euler("ZYX", np.column_stack([rng.uniform(-math.pi, math.pi, count), tilt]))
    north_east_down = 49.0 * np.array([math.cos(dip), 0.0, math.sin(dip)])
    mag = attitude.inv().apply(north_east_down) + 0.5 * rng.normal(size=(count, 3))
    return mag, attitude.inv().apply([0.0, 0.0, -9.80665]) + 0.1 * rng.normal(size=(count, 3))


def test_twenty_four_rotations_with_names_that_say_them() -> None:
    assert len(RIGHT_ANGLES) == 24
    assert RIGHT_ANGLES[0].name == "none"
    assert len({m.name for m in RIGHT_ANGLES}) == 24
    for mounting in RIGHT_ANGLES:
        np.testing.assert_allclose(
            rotation_matrix(mounting.roll, mounting.pitch, mounting.yaw), mounting.matrix, atol=1e-12
        )
        assert np.linalg.det(mounting.matrix) == pytest.approx(1.0)
        other = Rotation.from_euler("ZYX", [mounting.yaw, mounting.pitch, mounting.roll], degrees=True).as_matrix()
        np.testing.assert_allclose(mounting.matrix, other, atol=1e-12)
    names = {m.name for m in RIGHT_ANGLES}
    assert {"yaw_90", "roll_180", "roll_180_yaw_90", "pitch_180", "roll_90", "pitch_270"} <= names


@pytest.mark.sampled
@pytest.mark.parametrize("mounting", RIGHT_ANGLES, ids=lambda m: m.name)
@pytest.mark.parametrize("dip_known", [True, False])
def test_every_mounting_is_found(mounting: Any, dip_known: bool) -> None:
    mag, accel = moved(np.random.default_rng(1), 300)
    found = find_orientation(mag @ mounting.matrix, accel, inclination=DIP if dip_known else None)
    assert found.best.name == mounting.name
    assert found.verdict == (MountingVerdict.AS_STATED if mounting.name == "none" else MountingVerdict.ROTATED)
    assert found.log_likelihood_margin > 10.0
    assert next(iter(found.rms)) == mounting.name


def test_turns_on_the_level_do_not_tell_a_yaw() -> None:
    mag, accel = moved(np.random.default_rng(2), 300, tilt_deg=2.0)
    found = find_orientation(mag @ rotation_matrix(0, 0, 90), accel, inclination=DIP)
    assert found.verdict == MountingVerdict.AMBIGUOUS
    assert "tilt" in found.message
    assert found.misalignment_deg is None


def test_moderate_tilt_is_enough_when_the_dip_is_known() -> None:
    mag, accel = moved(np.random.default_rng(3), 500, tilt_deg=45.0)
    found = find_orientation(mag @ rotation_matrix(180, 0, 0), accel, inclination=DIP)
    assert (found.verdict, found.best.name) == (MountingVerdict.ROTATED, "roll_180")


@pytest.mark.parametrize("angles", [(0, 0, 45), (0, 0, 29), (0, 12, 0), (-9, 0, 0), (45, 30, 130), (180, 0, 61)])
@pytest.mark.parametrize(("tilt", "dip_known"), [(180.0, True), (180.0, False), (45.0, True)])
def test_a_mounting_between_right_angles_is_fitted(angles: Any, tilt: float, dip_known: bool) -> None:
    mag, accel = moved(np.random.default_rng(4), 600, tilt)
    found = find_orientation(mag @ rotation_matrix(*angles), accel, inclination=DIP if dip_known else None)
    assert found.verdict == MountingVerdict.BY_ANGLES
    assert found.fitted is not None
    assert angle_between(found.fitted.matrix, rotation_matrix(*angles)) < 3.0 * found.fitted.sd
    assert math.radians(0.3) < found.fitted.sd < math.radians(1.0)
    assert str(found.fitted.euler) in found.message
    assert found.sine == pytest.approx(math.sin(DIP), abs=0.02)


def test_an_angle_as_small_as_that_of_a_bracket_is_a_right_angle() -> None:
    mag, accel = moved(np.random.default_rng(14), 600)
    assert find_orientation(mag @ rotation_matrix(0, 4, 90), accel, inclination=DIP).verdict == MountingVerdict.ROTATED
    found = find_orientation(mag @ rotation_matrix(0, 7, 90), accel, inclination=DIP)
    assert (found.verdict, found.best.name) == (MountingVerdict.BY_ANGLES, "yaw_90")


def test_an_odd_angle_is_not_told_by_turns_on_the_level() -> None:
    mag, accel = moved(np.random.default_rng(15), 600, tilt_deg=2.0)
    found = find_orientation(mag @ rotation_matrix(0, 0, 29), accel, inclination=DIP)
    assert found.verdict == MountingVerdict.AMBIGUOUS


def test_samples_beside_a_magnet_do_not_turn_the_angles() -> None:
    rng = np.random.default_rng(16)
    mag, accel = moved(rng, 600)
    mag[:30] += [60.0, -40.0, 20.0]
    found = find_orientation(mag @ rotation_matrix(3, -8, 29), accel, inclination=DIP)
    assert found.verdict == MountingVerdict.BY_ANGLES
    assert found.fitted is not None
    assert angle_between(found.fitted.matrix, rotation_matrix(3, -8, 29)) < math.radians(1.5)


MIRRORS = {
    "its x axis reads with the wrong sign": np.diag([-1.0, 1.0, 1.0]),
    "its z axis reads with the wrong sign": np.diag([1.0, 1.0, -1.0]),
    "all its axes read reversed": -np.eye(3),
    "its x and y axes are exchanged": np.eye(3)[[1, 0, 2]],
    "its axes are mirrored": -rotation_matrix(30, 40, 50),
}


@pytest.mark.sampled
@pytest.mark.parametrize("words", MIRRORS)
@pytest.mark.parametrize(("tilt", "dip"), [(180.0, DIP), (45.0, DIP), (180.0, -0.9), (180.0, 0.2)])
@pytest.mark.parametrize("stated", [np.eye(3), rotation_matrix(0, 0, 270)], ids=["none", "yaw_270"])
def test_mirrored_axes_are_named_as_the_sensor_has_them(words: str, tilt: float, dip: float, stated: Any) -> None:
    mag, accel = moved(np.random.default_rng(17), 600, tilt, dip)
    sensor = mag @ stated @ MIRRORS[words]
    found = find_orientation(sensor @ stated.T, accel, inclination=dip, stated=stated)
    assert found.verdict == MountingVerdict.MIRRORED
    assert found.message.startswith(words + ", which no mounting does")
    assert "Power-cycle" in found.message
    assert found.fitted is None


def test_where_the_place_is_not_known_a_mirror_image_is_a_doubt_and_no_finding() -> None:
    mag, accel = moved(np.random.default_rng(18), 600)
    found = find_orientation(mag @ MIRRORS["its z axis reads with the wrong sign"], accel)
    assert (found.verdict, found.best.name) == (MountingVerdict.ROTATED, "yaw_180")
    assert "a compass with a mirrored axis would look the same" in found.message
    assert found.sine == pytest.approx(-math.sin(DIP), abs=0.02)


def test_a_field_that_has_nothing_to_do_with_the_vertical_is_not_explained() -> None:
    rng = np.random.default_rng(5)
    mag, accel = moved(rng, 300)
    found = find_orientation(rng.permutation(mag), accel, inclination=DIP)
    assert found.verdict == MountingVerdict.UNEXPLAINED


def test_small_misalignment_is_reported_with_its_uncertainty() -> None:
    mag, accel = moved(np.random.default_rng(6), 2000)
    small = Rotation.from_rotvec(np.radians([1.0, -2.0, 3.0])).as_matrix()
    found = find_orientation(mag @ small, accel, inclination=DIP)
    assert found.verdict == MountingVerdict.AS_STATED
    assert found.misalignment_deg is not None
    assert found.misalignment_sd_deg is not None
    error = np.array(found.misalignment_deg) - [1.0, -2.0, 3.0]
    assert np.abs(error).max() < 0.25
    assert 0.005 < max(found.misalignment_sd_deg) < 0.5


def test_a_lag_is_not_taken_for_a_misalignment() -> None:
    """A magnetometer 40 ms late on a vehicle that keeps turning one way at 1 rad/s."""
    rng = np.random.default_rng(7)
    t = np.arange(0.0, 60.0, 0.02)
    rates = np.stack([0.3 * np.sin(0.3 * t), 0.4 * np.cos(0.2 * t), np.full(len(t), 1.0)], axis=1)
    attitude = [Rotation.random(rng=rng)]
    for step in Rotation.from_rotvec(rates * 0.02):
        attitude.append(attitude[-1] * step)
    poses = Rotation.concatenate(attitude[:-1])
    mag, accel = poses.inv().apply(NORTH_EAST_DOWN), poses.inv().apply([0.0, 0.0, -9.80665])
    late = interpolated(t - 0.04, t, mag)
    plain = find_orientation(late, accel, inclination=DIP)
    told = find_orientation(late, accel, gyro=rates, inclination=DIP)
    assert plain.lag is None
    assert plain.misalignment_deg is not None
    assert np.abs(plain.misalignment_deg).max() > 0.5
    assert told.lag == pytest.approx(0.04, abs=0.002)
    assert told.misalignment_deg is not None
    assert np.abs(told.misalignment_deg).max() < 0.1


def test_at_rest_a_gyro_changes_nothing() -> None:
    mag, accel = moved(np.random.default_rng(8), 300)
    plain, still = find_orientation(mag, accel), find_orientation(mag, accel, gyro=np.full((300, 3), 1e-3))
    assert still.lag is None
    assert still.misalignment_deg == plain.misalignment_deg


def test_shaken_samples_are_left_out() -> None:
    rng = np.random.default_rng(9)
    mag, accel = moved(rng, 400)
    accel[:200] *= 1.5
    assert find_orientation(mag, accel).n_used < 210
    with pytest.raises(UndeterminedError, match="20 are needed") as caught:
        find_orientation(mag[:200], accel[:200])
    assert "slowly" in caught.value.remedy


@pytest.mark.parametrize(
    ("mag", "accel"),
    [
        (np.ones((30, 3)), np.ones((29, 3))),
        (np.ones((30, 2)), np.ones((30, 2))),
        (np.full((30, 3), math.nan), np.ones((30, 3))),
    ],
)
def test_wrong_input_is_an_error(mag: Any, accel: Any) -> None:
    with pytest.raises(InvalidInputError):
        find_orientation(mag, accel)


def test_a_gyro_that_does_not_match_is_an_error() -> None:
    mag, accel = moved(np.random.default_rng(10), 50)
    with pytest.raises(InvalidInputError, match="gyro"):
        find_orientation(mag, accel, gyro=np.ones((49, 3)))
