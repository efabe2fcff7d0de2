"""What a DataFlash log says of the flight itself: mixer, battery, height and the estimator's own trajectory."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.logs.dataflash import read_dataflash
from mavcal.calib.recording import Channel, Recording, Sensor
from tests.unit.logs.dataflash_file import FMT, Message, flight

MOTB = Message(200, "MOTB", "QfffffB", "TimeUS,LiftMax,BatVolt,ThLimit,ThrAvMx,ThrOut,FailFlags")
XKF1 = Message(201, "XKF1", "QBccCfffffff", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD")
XKQ = Message(202, "XKQ", "QBffff", "TimeUS,C,Q1,Q2,Q3,Q4")
BARO = Message(206, "BARO", "QBfffcfIffBf", "TimeUS,I,Alt,AltAMSL,Press,Temp,CRt,SMS,Offset,GndTemp,H,CPress")
RFND = Message(203, "RFND", "QBCBB", "TimeUS,Instance,Dist,Stat,Orient")
CURR = Message(204, "CURR", "QhhhhfBB", "TimeUS,Throttle,Volt,Curr,Vcc,CurrTot,A,B")
EKF1 = Message(205, "EKF1", "QccCffffff", "TimeUS,Roll,Pitch,Yaw,VN,VE,VD,PN,PE,PD")
START_US = 5_000_000


def times(count: int, hz: float) -> np.ndarray:
    return START_US + (np.arange(count) * 1e6 / hz).astype(np.uint64)


def log(*parts: bytes, seconds: float = 4.0) -> Recording:
    return read_dataflash(flight(seconds, 1) + b"".join(parts))


def rows(message: Message, count: int, hz: float, **columns: object) -> bytes:
    return message.definition() + message.rows(count, TimeUS=times(count, hz), **columns).tobytes()


def of(recording: Recording, sensor: Sensor, instance: int = 0) -> Channel:
    (found,) = (c for c in recording.dynamics if (c.sensor, c.instance) == (sensor, instance))
    return found


def test_inputs_of_the_mixer_are_at_loop_rate() -> None:
    """Roll, pitch and yaw with feed-forward, and the throttle: outputs, not wanted rates."""
    data = flight(4.0, 1)
    recording = read_dataflash(data)
    control = of(recording, Sensor.CONTROL)
    assert control.source == "RATE"
    assert control.values.shape[1] == 4
    assert 1.0 / np.median(np.diff(control.t)) == pytest.approx(400.0)
    # what the file holds, read once more by hand
    layout = Message(67, "RATE", "Qffffffffffff", "TimeUS,RDes,R,ROut,PDes,P,POut,YDes,Y,YOut,ADes,A,AOut").dtype
    at = data.index(bytes((0xA3, 0x95, 67)), data.index(b"ArduCopter"))
    first = np.frombuffer(data, layout, 1, at)[0]
    np.testing.assert_allclose(control.values[0], [first[n] for n in ("ROut", "POut", "YOut", "AOut")])


def test_what_scales_the_mixer() -> None:
    made = rows(MOTB, 40, 10.0, LiftMax=0.93, BatVolt=0.96, ThLimit=np.linspace(1.0, 0.9, 40), ThrOut=7.0)
    mixer = of(log(made), Sensor.MIXER)
    np.testing.assert_allclose(mixer.values[:, :2], np.tile([0.93, 0.96], (40, 1)), rtol=1e-6)
    np.testing.assert_allclose(mixer.values[:, 2], np.linspace(1.0, 0.9, 40), rtol=1e-6)


def test_a_mixer_message_without_its_columns_is_left_out() -> None:
    old = Message(200, "MOTB", "Qff", "TimeUS,LiftMax,BatVolt")
    found = log(rows(old, 40, 10.0, LiftMax=1.0, BatVolt=1.0))
    assert Sensor.MIXER not in {c.sensor for c in found.dynamics}


def test_the_voltage_is_that_of_the_first_battery() -> None:
    volts = of(log(), Sensor.VOLTAGE)
    assert volts.unit == "V"
    np.testing.assert_allclose(volts.values, 15.0)


def test_an_old_log_counts_its_voltage_in_hundredths() -> None:
    data = flight(4.0, 1)
    renamed = data.replace(b"BAT\x00QBfffffcf", b"BAX\x00QBfffffcf")
    found = read_dataflash(renamed + rows(CURR, 40, 10.0, Volt=1234))
    np.testing.assert_allclose(of(found, Sensor.VOLTAGE).values, 12.34)


def test_a_rangefinder_tells_the_height() -> None:
    found = of(log(rows(RFND, 40, 10.0, Dist=250, Orient=25)), Sensor.HEIGHT)
    np.testing.assert_allclose(found.values, 2.5)
    assert found.unit == "m"


def test_the_first_barometer_tells_pressure_and_temperature() -> None:
    found = of(log(rows(BARO, 40, 10.0, I=np.arange(40) % 2, Press=94500.0, Temp=2970)), Sensor.AIR)
    np.testing.assert_allclose(found.values, np.tile([94500.0, 29.7], (20, 1)), rtol=1e-3)
    assert found.unit == "Pa degC"


def test_each_core_of_the_estimator_has_its_own_trajectory() -> None:
    count = 80
    core = np.arange(count) % 2
    found = log(
        rows(XKF1, count, 20.0, C=core, VN=1.0 + core, VE=2.0, VD=-0.5, PN=10.0, PE=20.0, PD=-30.0 - core),
        rows(XKQ, count, 20.0, C=core, Q1=0.6, Q4=np.where(core == 1, -0.8, 0.8)),
    )
    for k in (0, 1):
        velocity, place = of(found, Sensor.VELOCITY, k), of(found, Sensor.PLACE, k)
        assert len(velocity) == len(place) == count // 2
        np.testing.assert_allclose(velocity.values, np.tile([1.0 + k, 2.0, -0.5], (40, 1)))
        np.testing.assert_allclose(place.values[:, 2], -30.0 - k)
        q = of(found, Sensor.ATTITUDE, k)
        np.testing.assert_allclose(np.linalg.norm(q.values, axis=1), 1.0)
        np.testing.assert_allclose(np.abs(q.values), np.tile([0.6, 0.0, 0.0, 0.8], (40, 1)), atol=1e-6)
    assert velocity.source == "XKF1"


def test_an_old_estimator_has_one_core() -> None:
    found = log(rows(EKF1, 40, 10.0, VN=3.0, PD=-7.0))
    np.testing.assert_allclose(of(found, Sensor.VELOCITY).values, np.tile([3.0, 0.0, 0.0], (40, 1)))
    np.testing.assert_allclose(of(found, Sensor.PLACE).values[:, 2], -7.0)


def test_the_sensors_stay_where_they_were() -> None:
    """Nothing of this is a channel: calibrations do not see it."""
    found = log(rows(XKF1, 40, 10.0, VN=1.0), rows(MOTB, 40, 10.0, LiftMax=1.0))
    assert not {c.source for c in found.channels} & {"XKF1", "XKQ", "MOTB", "RATE"}
    assert {c.sensor for c in log().dynamics} == {Sensor.CONTROL, Sensor.VOLTAGE}
    assert FMT.type == 128
