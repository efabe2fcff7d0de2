from __future__ import annotations

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib import logs
from mavcal.calib.errors import UnreadableError
from mavcal.calib.firmware.in_force.undo import undo
from mavcal.calib.logs.dataflash import read_dataflash, read_dataflash_text
from mavcal.calib.recording import Oddity, OddSamples, Recording, Rounding, Sensor, Stage
from tests.examples import examples
from tests.unit.logs import dataflash_file as made

FLIGHT = made.flight(2.0, seed=1)
HEAD = made.head()
BODY = FLIGHT[len(HEAD) :]
ISBH = made.Message(91, "ISBH", "QHBBHHQf", "TimeUS,N,type,instance,mul,smp_cnt,SampleUS,smp_rate")
ISBD = made.Message(92, "ISBD", "QHHaaa", "TimeUS,N,seqno,x,y,z")
SIM = made.Message(93, "SIM", "QccCfLLffff", "TimeUS,Roll,Pitch,Yaw,Alt,Lat,Lng,Q1,Q2,Q3,Q4")
SIM2 = made.Message(94, "SIM2", "Qdddfff", "TimeUS,PN,PE,PD,VN,VE,VD")
CTUN = made.Message(95, "CTUN", "Qfff", "TimeUS,ThI,ABst,ThO")
RCOU = made.Message(96, "RCOU", "QHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6")
ESC = made.Message(97, "ESC", "QBf", "TimeUS,Instance,RPM")
ARM = made.Message(98, "ARM", "QB", "TimeUS,ArmState")
VIBE = made.Message(99, "VIBE", "QBfffI", "TimeUS,IMU,VibeX,VibeY,VibeZ,Clip")
VER = made.Message(100, "VER", "QBBB", "TimeUS,Maj,Min,Pat")
EV = made.Message(102, "EV", "QB", "TimeUS,Id")
CURR = made.Message(103, "CURR", "Qff", "TimeUS,Volt,Curr")
DSF = made.Message(101, "DSF", "QI", "TimeUS,Dp")


def with_rows(*parts: tuple[made.Message, dict]) -> bytes:
    """The flight and other messages behind it."""
    extra = b"".join(m.definition() + m.rows(len(v["TimeUS"]), **v).tobytes() for m, v in parts)
    return FLIGHT + extra


def kinds(recording: Recording, kind: str) -> list[str]:
    return [event.text for event in recording.events if event.kind == kind]


def times(*seconds: float) -> list[int]:
    return [round(1e6 * s) for s in seconds]


class TestSensors:
    recording = read_dataflash(FLIGHT)

    def test_every_instance_at_its_own_rate(self):
        assert self.recording.instances(Sensor.ACCEL) == (0, 1)
        accel = self.recording.channel(Sensor.ACCEL, 1)
        assert (accel.source, accel.unit, accel.stage, len(accel)) == ("IMU", "m/s2", Stage.FILTERED, 800)
        assert accel.t[0] == 5.0
        assert np.diff(accel.t) == pytest.approx(0.0025)
        assert accel.values.mean(axis=0) == pytest.approx([0.0, 0.0, -9.8], abs=0.05)
        assert self.recording.channel(Sensor.TEMPERATURE).values[0, 0] == 40.0

    def test_a_field_is_truncated_whole_milligauss(self):
        field = self.recording.channel(Sensor.MAG)
        assert (field.unit, field.quantum, field.rounding) == ("uT", 0.1, Rounding.TOWARD_ZERO)
        assert field.stage == Stage.CORRECTED
        assert field.values[0, 2] % 0.1 == pytest.approx(0.05)
        assert field.t[0] == pytest.approx(5.099)

    def test_whose_it_is_and_when(self):
        assert self.recording.identity.autopilot == "ardupilot"
        assert self.recording.identity.firmware == (4, 5, 7)
        assert kinds(self.recording, "utc") == ["2024-02-03T23:59:47+00:00"]
        assert self.recording.parameters.end_observed
        assert self.recording.parameters.final()["INS_ACCSCAL_X"] == 1.0

    def test_a_compass_that_was_not_read_anew_is_not_a_sample(self):
        rows = made.MAG.rows(3, TimeUS=times(8, 8.1, 8.2), S=times(7.99, 7.99, 8.19), MagX=220, Health=1)
        field = read_dataflash(HEAD + rows.tobytes()).channel(Sensor.MAG)
        assert field.t.tolist() == pytest.approx([7.99, 8.19])

    def test_the_time_of_the_read_wraps_every_71_minutes(self):
        t = 2**32 + 500
        stamps = [t - 100_000, t]
        rows = made.MAG.rows(2, TimeUS=stamps, S=[(at - 2000) % 2**32 for at in stamps], MagX=220, Health=1)
        assert read_dataflash(HEAD + rows.tobytes()).channel(Sensor.MAG).t[1] == pytest.approx((t - 2000) * 1e-6)

    @pytest.mark.long
    def test_what_the_vehicle_distrusts_and_what_cannot_be_is_left_out_and_counted(self):
        bad = made.IMU.rows(2, TimeUS=times(8, 8.1), AccX=[1, 3e38], AccZ=-9, GyrX=[np.nan, 1], AH=[0, 1], GH=1)
        recording = read_dataflash(FLIGHT + bad.tobytes())
        assert len(recording.channel(Sensor.ACCEL)) == 800
        assert len(recording.channel(Sensor.GYRO)) == 801
        assert set(kinds(recording, "damage")) == {
            "gyro 1: 1 of 802 samples of IMU are no numbers that such a sensor can read; left out",
            "accel 1: 1 of 802 samples of IMU are no numbers that such a sensor can read; left out",
            "accel 1: 1 of 802 samples of IMU the vehicle itself calls unhealthy; left out",
        }

    def test_names_of_older_firmwares(self):
        imu2 = made.Message(110, "IMU2", "IffffffIIf", "TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,ErrG,ErrA,Temp")
        mag3 = made.Message(111, "MAG3", "Ihhhhhhhhh", "TimeMS,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOfsX,MOfsY,MOfsZ")
        data = HEAD + imu2.definition() + mag3.definition()
        data += imu2.rows(2, TimeMS=[9000, 9020], AccZ=-9.7, Temp=31.5).tobytes()
        data += mag3.rows(1, TimeMS=9030, MagX=-3).tobytes()
        recording = read_dataflash(data)
        assert recording.channel(Sensor.ACCEL, 1).t.tolist() == [9.0, 9.02]
        assert recording.channel(Sensor.TEMPERATURE, 1).values[0, 0] == 31.5
        assert recording.channel(Sensor.MAG, 2).values[0].tolist() == pytest.approx([-0.35, 0.0, 0.0])


SAMPLED = made.Message(112, "MAG", "QBhhhhhhhhhBI", "TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOX,MOY,MOZ,Health,S")
SAMPLED_WIDE = made.Message(112, "MAG", "QBhhhhhhhhhBQ", SAMPLED.columns)
TURN_US = 2**32


class TestSampleTimes:
    """``S`` is when the compass was read: in 64 bits, or in the 32 that wrap every 71 minutes."""

    @pytest.mark.parametrize("message", [SAMPLED, SAMPLED_WIDE])
    @pytest.mark.parametrize("written_us", [9_000_000, TURN_US - 40, TURN_US, TURN_US + 500, 3 * TURN_US + 7])
    @pytest.mark.parametrize(
        ("late_us", "believed"),
        [
            (0, True),
            (4000, True),
            (-30, True),
            (999_999, True),
            (-999_999, True),
            (1_000_000, False),
            (5_000_000, False),
        ],
    )
    def test_a_sample_has_the_time_at_which_it_was_read(self, message, written_us, late_us, believed):
        read = written_us - late_us
        rows = message.rows(3, TimeUS=written_us + np.arange(3) * 100_000, MagX=100, Health=1, I=0, S=0)
        said = read + np.arange(3) * 100_000
        rows["S"] = said % TURN_US if message is SAMPLED else said
        data = HEAD + message.definition() + rows.tobytes()
        t = read_dataflash(data).channel(Sensor.MAG, 0).t
        first = 1e-6 * (read if believed else written_us)
        assert t == pytest.approx(first + 0.1 * np.arange(3), abs=1e-6)


class TestBatches:
    def recording(self, option: float) -> Recording:
        data = made.head({**made.PARAMETERS, "INS_LOG_BAT_OPT": option})
        data += ISBH.definition() + ISBD.definition()
        for number, start in ((65535, 10.0), (0, 12.0)):
            data += ISBH.rows(
                1,
                TimeUS=times(start),
                N=number,
                type=0,
                instance=1,
                mul=100,
                smp_cnt=48,
                SampleUS=times(start),
                smp_rate=1000.0,
            ).tobytes()
            for part in range(2):
                counts = np.arange(32) + 32 * part
                data += ISBD.rows(1, N=number, seqno=part, x=counts, y=-counts, z=-981).tobytes()
        return read_dataflash(data + made.IMU.rows(1, TimeUS=times(9.0), AccZ=-9.8, AH=1).tobytes())

    def test_samples_get_their_own_times_and_bins(self):
        batch = next(c for c in self.recording(1).find(Sensor.ACCEL, 1) if c.source == "ISBD")
        assert len(batch) == 96
        assert batch.t[:2] == pytest.approx([10.0, 10.001])
        assert batch.t[48] == pytest.approx(12.0)
        assert batch.values[47].tolist() == pytest.approx([0.475, -0.475, -9.815])
        assert batch.zero_bin[0].tolist() == [True, True, False]
        assert batch.quantum == pytest.approx(0.01)

    @pytest.mark.parametrize(("option", "stage"), [(0, Stage.CORRECTED), (1, Stage.RAW), (2, Stage.FILTERED)])
    def test_what_they_are_is_the_vehicle_s_choice(self, option, stage):
        assert next(c for c in self.recording(option).channels if c.source == "ISBD").stage == stage


class TestState:
    def test_attitude_place_and_velocity(self):
        recording = read_dataflash(FLIGHT)
        q = recording.channel(Sensor.ATTITUDE).values[10]
        assert 2 * np.arctan2(q[3], q[0]) == pytest.approx(0.2, abs=1e-3)
        assert recording.channel(Sensor.POSITION).values[0].tolist() == pytest.approx([-35.363261, 149.16523, 584.0])
        moving = made.GPS.rows(1, TimeUS=times(9), Status=3, GCrs=90.0, Spd=4.0, VZ=-1.0, Lat=1, Lng=1)
        east = read_dataflash(FLIGHT + moving.tobytes()).channel(Sensor.VELOCITY)
        assert east.values[-1].tolist() == pytest.approx([0.0, 4.0, -1.0], abs=1e-6)

    def test_a_receiver_that_never_had_a_fix(self):
        blind = made.GPS.rows(3, TimeUS=times(6, 6.2, 6.4), Status=1, Lat=5, Lng=5).tobytes()
        still = made.IMU.rows(2, TimeUS=times(6, 6.5), AccZ=-9.8, AH=1, GH=1).tobytes()
        assert read_dataflash(HEAD + still + blind).instances(Sensor.POSITION) == ()

    def test_current_throttle_motors_and_rotors(self):
        data = with_rows(
            (CTUN, {"TimeUS": times(6, 6.1), "ThO": [0.25, 0.5]}),
            (RCOU, {"TimeUS": times(6, 6.1), "C1": 1500, "C2": 1800, "C3": [1100, 900], "C5": 1333}),
            (ESC, {"TimeUS": times(6, 6.01, 6.1, 6.11), "Instance": [0, 1, 0, 1], "RPM": [600, 1200, 660, 1260]}),
        )
        names = {"SERVO1_FUNCTION": 34.0, "SERVO2_FUNCTION": 33.0, "SERVO3_FUNCTION": 35.0, "SERVO5_FUNCTION": 51.0}
        settings_ = {**made.PARAMETERS, **names, "MOT_PWM_MIN": 1000.0, "MOT_PWM_MAX": 2000.0}
        recording = read_dataflash(made.head(settings_) + data[len(HEAD) :])
        assert recording.channel(Sensor.THROTTLE).values[:, 0].tolist() == [0.25, 0.5]
        assert recording.channel(Sensor.MOTOR).values.tolist() == [[0.8, 0.5, 0.1], [0.8, 0.5, 0.0]]
        assert recording.channel(Sensor.ROTOR_SPEED).values.tolist() == [[10.0, 20.0], [11.0, 20.0]]
        assert recording.channel(Sensor.CURRENT).values.mean() == pytest.approx(15.0, abs=2.0)

    @pytest.mark.parametrize("functions", [(73, 74), (70,)], ids=["a boat of two throttles", "a plane of one"])
    def test_without_motor_outputs_the_throttles_drive(self, functions):
        """SERVOn_FUNCTION is an SRV_Channel function: 70 throttle, 73 and 74 the left and the right one."""
        outputs = {f"C{k}": 1000 + 200 * k for k in range(1, 7)}
        data = with_rows((RCOU, {"TimeUS": times(6, 6.1), **outputs}))
        names = {f"SERVO{k}_FUNCTION": 26.0 for k in (1, 2, 4, 6)}  # ground steering, say: k_steering
        names |= {f"SERVO{n}_FUNCTION": float(f) for n, f in zip((3, 5), functions, strict=False)}
        recording = read_dataflash(made.head({**made.PARAMETERS, **names}) + data[len(HEAD) :])
        assert recording.channel(Sensor.MOTOR).values[0].tolist() == [0.6, 1.0][: len(functions)]

    def test_a_simulator_s_truth_is_the_reference(self):
        data = with_rows(
            (SIM, {"TimeUS": times(6), "Q1": 1.0, "Lat": 10_000_000, "Alt": 5.0}),
            (SIM2, {"TimeUS": times(6), "PN": 1.5, "VD": -2.0}),
        )
        reference = {c.sensor: c.values[0].tolist() for c in read_dataflash(data).reference}
        assert reference[Sensor.ATTITUDE] == [1.0, 0.0, 0.0, 0.0]
        assert reference[Sensor.PLACE] == [1.5, 0.0, 0.0]
        assert reference[Sensor.VELOCITY] == [0.0, 0.0, -2.0]
        assert reference[Sensor.POSITION] == [1.0, 0.0, 5.0]

    def test_what_was_said_and_counted(self):
        data = with_rows(
            (ARM, {"TimeUS": times(6, 7), "ArmState": [1, 0]}),
            (VIBE, {"TimeUS": times(6, 6.5, 7), "IMU": 1, "Clip": [3, 3, 9]}),
            (DSF, {"TimeUS": times(6, 7), "Dp": [0, 12]}),
            (VER, {"TimeUS": times(6), "Maj": 4, "Min": 6, "Pat": 1}),
            (made.MSG, {"TimeUS": times(6), "Message": b"fmuv3 002E0024 30345119 36393438"}),
        )
        recording = read_dataflash(data)
        assert [e.t for e in recording.events if e.kind in ("armed", "disarmed")] == [6.0, 7.0]
        assert kinds(recording, "clipping") == ["accelerometer 2 clipped 6 times"]
        assert [e.odd for e in recording.events if e.kind == "clipping"] == [
            OddSamples(Oddity.CLIPPED, Sensor.ACCEL, 1, 6, until=7.0)
        ]
        assert kinds(recording, "drop") == ["the vehicle could not write 12 messages of this log"]
        assert recording.identity.firmware == (4, 6, 1)
        assert recording.identity.uid == "24002e001951343038343936"

    def test_a_log_without_arm_messages_is_armed_by_its_events(self):
        data = with_rows((EV, {"TimeUS": times(6, 6.5, 7, 8), "Id": [10, 62, 11, 10]}))
        told = [(e.t, e.kind) for e in read_dataflash(data).events if e.kind in ("armed", "disarmed")]
        assert told == [(6.0, "armed"), (7.0, "disarmed"), (8.0, "armed")]

    def test_one_battery_that_is_logged_twice_is_one_current(self):
        recording = read_dataflash(with_rows((CURR, {"TimeUS": times(5.0, 5.1), "Curr": 99.0})))
        assert [c.instance for c in recording.channels if c.sensor == Sensor.CURRENT] == [0]
        assert recording.channel(Sensor.CURRENT).values.max() < 50.0


class TestParameters:
    def test_a_change_in_flight_is_undone_from_its_own_time_on(self):
        change = made.PARM.rows(1, TimeUS=times(7.0), Name=b"INS_ACCOFFS_X", Value=0.5).tobytes()
        later = made.flight(2.0, seed=2, start_us=7_000_000)[len(HEAD) :]
        streamed = read_dataflash(FLIGHT + change + later)
        raw = undo(streamed).channel(Sensor.ACCEL)
        assert raw.stage == Stage.RAW
        before, after = raw.between(5.0, 6.4), raw.between(7.2, 9.0)
        assert before.values[0].tolist() == streamed.channel(Sensor.ACCEL).values[0].tolist()
        held = streamed.channel(Sensor.ACCEL).between(7.2, 9.0)
        assert (after.values - held.values).mean(axis=0).tolist() == pytest.approx([0.5, 0.0, 0.0])

    def test_without_parameters_nothing_is_undone_and_it_is_said(self):
        recording = undo(read_dataflash(made.head({}) + BODY))
        assert recording.channel(Sensor.ACCEL).stage == Stage.FILTERED
        assert any("stays as streamed" in text for text in kinds(recording, "undo"))

    def test_the_motor_compensation_in_force_is_undone(self):
        given_ = {**made.PARAMETERS, "COMPASS_MOTCT": 2.0, "COMPASS_MOT_X": 4.0}
        current = made.BAT.rows(1, TimeUS=times(5.0), Curr=10.0).tobytes()
        row = made.MAG.rows(1, TimeUS=times(5.1), S=times(5.1), MagX=240, MagY=3, MOX=40, Health=1).tobytes()
        raw = undo(read_dataflash(made.head(given_) + current + row)).channel(Sensor.MAG)
        assert raw.values[0].tolist() == pytest.approx([20.05, 0.35, 0.0])

    @pytest.mark.parametrize("value", [np.nan, np.inf, 1e20])
    def test_a_corrupt_motor_compensation_is_named(self, value):
        recording = read_dataflash(made.head({**made.PARAMETERS, "COMPASS_MOTCT": 1.0, "COMPASS_MOT_Y": value}) + BODY)
        assert "COMPASS_MOT_Y is" in kinds(recording, "undo")[0]
        undone = undo(recording)
        assert undone.channel(Sensor.MAG).stage == Stage.CORRECTED
        assert any("mag 1 of MAG stays as streamed: COMPASS_MOT_Y" in text for text in kinds(undone, "undo"))
        assert np.isfinite(undone.channel(Sensor.MAG).values).all()

    def test_a_field_that_collapsed_is_said(self):
        rows = made.MAG.rows(
            10, TimeUS=times(*range(8, 18)), S=times(*range(8, 18)), MagX=[200] * 6 + [0] * 4, Health=1
        )
        recording = read_dataflash(HEAD + rows.tobytes())
        assert len(recording.channel(Sensor.MAG)) == 6
        assert kinds(recording, "damage") == [
            "mag 1: 4 of 10 samples of MAG are exactly 0, 0, 0, which such a sensor never reads; left out"
        ]
        (odd,) = [event.odd for event in recording.events if event.kind == "damage"]
        assert odd == OddSamples(Oddity.ZERO, Sensor.MAG, 0, 4, 10, until=17.0)

    def test_a_compass_of_zeros_alone_is_dead_by_its_numbers(self):
        rows = made.MAG.rows(10, TimeUS=times(*range(8, 18)), S=times(*range(8, 18)), MagX=0, Health=1)
        moving = made.IMU.rows(10, TimeUS=times(*range(8, 18)), AccZ=-9.8, GyrX=0.1 * np.arange(10))
        recording = read_dataflash(HEAD + rows.tobytes() + moving.tobytes())
        (dead,) = [event for event in recording.events if event.kind == "dead"]
        assert (dead.t, dead.odd) == (8.0, OddSamples(Oddity.ZERO, Sensor.MAG, 0, 10, 10, until=17.0))

    def test_levels_of_vibration_belong_to_their_unit(self):
        levels = {"TimeUS": times(6, 6, 7, 7), "IMU": [0, 1, 0, 1], "VibeX": [1, 2, 3, 4], "VibeZ": [5, 6, 7, 8]}
        recording = read_dataflash(with_rows((VIBE, levels)))
        found = {c.instance: c.values.tolist() for c in recording.channels if c.sensor == Sensor.VIBRATION}
        assert found == {0: [[1.0, 0.0, 5.0], [3.0, 0.0, 7.0]], 1: [[2.0, 0.0, 6.0], [4.0, 0.0, 8.0]]}

    def test_offsets_that_the_vehicle_learnt_are_undone_too(self):
        t = times(*(5 + 0.1 * k for k in range(20)))
        rows = made.MAG.rows(20, TimeUS=t, S=t, MagX=300, OfsX=[0] * 10 + [60] * 10, Health=1)
        recording = read_dataflash(HEAD + rows.tobytes())
        assert [(e.name, e.value) for e in recording.parameters.changes(("COMPASS_OFS",))] == [("COMPASS_OFS_X", 60.0)]
        assert any("learnt on the way" in text for text in kinds(recording, "text"))
        raw = undo(recording).channel(Sensor.MAG)
        assert raw.values[0, 0] == pytest.approx(30.05)
        assert raw.values[-1, 0] == pytest.approx(24.05)

    def test_damage_in_the_middle_leaves_the_end_unobserved(self):
        at = len(HEAD) + 54 * 7
        assert not read_dataflash(FLIGHT[:at] + bytes(54) + FLIGHT[at + 54 :]).parameters.end_observed
        assert read_dataflash(FLIGHT[:-10]).parameters.end_observed


class TestTime:
    @pytest.mark.parametrize("wrong", [2**50, 0, 5_000_000])
    def test_a_damaged_stamp_costs_its_own_sample(self, wrong):
        rows = made.IMU.rows(200, TimeUS=times(*(10 + 0.01 * np.arange(200))), AccZ=-9.8, AH=1, GH=1)
        rows["TimeUS"][77] = wrong
        recording = read_dataflash(HEAD + rows.tobytes())
        accel = recording.channel(Sensor.ACCEL)
        assert len(accel) == 199
        assert (accel.t[0], accel.t[-1]) == (10.0, pytest.approx(11.99))
        assert "1 messages say a time" in kinds(recording, "damage")[0]

    def test_a_small_step_costs_its_own_sample(self):
        rows = made.IMU.rows(200, TimeUS=times(*(10 + 0.01 * np.arange(200))), AccZ=-9.8, AH=1, GH=1)
        rows["TimeUS"][77] += 65_536
        assert len(read_dataflash(HEAD + rows.tobytes()).channel(Sensor.ACCEL)) == 199

    def test_a_clock_that_starts_again_goes_on(self):
        recording = read_dataflash(FLIGHT + BODY)
        accel, field = recording.channel(Sensor.ACCEL), recording.channel(Sensor.MAG)
        assert len(accel) == 1600
        assert len(field) == 40
        assert (np.diff(accel.t) > 0).all()
        assert len(kinds(recording, "reboot")) == 1
        assert accel.t[800] - accel.t[799] == pytest.approx(0.5)
        assert field.t[20] - accel.t[800] == pytest.approx(0.099)


class TestText:
    def read(self, tmp_path, body: str) -> Recording:
        path = tmp_path / "a.log"
        path.write_text(
            "\nArduCopter V3.1.1 (681dafcf)\nFMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format\n"
            "FMT, 129, 23, PARM, Nf, Name,Value\nFMT, 132, 67, MSG, Z, Message\n"
            "FMT, 131, 31, IMU, Iffffff, TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ\n"
            "FMT, 15, 25, MAG, Ihhh, TimeMS,MagX,MagY,MagZ\nFMT, 3, 6, MODE, Mh, Mode,ThrCrs\n" + body
        )
        return logs.read(path)

    def test_lines_are_messages(self, tmp_path):
        recording = self.read(
            tmp_path,
            "MSG, ArduCopter V3.1.1, and more\nPARM, INS_ACCOFFS_X, 0.25\nPARM, COMPASS_MOT_X, NaN\n"
            "IMU, 1000, 0.1, 0.2, 0.3, 1, 2, -9.5\nMODE, Stabilize, 500\nIMU, 1020, 0.1, 0.2, 0.3, 1, 2, -9.5\n"
            "MAG, 1010, -5, 0, 40\nIMU, 1040, 0.1, 0.2, broken, 1, 2\nnonsense\nNONE, 1, 2\n",
        )
        assert recording.channel(Sensor.ACCEL).values.tolist() == [[1.0, 2.0, -9.5]] * 2
        assert recording.channel(Sensor.MAG).values[0].tolist() == pytest.approx([-0.55, 0.0, 4.05])
        assert recording.parameters.final()["INS_ACCOFFS_X"] == 0.25
        assert recording.identity.firmware == (3, 1, 1)
        assert "ArduCopter V3.1.1, and more" in kinds(recording, "text")
        assert "mode Stabilize" in kinds(recording, "text")
        assert kinds(recording, "damage") == ["2 of 18 lines of a.log are no intact messages and were left out"]
        assert any("COMPASS_MOT_X is nan" in text for text in kinds(recording, "undo"))

    def test_a_firmware_older_than_soft_iron_has_none(self, tmp_path):
        names = {n: v for n, v in made.PARAMETERS.items() if "DIA" not in n and "ODI" not in n}
        recording = self.read(
            tmp_path,
            "MSG, ArduCopter V3.1.1\n"
            + "".join(f"PARM, {n}, {v}\n" for n, v in names.items())
            + "MAG, 10, -5, 0, 40\n",
        )
        assert undo(recording).channel(Sensor.MAG).stage == Stage.RAW

    def test_a_log_without_definitions(self, tmp_path):
        path = tmp_path / "a.log"
        path.write_text("ATT, 1, 2\n")
        with pytest.raises(UnreadableError, match="no line begins with FMT"):
            read_dataflash_text(path)
        with pytest.raises(UnreadableError, match="cannot be opened"):
            read_dataflash_text(tmp_path / "none.log")


class TestBadInput:
    def test_a_log_with_nothing_to_calibrate(self, tmp_path):
        with pytest.raises(UnreadableError, match="without a single sample"):
            read_dataflash(HEAD)
        path = tmp_path / "wrong.csv"
        path.write_bytes(FLIGHT)
        assert len(logs.read(path).channel(Sensor.ACCEL)) == 800
        with pytest.raises(ValueError, match="leave mapping out"):
            logs.read(path, mapping={"accel_x": "1"})

    @settings(max_examples=examples(80))
    @given(st.data())
    def test_mutations_give_a_recording_or_one_clear_refusal(self, data):
        content = bytearray(SMALL)
        for _ in range(data.draw(st.integers(1, 12))):
            at = data.draw(st.integers(0, len(content) - 1))
            if data.draw(st.booleans()):
                content[at] = data.draw(st.integers(0, 255))
            else:
                content[at : at + data.draw(st.integers(0, 300))] = data.draw(st.binary(max_size=100))
        try:
            recording = read_dataflash(bytes(content))
        except UnreadableError:
            return
        for channel in (*recording.channels, *recording.reference):
            assert np.isfinite(channel.values).all()
            assert (np.diff(channel.t) >= 0).all()
        undo(recording)

    @pytest.mark.sampled
    @pytest.mark.parametrize("name", sorted({c for m in made.MESSAGES for c in m.columns.split(",")}, key=str))
    def test_a_column_whose_name_is_damaged_is_missed_or_refused(self, name):
        damaged = SMALL.replace(f",{name}".encode(), b"," + b"x" * len(name))
        with contextlib.suppress(UnreadableError):  # anything else is not
            read_dataflash(damaged)

    @settings(max_examples=examples(60))
    @given(st.data())
    def test_definitions_may_say_anything(self, data):
        name = data.draw(
            st.sampled_from(["IMU", "MAG", "PARM", "GPS", "ATT", "BAT", "MSG", "ISBH", "SIM", "ESC", "VIBE"])
        )
        source = next((m for m in (*made.MESSAGES, ISBH, SIM, ESC, VIBE) if m.name == name), made.IMU)
        columns = source.columns.split(",")
        letters = "".join(data.draw(st.sampled_from("abBghHiIfdnNZcCeELMqQ")) for _ in columns)
        odd = made.Message(200, name, letters, source.columns)
        if odd.dtype.itemsize > 255:
            return
        rows = data.draw(st.binary(min_size=0, max_size=600))
        size = odd.dtype.itemsize - 3
        bodies = [rows[k : k + size].ljust(size, b"\0") for k in range(0, len(rows), size)]
        content = odd.definition() + b"".join(bytes([0xA3, 0x95, 200]) + body for body in bodies)
        try:
            undo(read_dataflash(content + SMALL))
        except UnreadableError:
            return

    @pytest.mark.shared
    @pytest.mark.parametrize("name", ["sitl_flights/null.bin", "df_log171_triple_imu_mag/log171.bin"])
    def test_mutations_of_real_logs(self, shared_data, name):
        content = (shared_data / name).read_bytes()[:400_000]
        for seed in range(6):
            bad = made.cut(made.flipped(content, 40 * 4**seed, seed)[0], 10, 300, seed)[0]
            try:
                recording = undo(read_dataflash(bad))
            except UnreadableError:
                continue
            assert all(np.isfinite(c.values).all() and (np.diff(c.t) >= 0).all() for c in recording.channels)

    @pytest.mark.shared
    def test_mutations_of_a_real_text_log(self, shared_data, tmp_path):
        content = (shared_data / "df_loganalyzer_examples/nan.log").read_bytes()
        for seed in range(6):
            path = tmp_path / f"{seed}.log"
            path.write_bytes(made.flipped(content, 40 * 4**seed, seed)[0])
            try:
                recording = undo(read_dataflash_text(path))
            except UnreadableError:
                continue
            assert all(np.isfinite(c.values).all() and (np.diff(c.t) >= 0).all() for c in recording.channels)


SMALL = (
    made.flight(0.3, seed=6)
    + b"".join(m.definition() for m in (CTUN, RCOU, ESC, ARM, VIBE, SIM, SIM2, ISBH, ISBD))
    + b"".join(m.rows(2, TimeUS=times(5.1, 5.2)).tobytes() for m in (CTUN, RCOU, ESC, ARM, VIBE, SIM, SIM2, ISBH, ISBD))
)
