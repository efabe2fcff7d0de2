"""The real recordings as :class:`calib.recording.Recording`; they are not part of this project."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mavcal.calib.logs.tables import read_table
from mavcal.calib.recording import Channel, Recording, Segment, Sensor, Stage

DATA = Path(__file__).resolve().parents[4] / "shared" / "data"


def triad(sensor: str, columns: tuple[str, str, str]) -> dict[str, str]:
    """Mapping of a sensor's three columns."""
    return {f"{sensor}_{axis}": column for axis, column in zip("xyz", columns, strict=True)}


def xsens() -> Recording:
    """Xsens MTi, counts, accelerometer and gyroscope in two files."""
    folder = DATA / "imu_tk_xsens"
    accel = read_table(
        folder / "xsens_acc.mat", mapping={"t": "0", **triad("accel", ("1", "2", "3"))}, unit_accel="counts"
    )
    gyro = read_table(
        folder / "xsens_gyro.mat", mapping={"t": "0", **triad("gyro", ("1", "2", "3"))}, unit_gyro="counts"
    )
    return Recording((*accel.channels, *gyro.channels), source="imu_tk_xsens")


def mikoff(unit: int) -> Recording:
    """MPU-9150, SI."""
    columns = {**triad("accel", ("0", "1", "2")), **triad("gyro", ("3", "4", "5"))}
    return read_table(DATA / "mikoff_mpu9150x5" / f"imu{unit}.log", mapping=columns, rate=100.0)


def cuyo() -> Recording:
    """MPU-6050, counts, about ten positions."""
    columns = {**triad("accel", ("ax", "ay", "az")), **triad("gyro", ("gx", "gy", "gz"))}
    file = DATA / "cuyo_mpu6050" / "calibration_data__example_data_calibration.csv"
    return read_table(file, mapping=columns, rate=100.0, unit_accel="counts", unit_gyro="counts")


def cuyo_answers(name: str) -> np.ndarray:
    """The authors' own result of that name."""
    return np.loadtxt(DATA / "cuyo_mpu6050" / f"optmization_result_data__{name}.csv")


def ferraris() -> Recording:
    """Six faces and three turns, labelled with the names of the data set."""
    folder = DATA / "imucal_ferraris"
    columns = {**triad("accel", ("acc_x", "acc_y", "acc_z")), **triad("gyro", ("gyr_x", "gyr_y", "gyr_z"))}
    recording = read_table(
        folder / "example_ferraris_session.csv", mapping=columns, rate=FERRARIS_RATE, unit_gyro="deg/s"
    )
    sections = json.loads((folder / "example_ferraris_session_list.json").read_text())
    spans = [Segment(n, s["start"] / FERRARIS_RATE, s["end"] / FERRARIS_RATE) for n, s in sections.items()]
    return dataclasses.replace(recording, segments=tuple(sorted(spans, key=lambda span: span.start)))


FERRARIS_RATE = 102.4


def ferraris_answer() -> dict[str, np.ndarray]:
    """What imucal computed from it."""
    text = (DATA / "imucal_ferraris" / "ferraris_answer_computed_with_imucal.json").read_text()
    return {key: np.array(value) for key, value in json.loads(text).items() if key[:2] in {"K_", "R_", "b_"}}


def labelled(recording: Recording, names: Mapping[str, str]) -> Recording:
    """Only the segments that `names` renames."""
    kept = [dataclasses.replace(s, label=names[s.label]) for s in recording.segments if s.label in names]
    return dataclasses.replace(recording, segments=tuple(kept))


def cuyo_magnetometer(kind: str) -> Recording:
    """QMC5883L, counts; `kind` is filtered or noisy."""
    file = DATA / "mag_cuyo_qmc5883l" / f"calibration_data__{kind}_raw_data.csv"
    return read_table(file, mapping=triad("mag", ("mx", "my", "mz")), rate=50.0, unit_mag="counts")


def ellipsoid_fit() -> Recording:
    """347 points, counts."""
    file = DATA / "mag_ellipsoid_fit_python" / "mag_out.txt"
    return read_table(file, mapping=triad("mag", ("0", "1", "2")), unit_mag="counts")


def ntars() -> Recording:
    """The table of the specification, counts against degC."""
    return read_table(DATA / "ntars.csv", mapping={"temperature": "temp_c"}, unit_accel="counts", unit_gyro="counts")


def cats(sweep: str) -> Recording:
    """A motionless device over slow sweeps of temperature; `sweep` is P0_z or P1_x."""
    with np.load(DATA / "temp_cats_imu" / f"dev_{sweep}.npz") as file:
        columns = {name: np.asarray(file[name], dtype=float) for name in ("t_s", "acc_mps2", "gyro_mradps", "temp_C")}
    t = columns["t_s"] - columns["t_s"][0]
    return Recording(
        (
            _channel(Sensor.ACCEL, t, columns["acc_mps2"], "m/s2"),
            _channel(Sensor.GYRO, t, columns["gyro_mradps"] * 1e-3, "rad/s"),
            _channel(Sensor.TEMPERATURE, t, columns["temp_C"], "degC"),
        ),
        source=f"temp_cats_imu {sweep}",
    )


def galaxy() -> Recording:
    """A phone at rest for six hours, 10 Hz."""
    with np.load(DATA / "allan_galaxy_s5" / "galaxy_s5_static_10Hz.npz") as file:
        gyro, rate = np.asarray(file["gyro_radps"], dtype=float), float(file["fs"])
        accel = np.asarray(file["acc_mps2"], dtype=float)
    t = np.arange(len(accel)) / rate
    return Recording(
        (_channel(Sensor.ACCEL, t, accel, "m/s2"), _channel(Sensor.GYRO, t, gyro[:, :3], "rad/s")),
        source="allan_galaxy_s5",
    )


def _channel(sensor: Sensor, t: np.ndarray, values: np.ndarray, unit: str) -> Channel:
    return Channel(sensor, 0, t, values, unit, Stage.RAW, "table")
