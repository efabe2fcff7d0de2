"""The log of the flying vehicle, read back by the reader of real ones, and held against what it simulated."""

from __future__ import annotations

import lzma
from pathlib import Path

import numpy as np
import pytest

from mavcal.calib.logs.dataflash import DataFlash, read_dataflash
from mavcal.calib.recording import Sensor
from mavcal.service.simvehicle.flight.flightlog import MESSAGES
from tests.unit.simvehicle.flights import Flight

FACTORS = {  # roll, pitch, yaw of each output (AP_MotorsMatrix.cpp)
    0: [(-0.5, 0.0, 0.5), (0.5, 0.0, 0.5), (0.0, 0.5, -0.5), (0.0, -0.5, -0.5)],
    1: [(-0.5, 0.5, 0.5), (0.5, -0.5, 0.5), (0.5, 0.5, -0.5), (-0.5, -0.5, -0.5)],
}


def short(path: Path, frame: dict | None = None, **parameters: float) -> Path:
    """A minute's mission in twenty seconds."""
    flight = Flight(path, frame, **parameters)
    flight.take_off()
    flight.follow(4.0, 0.0, -2.0, 2.0, yaw=1.0)
    flight.follow(0.0, -4.0, 1.0, 2.0)
    flight.lean(15.0, 0.0, 0.4)
    flight.lean(0.0, -15.0, 0.4)
    flight.follow(0.0, 0.0, 1.5, 2.0)
    flight.land()
    flight.close()
    return path


@pytest.fixture(scope="module")
def default(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return short(tmp_path_factory.mktemp("flight") / "x.bin")


def test_the_reader_finds_everything_that_a_diagnosis_needs(default: Path) -> None:
    recording = read_dataflash(default)
    rates = {(c.sensor, c.instance): (len(c) - 1) / (c.t[-1] - c.t[0]) for c in recording.channels}
    assert rates[Sensor.ACCEL, 0] == pytest.approx(400.0)
    assert rates[Sensor.GYRO, 1] == pytest.approx(40.0)
    assert rates[Sensor.MOTOR, 0] == pytest.approx(10.0)
    dynamics = {c.sensor: (len(c) - 1) / (c.t[-1] - c.t[0]) for c in recording.dynamics}
    assert dynamics == {
        Sensor.CONTROL: pytest.approx(400.0), Sensor.MIXER: pytest.approx(10.0), Sensor.VOLTAGE: pytest.approx(10.0),
        Sensor.VELOCITY: pytest.approx(25.0), Sensor.PLACE: pytest.approx(25.0), Sensor.ATTITUDE: pytest.approx(25.0),
        Sensor.AIR: pytest.approx(10.0),
    }  # fmt: skip
    assert recording.identity.autopilot == "ardupilot"
    assert recording.parameters.final()["FRAME_CLASS"] == 1
    kinds = [event.kind for event in recording.events]
    assert kinds.count("armed") == kinds.count("disarmed") == 1
    assert not {"damage", "drop", "dead"} & set(kinds)


def test_it_rests_before_arming_and_after_landing(default: Path) -> None:
    accel = read_dataflash(default).channel(Sensor.ACCEL)
    for part in (accel.values[:2000], accel.values[-300:]):
        np.testing.assert_allclose(part.mean(axis=0), [0.0, 0.0, -9.80665], atol=5e-3)


@pytest.mark.parametrize(
    ("frame", "parameters"),
    [
        ({}, {"FRAME_TYPE": 1.0}),
        ({}, {"FRAME_TYPE": 0.0, "MOT_THST_EXPO": 0.4, "MOT_SPIN_MIN": 0.12, "SIM_OPOS_ALT": 20.0}),
        ({"battCapacityAh": 0.6, "refBatRes": 0.02}, {"MOT_PWM_MIN": 1100.0, "MOT_PWM_MAX": 1900.0}),
    ],
)
def test_commands_rebuilt_from_rate_and_mixer_are_the_outputs(tmp_path: Path, frame: dict, parameters: dict) -> None:
    """AIRFRAME 3.1, written down a second time: RATE and MOTB give RCOU to the microsecond that it is cut to."""
    log = DataFlash(short(tmp_path / "x.bin", {**frame, "pwmMin": parameters.get("MOT_PWM_MIN", 1000.0)}, **parameters))
    p = dict(zip(log["PARM"]["Name"].tolist(), log["PARM"]["Value"].tolist(), strict=True))
    t, at = log["RCOU"]["TimeUS"], log["RATE"]["TimeUS"]
    rows = np.searchsorted(at, t)
    roll, pitch, yaw, throttle = (log["RATE"][name][rows] for name in ("ROut", "POut", "YOut", "AOut"))
    lift, ratio = (np.interp(t, log["MOTB"]["TimeUS"], log["MOTB"][name]) for name in ("LiftMax", "BatVolt"))
    height = np.interp(t, log["BARO"]["TimeUS"], log["BARO"]["AltAMSL"])
    density = ((288.15 - 0.0065 * height) / 288.15) ** 4.2559
    e, low, span = p["MOT_THST_EXPO"], p["MOT_PWM_MIN"], p["MOT_PWM_MAX"] - p["MOT_PWM_MIN"]
    inputs = np.column_stack([throttle, roll, pitch, yaw])
    factors = np.array([(1.0, *one) for one in FACTORS[int(p["FRAME_TYPE"])]])
    thrust = (inputs @ factors.T) / (lift * density)[:, None]
    free = (throttle > 0.2) & (thrust.min(axis=1) >= 0.0) & (thrust.max(axis=1) <= 1.0)
    c = ((e - 1.0) + np.sqrt((1.0 - e) ** 2 + 4.0 * e * lift[free, None] * thrust[free])) / (2.0 * e)
    share = p["MOT_SPIN_MIN"] + (p["MOT_SPIN_MAX"] - p["MOT_SPIN_MIN"]) * c / ratio[free, None]
    logged = np.column_stack([log["RCOU"][f"C{k}"] for k in range(1, 5)])[free]
    off = np.abs(low + span * share - logged)
    assert len(off) > 100
    assert np.median(off) < 0.7
    assert np.quantile(off, 0.99) < 1.5


def test_sensor_errors_of_the_simulator_are_in_the_samples(tmp_path: Path) -> None:
    flight = Flight(tmp_path / "x.bin", SIM_ACC1_BIAS_X=0.3, SIM_ACC2_SCAL_Z=0.95, SIM_GYR1_BIAS_Y=0.02)
    flight.wait(3.0)
    flight.close()
    recording = read_dataflash(tmp_path / "x.bin")
    mean = {(s, k): recording.channel(s, k).values.mean(axis=0) for s in (Sensor.ACCEL, Sensor.GYRO) for k in (0, 1)}
    np.testing.assert_allclose(mean[Sensor.ACCEL, 0], [0.3, 0.0, -9.80665], atol=5e-3)
    np.testing.assert_allclose(mean[Sensor.ACCEL, 1], [0.0, 0.0, -9.80665 / 0.95], atol=8e-3)
    np.testing.assert_allclose(mean[Sensor.GYRO, 0], [0.0, 0.02, 0.0], atol=1e-3)


def test_the_force_of_the_log_is_that_of_the_frame(default: Path) -> None:
    """Least squares on what was logged: k and the curve of the default frame at the reference altitude."""
    recording = read_dataflash(default)
    accel, motor = recording.channel(Sensor.ACCEL), recording.channel(Sensor.MOTOR)
    c = np.clip((motor.values - 0.15) / 0.8, 0.0, 1.0)
    calm = (c.min(axis=1) > 0.3) & (np.abs(np.gradient(c.mean(axis=1))) < 0.002)
    up = -np.interp(motor.t[calm], accel.t, accel.values[:, 2])
    share = (0.35 * c + 0.65 * c**2).mean(axis=1)[calm]
    assert np.median(up / share) == pytest.approx(9.80665 / 0.39, rel=0.03)


@pytest.mark.long
@pytest.mark.shared
def test_columns_and_types_are_those_of_a_real_firmware(shared_data: Path, default: Path) -> None:
    with lzma.open(shared_data / "airframe_flights" / "d01.bin.xz") as file:
        real = DataFlash(file.read())
    ours = DataFlash(default)
    for message in MESSAGES:
        if message.name not in ("RFND", "CMD"):  # that vehicle has neither a rangefinder nor a mission
            assert ours[message.name].format == real[message.name].format
