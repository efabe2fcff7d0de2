from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.fit import FitResult, FitStatus, parameter_names
from mavcal.calib.procedures.body_frame import in_body, in_sensor
from mavcal.calib.recording import Channel, Rounding, Sensor, Stage
from mavcal.calib.triad import TriadModel

YAW_90 = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
OBLIQUE = Rotation.from_euler("ZYX", [30.0, 20.0, -50.0], degrees=True).as_matrix()


def fitted(rng, undetermined=()):
    root = rng.normal(0.0, 0.01, (12, 12))
    covariance = root @ root.T
    rows = [parameter_names().index(name) for name in undetermined]
    covariance[rows, :] = covariance[:, rows] = 0.0
    return FitResult(
        *("test", Sensor.GYRO, 0, FitStatus.OK, ""),
        model=TriadModel(rng.normal(size=3), np.eye(3) + rng.normal(0.0, 0.1, (3, 3))),
        covariance=covariance,
        unit="rad/s",
        n_samples=1,
        n_used=1,
        residual_rms=0.0,
        condition_number=1.0,
        undetermined=undetermined,
        movements={name: f"move for {name}" for name in undetermined},
    )


@pytest.mark.parametrize("R", [YAW_90, OBLIQUE])
def test_the_turned_model_corrects_the_raw_sensor_as_the_body_is_corrected(R):
    rng = np.random.default_rng(1)
    fit = fitted(rng)
    raw = rng.normal(size=(20, 3))
    turned = in_sensor(fit, R, temperature=21.0)
    np.testing.assert_allclose(turned.model.apply(raw) @ R.T, fit.model.apply(raw @ R.T), atol=1e-12)
    assert turned.temperature == 21.0

    def gradient(model, at):  # of the corrected reading by offset and matrix
        return np.hstack([-model.matrix, np.kron(np.eye(3), at - model.offset)])

    for at in raw[:3]:
        body = gradient(fit.model, R @ at)
        sensor = R @ gradient(turned.model, at)
        np.testing.assert_allclose(sensor @ turned.covariance @ sensor.T, body @ fit.covariance @ body.T, atol=1e-12)


def test_names_of_what_is_open_turn_with_the_sensor():
    fit = fitted(np.random.default_rng(2), ("matrix_xx", "matrix_zy"))
    turned = in_sensor(fit, YAW_90)
    assert turned.undetermined == ("matrix_yy", "matrix_zx")  # body x is -y of the sensor, body y its x
    assert turned.movements["matrix_yy"] == "move for matrix_xx"
    assert np.isnan(turned.sd[7])
    everything = in_sensor(fit, OBLIQUE).undetermined
    assert set(everything) == {name for name in parameter_names() if name.startswith("matrix")}


def test_bins_survive_a_turn_by_right_angles_alone():
    zero = np.array([[True, False, False], [False, False, True]])
    values = np.array([[0.0, 2.0, 3.0], [4.0, 5.0, 0.0]])
    facts = {"quantum": 1.0, "rounding": Rounding.TOWARD_ZERO, "zero_bin": zero}
    channel = Channel(Sensor.ACCEL, 0, np.arange(2.0), values, "m/s2", Stage.RAW, "S", **facts)
    turned = in_body(channel, YAW_90)
    np.testing.assert_array_equal(turned.values, values @ YAW_90.T)
    np.testing.assert_array_equal(turned.zero_bin, zero[:, [1, 0, 2]])
    assert turned.quantum == 1.0
    assert in_body(channel, OBLIQUE).quantum == 0.0
    assert in_body(channel, np.eye(3)) is channel
