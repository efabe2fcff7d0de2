"""Every log and recording of ../shared/data, read as the documents say, against what its README says of it."""

from __future__ import annotations

import lzma
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavcal.calib import logs
from mavcal.calib.firmware.in_force.undo import undo
from mavcal.calib.logs.inspection import inspect
from mavcal.calib.recording import Recording, Sensor, Stage

pytestmark = pytest.mark.shared

BROAD = {"accel": "imu_acc", "gyro": "imu_gyr", "mag": "imu_mag", "q": "opt_quat", "ref_q": "opt_quat"}
AXES_1_TO_3 = {f"accel_{axis}": str(k + 1) for k, axis in enumerate("xyz")} | {"t": "0"}
SIX = {f"{s}_{axis}": str(3 * i + k) for i, s in enumerate(("accel", "gyro")) for k, axis in enumerate("xyz")}
XIO_NAMES = {"gyro": "Gyroscope {} (deg/s)", "accel": "Accelerometer {} (g)", "mag": "Magnetometer {} (uT)"}
XIO = {f"{s}_{axis}": name.format(axis.upper()) for s, name in XIO_NAMES.items() for axis in "xyz"}

# file, options of reading, sensors with their instances, length in s, least number of samples of the first
CASES: tuple[tuple[str, dict[str, Any], dict[str, int], float, int], ...] = (
    ("px4_pyulog/sample.ulg", {}, {"accel": 1, "gyro": 1, "mag": 1}, 69.0, 17000),
    ("px4_pyulog/sample_log_small.ulg", {}, {"accel": 3, "gyro": 3, "mag": 2, "temperature": 3}, 6.5, 1290),
    ("px4_roboto/test.ulg", {}, {"accel": 2, "gyro": 2, "mag": 2, "position": 1}, 9.0, 1300),
    ("df_log171_triple_imu_mag/log171.bin", {}, {"accel": 3, "gyro": 3, "mag": 3, "current": 1}, 242.0, 11900),
    ("df_erle_bench/51.BIN", {}, {"accel": 1, "gyro": 1, "current": 1}, 1306.1, 43400),
    ("df_erlebrain_22/22.BIN", {}, {"accel": 1, "gyro": 1, "mag": 1, "current": 1}, 226.2, 4740),
    ("df_forum_0036/log_0036_mechanical_failure.bin", {}, {"accel": 2, "gyro": 2, "mag": 2}, 150.7, 3750),
    ("airframe_flights/d01.bin.xz", {}, {"accel": 2, "gyro": 2, "mag": 3, "temperature": 2}, 137.5, 54900),
    ("airframe_flights/p01.ulg.xz", {}, {"accel": 1, "gyro": 1, "mag": 1, "temperature": 1}, 154.7, 154),
    ("px4_flights/null.ulg.xz", {}, {"accel": 1, "gyro": 1, "mag": 1, "temperature": 1}, 153.2, 38200),
    ("firmware_runs/ardupilot_gyro_57600.tlog", {}, {"accel": 2, "gyro": 2, "mag": 3}, 285.8, 8000),
    ("df_loganalyzer_examples/nan.log", {}, {"accel": 2, "mag": 2}, 29.0, 700),
    ("sitl_baseline/00000005.BIN", {}, {"accel": 2, "gyro": 2, "mag": 3}, 75.0, 1600),
    ("sitl_flights/null.bin", {}, {"accel": 2, "gyro": 2, "mag": 3, "temperature": 2}, 129.6, 51000),
    ("sitl_flights_2/f10.bin.xz", {}, {"accel": 2, "gyro": 2, "mag": 3, "temperature": 2}, 129.0, 5000),
    ("sitl_captures/six_faces.tlog", {}, {"accel": 2, "gyro": 2, "mag": 2}, 70.0, 3500),
    ("px4_captures/bench_faces.tlog", {}, {"accel": 1, "gyro": 1, "mag": 1}, 73.5, 6900),
    (
        "broad/32_disturbed_attached_magnet_1cm.mat",
        {"mapping": BROAD, "world": "enu", "body": "flu", "rate": 285.714286},
        {"accel": 1, "gyro": 1, "mag": 1},
        1.0,
        9000,
    ),
    ("imu_tk_xsens/xsens_acc.mat", {"mapping": AXES_1_TO_3, "unit_accel": "counts"}, {"accel": 1}, 511.7, 51175),
    ("mikoff_mpu9150x5/imu0.log", {"mapping": SIX, "rate": 100.0}, {"accel": 1, "gyro": 1}, 160.0, 15000),
    (
        "mag_ellipsoid_fit_python/mag_out.txt",
        {"mapping": {"mag_x": "0", "mag_y": "1", "mag_z": "2"}, "unit_mag": "counts"},
        {"mag": 1},
        346.0,
        347,
    ),
    (
        "mag_cuyo_qmc5883l/calibration_data__noisy_raw_data.csv",
        {"mapping": {"mag_x": "mx", "mag_y": "my", "mag_z": "mz"}, "rate": 50.0, "unit_mag": "counts"},
        {"mag": 1},
        1.0,
        100,
    ),
    (
        "cuyo_mpu6050/calibration_data__example_data_calibration.csv",
        {
            "mapping": {f"{s}_{a}": s[0] + a for s in ("accel", "gyro") for a in "xyz"},
            "rate": 100.0,
            "unit_accel": "counts",
            "unit_gyro": "counts",
        },
        {"accel": 1, "gyro": 1},
        1.0,
        1000,
    ),
    (
        "temp_cats_imu/dev_P0_z.npz",
        {
            "mapping": {
                "t": "t_s",
                "accel": "acc_mps2",
                "gyro": "gyro_mradps",
                "mag": "mag_uT",
                "temperature": "temp_C",
            },
            "unit_gyro": "mrad/s",
        },
        {"accel": 1, "gyro": 1, "mag": 1, "temperature": 1},
        1.0,
        1000,
    ),
    (
        "allan_galaxy_s5/galaxy_s5_static_10Hz.npz",
        {"mapping": {"accel": "acc_mps2"}, "rate": 10.0},
        {"accel": 1},
        21400.0,
        200000,
    ),
    (
        "imucal_ferraris/ferraris_example.csv",
        {
            "mapping": {f"{s}_{a}": f"{c}_{a}" for s, c in (("accel", "acc"), ("gyro", "gyr")) for a in "xyz"},
            "rate": 102.4,
            "unit_gyro": "deg/s",
        },
        {"accel": 1, "gyro": 1},
        0.4,
        50,
    ),
    (
        "xio_fusion/sensor_data.csv",
        {"mapping": XIO | {"t": "Time (s)"}, "unit_gyro": "deg/s", "unit_accel": "g"},
        {"accel": 1, "gyro": 1, "mag": 1},
        1.0,
        1000,
    ),
    ("ntars.csv", {"mapping": {"temperature": "temp_c"}}, {"accel": 1, "gyro": 1, "temperature": 1}, 48.0, 49),
)


def read(folder: Path, name: str, options: dict[str, Any] | None = None) -> Recording:
    return logs.read(folder / name, **(options or {}))


@pytest.mark.sampled
@pytest.mark.parametrize(("name", "options", "sensors", "seconds", "least"), CASES, ids=[c[0] for c in CASES])
def test_what_a_file_holds(shared_data, tmp_path, name, options, sensors, seconds, least):
    folder = shared_data
    if name.endswith(".xz"):
        name, packed = Path(name).stem, (folder / name).read_bytes()
        folder = tmp_path
        (folder / name).write_bytes(lzma.decompress(packed))
    recording = read(folder, name, options)
    document = inspect(recording)
    for sensor, count in sensors.items():
        assert len(recording.instances(Sensor(sensor))) == count, sensor
    first = next(iter(sensors))
    assert len(recording.channel(Sensor(first), recording.instances(Sensor(first))[0])) >= least
    assert document["duration"] == pytest.approx(seconds, rel=0.02) if seconds > 1.0 else document["duration"] > seconds
    if recording.identity.autopilot is not None:
        undo(recording)


def test_every_file_is_covered_or_a_sibling_is(shared_data):
    """A folder of recordings that is new must get a line above."""
    covered = {name.split("/")[0] for name, *_ in CASES} | {"vqf_test_data", "reported_cases"}
    assert {entry.name for entry in shared_data.iterdir()} - {"README.md"} <= covered


def test_the_field_of_a_healthy_flight(shared_data):
    document = inspect(read(shared_data, "px4_pyulog/sample.ulg"))
    (mag,) = [c for c in document["channels"] if c["sensor"] == "mag"]
    assert mag["norm"][0] == pytest.approx(48.2, abs=0.05)
    assert document["counts"]["drop"] == 4
    assert not document["parameters"]["end_observed"]
    assert {e["name"] for e in document["parameters"]["changes"]} == {"COM_AUTOS_PAR"}


def test_clipping_and_a_second_row_of_calibrations(shared_data):
    recording = read(shared_data, "px4_roboto/test.ulg")
    assert recording.instances(Sensor.ACCEL) == (2, 3)  # rows 0 and 1 belong to another board
    assert recording.instances(Sensor.GYRO) == (0, 1)
    assert inspect(recording)["counts"]["clipping"] == 2
    undone = undo(recording)
    assert all(c.stage == Stage.RAW for c in undone.channels if c.sensor in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG))
    raw = {c.source: c for c in undone.find(Sensor.MAG, 0)}
    corrected, driver = raw["vehicle_magnetometer"], raw["sensor_mag"]
    nearest = np.abs(corrected.t[:, None] - driver.t[None, :]).argmin(axis=0)
    apart = np.median(np.abs(corrected.values[nearest] - driver.values), axis=0)
    assert (apart < 1.5).all(), apart  # uT, of 50: the same compass by two ways


def test_nothing_to_calibrate_is_said(shared_data):
    document = inspect(read(shared_data, "df_loganalyzer_examples/mechanical_fail.log"))
    assert not {c["sensor"] for c in document["channels"]} & {"accel", "gyro", "mag"}
    (said,) = document["missing"]
    assert "no accelerometer" in said


def test_a_simulated_flight_is_described(shared_data):
    document = inspect(read(shared_data, "sitl_flights/vib_motor_temp.bin"))
    (armed,) = document["armed"]
    assert 30.0 < armed["end"] - armed["start"] < 110.0
    temperature = next(c for c in document["channels"] if (c["sensor"], c["instance"]) == ("temperature", 0))
    assert (temperature["least"][0], temperature["most"][0]) == pytest.approx((23.0, 54.0), abs=1.0)


def test_a_restart_is_counted(shared_data):
    assert inspect(read(shared_data, "px4_captures/reboot.tlog"))["counts"]["reboot"] == 1
