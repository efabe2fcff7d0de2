"""Topics beside the inertial ones: their numbers, and what of them is left out."""

from __future__ import annotations

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.firmware.px4.flight import arming_events, flight_channels, truth_channels
from mavcal.calib.recording import Sensor, Stage

from .test_topics import topic


def told(topics, made=flight_channels):
    """Channels as plain numbers."""
    channels = made(topics)
    assert {c.stage for c in channels} <= {Stage.RAW}
    return [(c.sensor, c.instance, c.unit, c.source, c.t.tolist(), c.values.tolist()) for c in channels]


def test_an_attitude_is_a_unit_quaternion_or_left_out():
    q = [[2.0, 0, 0, 0], [0.5, 0, 0, 0], [0, 0.51, 0, 0], [np.nan, 0, 0, 0], [1, 1, 1, 1]]
    columns = topic([1_000_000, 2_000_000, 3_000_000, 4_000_000, 5_000_000], q=q)
    ((sensor, instance, unit, source, t, values),) = told({("vehicle_attitude", 0): columns})
    assert (sensor, instance, unit, source) == (Sensor.ATTITUDE, 0, "1", "vehicle_attitude")
    assert t == [1.0, 3.0, 5.0]
    assert values == [[1, 0, 0, 0], [0, 1, 0, 0], [0.5] * 4]
    for k in range(4):
        assert told({("vehicle_attitude", 0): {n: c for n, c in columns.items() if n != f"q[{k}]"}}) == []
    assert told({("vehicle_attitude", 1): columns}) == []


NEW = {"latitude_deg": [46.0, 47.5], "longitude_deg": [8.0, 8.25], "altitude_msl_m": [9.0, 500.5]}
OLD = {"lat": [460000000, 475000000], "lon": [80000000, 82500000], "alt": [9000, 500500]}
SPEED = {"vel_n_m_s": [9.0, 1.0], "vel_e_m_s": [9.0, 2.0], "vel_d_m_s": [9.0, 3.0]}


@pytest.mark.parametrize("fields", [NEW, OLD, OLD | NEW])
@pytest.mark.parametrize("name", ["vehicle_gps_position", "sensor_gps"])
def test_a_place_counts_from_a_fix_in_three_dimensions_on(fields, name):
    columns = topic([1_000_000, 2_000_000], fix_type=[2, 3], **fields)
    ((sensor, _, unit, source, t, values),) = told({(name, 0): columns})
    assert (sensor, unit, source, t) == (Sensor.POSITION, "deg deg m", name, [2.0])
    np.testing.assert_allclose(values, [[47.5, 8.25, 500.5]])
    for field in (NEW if fields is not OLD else OLD) if len(fields) == 3 else ():
        assert told({(name, 0): {n: c for n, c in columns.items() if n != field}}) == []
    assert told({(name, 0): {n: c for n, c in columns.items() if n != "fix_type"}}) == []


def test_the_velocity_of_a_receiver_needs_all_three_axes_and_the_fused_receiver_comes_first():
    columns = topic([1_000_000, 2_000_000], fix_type=[3, 3], **SPEED)
    other = topic([9_000_000], fix_type=[3], vel_n_m_s=[7.0], vel_e_m_s=[7.0], vel_d_m_s=[7.0])
    ((sensor, instance, unit, source, t, values),) = told(
        {("vehicle_gps_position", 0): columns, ("sensor_gps", 0): other}
    )
    assert (sensor, instance, unit, source, t) == (Sensor.VELOCITY, 0, "m/s", "vehicle_gps_position", [1.0, 2.0])
    assert values == [[9, 9, 9], [1, 2, 3]]
    for field in SPEED:
        assert told({("sensor_gps", 0): {n: c for n, c in columns.items() if n != field}}) == []


def test_a_local_place_counts_while_it_is_valid():
    columns = topic(
        [1_000_000, 2_000_000, 3_000_000],
        x=[1.0, 2, 3],
        y=[4.0, 5, 6],
        z=[7.0, 8, np.nan],
        vx=[0.1, 0.2, 0.3],
        vy=[0.4, 0.5, 0.6],
        vz=[0.7, 0.8, 0.9],
        xy_valid=[0, 1, 2],
    )
    place, speed = told({("vehicle_local_position", 0): columns})
    assert place == (Sensor.PLACE, 0, "m", "vehicle_local_position", [2.0], [[2, 5, 8]])
    assert speed[:2] == (Sensor.VELOCITY, 0)
    assert speed[4:] == ([1.0, 2.0, 3.0], [[0.1, 0.4, 0.7], [0.2, 0.5, 0.8], [0.3, 0.6, 0.9]])
    slow = columns | {"v_xy_valid": np.array([1, 0, 0])}
    assert told({("vehicle_local_position", 0): slow})[1][4] == [1.0]
    for missing, left in (("y", Sensor.VELOCITY), ("vz", Sensor.PLACE)):
        less = {n: c for n, c in columns.items() if n != missing}
        assert [c[0] for c in told({("vehicle_local_position", 0): less})] == [left]


def test_a_current_that_is_not_measured_is_none_and_zero_is_one():
    first = topic([1_000_000, 2_000_000, 3_000_000], current_a=[-1.0, 0.0, 12.5])
    topics = {("battery_status", 0): topic([1_000_000], voltage=[3.0]), ("battery_status", 1): first}
    assert told(topics) == [(Sensor.CURRENT, 1, "A", "battery_status", [2.0, 3.0], [[0.0], [12.5]])]


def test_the_throttle_is_the_length_of_the_thrust_or_the_old_fourth_control():
    thrust = topic([1_000_000], xyz=[[2.0, 3.0, -6.0]])
    old = topic([2_000_000], control=[[0.1, 0.2, 0.3, -0.4]])
    both = {("vehicle_thrust_setpoint", 0): thrust, ("actuator_controls_0", 0): old}
    assert told(both) == [(Sensor.THROTTLE, 0, "1", "vehicle_thrust_setpoint", [1.0], [[7.0]])]
    for axis in range(3):
        less = {n: c for n, c in thrust.items() if n != f"xyz[{axis}]"}
        found = told({("vehicle_thrust_setpoint", 0): less, ("actuator_controls_0", 0): old})
        assert found == [(Sensor.THROTTLE, 0, "1", "actuator_controls_0", [2.0], [[0.4]])]
    assert told({("actuator_controls_0", 0): topic([2_000_000], control=[[0.1, 0.2, 0.3]])}) == []


def test_motors_are_those_that_ever_get_a_command_clipped_to_full_thrust_either_way():
    """-1 is full thrust backwards, of motors that reverse (PX4 ``msg/versioned/ActuatorMotors.msg``)."""
    nan = np.nan
    commands = topic([1_000_000, 2_000_000], control=[[-1.5, nan, 0.25, nan], [1.5, nan, -0.5, nan]])
    outputs = topic([1_000_000], output=[[1100, 1200]])
    topics = {("actuator_motors", 0): commands, ("actuator_outputs", 0): outputs}
    assert told(topics) == [(Sensor.MOTOR, 0, "1", "actuator_motors", [1.0, 2.0], [[-1, 0.25], [1, -0.5]])]
    stopped = topic([1_000_000], control=[[nan, nan]])
    assert told({("actuator_motors", 0): stopped, ("actuator_outputs", 0): outputs}) == []
    many = topic([1_000_000], control=[[0.5] * 17])
    assert len(told({("actuator_motors", 0): many})[0][5][0]) == 16
    first = topic([1_000_000], control=[[0.5, nan]])
    assert told({("actuator_motors", 0): first})[0][5] == [[0.5]]


def test_outputs_are_motors_where_they_look_like_pulse_widths():
    outputs = topic(
        [1_000_000, 2_000_000],
        output=[[800, 1000, 799, 900.0, 0, 1500], [2200, 1250, 1500, 2201, 0, 2000]],
    )
    ((sensor, instance, unit, source, t, values),) = told({("actuator_outputs", 2): outputs})
    assert (sensor, instance, unit, source, t) == (Sensor.MOTOR, 2, "1", "actuator_outputs", [1.0, 2.0])
    assert values == [[0, 0, 0.5], [1, 0.25, 1]]
    assert told({("actuator_outputs", 0): topic([1_000_000], output=[[0.0, 5.0]])}) == []
    assert len(told({("actuator_outputs", 0): topic([1_000_000], output=[[1500] * 17])})[0][5][0]) == 16


def test_rotors_turn_in_hertz_as_many_as_ever_were_counted():
    columns = topic([1_000_000, 2_000_000], esc_count=[1, 2])
    columns |= {f"esc[{k}].esc_rpm": np.array([60 * (k + 1), -600 * (k + 1)]) for k in range(9)}
    assert told({("esc_status", 0): columns}) == [
        (Sensor.ROTOR_SPEED, 0, "Hz", "esc_status", [1.0, 2.0], [[1, 2], [10, 20]])
    ]
    many = columns | {"esc_count": np.array([9, 9])}
    assert len(told({("esc_status", 0): many})[0][5][0]) == 8
    assert told({("esc_status", 0): columns | {"esc_count": np.array([0, 0])}}) == []
    assert told({("esc_status", 0): {n: c for n, c in columns.items() if n != "esc_count"}}) == []
    assert told({("esc_status", 0): {n: c for n, c in columns.items() if n != "esc[1].esc_rpm"}}) == []
    assert told({("esc_status", 0): {n: c[:0] for n, c in columns.items()}}) == []


def test_a_simulator_s_truth_is_named_after_its_topics():
    topics = {
        ("vehicle_attitude_groundtruth", 0): topic([1_000_000], q=[[1.0, 0, 0, 0]]),
        ("vehicle_local_position_groundtruth", 0): topic([1_000_000], x=[1.0], y=[2.0], z=[3.0]),
        ("vehicle_global_position_groundtruth", 0): topic([1_000_000], lat=[47.0], lon=[8.0], alt=[400.0]),
    }
    found = told(topics, truth_channels)
    assert [(c[0], c[3], c[5]) for c in found] == [
        (Sensor.ATTITUDE, "vehicle_attitude_groundtruth", [[1, 0, 0, 0]]),
        (Sensor.PLACE, "vehicle_local_position_groundtruth", [[1, 2, 3]]),
        (Sensor.POSITION, "vehicle_global_position_groundtruth", [[47, 8, 400]]),
    ]
    assert found[2][1:3] == (0, "deg deg m")
    for field in ("lat", "lon", "alt"):
        less = {n: c for n, c in topics["vehicle_global_position_groundtruth", 0].items() if n != field}
        assert told({("vehicle_global_position_groundtruth", 0): less}, truth_channels) == []
    assert told({}, truth_channels) == []
    assert told(topics) == []


def test_arming_is_told_at_its_first_state_and_every_change_and_first_by_the_switch():
    t_us = [1_000_000, 2_000_000, 3_000_000, 4_000_000]
    state = topic(t_us, arming_state=[2, 1, 2, 3])
    events = arming_events({("vehicle_status", 0): state})
    assert [(e.t, e.kind, e.text) for e in events] == [
        (1.0, "armed", "the vehicle was armed"),
        (2.0, "disarmed", "the vehicle was disarmed"),
        (3.0, "armed", "the vehicle was armed"),
        (4.0, "disarmed", "the vehicle was disarmed"),
    ]
    switch = topic(t_us, armed=[0, 0, 1, 1])
    both = {("vehicle_status", 0): state, ("actuator_armed", 0): switch}
    assert [(e.t, e.kind) for e in arming_events(both)] == [(1.0, "disarmed"), (3.0, "armed")]
    unreadable = both | {("actuator_armed", 0): topic(t_us, prearmed=[0, 0, 1, 1])}
    assert len(arming_events(unreadable)) == 4
    empty = both | {("actuator_armed", 0): {n: c[:0] for n, c in switch.items()}}
    assert len(arming_events(empty)) == 4
    assert arming_events({}) == []


@pytest.mark.parametrize("kind", [dialect.MAV_TYPE_GROUND_ROVER, dialect.MAV_TYPE_SURFACE_BOAT])
def test_outputs_that_turn_both_ways_rest_at_neutral(kind):
    outputs = topic([1_000_000, 2_000_000], output=[[1500, 1000], [2000, 1500]])
    (channel,) = flight_channels({("actuator_outputs", 0): outputs}, kind)
    assert channel.values.tolist() == [[0, -1], [1, 0]]


@pytest.mark.parametrize("kind", [dialect.MAV_TYPE_FIXED_WING, dialect.MAV_TYPE_VTOL_TILTROTOR])
def test_outputs_of_a_vehicle_with_surfaces_tell_of_no_motor(kind):
    outputs = topic([1_000_000], output=[[1500, 1000]])
    assert flight_channels({("actuator_outputs", 0): outputs}, kind) == []
    commands = topic([1_000_000], control=[[0.5]])
    both = {("actuator_outputs", 0): outputs, ("actuator_motors", 0): commands}
    assert [c.source for c in flight_channels(both, kind)] == ["actuator_motors"]
