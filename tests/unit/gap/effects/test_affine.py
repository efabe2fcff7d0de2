"""Bias, scale, misalignment, rotation: against the sensor equation written out a second time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavcal.calib.gap.effects import by_id
from mavcal.calib.recording import Sensor
from tests.examples import examples

from .conftest import make
from .recovery import amplitudes, noisy

INERTIAL = (Sensor.ACCEL, Sensor.GYRO)


def _matrix(effect_id: str, parameters: np.ndarray) -> np.ndarray:
    """The matrix of a sensor by its parameters, from their names."""
    matrix = np.zeros((3, 3))
    for parameter, value in zip(by_id()[effect_id].parameters, parameters, strict=True):
        where = parameter.name.split(".")[1]
        row, column = "xyz".index(where[0]), "xyz".index(where[-1])
        matrix[row, column] = value
    return matrix


@pytest.mark.parametrize("sensor", INERTIAL)
@pytest.mark.parametrize("kind", ["scale", "misalignment"])
def test_a_matrix_is_recovered_by_the_names_of_its_elements(sensor, kind):
    effect, trace = by_id()[f"{sensor}_{kind}"], make(sensor)
    truth = np.linspace(-0.02, 0.03, len(effect.parameters))
    change = trace.ideal @ _matrix(effect.id, truth).T
    beta, sd, _ = amplitudes(effect, noisy(trace, change, 0.01, 7), np.nan)
    assert (np.abs(beta - truth) < 4.0 * 0.01 * sd).all()
    assert (sd * 0.01 < 0.002).all()


@pytest.mark.parametrize("sensor", [*INERTIAL, Sensor.MAG])
def test_a_bias_is_recovered(sensor):
    effect, trace = by_id()["mag_hard_iron" if sensor == Sensor.MAG else f"{sensor}_bias"], make(sensor, "static")
    beta, sd, _ = amplitudes(effect, noisy(trace, np.array([0.3, -0.2, 0.1]), 0.01, 3), np.nan)
    np.testing.assert_allclose(beta, [0.3, -0.2, 0.1], atol=4.0 * 0.01 * sd.max())


@pytest.mark.parametrize("sensor", [*INERTIAL, Sensor.MAG])
def test_rotation_is_the_derivative_of_a_turn_and_its_exact_form_the_turn(sensor):
    effect, trace = by_id()[f"{sensor}_rotation"], make(sensor)
    columns = effect.columns(trace, np.nan)
    for axis in range(3):
        small = 1e-6 * np.eye(3)[axis]
        turned = np.array([Rotation.from_rotvec(small).as_matrix() @ v for v in trace.ideal[::500]])
        np.testing.assert_allclose(columns[axis, ::500], (turned - trace.ideal[::500]) / 1e-6, atol=1e-3)
    large = np.array([0.3, -0.2, 0.5])
    assert effect.exact is not None
    np.testing.assert_allclose(
        trace.ideal + effect.exact(trace, large), trace.ideal @ Rotation.from_rotvec(large).as_matrix().T, atol=1e-12
    )


@pytest.mark.parametrize("sensor", [*INERTIAL, Sensor.MAG])
@pytest.mark.parametrize("kind", ["scale", "misalignment", "rotation", "soft_iron"])
def test_a_vehicle_at_rest_says_what_is_missing_and_a_tumbling_one_misses_nothing(sensor, kind):
    effect = by_id().get(f"{sensor}_{kind}")
    if effect is None:
        return
    lack = effect.missing(make(sensor, "static"))
    assert lack is not None
    assert "varies by" in lack[0]
    assert ">=" in lack[1]
    assert effect.missing(make(sensor, "tumble")) is None


@settings(max_examples=examples(15), deadline=None)
@given(st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3), st.sampled_from(["accel", "gyro"]))
def test_a_turned_mission_turns_the_columns(rotvec, name):
    turn, sensor = Rotation.from_rotvec(rotvec), Sensor(name)
    here, there = make(sensor, seconds=5.0), make(sensor, seconds=5.0, turn=turn)
    Q = turn.as_matrix()
    M = np.array([[0.01, 0.02, -0.03], [0.005, -0.02, 0.01], [0.0, 0.04, 0.03]])

    def change(trace, matrix):
        scale = np.einsum("j,jni->ni", np.diag(matrix), by_id()[f"{name}_scale"].columns(trace, np.nan))
        beside = [matrix[0, 1], matrix[0, 2], matrix[1, 0], matrix[1, 2], matrix[2, 0], matrix[2, 1]]
        return scale + np.einsum("j,jni->ni", beside, by_id()[f"{name}_misalignment"].columns(trace, np.nan))

    np.testing.assert_allclose(change(there, Q @ M @ Q.T), change(here, M) @ Q.T, atol=1e-9)
    r = np.array([0.1, -0.2, 0.3])
    columns = by_id()[f"{name}_rotation"].columns
    left = np.einsum("j,jni->ni", Q @ r, columns(there, np.nan))
    np.testing.assert_allclose(left, np.einsum("j,jni->ni", r, columns(here, np.nan)) @ Q.T, atol=1e-9)
