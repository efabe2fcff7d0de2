"""Which elements of a sensor's fit are compared with what is in force."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.firmware.compose.draft import Draft, Rank, Subject
from mavcal.calib.firmware.compose.fitted import Pair
from mavcal.calib.firmware.compose.plan import agreement
from mavcal.calib.firmware.names import ardupilot_compass_names, ardupilot_imu_names
from mavcal.calib.firmware.options import ComposeOptions
from mavcal.calib.firmware.plan import ParameterKind
from mavcal.calib.fit import parameter_names
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import ThermalPolynomial

ACCEL, GYRO, MAG = (Subject(s, 0) for s in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG))
CURVE = ThermalPolynomial(25.0, 10.0, 60.0, [[7e-5, 6e-7, 1e-9], [-4e-5, -3e-7, 2e-9], [9e-5, 4e-7, 0.0]])


def judged(parameters, pair, changes=(), autopilot="ardupilot"):
    draft = Draft(parameters, ComposeOptions(), ParameterKind.INT32)
    for name, value in dict(changes).items():
        draft.set_real(name, value, Rank.OFFSET, "", about=pair.about)
    return agreement(draft, autopilot, pair)


def in_force(parameters, sensor=Sensor.ACCEL, offset=(0.5, 0.3, 0.1)):
    """A unit that was calibrated at 30 degC."""
    names = ardupilot_imu_names(sensor, 0)
    return (
        parameters
        | {names["temperature"]: 30.0}
        | {names[f"offset_{a}"]: v for a, v in zip("xyz", offset, strict=True)}
    )


ELEMENTS = ("xx", "yy", "zz", "xy", "xz", "yz")
PLACES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
SDS = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]) * 1e-3


def fit_of(make_fit, sensor, change, undetermined=()):
    """A fit whose offset and symmetric matrix lie `change` (9,) from 0.5 0.3 0.1 and one, each with its own sd."""
    symmetric = np.eye(3)
    for value, (i, j) in zip(change[3:], PLACES, strict=True):
        symmetric[i, j] = symmetric[j, i] = symmetric[i, j] + value
    covariance = np.zeros((12, 12))
    names = parameter_names()
    for sd, element in zip(SDS, ("offset_x", "offset_y", "offset_z", *ELEMENTS), strict=True):
        if element.startswith("offset"):
            covariance[names.index(element), names.index(element)] = sd**2
            continue
        both = [names.index(f"matrix_{element}"), names.index(f"matrix_{element[::-1]}")]
        covariance[np.ix_(both, both)] = sd**2
    fit = make_fit(sensor, offset=np.array([0.5, 0.3, 0.1]) + change[:3], matrix=symmetric, temperature=31.0)
    return dataclasses.replace(fit, covariance=covariance, undetermined=undetermined)


COUNT = {Sensor.GYRO: 3, Sensor.ACCEL: 6, Sensor.MAG: 9}


@pytest.mark.parametrize("sensor", COUNT)
@pytest.mark.parametrize("element", range(9))
def test_every_element_is_weighed_by_its_own_sd(ardupilot_parameters, make_fit, sensor, element):
    change = np.zeros(9)
    change[element] = 0.5 * SDS[element]
    parameters = in_force(in_force(ardupilot_parameters, Sensor.GYRO))
    # a compass adds its offset and holds milligauss: 1 uT is 10 of them
    names = ardupilot_compass_names(0, 0)
    parameters |= {names[f"offset_{a}"]: -10.0 * v for a, v in zip("xyz", (0.5, 0.3, 0.1), strict=True)}
    found = judged(parameters, Pair(Subject(sensor, 0), fit_of(make_fit, sensor, change), None))
    assert found is not None
    counts = element < COUNT[sensor]
    assert found.deviation == pytest.approx(0.5 / np.sqrt(2.0 * COUNT[sensor]) if counts else 0.0, rel=2e-2, abs=2e-3)
    assert found.text.startswith(f"{sensor} 1 agrees")


@pytest.mark.parametrize("element", range(9))
def test_what_the_fit_leaves_open_is_not_judged(ardupilot_parameters, make_fit, element):
    names = ("offset_x", "offset_y", "offset_z", *(f"matrix_{e}" for e in ELEMENTS))
    parameters = ardupilot_parameters | {f"COMPASS_OFS_{a}": -v for a, v in zip("XYZ", (5.0, 3.0, 1.0), strict=True)}
    change = np.zeros(9)
    change[element] = 40.0 * SDS[element]
    fit = fit_of(make_fit, Sensor.MAG, change)
    stays = judged(parameters, Pair(MAG, fit, None))
    assert stays is not None
    assert stays.text.startswith("what can be stored of mag 1 agrees")  # nothing is to be written here
    left = judged(parameters, Pair(MAG, dataclasses.replace(fit, undetermined=(names[element],)), None))
    assert left is not None
    assert left.text.startswith("mag 1 agrees")


class TestNews:
    """A write that says more than numbers."""

    def test_a_number_of_a_rotation_or_an_id_is_news(self, ardupilot_parameters, make_fit):
        fit = fit_of(make_fit, Sensor.ACCEL, np.zeros(9))
        for rank, agrees in ((Rank.ID, False), (Rank.ROTATION, False), (Rank.SETTING, True)):
            draft = Draft(in_force(ardupilot_parameters), ComposeOptions(), ParameterKind.INT32)
            draft.set_integer("INS_ACC_ID", 7, rank, "", kind=ParameterKind.INT32, about=ACCEL)
            assert (agreement(draft, "ardupilot", Pair(ACCEL, fit, None)) is not None) == agrees

    def test_offsets_of_zero_are_a_first_calibration_but_of_a_gyro(self, ardupilot_parameters, make_fit):
        for sensor, agrees in ((Sensor.ACCEL, False), (Sensor.GYRO, True)):
            parameters = in_force(ardupilot_parameters, sensor, (0.0, 0.0, 0.0))
            fit = make_fit(sensor, offset_sd=1e-3, matrix_sd=1e-3)
            assert (judged(parameters, Pair(Subject(sensor, 0), fit, None)) is not None) == agrees
        one = in_force(ardupilot_parameters, Sensor.ACCEL, (0.0, 0.0, 0.5))
        fit = make_fit(Sensor.ACCEL, offset=[0.0, 0.0, 0.5], matrix_sd=1e-3)
        assert judged(one, Pair(ACCEL, fit, None)) is not None

    @pytest.mark.parametrize(("known", "agrees"), [(30.0, True), (-99.0, True), (-100.0, False), (-300.0, False)])
    def test_a_temperature_that_becomes_known_is_news(self, ardupilot_parameters, make_fit, known, agrees):
        fit = fit_of(make_fit, Sensor.ACCEL, np.zeros(9))
        parameters = in_force(ardupilot_parameters) | {"INS_ACC1_CALTEMP": known}
        assert (judged(parameters, Pair(ACCEL, fit, None)) is not None) == agrees
        silent = dataclasses.replace(fit, temperature=None)
        assert judged(parameters, Pair(ACCEL, silent, None)) is not None
        none = {n: v for n, v in parameters.items() if n != "INS_ACC1_CALTEMP"}
        assert judged(none, Pair(ACCEL, fit, None)) is not None

    def test_a_sensor_without_a_row_is_news(self, ardupilot_parameters, make_fit):
        lost = in_force(ardupilot_parameters) | {"COMPASS_PRIO1_ID": 5}
        assert judged(lost, Pair(MAG, fit_of(make_fit, Sensor.MAG, np.zeros(9)), None)) is None


def thermal(parameters, curve=CURVE, *, offset=(0.01, 0.02, 0.03)):
    """A gyroscope with `curve` in force, offset as at 35 degC."""
    names = ardupilot_imu_names(Sensor.GYRO, 0)
    row = {names["thermal_enable"]: 1, names["thermal_min"]: curve.t_min, names["thermal_max"]: curve.t_max}
    for order in (1, 2, 3):
        row |= {names[f"thermal_{order}_{a}"]: 0.0 for a in "xyz"}
    row |= {names["temperature"]: 35.0}
    row |= {names[f"offset_{a}"]: v for a, v in zip("xyz", offset, strict=True)}
    return parameters | row


class TestDrift:
    """Judged about the fit's own reference."""

    FLAT = ThermalPolynomial(30.0, 10.0, 60.0, [[1e-6, 1e-8], [1e-6, 1e-8], [1e-6, 1e-8]])

    def drift(self, make_fit, curve, **more):
        sd = more.pop("sd", 1e-4)
        return make_fit(Sensor.GYRO, offset=[0.01, 0.02, 0.03], polynomial=curve, polynomial_sd=sd, **more)

    def coefficients(self, draft_curve):
        """Change names of ArduPilot, about its fixed 35 degC, times a million."""
        names = ardupilot_imu_names(Sensor.GYRO, 0)
        return {
            names[f"thermal_{order}_{a}"]: 1e6 * draft_curve[i][order - 1]
            for order in (1, 2, 3)
            for i, a in enumerate("xyz")
        }

    def test_curves_are_compared_about_the_reference_of_the_fit(self, ardupilot_parameters, make_fit):
        about_35 = np.array([[7e-5, 6e-7, 1e-9], [-4e-5, -3e-7, 2e-9], [9e-5, 4e-7, 0.0]])
        fit = self.drift(make_fit, CURVE, offset_sd=1e-3)
        parameters = thermal(ardupilot_parameters)
        found = judged(parameters, Pair(GYRO, None, fit), self.coefficients(about_35))
        # the same cubics about 25 degC: a + 2 b d + 3 c d^2, b + 3 c d, c with d = -10
        a, b, c = about_35.T
        moved = np.array([a - 20 * b + 300 * c, b - 30 * c, c])
        offset = -(-10 * a + 100 * b - 1000 * c)
        sds = 1e-4 * 10.0 ** -np.arange(3)
        deviation = np.sqrt((((moved / sds[:, None]) ** 2).sum() + ((-offset / 1e-3) ** 2).sum()) / 24)
        assert found is not None
        assert found.deviation == pytest.approx(deviation, rel=1e-3)

    def test_a_shape_beside_a_fit_at_rest_leaves_the_offset_to_that(self, ardupilot_parameters, make_fit):
        rest = make_fit(Sensor.GYRO, offset=[0.01, 0.02, 0.03], offset_sd=1e-3, temperature=35.0)
        shape = self.drift(make_fit, CURVE, offset_sd=1e-9)
        about_35 = np.array([[7e-5, 6e-7, 1e-9], [-4e-5, -3e-7, 2e-9], [9e-5, 4e-7, 0.0]])
        found = judged(thermal(ardupilot_parameters), Pair(GYRO, rest, shape), self.coefficients(about_35))
        a, b, c = about_35.T
        moved = np.array([a - 20 * b + 300 * c, b - 30 * c, c])
        sds = 1e-4 * 10.0 ** -np.arange(3)
        assert found is not None
        assert found.deviation == pytest.approx(np.sqrt(((moved / sds[:, None]) ** 2).sum() / 24), rel=1e-3)

    def test_without_a_temperature_an_offset_beside_a_curve_cannot_be_judged(self, ardupilot_parameters, make_fit):
        rest = make_fit(Sensor.GYRO, offset=[0.01, 0.02, 0.03], offset_sd=1e-3, temperature=None)
        now = thermal(ardupilot_parameters) | self.coefficients(self.FLAT.coefficients[:, [0, 1, 1]])
        assert judged(now, Pair(GYRO, rest, None)) is None
        off = now | {"INS_TCAL1_ENABLE": 0}
        assert judged(off, Pair(GYRO, rest, None)) is not None
        rest = make_fit(Sensor.GYRO, offset=[0.5, 0.02, 0.03], offset_sd=1e-3, temperature=None)
        assert judged(off, Pair(GYRO, rest, None)) is not None  # of what can be stored
        draft = Draft(off, ComposeOptions(), ParameterKind.INT32)
        draft.set_integer("INS_TCAL1_ENABLE", 1, Rank.THERMAL_ENABLE, "", kind=ParameterKind.INT8, about=GYRO)
        assert agreement(draft, "ardupilot", Pair(GYRO, rest, None)) is None

    @pytest.mark.parametrize(("low", "high", "agrees"), [(9.0, 61.0, True), (8.9, 60.0, False), (10.0, 61.1, False)])
    def test_a_range_that_is_wider_by_more_than_a_degree_is_news(
        self, ardupilot_parameters, make_fit, low, high, agrees
    ):
        now = thermal(ardupilot_parameters) | self.coefficients(np.full((3, 3), 1e-9))
        wide = dataclasses.replace(self.FLAT, t_min=low, t_max=high)
        fit = self.drift(make_fit, wide, offset_sd=1e-2, sd=1.0)
        assert (judged(now, Pair(GYRO, None, fit)) is not None) == agrees

    def test_a_curve_that_would_not_be_in_force_cannot_agree(self, ardupilot_parameters, make_fit):
        off = thermal(ardupilot_parameters) | {"INS_TCAL1_ENABLE": 0}
        fit = self.drift(make_fit, self.FLAT, offset_sd=1e-2, sd=1.0)
        assert judged(off, Pair(GYRO, None, fit)) is None
        draft = Draft(off, ComposeOptions(), ParameterKind.INT32)
        draft.set_integer("INS_TCAL1_ENABLE", 1, Rank.THERMAL_ENABLE, "", kind=ParameterKind.INT8, about=GYRO)
        assert agreement(draft, "ardupilot", Pair(GYRO, None, fit)) is not None
