from __future__ import annotations

import struct
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib import logs
from mavcal.calib.errors import CalibError, UnreadableError
from mavcal.calib.firmware.in_force.undo import undo
from mavcal.calib.fit import FitStatus
from mavcal.calib.logs.ulog import read_ulog
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Sensor, Stage
from tests.examples import examples
from tests.unit.logs.ulog_file import ACCEL_ID, GYRO_ID, MAG_ID, MAGIC, PARAMETERS, UlogFile, driver, message, sample

COMBINED = (
    "float[3] gyro_rad;uint32_t gyro_integral_dt;int32_t accelerometer_timestamp_relative;"
    "float[3] accelerometer_m_s2;uint32_t accelerometer_integral_dt"
)
MAGNETOMETER = "uint64_t timestamp_sample;uint32_t device_id;float[3] magnetometer_ga;uint8_t calibration_count"


@pytest.fixture
def reading(tmp_path):
    def read(log):
        path = tmp_path / "log.ulg"
        path.write_bytes(log if isinstance(log, bytes) else log.bytes)
        return read_ulog(path)

    return read


def flight(parameters=None, n=40):
    """A log with every inertial topic: still, level, 1 G along north."""
    log = UlogFile(parameters)
    accel, gyro = driver(log, "sensor_accel", ACCEL_ID), driver(log, "sensor_gyro", GYRO_ID)
    mag = driver(log, "sensor_mag", MAG_ID)
    combined = log.topic("sensor_combined", COMBINED)
    for k in range(n):
        t = 2_000_000 + 5000 * k
        log.row(combined, t, 0.1, 0.2, 0.3, 4000, -1000, 0.5, 0.6, -9.8, 4000)
        if k % 10 == 0:
            sample(log, accel, t, 0.6, 0.6, -9.7, 30.0 + k)
            sample(log, gyro, t, 0.15, 0.2, 0.3)
            sample(log, mag, t, 0.2, 0.1, 0.4)
    return log


def test_a_sound_log_tells_no_damage(reading):
    assert [event for event in reading(flight()).events if event.kind == "damage"] == []


def test_topics_have_their_unit_stage_and_time(reading):
    recording = reading(flight())
    by_source = {(c.sensor, c.source): c for c in recording.channels}
    accel = by_source[Sensor.ACCEL, "sensor_accel"]
    assert (accel.stage, accel.unit, len(accel)) == (Stage.RAW, "m/s2", 4)
    combined = by_source[Sensor.ACCEL, "sensor_combined"]
    assert combined.stage == Stage.CORRECTED
    np.testing.assert_allclose(combined.t[0], 2.0 - 0.001 - 0.002)  # relative to the gyro's, middle of its interval
    np.testing.assert_allclose(by_source[Sensor.GYRO, "sensor_combined"].t[0], 2.0 - 0.002)
    np.testing.assert_allclose(by_source[Sensor.MAG, "sensor_mag"].values[0], [20.0, 10.0, 40.0], rtol=1e-6)
    np.testing.assert_allclose(recording.channel(Sensor.TEMPERATURE).values[:, 0], [30, 40, 50, 60])
    assert recording.identity.autopilot == "px4"
    assert recording.identity.firmware == (1, 14, 3)
    assert recording.identity.uid == "000200000000353338373138511600380018"


def test_the_full_rate_topic_is_better_than_a_thinned_one(reading):
    assert reading(flight()).channel(Sensor.ACCEL).source == "sensor_combined"


def test_means_of_the_status_topic_are_better_than_thinned_instants(reading):
    log = UlogFile()
    accel = driver(log, "sensor_accel", ACCEL_ID)
    status = log.topic("vehicle_imu_status", "uint32_t accel_device_id;float[3] mean_accel")
    for k in range(10):
        sample(log, accel, 2_000_000 + 1_000_000 * k, 1.0, 2.0, 3.0)
        log.row(status, 2_000_000 + 1_000_000 * k, ACCEL_ID, 1.0, 2.0, 3.0)
    assert reading(log).channel(Sensor.ACCEL).source == "vehicle_imu_status"


def test_status_means_are_turned_back_into_the_sensor(reading):
    log = UlogFile(PARAMETERS | {"SENS_BOARD_ROT": 2})  # yaw 90 degrees: body x is minus the board's y
    status = log.topic("vehicle_imu_status", "uint32_t accel_device_id;float[3] mean_accel")
    log.row(status, 2_000_000, ACCEL_ID, -2.0, 1.0, 3.0)
    np.testing.assert_allclose(reading(log).channel(Sensor.ACCEL).values[0], [1.0, 2.0, 3.0], atol=1e-6)


def test_status_means_without_a_known_rotation_are_left_out_and_said(reading):
    log = flight({})
    status = log.topic("vehicle_imu_status", "uint32_t accel_device_id;float[3] mean_accel")
    log.row(status, 2_000_000, ACCEL_ID, -2.0, 1.0, 3.0)
    recording = reading(log)
    assert "vehicle_imu_status" not in {c.source for c in recording.channels}
    assert any(e.kind == "left_out" and "raw means" in e.text for e in recording.events)


def test_an_instance_is_the_place_of_its_row_not_of_its_topic(reading):
    """Two boards were calibrated with this set of parameters: row 0 belongs to a sensor that is not there."""
    parameters = PARAMETERS | {"CAL_ACC0_ID": 99, "CAL_ACC1_ID": ACCEL_ID}
    log = flight(parameters)
    stranger = driver(log, "sensor_accel", 77, multi_id=1)
    sample(log, stranger, 2_300_000, 1.0, 2.0, 3.0)
    recording = reading(log)
    assert recording.instances(Sensor.ACCEL) == (0, 1, 2)
    assert {c.source for c in recording.find(Sensor.ACCEL, 1)} == {"sensor_accel"}
    assert recording.find(Sensor.ACCEL, 2)[0].values[0].tolist() == [1.0, 2.0, 3.0]


def test_selected_sensors_follow_the_selection(reading):
    log = flight(PARAMETERS | {"CAL_ACC1_ID": 77})
    selection = log.topic("sensor_selection", "uint32_t accel_device_id;uint32_t gyro_device_id")
    log.row(selection, 1_500_000, ACCEL_ID, GYRO_ID)
    log.row(selection, 2_100_000, 77, GYRO_ID)
    recording = reading(log)
    parts = [next(c for c in recording.find(Sensor.ACCEL, i) if c.source == "sensor_combined") for i in (0, 1)]
    assert [len(p) for p in parts] == [20, 20]
    assert parts[0].t[-1] < 2.1 < parts[1].t[0] + 0.01


def test_undo_takes_the_calibration_off_with_its_changes(reading):
    log = flight(PARAMETERS | {"CAL_ACC0_XOFF": 0.25, "CAL_ACC0_YSCALE": 1.25}, n=400)
    log.changed("CAL_ACC0_XOFF", 0.75)
    combined = 3
    for k in range(400):
        log.row(combined, 5_000_000 + 5000 * k, 0.1, 0.2, 0.3, 4000, -1000, 0.5, 0.6, -9.8, 4000)
    recording = reading(log)
    assert [e.name for e in recording.parameters.changes()] == ["CAL_ACC0_XOFF"]
    assert recording.parameters.end_observed
    raw = next(c for c in undo(recording).find(Sensor.ACCEL) if c.source == "sensor_combined")
    assert raw.stage == Stage.RAW
    np.testing.assert_allclose(raw.values[0], [0.75, 0.48, -9.8], rtol=1e-6)
    np.testing.assert_allclose(raw.values[-1], [1.25, 0.48, -9.8], rtol=1e-6)


def test_a_log_without_parameters_stays_as_it_is(reading):
    undone = undo(reading(flight({})))
    assert next(c for c in undone.find(Sensor.ACCEL) if c.source == "sensor_combined").stage == Stage.CORRECTED
    assert any(e.kind == "undo" for e in undone.events)


def test_a_compass_with_a_running_bias_estimate_is_debiased_from_then_on(reading):
    log = flight()
    field = log.topic("vehicle_magnetometer", MAGNETOMETER)
    estimate = log.topic("magnetometer_bias_estimate", "float[4] bias_x;uint8_t[4] valid")
    for k in range(10):
        log.row(field, 2_000_000 + 10_000 * k, 2_000_000 + 10_000 * k, MAG_ID, 0.2, 0.1, 0.4, 1)
        log.row(estimate, 2_000_000 + 10_000 * k, 0, 0, 0, 0, int(k >= 5), 0, 0, 0)
    found = [c for c in reading(log).channels if c.source == "vehicle_magnetometer"]
    assert {c.stage: len(c) for c in found} == {Stage.CORRECTED: 5, Stage.DEBIASED: 5}


def test_drivers_of_old_firmwares_calibrate_their_compass_themselves(reading):
    log = UlogFile()
    sample(log, driver(log, "sensor_mag", MAG_ID), 2_000_000, 0.2, 0.1, 0.4)
    log.row(log.topic("vehicle_magnetometer", "float[3] magnetometer_ga"), 2_000_000, 0.2, 0.1, 0.4)
    assert {c.stage for c in reading(log).find(Sensor.MAG)} == {Stage.CORRECTED}


def test_every_sample_of_a_fifo_has_its_time(reading):
    log = UlogFile()
    fields = "uint64_t timestamp_sample;uint32_t device_id;float dt;float scale;uint8_t samples;"
    fifo = log.topic("sensor_gyro_fifo", fields + "int32_t[4] x;int32_t[4] y;int32_t[4] z")
    log.row(fifo, 2_000_100, 2_000_000, GYRO_ID, 125.0, 0.5, 3, *(1, 2, 3, 99), *(4, 5, 6, 99), *(7, 8, 9, 99))
    gyro = reading(log).channel(Sensor.GYRO)
    np.testing.assert_allclose(gyro.t, [1.99975, 1.999875, 2.0])
    np.testing.assert_allclose(gyro.values[:, 0], [0.5, 1.0, 1.5])


def test_flight_topics(reading):
    log = flight()
    gps = log.topic("sensor_gps", "int32_t lat;int32_t lon;int32_t alt;uint8_t fix_type")
    battery = log.topic("battery_status", "float current_a")
    motors = log.topic("actuator_motors", "float[4] control")
    log.format("esc_report", "uint64_t timestamp;int32_t esc_rpm")
    esc = log.topic("esc_status", "uint8_t esc_count;esc_report[2] esc", layout="<QBQiQi")
    status = log.topic("vehicle_status", "uint8_t arming_state;uint8_t system_id")
    log.row(gps, 2_000_000, 634170503, 104082203, 63889, 1)
    log.row(gps, 2_100_000, 634170503, 104082203, 63889, 3)
    log.row(battery, 2_000_000, -1.0)
    log.row(battery, 2_100_000, 12.5)
    log.row(motors, 2_000_000, 0.25, float("nan"), 1.5, float("nan"))
    log.row(esc, 2_000_000, 2, 0, 6000, 0, -3000)
    for t, state in ((2_000_000, 1), (2_050_000, 2), (2_150_000, 1)):
        log.row(status, t, state, 7)
    log.said(2_060_000, "[cal] hello\n")
    recording = reading(log)
    np.testing.assert_allclose(recording.channel(Sensor.POSITION).values, [[63.4170503, 10.4082203, 63.889]])
    assert recording.channel(Sensor.CURRENT).values.tolist() == [[12.5]]
    assert recording.channel(Sensor.MOTOR).values.tolist() == [[0.25, 1.0]]
    assert recording.channel(Sensor.ROTOR_SPEED).values.tolist() == [[100.0, 50.0]]
    told = [(e.kind, e.t) for e in recording.events if e.kind in {"armed", "disarmed"}]
    first = ("disarmed", pytest.approx(2.0))
    assert told == [first, ("armed", pytest.approx(2.05)), ("disarmed", pytest.approx(2.15))]
    assert "[cal] hello" in [e.text for e in recording.events if e.kind == "text"]
    assert recording.identity.system == 7


def test_drops_are_said_and_make_the_end_unobserved(reading):
    log = flight()
    log.dropout(120)
    recording = reading(log)
    assert [e.text for e in recording.events if e.kind == "drop"] == [
        "the logger dropped 120 ms: the card was too slow"
    ]
    assert not recording.parameters.end_observed


@pytest.mark.parametrize("stamp", [0, 2**63, 2_000_000 + 3 * 10**12])
def test_a_damaged_stamp_costs_only_itself(reading, stamp):
    log = flight()
    sample(log, 0, stamp, 9.0, 9.0, 9.0)
    sample(log, 0, 2_300_000, 1.0, 1.0, 1.0)
    recording = reading(log)
    accel = next(c for c in recording.find(Sensor.ACCEL) if c.source == "sensor_accel")
    assert len(accel) == 5
    assert (np.diff(accel.t) >= 0).all()
    assert any(e.kind == "damage" and "1 of 6 samples of sensor_accel" in e.text for e in recording.events)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"ULogEnc\x01" + bytes(40), "encrypted ULog"),
        (b"ULog\x01\x12\x35", r"^\S+ is no ULog: its header"),
        (UlogFile().bytes, "without a sensor"),
        (UlogFile().bytes[:30], "without a sensor"),
    ],
)
def test_what_cannot_be_read_is_told_in_one_sentence(reading, content, says):
    with pytest.raises(UnreadableError, match=says) as told:
        reading(content)
    assert "\n" not in str(told.value)


def test_a_format_that_contains_itself_and_one_that_unfolds_without_end_are_harmless(reading):
    good = flight()
    extra = message("F", b"a:uint64_t timestamp;a[2] a") + message("A", struct.pack("<BH", 0, 900) + b"a")
    for k in range(8):
        extra += message("F", f"n{k}:n{k + 1}[60000] x".encode())
    extra += message("F", b"n8:uint64_t timestamp") + message("A", struct.pack("<BH", 0, 901) + b"n0")
    content = good.bytes
    split = content.index(message("A", struct.pack("<BH", 0, 0) + b"sensor_accel"))
    recording = reading(content[:split] + extra + content[split:])
    assert len(recording.channel(Sensor.ACCEL)) == 40
    assert any(e.kind == "damage" for e in recording.events)


def test_nothing_is_printed(reading, capsys):
    content = bytearray(flight().bytes)
    content[len(content) // 2] ^= 0xFF
    content[-30] ^= 0xFF
    reading(bytes(content))
    assert capsys.readouterr() == ("", "")


WHOLE = flight().bytes


@given(st.data())
@settings(max_examples=examples(60))
def test_damage_gives_a_recording_or_the_typed_error(tmp_path_factory, data):
    content = bytearray(WHOLE)
    for _ in range(data.draw(st.integers(1, 12))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(content)))
    path = tmp_path_factory.getbasetemp() / "damaged.ulg"
    path.write_bytes(bytes(content[:cut] if data.draw(st.booleans()) else content[cut:]))
    try:
        recording = undo(logs.read(path))
    except CalibError:
        return
    assert all(np.isfinite(c.t).all() and (np.diff(c.t) >= 0).all() for c in recording.channels)


def test_a_flight_without_a_rest_is_no_rest(reading):
    log = flight(n=400)
    armed = log.topic("actuator_armed", "uint8_t armed")
    log.row(armed, 1_900_000, 1)
    (fit,) = METHODS["gyro-rest"].run(reading(log))
    assert fit.status == FitStatus.REFUSED
    assert "never at rest with its motors off" in fit.message


def test_compensation_for_the_motors_is_taken_off_too(reading):
    gains = {"CAL_MAG_COMP_TYP": 2, "CAL_MAG0_XCOMP": 2.0, "CAL_MAG0_YCOMP": 0.0, "CAL_MAG0_ZCOMP": -4.0}
    log = UlogFile(PARAMETERS | gains | {"CAL_MAG0_XOFF": 0.05})
    field = log.topic("vehicle_magnetometer", MAGNETOMETER)
    battery = log.topic("battery_status", "float current_a")
    log.row(battery, 1_500_000, 10.0)
    log.row(field, 2_000_000, 2_000_000, MAG_ID, 0.2, 0.1, 0.4, 1)
    raw = undo(reading(log)).channel(Sensor.MAG)
    assert raw.stage == Stage.RAW
    np.testing.assert_allclose(raw.values[0], [20.0 + 5.0 - 2.0, 10.0, 40.0 + 4.0], rtol=1e-6)


def test_a_compensation_that_follows_what_was_not_recorded_leaves_the_field_as_it_is(reading):
    gains = {"CAL_MAG_COMP_TYP": 1, "CAL_MAG0_XCOMP": 2.0, "CAL_MAG0_YCOMP": 0.0, "CAL_MAG0_ZCOMP": -4.0}
    log = UlogFile(PARAMETERS | gains)
    log.row(log.topic("vehicle_magnetometer", MAGNETOMETER), 2_000_000, 2_000_000, MAG_ID, 0.2, 0.1, 0.4, 1)
    undone = undo(reading(log))
    assert undone.channel(Sensor.MAG).stage == Stage.CORRECTED
    assert any("follows the thrust" in e.text for e in undone.events)


def test_a_simulators_truth_is_the_reference_and_no_channel(reading):
    log = flight()
    attitude = log.topic("vehicle_attitude_groundtruth", "uint64_t timestamp_sample;float[4] q")
    local = log.topic("vehicle_local_position_groundtruth", "float x;float y;float z;float vx;float vy;float vz")
    place = log.topic("vehicle_global_position_groundtruth", "double lat;double lon;float alt")
    for k in range(20):
        t = 2_000_000 + 10_000 * k
        log.row(attitude, t, t, 2.0, 0.0, 0.0, 0.0)
        log.row(local, t, 1.0, 2.0, -3.0, 0.1, 0.2, -0.3)
        log.row(place, t, 47.4, 8.5, 488.0)
    recording = reading(log)
    truth = {c.sensor: c for c in recording.reference}
    np.testing.assert_allclose(truth[Sensor.ATTITUDE].values, np.tile([1.0, 0.0, 0.0, 0.0], (20, 1)))
    np.testing.assert_allclose(truth[Sensor.PLACE].values[0], [1.0, 2.0, -3.0])
    np.testing.assert_allclose(truth[Sensor.VELOCITY].values[0], [0.1, 0.2, -0.3], rtol=1e-6)
    np.testing.assert_allclose(truth[Sensor.POSITION].values[0], [47.4, 8.5, 488.0])
    assert not any("groundtruth" in c.source for c in recording.channels)


@pytest.mark.parametrize("size", [0x2000, 0x0FFF])
def test_a_length_that_leads_back_to_itself_is_refused_soon(tmp_path, size):
    """In the definitions pyulog steps back by the length that a message claims, whether it was there or not."""
    content = MAGIC + bytes(8) + message("B", bytes(40)) + bytes(70_000)
    (tmp_path / "a.ulg").write_bytes(content + struct.pack("<HB", size, 0) + bytes(100))
    began = time.process_time()
    with pytest.raises(UnreadableError):
        read_ulog(tmp_path / "a.ulg")
    assert time.process_time() - began < 20.0  # of a machine that is slow; here it took 0.3 s, and before for ever


def test_a_compass_that_dies_is_told_by_its_zeros(reading):
    log = UlogFile()
    field = driver(log, "sensor_mag", MAG_ID)
    for k in range(100):
        sample(log, field, 2_000_000 + 100_000 * k, *((0.2, 0.1, 0.4) if k < 70 else (0.0, 0.0, 0.0)))
    recording = reading(log)
    assert len(recording.channel(Sensor.MAG)) == 70
    assert [(e.odd.count, e.odd.total) for e in recording.events if e.odd is not None] == [(30, 100)]
