"""Columns of a PX4 log in, channels out: times, units, stages and instances by their numbers."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.firmware.px4.topics import Rows, inertial_channels
from mavcal.calib.recording import Oddity, OddSamples, Sensor, Stage

ACCEL, GYRO, MAG = 1310988, 2490644, 197388


def topic(t_us, **fields):
    """Columns by field name; a list of lists is an array field."""
    columns = {"timestamp": np.array(t_us, dtype=np.uint64)}
    for name, values in fields.items():
        for column, value in vectors(name.replace("__", "."), values):
            columns[column] = value
    return columns


def vectors(name, values):
    array = np.asarray(values)
    if array.ndim == 1:
        return [(name, array)]
    return [(f"{name}[{k}]", array[:, k]) for k in range(array.shape[1])]


def driver(device, t_us, values, **more):
    x, y, z = np.array(values, dtype=np.float64).T
    return topic(t_us, device_id=np.full(len(x), device), x=x, y=y, z=z, **more)


def read(topics, parameters=None):
    return inertial_channels(topics, parameters or {})


def only(channels, sensor, source):
    (found,) = [c for c in channels if (c.sensor, c.source) == (sensor, source)]
    return found


@pytest.mark.parametrize(
    ("name", "sensor", "unit", "factor"),
    [
        ("sensor_accel", Sensor.ACCEL, "m/s2", 1.0),
        ("sensor_gyro", Sensor.GYRO, "rad/s", 1.0),
        ("sensor_mag", Sensor.MAG, "uT", 100.0),
    ],
)
def test_a_driver_s_topic_is_raw_in_si_units_at_the_time_of_the_sample(name, sensor, unit, factor):
    columns = driver(5, [2_000_100, 2_001_100], [[1, 2, 3], [4, 5, 6]], timestamp_sample=np.array([0, 2_000_600]))
    (channel,), events = read({(name, 1): columns})
    assert events == []
    assert (channel.sensor, channel.instance, channel.unit, channel.stage) == (sensor, 0, unit, Stage.RAW)
    assert channel.t.tolist() == pytest.approx([2.0001, 2.0006], abs=1e-9)  # no time of a sample: that of the row
    np.testing.assert_allclose(channel.values, factor * np.array([[1, 2, 3], [4, 5, 6]]))
    assert channel.window == pytest.approx(1e-3)


@pytest.mark.parametrize("field", ["x_raw", "x_integral", "scaling"])
def test_drivers_of_old_firmwares_correct_themselves(field):
    columns = driver(5, [1_000_000], [[1, 2, 3]]) | {field: np.array([1.0])}
    assert read({("sensor_accel", 0): columns})[0][0].stage == Stage.CORRECTED


def test_a_field_without_a_device_id_says_that_the_compass_drivers_correct():
    field = topic([1_000_000], magnetometer_ga=[[0.1, 0.2, 0.3]])
    own = {
        ("sensor_mag", 0): driver(MAG, [1_000_000], [[1, 2, 3]]),
        ("sensor_accel", 0): driver(5, [1_000_000], [[1, 2, 3]]),
    }
    stages = {
        told: {
            c.sensor: c.stage
            for c in read(own | {("vehicle_magnetometer", 0): f})[0]
            if c.source != "vehicle_magnetometer"
        }
        for told, f in ((True, field | {"device_id": np.array([MAG])}), (False, field))
    }
    assert stages[True] == {Sensor.MAG: Stage.RAW, Sensor.ACCEL: Stage.RAW}
    assert stages[False] == {Sensor.MAG: Stage.CORRECTED, Sensor.ACCEL: Stage.RAW}


def test_topics_that_lack_a_field_or_rows_are_passed_over_and_the_next_is_read():
    def two(name, whole, without):
        return {(name, 0): {k: v for k, v in whole.items() if k not in without}, (name, 1): whole}

    good = driver(7, [1_000_000], [[1, 2, 3]])
    for axis in "xyz":
        (channel,), _ = read(two("sensor_gyro", good, {axis}))
        assert channel.values.tolist() == [[1, 2, 3]]
    (channel,), _ = read({("sensor_gyro", 0): {k: v[:0] for k, v in good.items()}, ("sensor_gyro", 1): good})
    assert len(channel) == 1
    imu = topic([1_000_000], accel_device_id=[5], delta_velocity=[[1.0, 2, 3]], delta_velocity_dt=[4000])
    for field in ("delta_velocity[0]", "delta_velocity[1]", "delta_velocity[2]", "delta_velocity_dt"):
        assert len(read(two("vehicle_imu", imu, {field}))[0]) == 1
    field = topic([1_000_000], device_id=[5], magnetometer_ga=[[0.1, 0.2, 0.3]])
    for axis in range(3):
        assert len(read(two("vehicle_magnetometer", field, {f"magnetometer_ga[{axis}]"}))[0]) == 1
    status = topic([1_000_000], accel_device_id=[5], accel_clipping=[[1, 0, 2]])
    for axis in range(3):
        assert len(read(two("vehicle_imu_status", status, {f"accel_clipping[{axis}]"}))[1]) == 1


def test_an_empty_interval_is_no_sample_of_the_integrated_topic():
    columns = topic(
        [1_000_000, 1_005_000, 1_010_000],
        gyro_device_id=[9, 9, 9],
        delta_angle=[[0.4, 0.8, 1.2], [1, 1, 1], [0.1, 0.2, 0.3]],
        delta_angle_dt=[4000, 0, 5000],
        delta_velocity=[[1.0, 2, 3]] * 3,
        delta_velocity_dt=[0, 0, 0],
    )
    (channel,), _ = read({("vehicle_imu", 0): columns})
    assert (channel.sensor, channel.unit, channel.stage) == (Sensor.GYRO, "rad/s", Stage.CORRECTED)
    np.testing.assert_allclose(channel.t, [0.998, 1.0075])  # the middle of the interval
    np.testing.assert_allclose(channel.values, [[100, 200, 300], [20, 40, 60]])
    assert channel.window == pytest.approx(0.0045)


def test_the_newest_sample_of_a_fifo_has_the_time_of_the_row():
    columns = topic(
        [3_000_000] * 2,
        timestamp_sample=np.array([2_000_000, 2_001_000]),
        device_id=[GYRO] * 2,
        dt=[100.0, 200.0],
        scale=[0.5, 2.0],
        samples=[2, 9],
        x=[[1, 2, 50], [3, 4, 5]],
        y=[[1, 3, 50], [3, 4, 5]],
        z=[[1, 4, 50], [3, 4, 6]],
    )
    (channel,), _ = read({("sensor_gyro_fifo", 0): columns})
    np.testing.assert_allclose(channel.t, [1.9999, 2.0, 2.0006, 2.0008, 2.001], atol=1e-9)
    np.testing.assert_allclose(channel.values, [[0.5, 0.5, 0.5], [1, 1.5, 2], [6, 6, 6], [8, 8, 8], [10, 10, 12]])
    assert (channel.stage, channel.unit, channel.source) == (Stage.RAW, "rad/s", "sensor_gyro_fifo")
    assert channel.window == pytest.approx(150e-6)
    for field in ("timestamp_sample", "dt", "scale", "samples", "x[0]", "y[0]", "z[0]"):
        less = {name: column for name, column in columns.items() if name != field}
        assert len(read({("sensor_gyro_fifo", 0): less, ("sensor_gyro_fifo", 1): columns})[0]) == 1


def test_a_fifo_is_as_deep_as_all_three_axes_go():
    columns = topic([1], timestamp_sample=[1_000_000], dt=[100.0], scale=[1.0], samples=[80], x=[[1] * 70])
    columns |= {f"{a}[{k}]": np.array([k]) for a, n in (("y", 66), ("z", 64)) for k in range(n)}
    assert len(read({("sensor_accel_fifo", 0): columns})[0][0]) == 64
    del columns["z[63]"]
    assert len(read({("sensor_accel_fifo", 0): columns})[0][0]) == 63


def combined(t_us, **more):
    n = len(t_us)
    return topic(
        t_us,
        gyro_rad=np.arange(3 * n).reshape(n, 3) / 10,
        accelerometer_m_s2=np.arange(3 * n).reshape(n, 3) + 1.0,
        magnetometer_ga=np.arange(3 * n).reshape(n, 3) / 100,
        **more,
    )


def test_sensor_combined_has_a_time_for_every_sensor_and_repeats_nothing():
    none = 0x7FFFFFFF
    columns = combined(
        [1_000_000, 1_004_000, 1_008_000, 1_012_000],
        gyro_integral_dt=np.array([4000, 4000, 2000, 4000]),
        accelerometer_integral_dt=np.array([0.002, 0.002, 0.002, 7.0], dtype=np.float32),
        accelerometer_timestamp_relative=np.array([-1000, -1000, -5000, none]),
        magnetometer_timestamp_relative=np.array([none, -2000, none, 500]),
    )
    channels, _ = read({("sensor_combined", 0): columns})
    gyro, accel, mag = (only(channels, s, "sensor_combined") for s in (Sensor.GYRO, Sensor.ACCEL, Sensor.MAG))
    np.testing.assert_allclose(gyro.t, [0.998, 1.002, 1.007, 1.010])
    np.testing.assert_allclose(accel.t, [0.998, 1.002], atol=1e-9)
    np.testing.assert_allclose(mag.t, [1.002, 1.0125])
    np.testing.assert_allclose(mag.values, [[3, 4, 5], [9, 10, 11]])
    assert accel.values.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert [c.unit for c in (gyro, accel, mag)] == ["rad/s", "m/s2", "uT"]
    assert [c.window for c in (gyro, accel, mag)] == pytest.approx([0.004, 0.002, 0.001], rel=1e-6)
    assert {c.stage for c in channels} == {Stage.CORRECTED}


def test_an_integration_interval_is_a_second_at_most():
    columns = combined([5_000_000], gyro_integral_dt=np.array([9_000_000]))
    channels, _ = read({("sensor_combined", 0): columns})
    assert only(channels, Sensor.GYRO, "sensor_combined").t[0] == pytest.approx(4.5)
    columns = combined([5_000_000], gyro_integral_dt=np.array([-3.0]))
    assert only(read({("sensor_combined", 0): columns})[0], Sensor.GYRO, "sensor_combined").t[0] == pytest.approx(5.0)


@pytest.mark.parametrize("missing", ["accelerometer_m_s2[0]", "accelerometer_m_s2[1]", "accelerometer_m_s2[2]"])
def test_a_sensor_that_sensor_combined_lacks_does_not_cost_the_next(missing):
    columns = combined([5_000_000])
    del columns[missing]
    channels, _ = read({("sensor_combined", 0): columns})
    assert [c.sensor for c in channels] == [Sensor.GYRO, Sensor.MAG]
    assert read({("sensor_combined", 0): {k: v[:0] for k, v in columns.items()}}) == ([], [])


def test_the_selection_in_force_says_whose_a_row_is():
    parameters = {"CAL_ACC0_ID": 11, "CAL_ACC1_ID": 12, "CAL_GYRO0_ID": 21, "CAL_GYRO1_ID": 22, "CAL_GYRO_PRIME": 22}
    parameters |= {"CAL_MAG0_ID": 31, "CAL_MAG1_ID": 32, "CAL_MAG_PRIME": 32, "CAL_ACC_PRIME": 99}
    columns = combined([1_000_000, 2_000_000, 3_000_000])
    alone, _ = read({("sensor_combined", 0): columns}, parameters)
    assert {c.sensor: c.instance for c in alone} == {Sensor.GYRO: 1, Sensor.ACCEL: 0, Sensor.MAG: 1}
    selection = topic([1_500_000, 2_000_000], accel_device_id=[12, 11])
    channels, _ = read({("sensor_combined", 0): columns, ("sensor_selection", 0): selection}, parameters)
    accel = {c.instance: c.t.tolist() for c in channels if c.sensor == Sensor.ACCEL}
    assert accel == {1: [1.0], 0: [2.0, 3.0]}  # what was before the first selection is the first one's
    assert {c.instance for c in channels if c.sensor == Sensor.GYRO} == {1}
    nothing = {k: v[:0] for k, v in selection.items()}
    empty, _ = read({("sensor_combined", 0): columns, ("sensor_selection", 0): nothing}, parameters)
    assert {c.instance for c in empty if c.sensor == Sensor.ACCEL} == {0}
    later = combined([1_000_000, 2_000_000], accelerometer_timestamp_relative=np.array([0, 0x7FFFFFFF]))
    stale, _ = read(
        {
            ("sensor_combined", 0): later,
            ("sensor_selection", 0): topic([1_000_000, 2_000_000], accel_device_id=[12, 11]),
        },
        parameters,
    )
    assert [c.instance for c in stale if c.sensor == Sensor.ACCEL] == [1]  # nothing new of the other one


def test_instances_are_rows_of_the_calibration_then_topics_in_their_order():
    topics = {
        ("sensor_accel", 0): driver(77, [1_000_000], [[1, 2, 3]]),
        ("sensor_accel", 1): driver(12, [1_000_000], [[1, 2, 3]]),
        ("vehicle_imu", 0): topic([1_000_000], accel_device_id=[78], gyro_device_id=[88]),
        ("sensor_accel_fifo", 0): topic([1_000_000], device_id=[79]),
        ("sensor_mag", 0): topic([1_000_000] * 3, device_id=[5, 6, 6]),
        ("vehicle_magnetometer", 0): topic([1_000_000], device_id=[4]),
        ("sensor_gyro", 0): topic([1_000_000], device_id=[0]),
    }
    rows = Rows(topics, {"CAL_ACC0_ID": 11, "CAL_ACC2_ID": 12})
    assert [rows.instance(Sensor.ACCEL, device, 9) for device in (11, 12, 77, 79, 78, 5)] == [0, 1, 2, 3, 4, 9]
    assert [rows.instance(Sensor.GYRO, device, 9) for device in (88, 0, 11)] == [0, 9, 9]
    assert [rows.instance(Sensor.MAG, device, 9) for device in (6, 4, 5)] == [0, 1, 9]
    assert [rows.primary(s) for s in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG)] == [0, 0, 0]


@pytest.mark.parametrize(
    ("kind", "sensor", "topic_name"),
    [
        ("ACC", Sensor.ACCEL, "sensor_accel"),
        ("GYRO", Sensor.GYRO, "sensor_gyro"),
        ("MAG", Sensor.MAG, "sensor_mag"),
    ],
)
def test_the_first_row_is_the_primary_one_where_nothing_names_another(kind, sensor, topic_name):
    """No device id stands for "not said", however small the ids of a log are."""
    ids = (2, 1, 3)
    devices = {f"CAL_{kind}{k}_ID": device for k, device in enumerate(ids)}
    topics = {(topic_name, k): driver(device, [1_000_000], [[1, 2, 3]]) for k, device in enumerate(ids)}
    for parameters in (devices, devices | {f"CAL_{kind}_PRIME": 0}, devices | {f"CAL_{kind}_PRIME": 99}):
        assert Rows(topics, parameters).primary(sensor) == 0
    for instance, device in enumerate(ids):
        assert Rows(topics, devices | {f"CAL_{kind}_PRIME": device}).primary(sensor) == instance


BOARD = {f"SENS_BOARD_{a}_OFF": 0.0 for a in "XYZ"} | {"SENS_BOARD_ROT": 2}
OWN = {f"CAL_{s}{k}_ROT": -1 for s in ("ACC", "GYRO") for k in range(4)}


def test_means_of_the_status_topic_begin_a_tenth_of_a_second_before():
    columns = topic(
        [2_000_000],
        accel_device_id=[5],
        gyro_device_id=[6],
        mean_accel=[[-2.0, 1.0, 3.0]],
        mean_gyro=[[-0.2, 0.1, 0.3]],
    )
    parameters = BOARD | OWN | {"CAL_ACC0_ID": 9, "CAL_ACC1_ID": 5, "CAL_GYRO0_ID": 6}
    channels, events = read({("vehicle_imu_status", 0): columns}, parameters)
    accel, gyro = channels
    assert events == []
    np.testing.assert_allclose(accel.values, [[1, 2, 3]], atol=1e-12)
    np.testing.assert_allclose(gyro.values, [[0.1, 0.2, 0.3]], atol=1e-12)
    assert [(c.instance, c.unit, c.stage, c.window) for c in channels] == [
        (1, "m/s2", Stage.RAW, 0.1),
        (0, "rad/s", Stage.RAW, 0.1),
    ]
    assert accel.t[0] == pytest.approx(1.95)
    for axis in range(3):
        less = {k: v for k, v in columns.items() if k != f"mean_accel[{axis}]"}
        assert [c.sensor for c in read({("vehicle_imu_status", 0): less}, parameters)[0]] == [Sensor.GYRO]
    unknown = {k: v for k, v in parameters.items() if k != "CAL_ACC1_ROT"}
    kept, (event,) = read({("vehicle_imu_status", 0): columns}, unknown)
    assert [c.sensor for c in kept] == [Sensor.GYRO]
    assert (event.t, event.kind) == (2.0, "left_out")
    assert event.text.startswith("the raw means of accel 2 in vehicle_imu_status are left out: ")


def field(t_us, device=MAG):
    return topic(t_us, device_id=[device] * len(t_us), magnetometer_ga=[[0.1, 0.2, 0.3]] * len(t_us))


def test_a_field_is_debiased_from_the_first_valid_estimate_of_its_own_instance():
    estimate = topic([1_000_000, 2_000_000, 3_000_000], valid=[[1, 0, 0], [1, 0, 1], [1, 0, 1]])
    t_us = [1_500_000, 2_000_000, 2_500_000]
    for multi_id, corrected, debiased in ((0, [], [1.5, 2, 2.5]), (1, [1.5, 2, 2.5], []), (2, [1.5], [2, 2.5])):
        topics = {("vehicle_magnetometer", multi_id): field(t_us), ("magnetometer_bias_estimate", 0): estimate}
        channels, events = read(topics, {"CAL_MAG0_ID": 3, "CAL_MAG1_ID": MAG, "MBE_ENABLE": 1})
        times = {c.stage: c.t.tolist() for c in channels}
        assert times == {s: t for s, t in ((Stage.CORRECTED, corrected), (Stage.DEBIASED, debiased)) if t}
        assert {(c.instance, c.unit, c.window) for c in channels} == {(1, "uT", 1e-3)}
        assert [(e.t, e.kind) for e in events] == [(t, "left_out") for t in debiased[:1]]
        assert all("vehicle_magnetometer 2 has a running bias estimate" in e.text for e in events)
        np.testing.assert_allclose(channels[0].values[0], [10, 20, 30])


@pytest.mark.parametrize(
    ("parameters", "stage"), [({"MBE_ENABLE": 1}, "debiased"), ({"MBE_ENABLE": 0}, "corrected"), ({}, "corrected")]
)
def test_an_estimate_that_was_not_logged_may_have_been_there_all_along(parameters, stage):
    channels, _ = read({("vehicle_magnetometer", 0): field([1_000_000])}, parameters)
    assert [c.stage for c in channels] == [Stage(stage)]


def test_a_field_without_an_id_is_the_primary_compass_s():
    columns = field([1_000_000])
    del columns["device_id"]
    parameters = {"CAL_MAG0_ID": 31, "CAL_MAG1_ID": 32, "CAL_MAG_PRIME": 32}
    assert read({("vehicle_magnetometer", 3): columns}, parameters)[0][0].instance == 1
    assert read({("vehicle_magnetometer", 3): field([1_000_000], 31)}, parameters)[0][0].instance == 0


def test_every_thermometer_is_told_once_and_without_what_is_no_number():
    topics = {
        ("sensor_accel", 0): topic([1_000_000, 2_000_000], device_id=[5, 5], temperature=[np.nan, 31.0]),
        ("sensor_accel", 1): topic([1_000_000], device_id=[6], temperature=[np.nan]),
        ("vehicle_imu_status", 0): topic(
            [1_000_000], accel_device_id=[5], gyro_device_id=[7], temperature_accel=[32.0], temperature_gyro=[33.0]
        ),
        ("sensor_gyro", 0): topic([1_000_000], device_id=[8], temperature=[34.0]),
        ("sensor_gyro", 1): topic([1_000_000], device_id=[9], temperature=[35.0]),
        ("sensor_gyro", 2): topic([1_000_000], device_id=[9], pressure=[35.0]),
    }
    channels, _ = read(topics, {"CAL_GYRO0_ID": 1, "CAL_GYRO1_ID": 8, "CAL_GYRO2_ID": 7, "CAL_GYRO3_ID": 2})
    told = [(c.source, c.instance, c.t.tolist(), c.values.ravel().tolist()) for c in channels]
    assert told == [
        ("sensor_accel", 0, [2.0], [31.0]),
        ("vehicle_imu_status", 0, [1.0], [32.0]),
        ("sensor_gyro", 1, [1.0], [34.0]),
        ("sensor_gyro", 4, [1.0], [35.0]),
        ("vehicle_imu_status", 2, [1.0], [33.0]),
    ]
    assert {(c.sensor, c.unit, c.stage) for c in channels} == {(Sensor.TEMPERATURE, "degC", Stage.RAW)}


def test_clipping_is_counted_by_axis_and_silent_without_any():
    quiet = topic([1_000_000], accel_device_id=[5], accel_clipping=[[0, 0, 0]])
    loud = topic([1_000_000, 2_000_000], accel_device_id=[6, 6], accel_clipping=[[1, 0, 2], [4, 0, 3]])
    channels, (event,) = read(
        {("vehicle_imu_status", 0): quiet, ("vehicle_imu_status", 1): loud}, {"CAL_ACC0_ID": 5, "CAL_ACC1_ID": 6}
    )
    assert channels == []
    assert (event.t, event.kind) == (2.0, "clipping")
    assert event.text == "accel 2 reached the end of its range 7 times since boot (x 4, y 0, z 3)"
    assert event.odd == OddSamples(Oddity.CLIPPED, Sensor.ACCEL, 1, 4, until=2.0)  # what it counted before is not of it


def test_levels_of_vibration_are_channels_of_their_own():
    status = topic(
        [1_000_000, 2_000_000], accel_device_id=[5, 5], gyro_device_id=[7, 7],
        accel_vibration_metric=[0.5, np.nan], gyro_vibration_metric=[0.01, 0.02],
    )  # fmt: skip
    channels, _ = read({("vehicle_imu_status", 0): status}, {"CAL_ACC0_ID": 4, "CAL_ACC1_ID": 5, "CAL_GYRO0_ID": 7})
    found = {(c.sensor, c.instance, c.unit): c.values[:, 0].tolist() for c in channels}
    assert found == {
        (Sensor.VIBRATION, 1, "m/s2"): [0.5],
        (Sensor.GYRO_VIBRATION, 0, "rad/s"): [0.01, 0.02],
    }
