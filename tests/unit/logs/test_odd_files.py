"""Files that are no recordings, or hold none: each is refused or read by name, without a warning of numpy."""

from __future__ import annotations

import os
import warnings

import numpy as np
import pytest

from mavcal.calib import logs
from mavcal.calib.errors import CalibError, InvalidInputError, UnreadableError
from mavcal.calib.health.report import health
from mavcal.calib.logs.damaged import MOST_AT_ONCE, moving
from mavcal.calib.logs.dataflash.reader import read_dataflash
from mavcal.calib.logs.tables import read_table
from mavcal.calib.methods.overview import overview
from mavcal.calib.recording import Oddity, OddSamples, Sensor
from tests.unit.logs.test_dataflash_reader import HEAD, kinds, made, times

CELLS = "t,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z\n"


@pytest.fixture(autouse=True)
def _silent():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def written(tmp_path, rows, head=CELLS):
    path = tmp_path / "table.csv"
    path.write_text(head + "\n".join(rows) + "\n")
    return path


def imu(stamps, **fields):
    rng = np.random.default_rng(1)
    n = len(stamps)
    noise = {name: rng.normal(0.0, 0.01, n) for name in ("AccX", "AccY", "GyrX", "GyrY", "GyrZ")}
    return made.IMU.rows(
        n, TimeUS=stamps, AccZ=-9.8 + 0.01 * rng.normal(size=n), AH=1, GH=1, **noise, **fields
    ).tobytes()


def test_what_has_no_end_is_never_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe.bin")
    for path in (tmp_path, tmp_path / "pipe.bin", "/dev/null"):
        with pytest.raises(UnreadableError, match="is a folder, a pipe or a device: give a file"):
            logs.read(path)
        assert not logs.is_table(path)
    with pytest.raises(UnreadableError, match="cannot be opened"):
        logs.read(tmp_path / "absent.bin")


def test_columns_without_a_number_are_named(tmp_path):
    with pytest.raises(UnreadableError, match=r"accel_x, .*gyro_z hold no number in any row"):
        read_table(written(tmp_path, [f"{k},nan,nan,nan,nan,nan,nan" for k in range(9)]))
    part = read_table(written(tmp_path, [f"{k},1,2,nan,4,5,6" for k in range(9)]))
    assert part.instances(Sensor.ACCEL) == ()
    assert kinds(part, "damage") == ["accel_z holds no number in any row"]
    scattered = [f"{k},{'1' if k % 2 else ''},{'' if k % 2 else '1'},1,,," for k in range(8)]
    with pytest.raises(UnreadableError, match="gyro_x, gyro_y, gyro_z hold no number"):
        read_table(written(tmp_path, scattered))


@pytest.mark.parametrize("wild", ["inf", "-inf", "1e308", "-1e308", "1e200"])
def test_what_is_no_measurement_is_left_out_by_name_and_refused_where_it_is_all(tmp_path, wild):
    some = [f"{k / 100},{wild if k == 7 else 0.1 * (k % 3)},2,9,4,5,6" for k in range(200)]
    recording = read_table(written(tmp_path, some))
    assert kinds(recording, "damage") == ["1 of 200 cells of accel_x are infinite or beyond 1e+15 and were left out"]
    assert len(recording.channel(Sensor.ACCEL)) == 199
    assert "inf" not in str(overview(recording)["channels"])
    with pytest.raises(UnreadableError, match="accel_x are infinite"):
        read_table(written(tmp_path, [f"{k / 100},{wild},2,9,4,5,6" for k in range(200)]))
    with pytest.raises(CalibError):
        read_table(written(tmp_path, [*some, f"{wild},1,2,9,4,5,6"]))


def test_dates_are_times(tmp_path):
    rows = [f"2026-11-26 10:00:{k:02d}.5,1,2,9,4,5,6" for k in range(9)]
    assert read_table(written(tmp_path, rows)).channel(Sensor.ACCEL).t.tolist() == list(map(float, range(9)))
    zoned = [row.replace(" ", "T", 1).replace(".5,", ".5Z,") for row in rows]
    assert read_table(written(tmp_path, zoned)).channel(Sensor.ACCEL).t.tolist() == list(map(float, range(9)))
    with pytest.raises(UnreadableError, match=r"column t holds texts such as '26/11"):
        read_table(written(tmp_path, [f"26/11/2026 10:00:{k:02d},1,2,9,4,5,6" for k in range(9)]))
    stamps = np.datetime64("2026-11-26T10:00:00") + np.arange(20) * np.timedelta64(250, "ms")
    np.savez(tmp_path / "a.npz", t=stamps, accel=np.random.default_rng(1).normal(size=(20, 3)))
    assert read_table(tmp_path / "a.npz").channel(Sensor.ACCEL).t.tolist() == (0.25 * np.arange(20)).tolist()
    np.savez(tmp_path / "b.npz", t=np.append(stamps[:-1], np.datetime64("NaT")), accel=np.ones((20, 3)))
    with pytest.raises(InvalidInputError, match="row 20 of the table has no time"):
        read_table(tmp_path / "b.npz")
    np.savez(tmp_path / "c.npz", t=stamps.astype(object), accel=np.ones((20, 3)))
    with pytest.raises(UnreadableError, match=r"t\.npy holds objects of Python"):
        read_table(tmp_path / "c.npz")


def test_a_clock_that_stands_still_tells_no_times(tmp_path):
    t = np.repeat([0.0, 1.0, 2.0], [3, MOST_AT_ONCE + 1, MOST_AT_ONCE])
    assert np.flatnonzero(~moving(t)).tolist() == list(range(4, 4 + MOST_AT_ONCE))
    recording = read_dataflash(HEAD + imu(times(*[8.0] * 1000)))
    assert len(recording.channel(Sensor.GYRO)) == 1
    (said,) = kinds(recording, "damage")
    assert said.startswith("999 of 1000 samples of IMU, instance 1, carry one time all over")
    assert overview(recording)["counts"]["damage"] == 1
    with pytest.raises(InvalidInputError, match="time stands still from row 1 on"):
        read_table(written(tmp_path, ["5,1,2,9,4,5,6"] * 100))


def test_times_that_go_back_are_counted():
    (said,) = kinds(read_dataflash(HEAD + imu(times(*(60.0 - 0.01 * np.arange(2000))))), "damage")
    assert said.startswith("1999 of")
    assert all(token in said for token in ("2000 samples", "IMU, instance 1", "left out"))


@pytest.mark.parametrize("wraps", [1, 2])
def test_a_clock_of_32_bits_that_runs_over_keeps_its_place(wraps):
    start = wraps * 2**32 - 10_000_000
    stamps = start + 20_000 * np.arange(1000) + (0 if wraps == 1 else -(2**32) * (wraps - 1))
    t = read_dataflash(HEAD + imu((stamps % 2**32).tolist())).channel(Sensor.GYRO)
    assert len(t) == 1000
    np.testing.assert_allclose(np.diff(t.t), 0.02, atol=1e-6)
    assert kinds(read_dataflash(HEAD + imu((stamps % 2**32).tolist())), "reboot") == []


def test_zeros_of_a_compass_that_dies_are_left_out_and_counted(tmp_path):
    rows = [f"{k / 10},0,0,9,{f'2{k % 7},5,40' if k < 60 else '0,0,0'}" for k in range(100)]
    head = "t,gyro_x,gyro_y,gyro_z,mag_x,mag_y,mag_z\n"
    recording = read_table(written(tmp_path, rows, head))
    assert len(recording.channel(Sensor.MAG)) == 60
    (odd,) = [event.odd for event in recording.events if event.odd is not None]
    assert odd == OddSamples(Oddity.ZERO, Sensor.MAG, 0, 40, 100, until=9.9)
    whole = read_table(written(tmp_path, [f"{k / 10},0,0,9,0,0,0" for k in range(100)], head))
    assert len(whole.channel(Sensor.MAG)) == 100
    (found,) = [s for s in health(recording).sensors if s.sensor == Sensor.MAG]
    assert found.findings[0].text == "reads 0, 0, 0 in 40 % of its samples, first at 6.0 s"
