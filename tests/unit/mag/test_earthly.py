"""No compass fit is ok in a field that no place on the Earth has."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.earth import beyond_earth, earth_field
from mavcal.calib.fit import FitStatus
from mavcal.calib.mag.earthly import plausible_field
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Channel, Recording, Sensor, Stage

METHODS_OF = ("mag-sphere", "mag-ellipsoid-axis", "mag-ellipsoid", "mag-align", "mag-gyro")
RATE = np.array([0.30, 0.53, 0.64])


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
