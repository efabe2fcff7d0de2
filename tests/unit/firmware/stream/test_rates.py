from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.stream.assembler import WRAP_S, Assembler, VehicleClock
from mavcal.calib.firmware.stream.rates import live_streams, requested_streams
from mavcal.calib.recording import Channel, Event, Identity, Recording, Rounding, Sensor, Stage, join
from mavcal.calib.wire.codec import RawMessage, encode
from mavcal.calib.wire.frames import Frame, FrameParser
from tests.examples import examples

ARDUPILOT = Identity(autopilot="ardupilot", system=1, component=1)
PX4 = Identity(autopilot="px4", system=1, component=1)


Row = tuple[int | None, Frame]
Ints = tuple[int, int, int]
Floats = tuple[float, float, float]


def frame(message: Any, system: int = 1, component: int = 1) -> Row:
    return None, FrameParser().feed(encode(message, system, component, 0))[0]


def raw_imu(
    t: float, accel: Ints = (0, 0, -1000), gyro: Ints = (0, 0, 0), mag: Ints = (200, 0, 400), temperature: int = 2500
) -> Row:
    return frame(dialect.MAVLink_raw_imu_message(round(t * 1e6), *accel, *gyro, *mag, 0, temperature))


def scaled(
    t: float,
    accel: Ints = (0, 0, -1000),
    gyro: Ints = (0, 0, 0),
    mag: Ints = (200, 0, 400),
    temperature: int = 2500,
    *,
    unit: int = 0,
) -> Row:
    cls = (dialect.MAVLink_scaled_imu_message, dialect.MAVLink_scaled_imu2_message, dialect.MAVLink_scaled_imu3_message)
    return frame(cls[unit](round(t * 1e3) % 2**32, *accel, *gyro, *mag, temperature))


def highres(
    t: float, accel: Floats = (0.0, 0.0, -9.8), mag: Floats = (0.2, 0.0, 0.4), updated: int = 8191, unit: int = 0
) -> Row:
    message = dialect.MAVLink_highres_imu_message(
        round(t * 1e6), *accel, 0.0, 0.0, 0.0, *mag, 950.0, 0.0, 500.0, 27.3, updated, unit
    )
    return frame(message)


def parameter(name: str, bits: bytes, kind: int) -> Row:
    return frame(RawMessage(22, struct.pack("<4sHH16sB", bits, 900, 1, name.encode(), kind)))


def real(name: str, value: float, kind: int = dialect.MAV_PARAM_TYPE_REAL32) -> Row:
    return parameter(name, struct.pack("<f", value), kind)


def one(recording: Recording, sensor: Sensor, source: str, instance: int = 0) -> Channel:
    (found,) = [c for c in recording.find(sensor, instance) if c.source == source]
    return found


def kinds(recording: Recording) -> list[str]:
    return [event.kind for event in recording.events]


class TestQuantities:
    def test_truncated_numbers_become_the_middle_of_their_bin(self) -> None:
        row = raw_imu(1.0, (0, 31, -970), (13, 0, -8), (122, 0, -563), 2580)
        recording = Assembler(ARDUPILOT).feed([row])
        accel = one(recording, Sensor.ACCEL, "RAW_IMU")
        assert accel.values[0] == pytest.approx([0.0, 31.5e-3 * STANDARD_GRAVITY, -970.5e-3 * STANDARD_GRAVITY])
        assert accel.zero_bin is not None
        assert accel.zero_bin.tolist() == [[True, False, False]]
        assert (accel.quantum, accel.rounding, accel.unit) == (STANDARD_GRAVITY / 1000, Rounding.TOWARD_ZERO, "m/s2")
        assert one(recording, Sensor.GYRO, "RAW_IMU").values[0] == pytest.approx([0.0135, 0.0, -0.0085])
        assert one(recording, Sensor.MAG, "RAW_IMU").values[0] == pytest.approx([12.25, 0.0, -56.35])
        assert one(recording, Sensor.TEMPERATURE, "RAW_IMU").values[0, 0] == pytest.approx(25.805)
        assert accel.t == pytest.approx([1.0])

    def test_stages_of_each_firmware(self) -> None:
        rows = [scaled(1.0), highres(1.0)]
        ours, theirs = Assembler(ARDUPILOT).feed(rows), Assembler(PX4).feed(rows)
        assert one(ours, Sensor.ACCEL, "SCALED_IMU").stage == Stage.FILTERED
        assert one(ours, Sensor.GYRO, "HIGHRES_IMU").stage == Stage.FILTERED
        assert one(ours, Sensor.MAG, "SCALED_IMU").stage == Stage.CORRECTED
        assert one(theirs, Sensor.ACCEL, "SCALED_IMU").stage == Stage.CORRECTED
        assert one(theirs, Sensor.MAG, "SCALED_IMU").stage == Stage.RAW
        assert {c.stage for c in theirs.channels if c.source == "HIGHRES_IMU"} == {Stage.DEBIASED}
        assert theirs.channel(Sensor.ACCEL).source == "SCALED_IMU"  # never the debiased one
        assert ours.channel(Sensor.ACCEL).source == "HIGHRES_IMU"  # the finer one

    def test_px4_has_no_raw_imu(self) -> None:
        assert not Assembler(PX4).feed([raw_imu(1.0)]).channels

    def test_px4_rounds_its_temperature(self) -> None:
        channel = one(Assembler(PX4).feed([scaled(1.0, temperature=1500)]), Sensor.TEMPERATURE, "SCALED_IMU")
        assert channel.values[0, 0] == pytest.approx(15.0)
        assert channel.zero_bin is None

    def test_instances(self) -> None:
        recording = Assembler(ARDUPILOT).feed([scaled(1.0, unit=1), scaled(1.0, unit=2), highres(1.0, unit=2)])
        assert recording.instances(Sensor.ACCEL) == (1, 2)
        assert one(recording, Sensor.GYRO, "HIGHRES_IMU", 2).instance == 2
        assert one(recording, Sensor.MAG, "HIGHRES_IMU", 0).instance == 0

    def test_highres_shows_the_first_compass_in_use(self) -> None:
        rows = [real("COMPASS_USE", 0, dialect.MAV_PARAM_TYPE_INT8), highres(1.0)]
        assert Assembler(ARDUPILOT).feed(rows).instances(Sensor.MAG) == (1,)
        assert Assembler(ARDUPILOT, {"COMPASS_USE": 0, "COMPASS_USE2": 0}).feed(rows[1:]).instances(Sensor.MAG) == (2,)

    def test_highres_field_defect_is_recognised_by_its_magnitude(self) -> None:
        rows = [highres(1.0, mag=(122789.453125, 125009.15625, -563302.1875)), highres(1.2, mag=(0.2, -0.1, 0.4))]
        field = one(Assembler(ARDUPILOT).feed(rows), Sensor.MAG, "HIGHRES_IMU")
        assert field.values[0] == pytest.approx([12.2789453125, 12.500915625, -56.33021875])
        assert field.values[1] == pytest.approx([20.0, -10.0, 40.0])

    def test_highres_temperature_is_the_barometers(self) -> None:
        assert not Assembler(ARDUPILOT).feed([highres(1.0)]).find(Sensor.TEMPERATURE)

    def test_px4_highres_flags_say_what_is_new(self) -> None:
        recording = Assembler(PX4).feed([highres(1.0), highres(1.02, updated=0b111111), highres(1.04)])
        assert len(one(recording, Sensor.ACCEL, "HIGHRES_IMU")) == 3
        assert one(recording, Sensor.MAG, "HIGHRES_IMU").t == pytest.approx([1.0, 1.04])

    def test_no_number_stays_a_sample(self) -> None:
        accel = one(Assembler(ARDUPILOT).feed([highres(1.0, accel=(np.nan, 0.0, 0.0))]), Sensor.ACCEL, "HIGHRES_IMU")
        assert np.isnan(accel.values[0, 0])


class TestAbsence:
    def test_an_absent_unit_is_no_channel_but_its_compass_is(self) -> None:
        row = scaled(1.0, (0, 0, 0), (0, 0, 0), (100, 200, 300), 0, unit=2)
        recording = Assembler(ARDUPILOT).feed([row])
        assert [(c.sensor, c.instance) for c in recording.channels] == [(Sensor.MAG, 2)]

    def test_a_good_gyroscope_at_rest_reads_three_zeros(self) -> None:
        assert len(one(Assembler(ARDUPILOT).feed([raw_imu(1.0)]), Sensor.GYRO, "RAW_IMU")) == 1

    def test_an_absent_compass_is_no_channel(self) -> None:
        assert Assembler(ARDUPILOT).feed([raw_imu(1.0, mag=(0, 0, 0))]).instances(Sensor.MAG) == ()

    def test_zero_temperature_means_none(self) -> None:
        rows = [raw_imu(1.0, temperature=0), raw_imu(1.1, temperature=-1)]
        channel = one(Assembler(ARDUPILOT).feed(rows), Sensor.TEMPERATURE, "RAW_IMU")
        assert channel.t == pytest.approx([1.1])
        assert channel.values[0, 0] == pytest.approx(-0.015)


class TestRepeats:
    def test_ardupilots_compass_is_read_ten_times_a_second(self) -> None:
        rows = [raw_imu(1 + 0.02 * k, mag=(200 + 3 * (k // 5), 10, 400)) for k in range(50)]
        field = one(Assembler(ARDUPILOT).feed(rows), Sensor.MAG, "RAW_IMU")
        assert np.diff(field.t) == pytest.approx([0.1] * 9)

    @pytest.mark.parametrize("step", [0.004, 0.008, 0.02])
    def test_px4s_field_is_new_fifty_times_a_second(self, step: float) -> None:
        times = np.arange(0.0, 1.0, step) + 1
        rows = [scaled(t, mag=(200 + int(t / 0.02 + 1e-6), 10, 400)) for t in times.tolist()]
        field = one(Assembler(PX4).feed(rows), Sensor.MAG, "SCALED_IMU")
        assert len(field) == 50

    def test_an_equal_value_after_its_time_is_a_new_sample(self) -> None:
        rows = [raw_imu(1 + 0.02 * k) for k in range(50)]
        field = one(Assembler(ARDUPILOT).feed(rows), Sensor.MAG, "RAW_IMU")
        assert 0.1 <= np.diff(field.t).max() <= 0.15  # neither fifty a second nor one for ever

    def test_px4_sends_an_old_unit_with_a_new_field(self) -> None:
        rows = [scaled(1.0, (5, 0, -1000), mag=(200, 0, 0)), scaled(1.0, (5, 0, -1000), mag=(201, 0, 0))]
        recording = Assembler(PX4).feed(rows)
        assert len(one(recording, Sensor.ACCEL, "SCALED_IMU")) == 1
        assert len(one(recording, Sensor.MAG, "SCALED_IMU")) == 2

    def test_a_duplicated_and_a_late_frame_are_left_out(self) -> None:
        rows = [raw_imu(1.0), raw_imu(1.0), raw_imu(1.04), raw_imu(1.02, (9, 9, 9)), raw_imu(1.06)]
        accel = one(Assembler(ARDUPILOT).feed(rows), Sensor.ACCEL, "RAW_IMU")
        assert accel.t == pytest.approx([1.0, 1.04, 1.06])
        assert accel.values[:, 0] == pytest.approx([0.0, 0.0, 0.0])


class TestClock:
    def test_milliseconds_wrap_after_seven_weeks(self) -> None:
        start = WRAP_S - 0.1
        assembler = Assembler(ARDUPILOT)
        recording = join(assembler.feed([scaled(start + 0.04 * k)]) for k in range(6))
        assert one(recording, Sensor.ACCEL, "SCALED_IMU").t == pytest.approx(start + 0.04 * np.arange(6), abs=1e-3)
        assert "reboot" not in kinds(recording)

    def test_a_small_number_is_no_wrap_of_a_young_clock(self) -> None:
        clock = VehicleClock()
        clock.read(np.array([100.0]))
        assert clock.unwrap_ms(np.array([5], dtype=np.uint32)) == pytest.approx([0.005])

    def test_a_reboot_is_an_event_and_time_goes_on(self) -> None:
        before = [raw_imu(100 + 0.02 * k) for k in range(5)]
        after = [raw_imu(2 + 0.02 * k) for k in range(6)]
        recording = Assembler(ARDUPILOT).feed(before + after)
        accel = one(recording, Sensor.ACCEL, "RAW_IMU")
        assert kinds(recording) == ["reboot"]
        assert (np.diff(accel.t) > 0).all()
        assert len(accel) == 5 + 4  # two were needed to tell a reboot from late frames

    def test_a_frame_that_was_held_up_is_no_reboot(self) -> None:
        rows = [raw_imu(100.0), raw_imu(100.02), raw_imu(97.0), raw_imu(100.04)]
        recording = Assembler(ARDUPILOT).feed(rows)
        assert "reboot" not in kinds(recording)
        assert len(one(recording, Sensor.ACCEL, "RAW_IMU")) == 3

    def test_a_pause_is_told(self) -> None:
        recording = Assembler(ARDUPILOT).feed([raw_imu(1.0), raw_imu(4.5)])
        (event,) = recording.events
        assert event.kind == "gap"
        assert "RAW_IMU" in event.text
        assert "3.5 s" in event.text

    @given(st.lists(st.floats(0, 1e6), max_size=60), st.integers(1, 7))
    @settings(max_examples=examples(60), deadline=None)
    def test_batches_do_not_matter(self, stamps: list[float], size: int) -> None:
        whole, pieces = VehicleClock(), VehicleClock()
        raw = np.array(stamps)
        times, reboots = whole.read(raw)
        parts = [pieces.read(raw[i : i + size]) for i in range(0, len(raw), size)]
        assert np.array_equal(times, np.concatenate([t for t, _ in parts] or [np.empty(0)]))
        found = [i * size + k for i, (_, own) in enumerate(parts) for k in own]
        assert list(reboots) == found
        assert whole.now == pieces.now


class TestParameters:
    def test_px4_integers_are_their_own_bytes(self) -> None:
        values = {"CAL_ACC3_ID": -1, "CAL_ACC2_ID": -8388000, "CAL_ACC1_ID": 16777217, "CAL_ACC0_ID": 1310988}
        rows = [parameter(n, struct.pack("<i", v), dialect.MAV_PARAM_TYPE_INT32) for n, v in values.items()]
        entries = Assembler(PX4).feed(rows).parameters.entries
        assert {e.name: e.value for e in entries} == values
        assert all(isinstance(e.value, int) for e in entries)

    def test_ardupilot_casts(self) -> None:
        rows = [real("COMPASS_DEV_ID", 97539.0, dialect.MAV_PARAM_TYPE_INT32), real("INS_ACCOFFS_X", 0.25)]
        assert Assembler(ARDUPILOT).feed(rows).parameters.final() == {"COMPASS_DEV_ID": 97539, "INS_ACCOFFS_X": 0.25}

    def test_a_name_of_sixteen_characters_and_the_hash(self) -> None:
        rows = [real("INS_ACC1_CALTEMP", 31.5), parameter("_HASH_CHECK", b"\1\2\3\4", dialect.MAV_PARAM_TYPE_UINT32)]
        assert Assembler(PX4).feed(rows).parameters.final() == {"INS_ACC1_CALTEMP": 31.5}

    def test_times_are_those_of_the_stream(self) -> None:
        rows = [real("A", 1.0), raw_imu(5.0), real("A", 2.0), raw_imu(5.02), real("A", 3.0)]
        entries = Assembler(ARDUPILOT).feed(rows).parameters.entries
        assert [e.t for e in entries] == [-np.inf, 5.0, 5.02]


class TestAnnouncements:
    def test_arming_and_calibrating_are_told_once(self) -> None:
        def heartbeat(mode: int, status: int) -> Row:
            return frame(dialect.MAVLink_heartbeat_message(2, 12, mode, 0, status, 3))

        rows = [heartbeat(29, 3), heartbeat(157, 4), heartbeat(157, 4), heartbeat(29, 2), heartbeat(29, 2)]
        recording = Assembler(PX4).feed(rows)
        assert kinds(recording) == ["armed", "disarmed", "onboard_calibration"]
        assert recording.identity.vehicle_type == 2

    def test_texts_in_chunks_are_put_together(self) -> None:
        text = "PreArm: " + "x" * 60 + " [cal]"
        rows = [
            frame(dialect.MAVLink_statustext_message(6, text[i : i + 50].encode(), 7, i // 50))
            for i in range(0, len(text), 50)
        ]
        rows.append(frame(dialect.MAVLink_statustext_message(6, b"short")))
        events = Assembler(ARDUPILOT).feed(rows).events
        assert events == (Event(0.0, "onboard_calibration", text), Event(0.0, "text", "short"))

    def test_px4s_report_of_its_compass_is_no_calibration(self) -> None:
        report = frame(dialect.MAVLink_mag_cal_report_message(0, 0, 4, 0, 0.0, *[0.0] * 9))
        assert not Assembler(PX4).feed([report]).events
        assert kinds(Assembler(ARDUPILOT).feed([report])) == ["onboard_calibration"]

    @pytest.mark.parametrize(
        ("uid", "known"),
        [
            (0x0123456789ABCDEF, "0123456789abcdef"),
            (5283920058631409231, None),  # what every simulator of PX4 says
        ],
    )
    def test_identity(self, uid: int, known: str | None) -> None:
        version = dialect.MAVLink_autopilot_version_message(
            0, 67567616, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, uid, [0] * 18
        )
        identity = Assembler(ARDUPILOT).feed([frame(version)]).identity
        assert (identity.firmware, identity.uid) == ((4, 7, 0), known)


class TestOthers:
    def test_position_current_throttle_attitude(self) -> None:
        rows = [
            frame(dialect.MAVLink_global_position_int_message(1500, 473977443, 85455938, 488953, 0, 0, 0, 0, 0)),
            frame(dialect.MAVLink_attitude_message(1500, np.pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0)),
            frame(dialect.MAVLink_battery_status_message(0, 1, 1, 0, [0] * 10, 1234, -1, -1, 50)),
            frame(dialect.MAVLink_battery_status_message(1, 1, 1, 0, [0] * 10, 99, -1, -1, 50)),
            frame(dialect.MAVLink_vfr_hud_message(0.0, 0.0, 0, 42, 0.0, 0.0)),
        ]
        recording = Assembler(PX4).feed(rows)
        assert recording.channel(Sensor.POSITION).values[0] == pytest.approx([47.3977443, 8.5455938, 488.953])
        assert recording.channel(Sensor.ATTITUDE).values[0] == pytest.approx([np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0])
        assert recording.channel(Sensor.CURRENT).values.tolist() == [[12.34]]
        assert recording.channel(Sensor.THROTTLE).values[0, 0] == pytest.approx(0.42)
        assert recording.channel(Sensor.THROTTLE).t == pytest.approx([1.5])

    def test_what_is_not_measured_is_no_sample(self) -> None:
        rows = [
            raw_imu(1.0),
            frame(dialect.MAVLink_global_position_int_message(1500, 0, 0, 0, 0, 0, 0, 0, 0)),
            frame(dialect.MAVLink_battery_status_message(0, 1, 1, 0, [0] * 10, -1, -1, -1, 50)),
        ]
        recording = Assembler(ARDUPILOT).feed(rows)
        assert not recording.find(Sensor.POSITION)
        assert not recording.find(Sensor.CURRENT)

    def test_other_senders_are_ignored(self) -> None:
        message = dialect.MAVLink_raw_imu_message(1000000, 1, 2, 3, 4, 5, 6, 7, 8, 9, 0, 10)
        assert not Assembler(ARDUPILOT).feed([frame(message, system=2), frame(message, component=154)]).channels

    def test_an_unknown_autopilot_is_refused(self) -> None:
        with pytest.raises(FirmwareError, match="other"):
            Assembler(Identity(autopilot="other"))


@given(st.data())
@settings(max_examples=examples(20), deadline=None)
def test_chunks_of_any_size_join_to_the_same_recording(data: st.DataObject) -> None:
    rows: list[Row] = []
    for k in range(40):
        jitter = data.draw(st.sampled_from([0.0, 0.0, 0.03, -0.05]))
        rows.append(raw_imu(10 + 0.02 * k + jitter, (k, 0, -1000), mag=(200 + k // 5, 0, 400)))
        if k % 7 == 0:
            rows += [real(f"P{k % 3}", float(k)), frame(dialect.MAVLink_vfr_hud_message(0.0, 0.0, 0, k, 0.0, 0.0))]
    whole = Assembler(ARDUPILOT).feed(rows)
    assembler, parts, at = Assembler(ARDUPILOT), [], 0
    while at < len(rows):
        size = data.draw(st.integers(1, 15))
        parts.append(assembler.feed(rows[at : at + size]))
        at += size
    joined = join(parts)
    assert {c.key for c in whole.channels} == {c.key for c in joined.channels}
    for ours in whole.channels:
        theirs = one(joined, ours.sensor, ours.source, ours.instance)
        assert np.array_equal(ours.t, theirs.t)
        assert np.array_equal(ours.values, theirs.values)
    assert whole.parameters.entries == joined.parameters.entries
    assert whole.events == joined.events


class TestRequests:
    def test_ardupilot(self) -> None:
        wanted = requested_streams("ardupilot", {Sensor.ACCEL})
        assert {27: 50.0, 116: 50.0, 129: 50.0, 105: 50.0}.items() <= wanted.items()
        assert dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE in wanted

    def test_ardupilot_says_that_it_calibrates_only_if_asked(self) -> None:
        asked = {dialect.MAVLINK_MSG_ID_MAG_CAL_PROGRESS, dialect.MAVLINK_MSG_ID_MAG_CAL_REPORT}
        assert asked <= requested_streams("ardupilot", {Sensor.GYRO}).keys()
        assert not asked & requested_streams("px4", {Sensor.GYRO}).keys()  # HEARTBEAT says it

    def test_px4_is_never_asked_for_its_debiased_stream(self) -> None:
        wanted = requested_streams("px4", {Sensor.GYRO})
        assert wanted[dialect.MAVLINK_MSG_ID_SCALED_IMU] == 50.0
        assert dialect.MAVLINK_MSG_ID_HIGHRES_IMU not in wanted

    def test_a_magnetometer_needs_place_and_current(self) -> None:
        wanted = requested_streams("ardupilot", {Sensor.MAG})
        assert {dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, dialect.MAVLINK_MSG_ID_BATTERY_STATUS} <= wanted.keys()

    def test_another_autopilot_is_refused(self) -> None:
        with pytest.raises(FirmwareError):
            requested_streams("other", {Sensor.ACCEL})


@pytest.mark.parametrize(("autopilot", "samples"), [("ardupilot", {27, 116, 129, 105}), ("px4", {26, 116, 129})])
def test_who_watches_asks_for_the_messages_of_a_job_at_a_rate_of_their_own(autopilot: str, samples: set[int]) -> None:
    job = requested_streams(autopilot, (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG))
    live = live_streams(autopilot, 200.0)
    attitude = dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION
    assert set(live) == {*job, attitude}
    assert {key for key, rate in live.items() if rate == 200.0} == samples
    assert {key: rate for key, rate in live.items() if key not in {*samples, attitude}} == {
        key: rate for key, rate in job.items() if key not in samples
    }
    assert live[attitude] == 25.0
    assert live_streams(autopilot, 10.0)[attitude] == 10.0
    with pytest.raises(FirmwareError):
        live_streams("slugs", 50.0)
