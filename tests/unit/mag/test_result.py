"""Results of compass fits: what all methods share, against many draws and against the Earth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavcal.calib.earth import beyond_earth, earth_field
from mavcal.calib.fit import FitStatus
from mavcal.calib.mag.result import mounting_of, plausible_field, rotation_covariance
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Channel, Recording, Sensor, Stage
from mavcal.calib.triad import TriadModel, drift_sd_deg_per_min, tilt_sd_deg
from tests.examples import examples

DRAWS = 400
G = 9.80665
METHODS_OF = ("mag-sphere", "mag-ellipsoid-axis", "mag-ellipsoid", "mag-align", "mag-gyro")
RATE = np.array([0.30, 0.53, 0.64])


def covariance_of(rng: np.random.Generator, size: float) -> np.ndarray:
    """A covariance (12, 12) of offset and matrix without any symmetry."""
    root = size * rng.normal(size=(12, 12))
    return root @ root.T


def drawn(model: TriadModel, covariance: np.ndarray, rng: np.random.Generator) -> list[TriadModel]:
    changes = rng.multivariate_normal(np.zeros(12), covariance, size=DRAWS)
    return [TriadModel(model.offset + c[:3], model.matrix + c[3:].reshape(3, 3)) for c in changes]


@settings(max_examples=examples(25))
@given(st.floats(0.0, 179.0), st.integers(0, 1000), st.lists(st.floats(0.7, 1.4), min_size=3, max_size=3))
def test_the_angle_is_that_of_the_rotation_whatever_the_scales(angle: float, seed: int, scales: list[float]) -> None:
    axis = np.random.default_rng(seed).normal(size=3)
    turn = Rotation.from_rotvec(math.radians(angle) * axis / np.linalg.norm(axis)).as_matrix()
    model = TriadModel(matrix=turn @ np.diag(scales))
    told = mounting_of(model, np.zeros((12, 12)))
    assert told["mounting_deg"] == pytest.approx(angle, abs=1e-5)
    assert told["mounting_sd_deg"] == 0.0


def test_the_covariance_of_the_rotation_is_that_of_many_draws() -> None:
    rng = np.random.default_rng(7)
    turn = Rotation.from_euler("xyz", [20.0, -35.0, 120.0], degrees=True).as_matrix()
    model = TriadModel(matrix=turn @ np.array([[1.1, 0.05, 0.0], [0.05, 0.9, -0.1], [0.0, -0.1, 1.0]]))
    covariance = covariance_of(rng, 3e-4)
    off = [Rotation.from_matrix(one.rotation @ model.rotation.T).as_rotvec() for one in drawn(model, covariance, rng)]
    expected = rotation_covariance(model, covariance)
    np.testing.assert_allclose(np.cov(np.array(off).T), expected, atol=0.2 * np.abs(expected).max())
    worst = math.degrees(math.sqrt(np.linalg.eigvalsh(expected)[-1]))
    assert mounting_of(model, covariance)["mounting_sd_deg"] == pytest.approx(worst)


def test_the_tilt_of_a_level_is_as_uncertain_as_many_draws_say() -> None:
    rng = np.random.default_rng(8)
    model = TriadModel(np.array([0.1, -0.2, 0.3]), np.array([[1.02, 0.01, 0.0], [0.0, 0.98, 0.02], [0.01, 0.0, 1.01]]))
    covariance = covariance_of(rng, 1e-3)
    raw = model.invert(np.array([[0.0, 0.0, -G]]))
    seen = np.array([one.apply(raw)[0] for one in drawn(model, covariance, rng)])
    spread = np.linalg.eigvalsh(np.cov(seen[:, :2].T))[-1]
    assert tilt_sd_deg(model, covariance, G) == pytest.approx(math.degrees(math.sqrt(spread) / G), rel=0.12)


def test_a_level_knows_an_offset_by_its_share_of_gravity() -> None:
    covariance = np.zeros((12, 12))
    covariance[0, 0] = 0.05**2
    covariance[2, 2] = 9.0  # along gravity: no tilt
    assert tilt_sd_deg(TriadModel(), covariance, G) == pytest.approx(math.degrees(0.05 / G))
    assert tilt_sd_deg(TriadModel(), np.zeros((12, 12)), G) == 0.0


def test_a_drift_is_the_worst_axis_of_the_offset_over_a_minute() -> None:
    covariance = np.zeros((15, 15))  # of a model with a thermal part as well
    covariance[:3, :3] = np.diag([1e-4, 2e-4, 1e-5]) ** 2
    assert drift_sd_deg_per_min(TriadModel(), covariance) == pytest.approx(math.degrees(60.0 * 2e-4))
    scaled = TriadModel(matrix=np.diag([10.0, 1.0, 1.0]))  # counts on one axis
    assert drift_sd_deg_per_min(scaled, covariance) == pytest.approx(math.degrees(60.0 * 1e-3))


def turned(strength, *, unit="uT"):
    """Half a minute of a slow tumble, with accelerometer and gyroscope."""
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 60.0, 0.05)
    attitude = Rotation.from_rotvec(np.outer(t, [0, 0, RATE[2]])) * Rotation.from_rotvec(np.outer(t, [*RATE[:2], 0]))
    rate = np.vstack([(attitude[:-1].inv() * attitude[1:]).as_rotvec() / 0.05, np.zeros(3)])
    north_down = strength * np.array([np.cos(1.1), 0.0, np.sin(1.1)])
    mag = attitude.inv().apply(north_down) + [5.0, -3.0, 8.0] + 0.2 * rng.normal(size=(len(t), 3))
    accel = attitude.inv().apply([0.0, 0.0, -9.80665]) + 0.02 * rng.normal(size=(len(t), 3))
    gyro = rate + 0.001 * rng.normal(size=(len(t), 3))
    return Recording(
        (
            Channel(Sensor.MAG, 0, t, mag, unit, Stage.RAW, "test"),
            Channel(Sensor.ACCEL, 0, t, accel, "m/s2", Stage.RAW, "test"),
            Channel(Sensor.GYRO, 0, t[:-1], gyro[:-1], "rad/s", Stage.RAW, "test"),
        )
    )


@pytest.mark.long
@pytest.mark.parametrize("method", METHODS_OF)
@pytest.mark.parametrize(
    ("strength", "status"), [(117.0, False), (9.0, False), (49.0, True), (66.0, True), (23.0, True)]
)
def test_a_field_that_the_earth_has_nowhere_is_refused(method, strength, status):
    (fit,) = METHODS[method].run(turned(strength))
    assert (fit.status != FitStatus.REFUSED) == status, fit.message
    assert ("22 to 67 uT anywhere" in fit.message) == (not status)
    assert not any("none of the Earth's" in text for text in fit.warnings)


def test_a_field_that_is_a_little_too_strong_is_said():
    (fit,) = METHODS["mag-ellipsoid"].run(turned(80.0))
    assert fit.status == FitStatus.OK
    assert "none of the Earth's, which has 22 to 67 uT anywhere" in fit.warnings[0]


def test_counts_and_a_stated_field_are_in_a_unit_of_their_own():
    (counts,) = METHODS["mag-ellipsoid"].run(turned(490.0, unit="counts"))
    assert counts.status == FitStatus.OK
    (stated,) = METHODS["mag-ellipsoid"].run(turned(490.0), {"field": 49.0})
    assert stated.status == FitStatus.OK
    assert "none of the Earth's" in stated.warnings[0]


@pytest.mark.parametrize("latitude", range(-90, 91, 15))
def test_every_place_has_a_plausible_field(latitude):
    """From the model: no place is called none of the Earth's."""
    for longitude in range(-180, 180, 20):
        assert beyond_earth(earth_field(float(latitude), float(longitude), 0.0, 2026.0).norm) == 0.0


def test_the_range_in_which_a_sensor_with_a_wrong_scale_may_read():
    assert [plausible_field(x) for x in (14.0, 15.0, 22.0, 67.0, 90.0, 91.0)] == [False, True, True, True, True, False]


@pytest.mark.parametrize(("share", "good"), [(0.01, True), (0.08, False)])
def test_a_field_that_wanders_while_turning_is_no_good_fit(share, good):
    recording = turned(49.0)
    mag = recording.channel(Sensor.MAG, 0)
    wandering = 49.0 * share * np.column_stack([np.sin(mag.t / w) for w in (3.1, 4.7, 7.3)])
    moved = Channel(Sensor.MAG, 0, mag.t, mag.values + wandering, "uT", Stage.RAW, "test")
    (fit,) = METHODS["mag-ellipsoid"].run(Recording((moved,)))
    assert (fit.status == FitStatus.OK) == good
    assert ("the field wandered by" in fit.message) != good
