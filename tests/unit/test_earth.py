from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.earth import EarthField, earth_field, local_gravity
from mavcal.calib.errors import InvalidInputError
from tests.fields import field_of


def test_reproduces_a_published_evaluation() -> None:
    """42.283 N 71.35 W, 1000 m, 4 July 2028: printed in the MathWorks manual of wrldmagm with WMM2025."""
    field = earth_field(42.283, -71.35, 1000.0, 2028.0 + 185 / 366)
    assert field.norm == pytest.approx(50.940, abs=0.005)
    assert math.degrees(field.declination) == pytest.approx(-13.6891, abs=0.005)
    assert math.degrees(field.inclination) == pytest.approx(65.9899, abs=0.005)
    assert field.north_east_down == pytest.approx([20.139, -4.905, 46.532], abs=0.005)
    assert field.valid
    assert field.model == "WMM-2025"


PUBLISHED = [  # year, height km, latitude, longitude, X Y Z in nT: the test values that NOAA publishes with the models
    (2020.0, 0, 80, 0, 6570.4, -146.3, 54606.0),
    (2020.0, 0, 0, 120, 39624.3, 109.9, -10932.5),
    (2020.0, 0, -80, 240, 5940.6, 15772.1, -52480.8),
    (2020.0, 100, 80, 0, 6261.8, -185.5, 52429.1),
    (2022.5, 0, 80, 0, 6529.9, 1.1, 54713.4),
    (2022.5, 0, 0, 120, 39684.7, -42.2, -10809.5),
    (2022.5, 100, -80, 240, 5815.0, 14803.0, -49755.3),
    (2025.0, 0, 80, 0, 6521.6, 145.9, 54791.5),
    (2025.0, 0, 0, 120, 39677.8, -109.6, -10580.2),
    (2025.0, 0, -80, 240, 6117.5, 15751.9, -52022.5),
    (2025.0, 100, 80, 0, 6216.0, 92.4, 52598.8),
    (2025.0, 65, 43, 93, 24299.9, 210.5, 50037.9),
    (2027.5, 0, 80, 0, 6500.8, 294.5, 54869.4),
    (2027.5, 0, 0, 120, 39701.6, -167.4, -10381.8),
    (2027.5, 100, 0, 120, 37711.5, -148.7, -9969.8),
    (2027.5, 100, -80, 240, 5984.0, 14760.1, -49317.7),
]


@pytest.mark.parametrize("row", PUBLISHED)
def test_reproduces_the_test_values_of_the_model(row: tuple[float, ...]) -> None:
    year, height, latitude, longitude, *components = row
    field = earth_field(latitude, longitude, 1000.0 * height, year)
    assert field.north_east_down * 1e3 == pytest.approx(components, abs=0.051)


def test_model_follows_the_date() -> None:
    at = {year: earth_field(47.4, 8.5, 500.0, year) for year in (2012.0, 2017.0, 2022.0, 2026.9)}
    assert [f.model for f in at.values()] == ["WMM-2010", "WMM-2015v2", "WMM-2020", "WMM-2025"]
    assert all(f.valid for f in at.values())
    assert all(40.0 < f.norm < 55.0 for f in at.values())


def test_a_date_after_the_last_model_is_extrapolated_and_says_so() -> None:
    inside, outside = (earth_field(47.4, 8.5, 500.0, year) for year in (2029.9, 2033.0))
    assert inside.valid
    assert not outside.valid
    assert outside.norm_sd > inside.norm_sd
    assert outside.norm == pytest.approx(inside.norm, abs=0.5)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ((91.0, 0.0, 0.0, 2026.0), "latitude"),
        ((math.nan, 0.0, 0.0, 2026.0), "latitude"),
        ((0.0, 400.0, 0.0, 2026.0), "longitude"),
        ((0.0, 0.0, 1e6, 2026.0), "metres"),
        ((0.0, 0.0, 0.0, 1990.0), "year"),
        ((0.0, 0.0, 0.0, 2045.0), "year"),
        ((0.0, 0.0, 0.0, math.nan), "year"),
    ],
)
def test_refuses_what_is_not_a_place_or_date(arguments: tuple[float, float, float, float], word: str) -> None:
    with pytest.raises(InvalidInputError, match=word):
        earth_field(*arguments)


@given(st.floats(-90, 90), st.floats(-180, 360), st.floats(2006, 2034))
def test_finite_and_plausible_everywhere(latitude: float, longitude: float, year: float) -> None:
    field = earth_field(latitude, longitude, 0.0, year)
    assert 20.0 < field.norm < 70.0
    assert 0.1 < field.norm_sd < 0.5


def test_longitude_is_periodic() -> None:
    np.testing.assert_allclose(
        earth_field(10.0, -120.0, 0.0, 2026.0).north_east_down, earth_field(10.0, 240.0, 0.0, 2026.0).north_east_down
    )


def test_elements_round_trip() -> None:
    field = field_of(49.0, math.radians(66.0), math.radians(-3.0), norm_sd=0.15)
    assert field.norm == pytest.approx(49.0)
    assert math.degrees(field.inclination) == pytest.approx(66.0)
    assert math.degrees(field.declination) == pytest.approx(-3.0)
    assert field.horizontal == pytest.approx(49.0 * math.cos(math.radians(66.0)))


@pytest.mark.parametrize("vector", [[0.0, 0.0, 0.0], [1.0, math.nan, 0.0], [1.0, 2.0]])
def test_refuses_what_is_not_a_field(vector: list[float]) -> None:
    with pytest.raises(InvalidInputError, match="magnetic field"):
        EarthField(np.array(vector))


def test_gravity_at_pole_and_equator() -> None:
    """Normal gravity of WGS 84 at pole and equator: NIMA TR8350.2, table 3.4."""
    assert local_gravity(0.0, 0.0) == pytest.approx(9.7803253359, abs=1e-10)
    assert local_gravity(90.0, 0.0) == pytest.approx(9.8321849378, abs=2e-9)
    assert local_gravity(-45.0, 0.0) == local_gravity(45.0, 0.0)


def test_gravity_falls_with_height_and_straddles_the_standard_one() -> None:
    assert local_gravity(45.0, 0.0) - local_gravity(45.0, 1000.0) == pytest.approx(3.085e-3, abs=5e-6)
    assert local_gravity(0.0, 0.0) < STANDARD_GRAVITY < local_gravity(90.0, 0.0)
    with pytest.raises(InvalidInputError, match="altitude"):
        local_gravity(45.0, math.inf)


@pytest.mark.parametrize(("latitude", "gravity"), [(0.0, 9.7803267715), (45.0, 9.806199203), (90.0, 9.8321863685)])
def test_gravity_of_the_geodetic_reference_system(latitude: float, gravity: float) -> None:
    """GRS 80 (Moritz 2000), whose constants differ from those of WGS 84 by 1.5e-6 m/s2."""
    assert local_gravity(latitude, 0.0) == pytest.approx(gravity, abs=2e-6)
