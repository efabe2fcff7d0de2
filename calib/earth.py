"""The Earth as a reference: its magnetic field at a place and date, and its gravity.

Dates are handed in; nothing here looks at a clock.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from datetime import date

import numpy as np
from numpy.typing import NDArray
from pygeomag import GeoMag
from pygeomag.wmm.wmm_2010 import WMM_2010
from pygeomag.wmm.wmm_2015v2 import WMM_2015v2
from pygeomag.wmm.wmm_2020 import WMM_2020
from pygeomag.wmm.wmm_2025 import WMM_2025

from mavcal.calib.errors import InvalidInputError

Array = NDArray[np.float64]

WEAKEST_UT, STRONGEST_UT = 22.0, 67.0
"""Least and largest strength of the Earth's field at its surface. They occur in South America, and between Australia
and Antarctica (WMM2025 and IGRF-14, charts of the total intensity)."""

LIFE_SPAN = 5.0
"""Years that one set of World Magnetic Model coefficients is valid for."""

# Model epoch -> coefficients and the one-sigma error of the total intensity in nT, crustal field included: technical
# reports of WMM2015, WMM2020 and WMM2025, error model. That of WMM2010 has another form: taken as WMM2015.
_MODELS = {2010.0: (WMM_2010, 152.0), 2015.0: (WMM_2015v2, 152.0), 2020.0: (WMM_2020, 148.0), 2025.0: (WMM_2025, 138.0)}

# Error growth outside the life span, nT per year: the secular acceleration, which the models leave out, reaches
# about 10 nT/yr2, hence 100 nT within the first years.
_GROWTH_NT_PER_YEAR = 50.0

# WGS 84 ellipsoid and its normal gravity: NIMA TR8350.2, equations 4-1 (Somigliana) and 4-3 (height), tables 3.1-3.4.
SEMI_MAJOR_AXIS_M = 6378137.0
_FLATTENING = 1.0 / 298.257223563
_ECCENTRICITY_SQUARED = 0.00669437999014
_EQUATORIAL_GRAVITY = 9.7803253359
_SOMIGLIANA = 0.00193185265241
_CENTRIFUGAL_RATIO = 0.00344978650684


@dataclass(frozen=True, eq=False)
class EarthField:
    """The Earth's magnetic field at one place and date.

    Parameters
    ----------
    north_east_down : shape (3,)
        uT.
    norm_sd
        One-sigma error of the field strength, uT: the model's, with the crust's typical contribution.
    valid
        False if the date is outside the life span of the newest fitting model: the field is extrapolated.
    model
        Name of the coefficients, or what else the field comes from.
    """

    north_east_down: Array
    norm_sd: float = 0.0
    valid: bool = True
    model: str = "given"

    def __post_init__(self) -> None:
        vector = np.array(self.north_east_down, dtype=np.float64)
        if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
            raise InvalidInputError(f"a magnetic field is three finite numbers in uT, not all zero; got {vector}")
        if not (math.isfinite(self.norm_sd) and self.norm_sd >= 0.0):
            raise InvalidInputError(f"standard deviation of a field strength cannot be {self.norm_sd} uT")
        object.__setattr__(self, "north_east_down", vector)

    @property
    def norm(self) -> float:
        """Field strength, uT."""
        return float(np.linalg.norm(self.north_east_down))

    @property
    def horizontal(self) -> float:
        """Strength of the horizontal part, uT: what a compass points with."""
        return math.hypot(float(self.north_east_down[0]), float(self.north_east_down[1]))

    @property
    def inclination(self) -> float:
        """Dip below the horizon, rad."""
        return math.atan2(float(self.north_east_down[2]), self.horizontal)

    @property
    def declination(self) -> float:
        """Angle from true north to the horizontal part, positive east, rad."""
        return math.atan2(float(self.north_east_down[1]), float(self.north_east_down[0]))


def decimal_year(when: date) -> float:
    """Decimal year of a date, as the magnetic model counts."""
    return when.year + (when.timetuple().tm_yday - 1) / 365.25


def earth_field(latitude: float, longitude: float, altitude: float, year: float) -> EarthField:
    """The World Magnetic Model's field at a place and date.

    Parameters
    ----------
    latitude, longitude
        Geodetic, degrees; north and east positive.
    altitude
        Above the ellipsoid, m, from -1 km to 850 km.
    year
        Decimal year, 2026.5 for the middle of 2026. The model of that date is taken; up to five years before the first
        or after the last one, the nearest is extrapolated and the result is not `valid`.

    Raises
    ------
    InvalidInputError
        If the place is not on Earth, or the date is more than five years off every model.
    """
    _check_place(latitude, longitude, altitude)
    epoch, outside = _epoch(year)
    coefficients, norm_sd_nt = _MODELS[epoch]
    result = _model(epoch).calculate(
        glat=latitude,
        glon=(longitude + 180.0) % 360.0 - 180.0,
        alt=altitude / 1000.0,
        time=year,
        allow_date_outside_lifespan=True,
    )
    return EarthField(
        north_east_down=np.array([result.x, result.y, result.z]) * 1e-3,
        norm_sd=math.hypot(norm_sd_nt, _GROWTH_NT_PER_YEAR * outside) * 1e-3,
        valid=outside == 0.0,
        model=coefficients[0][1],
    )


def beyond_earth(strength: float) -> float:
    """How far a field of `strength` uT lies outside the range of the Earth's, relative; 0: within it.

    >>> beyond_earth(49.0), beyond_earth(134.0), beyond_earth(11.0)
    (0.0, 1.0, 0.5)
    """
    return max(strength / STRONGEST_UT - 1.0, 1.0 - strength / WEAKEST_UT, 0.0)


def local_gravity(latitude: float, altitude: float) -> float:
    """Normal gravity in m/s2 at geodetic `latitude` (degrees) and `altitude` above the ellipsoid (m).

    Somigliana's formula on WGS 84 with the second-order height term (NIMA TR8350.2, 4-1 and 4-3). Real gravity
    departs from it by up to 0.002 m/s2 in mountains.

    >>> round(local_gravity(45.0, 0.0), 5)
    9.8062
    """
    _check_place(latitude, 0.0, altitude)
    s2 = math.sin(math.radians(latitude)) ** 2
    at_ellipsoid = _EQUATORIAL_GRAVITY * (1.0 + _SOMIGLIANA * s2) / math.sqrt(1.0 - _ECCENTRICITY_SQUARED * s2)
    h = altitude / SEMI_MAJOR_AXIS_M
    gradient = 1.0 + _FLATTENING + _CENTRIFUGAL_RATIO - 2.0 * _FLATTENING * s2
    return at_ellipsoid * (1.0 - 2.0 * gradient * h + 3.0 * h * h)


def _check_place(latitude: float, longitude: float, altitude: float) -> None:
    if not (math.isfinite(latitude) and abs(latitude) <= 90.0):
        raise InvalidInputError(f"latitude {latitude} is not within -90 to 90 degrees")
    if not (math.isfinite(longitude) and -180.0 <= longitude <= 360.0):
        raise InvalidInputError(f"longitude {longitude} is not within -180 to 360 degrees")
    if not (math.isfinite(altitude) and -1000.0 <= altitude <= 850e3):
        raise InvalidInputError(f"altitude {altitude} m is not within -1 km to 850 km: is it in metres?")


def _epoch(year: float) -> tuple[float, float]:
    """Epoch of the model for `year`, and by how many years `year` is outside of its life span."""
    first, last = min(_MODELS), max(_MODELS)
    if not (math.isfinite(year) and first - LIFE_SPAN <= year <= last + 2.0 * LIFE_SPAN):
        raise InvalidInputError(
            f"no magnetic model for the year {year}: the models at hand are good from {first:.0f} "
            f"to {last + LIFE_SPAN:.0f}; check the date, or update the package pygeomag"
        )
    epoch = max((e for e in _MODELS if e <= year), default=first)
    return epoch, max(0.0, first - year, year - (epoch + LIFE_SPAN))


@functools.cache
def _model(epoch: float) -> GeoMag:
    return GeoMag(coefficients_data=_MODELS[epoch][0])
