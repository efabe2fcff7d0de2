from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.service.simvehicle.magreader import MagReader

CLEAN = {"offset": [0, 0, 0], "matrix": np.eye(3).tolist(), "polynomial": np.zeros((3, 3)).tolist()}
QUIET = {"accel_noise": 0.0, "gyro_noise": 0.0, "mag_noise": 0.0}
RAW_IMU, HIGHRES, SCALED_2, SCALED_3 = 27, 105, 116, 129


def test_nothing_is_streamed_unasked(bench: Any) -> None:
    b = bench("ardupilot")
    b.run(5.0)
    assert {r.name for r in b.heard[0]} <= {"HEARTBEAT", "STATUSTEXT", "TIMESYNC"}
    assert len(b.take("HEARTBEAT")) == 5


@pytest.mark.long
@pytest.mark.parametrize(
    ("asked_us", "hz"), [(20000, 50.0), (10000, 100.0), (5000, 200.0), (4000, 250.0), (6667, 166.7), (3125, 333.3)]
)
def test_intervals_are_cut_to_whole_milliseconds(bench: Any, asked_us: float, hz: float) -> None:
    b = bench("ardupilot")
    b.command(511, RAW_IMU, asked_us)
    b.run(3.0)
    stamps = [m.time_usec for m in b.take("RAW_IMU")]
    assert (len(stamps) - 1) / (stamps[-1] - stamps[0]) * 1e6 == pytest.approx(hz, rel=5e-3)


def test_a_rate_above_the_loop_is_denied_and_the_old_one_stays(bench: Any) -> None:
    b = bench("ardupilot")
    b.command(511, RAW_IMU, 20000)
    b.run(0.1)
    b.take("COMMAND_ACK")
    b.command(511, RAW_IMU, 2500)
    b.run(1.0)
    acks = [r.message for r in b.heard[0] if r.name == "COMMAND_ACK"]
    texts = [r.message.text for r in b.heard[0] if r.name == "STATUSTEXT"]
    assert [a.result for a in acks] == [2]
    assert "too fast" in "".join(texts)
    assert len(b.take("RAW_IMU")) == pytest.approx(50, abs=1)


@pytest.mark.parametrize(
    ("number", "parameters", "result"), [(511, (9999, 20000), 2), (511, (27, 20000, 1), 2), (42006, (), 3)]
)
def test_what_is_not_supported_is_said(bench: Any, number: int, parameters: tuple[float, ...], result: int) -> None:
    b = bench("ardupilot")
    b.command(number, *parameters)
    assert [m.result for m in b.take("COMMAND_ACK")] == [result]


def test_intervals_are_lost_by_a_reboot(bench: Any) -> None:
    b = bench("ardupilot", boot_s=0.1)
    b.command(511, RAW_IMU, 20000)
    b.command(246, 1)
    b.run(0.2)
    b.take("RAW_IMU")
    b.run(1.0)
    assert b.take("RAW_IMU") == []


def test_a_data_stream_request_brings_the_group_without_scaled_imu(bench: Any) -> None:
    b = bench("ardupilot")
    b.send(dialect.MAVLink_request_data_stream_message(1, 1, 1, 10, 1))
    b.run(1.05)
    names = {r.name for r in b.heard[0]} - {"HEARTBEAT", "STATUSTEXT"}
    assert names == {"RAW_IMU", "SCALED_IMU2", "SCALED_IMU3", "SCALED_PRESSURE"}


@pytest.mark.parametrize(("bias", "counts"), [(0.0009, 0), (0.0011, 1), (-0.0019, -1)])
def test_gyro_bias_below_one_milliradian_is_invisible(bench: Any, bias: float, counts: int) -> None:
    b = bench("ardupilot", thermal=False, **QUIET, truth={"gyros": CLEAN, "accels": CLEAN})
    b.set("INS_GYROFFS_X", -bias)
    b.command(511, RAW_IMU, 20000)
    b.command(511, HIGHRES, 20000)
    b.run(0.5)
    highres = [r.message for r in b.heard[0] if r.name == "HIGHRES_IMU"]
    raw = b.take("RAW_IMU")
    assert {m.xgyro for m in raw} == {counts}
    assert highres[-1].xgyro == pytest.approx(bias, abs=1e-7)
    assert raw[-1].zacc == -1000


def test_offsets_and_scales_act_at_once_even_when_armed(bench: Any) -> None:
    b = bench("ardupilot", thermal=False, **QUIET, truth={"accels": CLEAN})
    b.vehicle.armed = True
    b.command(511, HIGHRES, 10000)
    b.run(0.2)
    b.set("INS_ACCOFFS_Z", 0.5)
    b.set("INS_ACCSCAL_Z", 1.01)
    b.run(0.1)
    assert b.take("HIGHRES_IMU")[-1].zacc == pytest.approx((-9.80665 - 0.5) * 1.01, rel=1e-6)


def test_a_slot_without_imu_carries_zeros(bench: Any) -> None:
    b = bench("ardupilot", imu_count=2)
    b.command(511, SCALED_3, 20000)
    b.run(0.2)
    last = b.take("SCALED_IMU3")[-1]
    assert (last.xacc, last.yacc, last.zacc, last.temperature) == (0, 0, 0, 0)


def test_the_compass_is_fresh_ten_times_a_second_and_repeated_between(bench: Any) -> None:
    b = bench("ardupilot")
    b.vehicle.world.motion.tumble(0.0)
    b.command(511, RAW_IMU, 10000)
    b.run(3.05)
    fields = [(m.time_usec, (m.xmag, m.ymag, m.zmag)) for m in b.take("RAW_IMU")]
    changes = [t for (t, a), (_, c) in zip(fields[1:], fields, strict=False) if a != c]
    assert len(changes) == pytest.approx(30, abs=2)
    steps = np.diff(changes)
    assert set(steps[(steps > 80_000) & (steps < 120_000)]) >= {100_000}
    read_at = b.vehicle.sensors.reader.read_at(np.array(changes) * 1e-6)
    age = np.array(changes) * 1e-6 - read_at
    assert 0.0 <= age.min() <= age.max() <= 0.01  # stamped when it was sent
    assert np.ptp(read_at % 0.1) > 1e-4  # the task comes late by part of a loop


def test_the_phase_of_the_compass_is_the_vehicles_own(bench: Any) -> None:
    phases = [b.vehicle.sensors.reader.read_at(np.array([1.0]))[0] % 0.1 for b in _run_for(bench, 1.0)]
    assert np.ptp(phases) > 0.02


def _run_for(bench: Any, seconds: float) -> list[Any]:
    vehicles = [bench("ardupilot", seed=seed) for seed in range(1, 5)]
    for b in vehicles:
        b.run(seconds)
    return vehicles


def test_the_compass_averages_the_field_over_its_period(bench: Any) -> None:
    """Turning at ω shrinks the mean over τ = 0.1 s by sinc(ωτ/2), and lets it lag by half the period."""
    clean = {"offset": [0, 0, 0], "matrix": np.eye(3).tolist()}
    b = bench("ardupilot", **QUIET, truth={"mags": clean}, field_ned_ut=[40.0, 0.0, 0.0])
    rate = np.radians(240.0)
    b.vehicle.world.motion.turn(0.0, [0, 0, 1], 240.0)
    b.vehicle.sensors.reader = MagReader(b.vehicle.world, 0.1, 10)
    b.run(3.0)
    body = b.vehicle.sensors.compass_body(0, np.array([3.0]))[0]
    length = 400.0 * np.sin(rate * 0.05) / (rate * 0.05)
    assert np.linalg.norm(body) == pytest.approx(length, rel=2e-4)
    now = b.vehicle.world.motion.evaluate(np.array([2.95]))[0][0]
    yaw = 2 * np.arctan2(now[3], now[0])
    # Ten samples end at the period's end: their middle is 5 ms after the period's middle.
    lag = (np.arctan2(-body[1], body[0]) - yaw + np.pi) % (2 * np.pi) - np.pi
    assert lag == pytest.approx(rate * 0.005, abs=2e-3)


def test_the_highres_magnetometer_is_a_million_times_too_big_where_the_defect_is(bench: Any) -> None:
    for defect, factor in ((True, 1000.0), (False, 1e-3)):
        b = bench("ardupilot", highres_mag_defect=defect, **QUIET)
        b.command(511, HIGHRES, 20000)
        b.command(511, RAW_IMU, 20000)
        b.run(0.1)
        highres = [r.message for r in b.heard[0] if r.name == "HIGHRES_IMU"][-1]
        raw = b.take("RAW_IMU")[-1]
        assert abs(highres.zmag) == pytest.approx(abs(raw.zmag) * factor, rel=3e-3)


def test_the_external_compass_is_rotated_by_its_parameter(bench: Any) -> None:
    clean = {"offset": [0, 0, 0], "matrix": np.eye(3).tolist()}
    right = bench("ardupilot", truth={"mags": clean}, **QUIET)
    wrong = bench("ardupilot", truth={"mags": clean}, mag_orientation_parameters=[0, 0, 0], **QUIET)
    field = np.array(right.vehicle.config.field_ned_ut) * 10
    for b, expected in ((right, field), (wrong, field @ np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]).T)):
        b.run(0.3)
        seen = b.vehicle.sensors.compass(1, np.array([0.3]))[0]
        assert np.linalg.norm(seen) == pytest.approx(np.linalg.norm(field))
        if b is right:
            assert seen == pytest.approx(expected)
        else:
            assert not np.allclose(seen, field, atol=10)


def test_temperature_is_read_once_a_second(bench: Any) -> None:
    b = bench("ardupilot")
    b.vehicle.world.thermal.warm_up(0.0, 20.0, 60.0, 30.0)
    b.command(511, RAW_IMU, 20000)
    b.run(10.0)
    values = [m.temperature for m in b.take("RAW_IMU")]
    assert len(set(values)) == pytest.approx(10, abs=1)


def test_thermal_correction_acts_with_enable_and_caltemp(bench: Any) -> None:
    b = bench("ardupilot", temperature=45.0, **QUIET, truth={"accels": CLEAN | {"polynomial": [[8e-3, 1.5e-4, 0]] * 3}})
    b.command(511, HIGHRES, 10000)
    for name, value in (("INS_TCAL1_ACC1_X", 8000.0), ("INS_TCAL1_ACC2_X", 150.0), ("INS_ACC1_CALTEMP", 35.0)):
        b.set(name, value)
    b.run(0.1)
    assert b.take("HIGHRES_IMU")[-1].xacc == pytest.approx(0.095, abs=1e-5)
    b.set("INS_TCAL1_ENABLE", 1.0)
    b.run(0.1)
    assert b.take("HIGHRES_IMU")[-1].xacc == pytest.approx(0.0, abs=1e-6)
    b.set("INS_ACC1_CALTEMP", -300.0)
    b.run(0.1)
    clamped = 1e-6 * (8000 * -35 + 150 * 35**2)
    assert b.take("HIGHRES_IMU")[-1].xacc == pytest.approx(clamped, abs=1e-5)


def test_the_primary_follows_its_use_switch(bench: Any) -> None:
    b = bench("ardupilot")
    b.set("INS_USE", 0.0)
    b.command(511, HIGHRES, 10000)
    b.run(0.1)
    assert b.take("HIGHRES_IMU")[-1].id == 1


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_streams_may_begin_late_and_go_on_at_once_with_another_rate(bench: Any, autopilot: str) -> None:
    b = bench(autopilot, stream_start_s=1.5)
    b.run(1.0)
    b.command(511, SCALED_2, 20000)
    b.run(1.4)
    assert b.take("SCALED_IMU2") == []
    b.run(1.0)
    assert len(b.take("SCALED_IMU2")) == pytest.approx(45, abs=3)
    b.command(511, SCALED_2, 40000)
    b.run(1.0)
    assert len(b.take("SCALED_IMU2")) == pytest.approx(25, abs=2)
