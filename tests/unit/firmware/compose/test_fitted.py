"""Which fits may be written, what is left out and why, and where an offset stands at a temperature."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.firmware.compose.draft import Draft, Subject
from mavcal.calib.firmware.compose.fitted import (
    Pair,
    drift_axes,
    is_shape_only,
    keeps_matrix,
    offset_at,
    pair_fits,
    usable_fits,
)
from mavcal.calib.firmware.losses import split
from mavcal.calib.firmware.names import ardupilot_imu_names
from mavcal.calib.firmware.options import ComposeOptions
from mavcal.calib.firmware.plan import Change, ParameterKind
from mavcal.calib.firmware.proof.evidence import StillMean
from mavcal.calib.firmware.proof.force import force_of
from mavcal.calib.firmware.rotations import euler_matrix, rotation_angle
from mavcal.calib.fit import AXES, FitStatus
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import ThermalPolynomial

CURVE = ThermalPolynomial(25.0, 10.0, 60.0, [[1e-3, 1e-5], [0.0, 2e-5], [3e-3, 0.0]])
GYRO, ACCEL, MAG = (Subject(s, 0) for s in (Sensor.GYRO, Sensor.ACCEL, Sensor.MAG))
OFFSETS = tuple(f"offset_{a}" for a in AXES)
SLOPES = tuple(f"poly{k}_{a}" for k in (1, 2) for a in AXES)


@pytest.fixture
def draft():
    return Draft({}, ComposeOptions(), ParameterKind.INT32)


def test_a_refused_fit_is_left_out_with_its_own_words(draft, make_fit):
    fits = [make_fit(Sensor.GYRO, status=FitStatus.REFUSED, message="never at rest"), make_fit(Sensor.ACCEL)]
    assert usable_fits(draft, fits) == (fits[1],)
    assert draft.dropped == {GYRO: "gyro 1 is left out: never at rest"}
    assert draft.plan(None).warnings == ("gyro 1 is left out: never at rest",)


@pytest.mark.parametrize(
    ("more", "why"),
    [
        (
            {"quality": {"below_resolution": True}},
            "its drift with temperature is below what the stream resolves, on every axis",
        ),
        ({"warnings": ("a", "b")}, "its drift with temperature is not determined on any axis. a; b"),
        ({"message": "warm it"}, "its drift with temperature is not determined on any axis. warm it"),
    ],
)
def test_a_drift_without_an_axis_is_left_out(draft, make_fit, more, why):
    fit = make_fit(Sensor.GYRO, polynomial=CURVE, undetermined=SLOPES, **more)
    assert usable_fits(draft, [fit]) == ()
    assert draft.dropped == {GYRO: f"gyro 1 is left out: {why}"}


def test_a_relative_fit_refuses_its_sensor(draft, make_fit):
    assert usable_fits(draft, [make_fit(Sensor.MAG, relative=True)]) == ()
    assert draft.refused[MAG][0].startswith("mag 1: the calibration in force during the capture is not known")


def test_the_axes_of_a_drift_are_those_with_every_coefficient(make_fit):
    assert drift_axes(make_fit(Sensor.GYRO)) == "xyz"
    assert drift_axes(make_fit(Sensor.GYRO, polynomial=CURVE, undetermined=("poly2_y",))) == "xz"
    assert drift_axes(make_fit(Sensor.GYRO, polynomial=CURVE, undetermined=("poly1_x", "poly1_z"))) == "y"


@pytest.mark.parametrize(
    ("sensor", "open_ones", "matrix_sd", "thermal", "shape"),
    [
        (Sensor.ACCEL, OFFSETS, 1e-3, True, True),
        (Sensor.ACCEL, ("offset_y",), 1e-3, True, True),
        (Sensor.ACCEL, (), 1e-3, True, False),
        (Sensor.ACCEL, (), 0.0, True, True),
        (Sensor.ACCEL, (), 0.0, False, False),
        (Sensor.GYRO, OFFSETS, 0.0, True, False),
        (Sensor.GYRO, (), 0.0, True, False),
    ],
)
def test_a_shape_says_how_an_offset_moves_and_not_where_it_stands(
    make_fit, sensor, open_ones, matrix_sd, thermal, shape
):
    fit = make_fit(sensor, polynomial=CURVE if thermal else None, undetermined=open_ones, matrix_sd=matrix_sd)
    assert is_shape_only(fit) is shape
    about = Subject(sensor, 0)
    assert Pair(about, None, fit).absolute is (None if shape else fit)
    rest = make_fit(sensor)
    assert Pair(about, rest, fit).absolute is rest
    assert Pair(about, None, None).absolute is None


@pytest.mark.parametrize(
    ("kept", "open_ones", "keeps"),
    [
        (True, ("matrix_xy", "matrix_zz"), True),
        (True, ("matrix_xy", "offset_x"), False),
        (False, (), False),
        (True, (), True),
    ],
)
def test_a_matrix_is_kept_where_nothing_else_is_open(make_fit, kept, open_ones, keeps):
    assert keeps_matrix(make_fit(Sensor.MAG, quality={"soft_iron_kept": kept}, undetermined=open_ones)) is keeps


def test_fits_of_one_sensor_are_put_together_and_the_last_counts(make_fit):
    first, last, drift, other = (make_fit(Sensor.GYRO), make_fit(Sensor.GYRO), make_fit(Sensor.GYRO, polynomial=CURVE),
                                 make_fit(Sensor.GYRO, 1, polynomial=CURVE))  # fmt: skip
    pairs = pair_fits([first, drift, other, last])
    assert [(p.about, p.at_rest, p.drift) for p in pairs] == [
        (GYRO, last, drift),
        (Subject(Sensor.GYRO, 1), None, other),
    ]


@pytest.mark.parametrize(("heat", "d"), [(35.0, 10.0), (5.0, -15.0), (99.0, 35.0)])
def test_an_offset_at_a_temperature_carries_its_correlations(make_fit, heat, d):
    fit = make_fit(Sensor.GYRO, offset=[0.1, 0.2, 0.3], polynomial=CURVE)
    root = 1e-3 * np.random.default_rng(2).normal(size=(18, 18))
    fit = dataclasses.replace(fit, covariance=root @ root.T)
    offset, covariance = offset_at(fit, heat)
    np.testing.assert_allclose(offset, [0.1 + 1e-3 * d + 1e-5 * d**2, 0.2 + 2e-5 * d**2, 0.3 + 3e-3 * d])
    rows = np.zeros((3, 18))
    for axis in range(3):
        rows[axis, axis], rows[axis, 12 + 2 * axis], rows[axis, 13 + 2 * axis] = 1.0, d, d * d
    np.testing.assert_allclose(covariance, rows @ fit.covariance @ rows.T)
    plain = make_fit(Sensor.GYRO, offset=[0.1, 0.2, 0.3], offset_sd=0.02)
    offset, covariance = offset_at(plain, heat)
    assert offset.tolist() == [0.1, 0.2, 0.3]
    np.testing.assert_allclose(covariance, 4e-4 * np.eye(3))


def test_a_matrix_is_split_with_the_covariance_of_its_symmetric_part(make_fit):
    symmetric = np.array([[1.1, 0.02, 0.01], [0.02, 0.93, 0.03], [0.01, 0.03, 1.02]])
    fit = make_fit(Sensor.MAG, matrix=euler_matrix(4, -7, 20) @ symmetric, offset=[1, 2, 3])
    root = 1e-3 * np.random.default_rng(2).normal(size=(12, 12))
    fit = dataclasses.replace(fit, covariance=root @ root.T)

    def parts(z):
        moved = fit.model.matrix + z[3:].reshape(3, 3)
        values, vectors = np.linalg.eigh(moved.T @ moved)
        s = (vectors * np.sqrt(values)) @ vectors.T
        return np.r_[z[:3], s[0, 0], s[1, 1], s[2, 2], s[0, 1], s[0, 2], s[1, 2]]

    jacobian = np.array([(parts(h) - parts(-h)) / 2e-5 for h in 1e-5 * np.eye(12)]).T
    found = split(fit)
    np.testing.assert_allclose(found.covariance, jacobian @ fit.covariance @ jacobian.T, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(found.diagonal, [1.1, 0.93, 1.02])
    thermal = make_fit(Sensor.MAG, matrix=symmetric, polynomial=CURVE, matrix_sd=1e-3, offset_sd=0.5)
    np.testing.assert_allclose(split(thermal).sd[:3], [0.5] * 3)  # what stands behind the matrix does not count
    np.testing.assert_allclose(found.cross, [0.02, 0.01, 0.03], atol=1e-12)
    assert (
        rotation_angle(euler_matrix(4, 0, 0)) == rotation_angle(euler_matrix(0, 4, 0)) == pytest.approx(np.radians(4))
    )


class TestForce:
    """Which correction would be in force if only some changes had taken effect."""

    def change(self, name, old, new, sensor=Sensor.GYRO):
        return Change(name, old, new, ParameterKind.REAL32, "", sensor=sensor)

    def test_a_change_that_was_refused_leaves_the_old_value(self, ardupilot_parameters):
        changes = (self.change("INS_GYROFFS_X", 0.1, 0.3), self.change("INS_GYROFFS_Y", 0.2, 0.4))
        force = force_of("ardupilot", ardupilot_parameters, changes)
        assert force.model(GYRO, {"INS_GYROFFS_Y"}).offset.tolist() == [0.1, 0.4, 0.0]
        assert force.acting(GYRO) == ("INS_GYROFFS_X", "INS_GYROFFS_Y")
        assert force.acting(ACCEL) == ()

    def test_what_was_hidden_had_the_firmware_s_defaults(self, ardupilot_parameters):
        names = ardupilot_imu_names(Sensor.GYRO, 0)
        rows = {names["thermal_enable"]: 1, names["thermal_min"]: 5.0, names["thermal_max"]: 50.0}
        rows |= {names[f"thermal_{k}_{a}"]: 7.0 for k in (1, 2, 3) for a in "xyz"}
        changes = tuple(self.change(name, None, value) for name, value in rows.items())
        force = force_of("ardupilot", ardupilot_parameters | {names["temperature"]: 30.0}, changes)
        only = force.model(GYRO, {names["thermal_enable"], names["thermal_1_x"]}).polynomial
        assert (only.t_min, only.t_max) == (0.0, 70.0)
        np.testing.assert_allclose(only.coefficients, [[7e-6, 0, 0], [0, 0, 0], [0, 0, 0]])
        assert force.model(GYRO, set()).polynomial is None
        acting = force.acting(GYRO)
        assert names["thermal_enable"] in acting
        assert names["thermal_1_x"] in acting

    def test_motors_act_on_compasses_of_ardupilot_alone(self, ardupilot_parameters, px4_parameters):
        known = ardupilot_parameters | {"COMPASS_MOTCT": 2, "COMPASS_DEC": 0.0}
        changes = tuple(
            self.change(f"COMPASS_MOT_{a}", 0.0, v, Sensor.MAG) for a, v in zip("XYZ", (10.0, 20, 0), strict=True)
        )
        force = force_of("ardupilot", known, changes)
        readings = [
            StillMean(1.0, np.zeros(3), np.eye(3), None, current=2.0),
            StillMean(2.0, np.zeros(3), np.eye(3), None, current=3.0),
        ]
        every = {c.name for c in changes}
        np.testing.assert_allclose(force.motor(MAG, every, readings), [[2, 4, 0], [3, 6, 0]])
        np.testing.assert_allclose(force.motor(MAG, every - {"COMPASS_MOT_X"}, readings), [[0, 4, 0], [0, 6, 0]])
        assert not force.motor(GYRO, every, readings).any()
        assert force.motor(MAG, every, []).shape == (0, 3)
        assert set(force.acting(MAG)) == every
        assert force.acting(GYRO) == ()
        assert not force_of("px4", px4_parameters | {"CAL_MAG_COMP_TYP": 2}, ()).motor(MAG, set(), readings).any()

    def test_a_curve_that_differs_only_beyond_the_other_s_range_does_not_act(self, ardupilot_parameters):
        names = ardupilot_imu_names(Sensor.GYRO, 0)
        row = {names["thermal_enable"]: 1, names["thermal_min"]: 10.0, names["thermal_max"]: 60.0}
        row |= {names[f"thermal_{k}_{a}"]: 0.0 for k in (1, 2, 3) for a in "xyz"}
        row |= {names["thermal_1_x"]: 100.0, names["temperature"]: 35.0}
        wider = force_of("ardupilot", ardupilot_parameters | row, (self.change(names["thermal_max"], 60.0, 70.0),))
        assert wider.acting(GYRO) == ()
        bent = force_of("ardupilot", ardupilot_parameters | row, (self.change(names["thermal_3_z"], 0.0, 0.01),))
        assert bent.acting(GYRO) == (names["thermal_3_z"],)
