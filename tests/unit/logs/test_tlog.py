from __future__ import annotations

import itertools
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.errors import UnreadableError
from mavcal.calib.firmware.in_force.undo import calibration_changes, undo
from mavcal.calib.logs.tlog import read_tlog
from mavcal.calib.recording import Channel, Recording, Sensor, Stage
from mavcal.calib.wire.codec import RawMessage, encode
from mavcal.calib.wire.tlog import tlog_record
from tests.examples import examples


def record(message: Any, system: int = 1, component: int = 1) -> bytes:
    return tlog_record(1_700_000_000_000_000, encode(message, system, component, 0))


def heartbeat(autopilot: int = 3, system: int = 1, component: int = 1) -> bytes:
    return record(dialect.MAVLink_heartbeat_message(2, autopilot, 81, 0, 3, 3), system, component)


def raw_imu(t: float, system: int = 1, x: int = 5) -> bytes:
    return record(dialect.MAVLink_raw_imu_message(round(t * 1e6), x, 0, -1000, 0, 0, 0, 1, 2, 3, 0, 2500), system)


def parameter(name: str, value: float, system: int = 1) -> bytes:
    return record(RawMessage(22, struct.pack("<fHH16sB", value, 9, 1, name.encode(), 9)), system)


STREAM = b"".join(raw_imu(1 + 0.02 * k) for k in range(50))


class TestWhose:
    def test_the_vehicle_with_most_inertial_frames(self) -> None:
        data = (
            heartbeat(system=1)
            + raw_imu(1.0, 1)
            + heartbeat(12, system=2)
            + b"".join(
                record(dialect.MAVLink_scaled_imu_message(1000 + 20 * k, 0, 0, -1000, 0, 0, 0, 0, 0, 0, 0), 2)
                for k in range(9)
            )
        )
        recording = read_tlog(data)
        assert (recording.identity.system, recording.identity.autopilot) == (2, "px4")
        assert len(recording.channel(Sensor.ACCEL)) == 9
        assert read_tlog(data, system=1).identity.autopilot == "ardupilot"

    def test_requests_and_ground_stations_are_ignored(self) -> None:
        own = record(RawMessage(23, struct.pack("<fBB16sB", 9.0, 1, 1, b"INS_ACCOFFS_X", 9)), 250, 190)
        data = heartbeat(8, 250, 190) + heartbeat() + own + parameter("INS_ACCOFFS_X", 7.0, 250) + STREAM
        recording = read_tlog(data)
        assert recording.identity.system == 1
        assert not recording.parameters

    @pytest.mark.parametrize("data", [b"", b"no log at all, only text", heartbeat(8, 250, 190), STREAM, heartbeat(0)])
    def test_without_a_vehicle_it_is_unreadable(self, data: bytes) -> None:
        with pytest.raises(UnreadableError, match="not among them"):
            read_tlog(data)

    def test_a_ground_station_is_no_autopilot(self) -> None:
        with pytest.raises(UnreadableError, match="heard: no autopilot"):
            read_tlog(heartbeat(8, 250, 190))

    def test_another_system_is_not_here(self) -> None:
        with pytest.raises(UnreadableError, match="system id 7"):
            read_tlog(heartbeat() + STREAM, system=7)

    def test_a_file_that_is_not_there(self, tmp_path: Path) -> None:
        with pytest.raises(UnreadableError, match="nothing"):
            read_tlog(tmp_path / "nothing.tlog")


class TestReading:
    def test_a_file_and_a_byte_range_of_it(self, tmp_path: Path) -> None:
        path = tmp_path / "flight.tlog"
        path.write_bytes(STREAM + heartbeat() + STREAM[: len(STREAM) // 2] + STREAM)
        recording = read_tlog(path, start=len(STREAM), end=len(STREAM) + len(heartbeat()) + len(STREAM) // 2)
        assert len(recording.channel(Sensor.ACCEL)) == 25
        assert recording.source == "flight.tlog"

    def test_damage_is_stepped_over_and_told(self) -> None:
        broken = bytearray(heartbeat() + STREAM)
        broken[len(heartbeat()) + 25] ^= 0x55
        recording = read_tlog(bytes(broken))
        assert len(recording.channel(Sensor.ACCEL)) == 49
        assert [e.kind for e in recording.events] == ["damage", "disarmed"]

    @given(st.binary(max_size=300), st.integers(0, 49))
    @settings(max_examples=examples(50), deadline=None)
    def test_garbage_never_costs_more_than_what_it_covers(self, garbage: bytes, at: int) -> None:
        size = len(STREAM) // 50
        recording = read_tlog(heartbeat() + STREAM[: at * size] + garbage + STREAM[at * size :])
        assert len(recording.channel(Sensor.ACCEL)) >= 49

    def test_end_observed_if_read_again_after_the_last_sample(self) -> None:
        first, again = parameter("INS_ACCOFFS_X", 0.1), parameter("INS_ACCOFFS_X", 0.1)
        assert read_tlog(heartbeat() + first + STREAM + again).parameters.end_observed
        assert not read_tlog(heartbeat() + first + STREAM).parameters.end_observed
        assert not read_tlog(heartbeat() + STREAM + again + raw_imu(9.0)).parameters.end_observed
        assert not read_tlog(heartbeat() + STREAM).parameters.end_observed


# Real captures: the injected truth is in data/README.md and px4_captures/README.txt.

SITL_SCALE = np.array([1.021, 0.984, 1.013])
SITL_BIAS = np.array([0.31, -0.22, 0.17])
SITL_MATRIX = np.array([[1.06, 0.03, -0.02], [0.03, 0.95, 0.015], [-0.02, 0.015, 1.03]])
PX4_ACCEL_K = np.array([1.021, 0.984, 1.013])
PX4_GYRO_BIAS = np.array([0.0132, -0.0284, 0.0057])
PX4_MAG_K = SITL_MATRIX
G = 9.80665


def of(recording: Recording, sensor: Sensor, source: str, instance: int = 0) -> Channel:
    (found,) = [c for c in recording.find(sensor, instance) if c.source == source]
    return found


def windows(gyro: Channel, seconds: float, rate: float, sd: float) -> list[tuple[float, float]]:
    """Spans in which the vehicle does not turn."""
    found = []
    for start in np.arange(gyro.t[0], gyro.t[-1] - seconds, seconds):
        part = gyro.between(start, start + seconds).values
        level = np.median(gyro.values, axis=0)
        if len(part) > 5 and part.std(axis=0).max() < sd and np.abs(part.mean(axis=0) - level).max() < rate:
            found.append((float(start), float(start + seconds)))
    return found


@pytest.mark.shared
class TestRealArduPilot:
    @pytest.mark.sampled
    @pytest.mark.parametrize(
        ("name", "counts"),
        [
            ("rest", {"RAW_IMU": 1604, "SCALED_IMU": 1602, "SCALED_IMU2": 1602, "HIGHRES_IMU": 1602}),
            ("six_faces", {"RAW_IMU": 3517, "SCALED_IMU": 3516, "SCALED_IMU2": 3516, "HIGHRES_IMU": 3516}),
            ("tumble", {"RAW_IMU": 6404, "SCALED_IMU": 6403, "SCALED_IMU2": 6403, "HIGHRES_IMU": 6403}),
            ("turntable", {"RAW_IMU": 3417, "SCALED_IMU": 3416, "SCALED_IMU2": 3416, "HIGHRES_IMU": 3416}),
            ("warm_up", {"RAW_IMU": 3751, "SCALED_IMU2": 3750, "HIGHRES_IMU": 3750}),
            ("reboot", {"RAW_IMU": 60}),
        ],
    )
    def test_every_sample_is_there(self, shared_data: Path, name: str, counts: dict[str, int]) -> None:
        recording = read_tlog(shared_data / "sitl_captures" / f"{name}.tlog")
        found = {c.source: len(c) for c in recording.channels if c.sensor == Sensor.ACCEL}
        assert found == counts  # SCALED_IMU3 has no inertial unit
        assert not [e for e in recording.events if e.kind in ("gap", "damage", "reboot")]

    def test_the_whole_parameter_list(self, shared_data: Path) -> None:
        recording = read_tlog(shared_data / "sitl_captures" / "params.tlog")
        values = recording.parameters.final()
        assert len(values) == 1348
        assert (values["INS_ACC_ID"], values["COMPASS_PRIO3_ID"]) == (2753028, 263178)
        assert recording.identity.firmware == (4, 7, 0)
        assert recording.identity.uid == "6564313231396337633463353430346161"  # 17 bytes of 18 are set

    @pytest.mark.long
    def test_faces_undone(self, shared_data: Path) -> None:
        raw = undo(read_tlog(shared_data / "sitl_captures" / "six_faces.tlog"))
        gyro, accel = of(raw, Sensor.GYRO, "HIGHRES_IMU"), of(raw, Sensor.ACCEL, "HIGHRES_IMU")
        still = windows(gyro, 1.0, 0.002, 0.002)
        assert len(still) > 30
        force = [(accel.between(*w).values.mean(axis=0) - SITL_BIAS) * SITL_SCALE for w in still]
        assert np.linalg.norm(force, axis=1) == pytest.approx(G, abs=6e-4)
        level = force[0]
        assert level == pytest.approx([0.0, 0.0, -G], abs=0.01)
        bias = np.mean([gyro.between(*w).values.mean(axis=0) for w in still], axis=0)
        assert bias == pytest.approx([0.0132, -0.0084, 0.0057], abs=3e-5)
        truncated = of(raw, Sensor.ACCEL, "RAW_IMU")
        rough = [(truncated.between(*w).values.mean(axis=0) - SITL_BIAS) * SITL_SCALE for w in still]
        # this simulator's filtered noise is a tenth of a bin, so a bin's middle may be off by half of it
        assert np.abs(np.linalg.norm(rough, axis=1) - G).max() < 0.5 * truncated.quantum * np.sqrt(3)
        clean = of(raw, Sensor.ACCEL, "SCALED_IMU2", 1)
        norms = [np.linalg.norm(clean.between(*w).values.mean(axis=0)) for w in still]
        assert norms == pytest.approx([G] * len(norms), abs=0.5 * clean.quantum * np.sqrt(3))

    def test_compass_undone(self, shared_data: Path) -> None:
        raw = undo(read_tlog(shared_data / "sitl_captures" / "six_faces.tlog"))
        gyro, field = of(raw, Sensor.GYRO, "HIGHRES_IMU"), of(raw, Sensor.MAG, "HIGHRES_IMU")
        still = windows(gyro, 1.0, 0.002, 0.002)
        means = np.array([field.between(w[0] + 0.2, w[1]).values.mean(axis=0) for w in still])
        strength = np.linalg.norm((means - [-9.0, 5.5, -3.5]) @ SITL_MATRIX.T, axis=1)
        assert strength.std() < 0.01
        clean = of(raw, Sensor.MAG, "SCALED_IMU2", 1)
        undone = np.array([clean.between(w[0] + 0.2, w[1]).values.mean(axis=0) for w in still])
        assert np.linalg.norm(undone - [-0.5, -1.3, 1.8], axis=1) == pytest.approx(strength.mean(), abs=0.1)

    @pytest.mark.long
    def test_compass_is_ten_samples_a_second(self, shared_data: Path) -> None:
        for source in ("RAW_IMU", "HIGHRES_IMU"):
            field = of(read_tlog(shared_data / "sitl_captures" / "tumble.tlog"), Sensor.MAG, source)
            assert np.median(np.diff(field.t)) == pytest.approx(0.1, abs=1e-3)
            assert len(field) == pytest.approx(1282, abs=10)  # 1282 reads in 128.1 s

    def test_turntable_rates(self, shared_data: Path) -> None:
        raw = undo(read_tlog(shared_data / "sitl_captures" / "turntable.tlog"))
        gyro = of(raw, Sensor.GYRO, "HIGHRES_IMU")
        scale = np.array([1.03, 0.98, 1.04])
        for axis in range(3):
            rates = (gyro.values[:, axis] - [0.0132, -0.0084, 0.0057][axis]) / scale[axis]
            for sign in (1, -1):
                turning = rates[np.abs(rates - sign * np.pi / 2) < 0.1]
                assert len(turning) > 300
                assert np.median(turning) == pytest.approx(sign * np.pi / 2, abs=2e-3)

    def test_warm_up(self, shared_data: Path) -> None:
        raw = undo(read_tlog(shared_data / "sitl_captures" / "warm_up.tlog"))
        degrees = of(raw, Sensor.TEMPERATURE, "RAW_IMU")
        accel, gyro = of(raw, Sensor.ACCEL, "HIGHRES_IMU"), of(raw, Sensor.GYRO, "HIGHRES_IMU")
        assert degrees.values[0, 0] < 21
        assert degrees.values[-1, 0] > 57
        d = np.interp(accel.t, degrees.t, degrees.values[:, 0])[:, None] - 35
        drift = 1e-6 * (d * [7000, -4000, 9000] + d**2 * [60, -30, 40])
        rest = (accel.values - SITL_BIAS - drift) * SITL_SCALE
        thirds = [part.mean(axis=0) for part in np.array_split(rest, 3)]
        assert np.abs(np.array(thirds) - [0, 0, -G]).max() < 0.012  # the warm vehicle stands level within a milliradian
        assert np.ptp(thirds, axis=0).max() < 2e-3
        rates = gyro.values - [0.0132, -0.0084, 0.0057] - 1e-6 * d * [350, -250, 150]
        assert rates.mean(axis=0) == pytest.approx([0, 0, 0], abs=5e-5)


@pytest.mark.shared
class TestRealPx4:
    @pytest.mark.sampled
    @pytest.mark.parametrize(
        ("name", "inertial", "fields"),
        [
            ("bench_faces", 6950, 3476),
            ("bench_tumble", 12418, 6210),
            ("bench_turn", 7736, 3869),
            ("bench_warm", 14888, 7445),
        ],
    )
    def test_every_sample_is_there(self, shared_data: Path, name: str, inertial: int, fields: int) -> None:
        recording = read_tlog(shared_data / "px4_captures" / f"{name}.tlog")
        assert len(of(recording, Sensor.ACCEL, "SCALED_IMU")) == inertial
        field = of(recording, Sensor.MAG, "SCALED_IMU")
        assert len(field) == fields
        assert fields / (field.t[-1] - field.t[0]) == pytest.approx(50.0, abs=0.05)
        assert recording.channel(Sensor.ACCEL).stage == Stage.CORRECTED

    def test_parameters_and_exact_integers(self, shared_data: Path) -> None:
        listed = read_tlog(shared_data / "px4_captures" / "params.tlog").parameters.final()
        assert len(listed) == 906  # 905 of the list, and the unlisted one that was read by name
        assert listed["CAL_ACC0_ID"] == 1310988
        entries = read_tlog(shared_data / "px4_captures" / "set.tlog").parameters.entries
        values = [e.value for e in entries if e.name == "CAL_ACC3_ID"]
        assert list(dict.fromkeys(values)) == [-1, 16777217, -8388000, 0]

    def test_level_undone(self, shared_data: Path) -> None:
        raw = undo(read_tlog(shared_data / "px4_captures" / "bench_faces.tlog"))
        accel, gyro, field = (of(raw, s, "SCALED_IMU") for s in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG))
        still = windows(gyro, 1.0, 0.001, 0.004)
        assert len(still) > 30
        means = np.array([accel.between(*w).values.mean(axis=0) for w in still])
        sd = 0.02 / np.sqrt(100)
        force = np.linalg.norm((means - SITL_BIAS) / PX4_ACCEL_K, axis=1)
        assert np.abs(force - G).max() < 4.5 * sd
        rate = np.mean([gyro.between(*w).values.mean(axis=0) for w in still], axis=0)
        assert np.abs(rate - PX4_GYRO_BIAS).max() < 4.5 * 0.002 / np.sqrt(100 * len(still))
        strength = [
            np.linalg.norm(np.linalg.solve(PX4_MAG_K, field.between(*w).values.mean(axis=0) - [9.0, -5.5, 3.5]))
            for w in still
        ]
        assert np.std(strength) < 0.1

    @pytest.mark.long
    def test_offsets_that_never_reached_memory(self, shared_data: Path) -> None:
        recording = read_tlog(shared_data / "px4_captures" / "cal_applied.tlog")
        changes = calibration_changes(recording)
        assert len(changes) == 13
        raw = undo(recording)
        accel, gyro = of(raw, Sensor.ACCEL, "SCALED_IMU"), of(raw, Sensor.GYRO, "SCALED_IMU")
        edges = [recording.span[0], *(c.t for c in changes), recording.span[1]]
        for start, end in itertools.pairwise(edges):
            part = accel.between(start, end).values
            # the stock simulator's z reads 0.004 m/s2 low in every capture at rest, also where nothing was ever written
            error = part.mean(axis=0) - [0, 0, -G - 0.004]
            assert np.abs(error).max() < 4.5 * 0.1 / np.sqrt(len(part))  # 0.1 m/s2 a sample
            rates = gyro.between(start, end).values
            assert np.abs(rates.mean(axis=0)).max() < 4.5 * 0.01 / np.sqrt(len(rates))

    def test_what_was_never_read_stays_relative(self, shared_data: Path) -> None:
        raw = undo(read_tlog(shared_data / "px4_captures" / "rest.tlog"))
        assert raw.channel(Sensor.ACCEL).stage == Stage.CORRECTED
        assert any("CAL_ACC0_ID" in e.text for e in raw.events if e.kind == "undo")

    def test_a_restart_and_a_calibration_are_told(self, shared_data: Path) -> None:
        kinds = [e.kind for e in read_tlog(shared_data / "px4_captures" / "reboot.tlog").events]
        assert kinds.count("reboot") == 1
        texts = [
            e.text
            for e in read_tlog(shared_data / "px4_captures" / "gyro_cal.tlog").events
            if e.kind == "onboard_calibration"
        ]
        assert texts[0] == "[cal] calibration started: 2 gyro"
        assert texts[-1] == "[cal] calibration done: gyro"

    @pytest.mark.long
    def test_warm_up(self, shared_data: Path) -> None:
        raw = undo(read_tlog(shared_data / "px4_captures" / "bench_warm.tlog"))
        accel, degrees = of(raw, Sensor.ACCEL, "SCALED_IMU"), of(raw, Sensor.TEMPERATURE, "SCALED_IMU")
        warming = accel.t > accel.t[0] + 0.5  # before, the bench had not read its model yet
        start = accel.t[np.argmin(degrees.values[:, 0])]
        curve = 62 - 50 * np.exp(-(degrees.t - start) / 60)
        assert np.abs(degrees.values[:, 0] - curve)[warming].max() < 0.2  # told ten times a second, at 0.83 degC/s
        d = degrees.values - 25
        drift = d * [0.007, -0.004, 0.009] + 1e-5 * d**2 * [6, -3, 4]
        rest = (accel.values - SITL_BIAS - drift) / PX4_ACCEL_K
        for part in np.array_split(rest[warming], 5):
            assert np.abs(part.mean(axis=0) - [0, 0, -G]).max() < 4.5 * 0.02 / np.sqrt(len(part)) + 2e-4


@pytest.mark.parametrize(
    ("told", "dead"), [({"INS_ACC2_ID": 12.0, "INS_GYR2_ID": 22.0}, 2), ({"INS_ACC2_ID": 0.0}, 0), ({}, 0)]
)
def test_a_unit_of_zeros_is_dead_where_its_id_is_set_and_absent_elsewhere(told: dict[str, float], dead: int) -> None:
    zeros = b"".join(
        record(dialect.MAVLink_scaled_imu2_message(1000 + 20 * k, 0, 0, 0, 0, 0, 0, 5, 6, 7 + k, 0)) for k in range(60)
    )
    listed = b"".join(parameter(name, value) for name, value in told.items())
    events = read_tlog(heartbeat() + listed + STREAM + zeros).events
    assert sum(event.kind == "dead" for event in events) == dead
