"""Real recordings of others, and captures of real firmware, with known answers."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.fit import FitStatus
from mavcal.calib.logs import read
from mavcal.calib.logs.tables import read_table
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Recording

pytestmark = pytest.mark.shared

SIX = {name: str(k) for k, name in enumerate(f"{s}_{a}" for s in ("accel", "gyro") for a in "xyz")}


def imu_multi(recording, **options):
    return METHODS["imu-multi"].run(recording, options)


@pytest.mark.long
def test_xsens_against_its_certificate(shared_data):
    accel = read_table(
        shared_data / "imu_tk_xsens/xsens_acc.mat",
        mapping={"t": "0", "accel_x": "1", "accel_y": "2", "accel_z": "3"},
        unit_accel="counts",
    )
    gyro = read_table(
        shared_data / "imu_tk_xsens/xsens_gyro.mat",
        mapping={"t": "0", "gyro_x": "1", "gyro_y": "2", "gyro_z": "3"},
        unit_gyro="counts",
    )
    fits = imu_multi(Recording(accel.channels + gyro.channels), gravity=9.81744, form="upper")
    assert [fit.status for fit in fits] == [FitStatus.OK, FitStatus.OK]
    assert fits[0].native["units_per_si"] == pytest.approx([415, 413, 415], rel=0.0025)
    assert fits[0].model.offset == pytest.approx([33123, 33276, 32360], abs=6)
    assert fits[1].native["units_per_si"] == pytest.approx([4778, 4758, 4766], rel=0.0025)
    assert fits[0].quality["norm_rms"] < 0.0012
    T = np.array(fits[0].native["imu_tk"]["misalignment"])
    assert T[[0, 0, 1], [1, 2, 2]] == pytest.approx([-0.0034, -0.0092, -0.0214], abs=5e-4)
    assert fits[1].quality["closure_rms_deg"] < 0.5
    assert any("scatter" in text for text in fits[0].warnings)


@pytest.mark.parametrize(
    ("file", "scale", "bias", "rate"),
    [
        ("imu0.log", (0.9961, 0.9966, 0.9934), (0.103, 0.097, 0.344), (1.12, -0.38, 1.22)),
        ("imu1.log", (0.9951, 0.9950, 0.9904), (0.090, 0.070, 0.338), (-0.60, 1.10, 0.32)),
    ],
)
def test_mikoff(shared_data, file, scale, bias, rate):
    recording = read_table(shared_data / "mikoff_mpu9150x5" / file, mapping=SIX, rate=100.0)
    accel, gyro = imu_multi(recording)
    assert (accel.status, gyro.status) == (FitStatus.OK, FitStatus.OK)
    assert np.diag(accel.model.matrix) == pytest.approx(scale, abs=5e-4)
    assert accel.model.offset == pytest.approx(bias, abs=0.004)
    assert np.degrees(gyro.model.offset) == pytest.approx(rate, abs=0.02)
    assert ((np.diag(gyro.model.matrix) > 0.989) & (np.diag(gyro.model.matrix) < 1.0055)).all()


def test_ten_positions_do_not_tell_the_misalignment(shared_data):
    recording = read_table(
        shared_data / "cuyo_mpu6050/calibration_data__example_data_calibration.csv",
        mapping=SIX,
        rate=100.0,
        unit_accel="counts",
        unit_gyro="counts",
    )
    accel, gyro = imu_multi(recording)
    published = np.loadtxt(shared_data / "cuyo_mpu6050/optmization_result_data__params_acc.csv")
    assert np.diag(accel.model.matrix) == pytest.approx(published[3:6], rel=1e-3)
    radius = 9.80665 / published[3:6].mean()
    assert accel.model.offset == pytest.approx(-published[6:9], abs=2e-3 * radius)
    assert accel.status == FitStatus.PARTIAL
    assert {"matrix_xy", "matrix_yx"} <= set(accel.undetermined)
    assert "45 degrees" in accel.movements["matrix_xy"]
    assert {f"matrix_{a}{b}" for a in "xyz" for b in "xyz" if a != b} <= set(gyro.undetermined)
    assert not {"offset_x", "matrix_xx", "matrix_yy", "matrix_zz"} & set(accel.undetermined)


@pytest.mark.long
def test_firmware_captures_with_known_truth(shared_data):
    accel, gyro = imu_multi(read(shared_data / "px4_captures/bench_faces.tlog"))
    truth = np.concatenate([[0.31, -0.22, 0.17], np.diag(1.0 / np.array([1.021, 0.984, 1.013])).ravel()])
    assert np.abs((accel.values - truth) / accel.sd).max() < 4.0
    assert np.abs((gyro.values - np.concatenate([[0.0132, -0.0284, 0.0057], np.eye(3).ravel()])) / gyro.sd).max() < 4.0

    accel, gyro = imu_multi(read(shared_data / "sitl_captures/six_faces.tlog"), instance=0)
    truth = np.concatenate([[0.31, -0.22, 0.17], np.diag([1.021, 0.984, 1.013]).ravel()])
    known = ~np.isnan(accel.sd)
    assert np.abs((accel.values - truth)[known] / accel.sd[known]).max() < 4.0
    assert gyro.status == FitStatus.PARTIAL  # turned faster than the stream samples: its scale is hardly known
    assert gyro.model.offset == pytest.approx([0.0132, -0.0084, 0.0057], abs=2e-5)
