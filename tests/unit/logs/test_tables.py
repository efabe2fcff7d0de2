from __future__ import annotations

import io
import zipfile

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavcal.calib import logs
from mavcal.calib.errors import InvalidInputError, UnreadableError
from mavcal.calib.logs.columns import text_columns
from mavcal.calib.logs.tables import NO_TIME, read_table, write_table
from mavcal.calib.recording import Channel, Recording, Rounding, Segment, Sensor, Stage
from tests.examples import examples

G = 9.80665
MAG_BY_NUMBER = {"mag_x": "0", "mag_y": "1", "mag_z": "2"}


@pytest.fixture
def table(tmp_path):
    def write(text, name="table.csv"):
        path = tmp_path / name
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return path

    return write


def test_the_interchange_format(table):
    recording = read_table(
        table(
            "t,segment,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z,temperature,motor_1,motor_2\n"
            "0.0,level,0.1,0.2,-9.8,0.01,0.02,0.03,25.0,0.1,0.2\n"
            "0.1,level,0.1,0.2,-9.7,,,,25.5,nan,0.2\n"
            "0.2,left,0.1,9.8,0.3,0.01,0.02,0.03,,0.3,0.4\n"
        )
    )
    accel, gyro = recording.channel(Sensor.ACCEL), recording.channel(Sensor.GYRO)
    assert accel.values[:, 2].tolist() == [-9.8, -9.7, 0.3]
    assert (accel.unit, gyro.unit, accel.stage) == ("m/s2", "rad/s", Stage.RAW)
    assert gyro.t.tolist() == [0.0, 0.2]
    assert recording.channel(Sensor.TEMPERATURE).values[:, 0].tolist() == [25.0, 25.5]
    assert recording.channel(Sensor.MOTOR).values.tolist() == [[0.1, 0.2], [0.3, 0.4]]
    assert recording.segments == (Segment("level", 0.0, 0.2), Segment("left", 0.2, pytest.approx(0.3)))
    assert not recording.parameters


def test_a_second_instance_has_its_number_in_the_name(table):
    recording = read_table(
        table("t,mag_x,mag_y,mag_z,mag2_x,mag2_y,mag2_z,temperature2\n0,1,2,3,4,5,6,30\n1,1,2,3,4,5,6,31\n")
    )
    assert recording.instances(Sensor.MAG) == (0, 1)
    assert recording.channel(Sensor.MAG, 1).values[0].tolist() == [4.0, 5.0, 6.0]
    assert recording.instances(Sensor.TEMPERATURE) == (1,)


@pytest.mark.parametrize("separator", [",", ";", "\t", "   "])
def test_separators(table, separator):
    rows = ["t mag_x mag_y mag_z", "0 1.5 -2 3e1", "0.5 2.5 -3 4e1"]
    path = table("\n".join(row.replace(" ", separator) for row in rows))
    assert read_table(path).channel(Sensor.MAG).values.tolist() == [[1.5, -2.0, 30.0], [2.5, -3.0, 40.0]]


def test_decimal_commas_between_semicolons(table):
    recording = read_table(table("t;mag_x;mag_y;mag_z\n0;1,5;-2,25;3\n1;1,5;-2,25;3\n"))
    assert recording.channel(Sensor.MAG).values[0].tolist() == [1.5, -2.25, 3.0]


def test_preamble_comments_blank_lines_and_windows_line_ends(table):
    path = table(
        "\ufeff# a comment\r\nFs,50.00\r\nInitialization time,60\r\n\r\nmx,my,mz\r\n"
        "1,2,3\r\n# in between\r\n4,5,6\r\n\r\n"
    )
    recording = read_table(path, mapping={"mag_x": "mx", "mag_y": "my", "mag_z": "mz"}, unit_mag="counts", rate=50.0)
    channel = recording.channel(Sensor.MAG)
    assert channel.values.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    assert channel.t.tolist() == [0.0, 0.02]


def test_a_header_in_a_comment(table):
    recording = read_table(table("% t, mag_x, mag_y, mag_z\n0, 1, 2, 3\n1, 1, 2, 3\n"))
    assert len(recording.channel(Sensor.MAG)) == 2


def test_no_header_needs_numbers(table):
    path = table("1 2 3\n4 5 6\n")
    assert len(read_table(path, mapping=MAG_BY_NUMBER).channel(Sensor.MAG)) == 2
    with pytest.raises(UnreadableError, match="3 columns without names"):
        read_table(path)


def test_rows_are_counted_where_there_is_no_time(table):
    recording = read_table(table("mag_x,mag_y,mag_z\n1,2,3\n4,5,6\n"))
    assert [event.kind for event in recording.events] == [NO_TIME]
    assert recording.channel(Sensor.MAG).t.tolist() == [0.0, 1.0]


def test_factors_and_names_in_the_mapping(table):
    path = table("time_ms,ax,ay,az\n0,1,0,-1\n20,1,0,-1\n")
    recording = read_table(
        path, mapping={"t": "time_ms*0.001", "accel_x": "AX*9.80665", "accel_y": "ay*9.80665", "accel_z": "3*9.80665"}
    )
    accel = recording.channel(Sensor.ACCEL)
    assert accel.t.tolist() == [0.0, 0.02]
    assert accel.values[0] == pytest.approx([G, 0.0, -G])


@pytest.mark.parametrize(("unit", "factor"), [("si", 1.0), ("g", G), ("mg", 1e-3 * G)])
def test_units_of_the_accelerometer(table, unit, factor):
    recording = read_table(table("t,accel_x,accel_y,accel_z\n0,1,2,3\n1,1,2,3\n"), unit_accel=unit)
    assert recording.channel(Sensor.ACCEL).values[0] == pytest.approx(np.array([1.0, 2.0, 3.0]) * factor)


def test_units_of_the_others(table):
    path = table("t,gyro_x,gyro_y,gyro_z,mag_x,mag_y,mag_z\n0,180,0,90,1,2,3\n1,0,0,0,1,2,3\n")
    recording = read_table(path, unit_gyro="deg/s", unit_mag="mgauss")
    assert recording.channel(Sensor.GYRO).values[0] == pytest.approx([np.pi, 0.0, np.pi / 2])
    assert recording.channel(Sensor.MAG).values[0] == pytest.approx([0.1, 0.2, 0.3])
    assert read_table(path, unit_mag="gauss").channel(Sensor.MAG).values[0] == pytest.approx([100.0, 200.0, 300.0])


def test_counts_stay_counts_and_know_their_quantum(table):
    path = table("t,gyro_x,gyro_y,gyro_z\n0,10,-3,7\n1,11,-3,8\n")
    gyro = read_table(path, unit_gyro="counts").channel(Sensor.GYRO)
    assert (gyro.unit, gyro.quantum, gyro.rounding) == ("counts", 1.0, Rounding.NEAREST)
    averaged = table("t,gyro_x,gyro_y,gyro_z\n0,10.5,-3,7\n1,11,-3,8\n", "b.csv")
    assert read_table(averaged, unit_gyro="counts").channel(Sensor.GYRO).quantum == 0.0


def test_a_body_of_forward_left_up(table):
    path = table("t,accel_x,accel_y,accel_z,mag_x,mag_y,mag_z\n0,0,0,9.8,20,5,-40\n1,0,0,9.8,20,5,-40\n")
    recording = read_table(path, body="flu")
    assert recording.channel(Sensor.ACCEL).values[0] == pytest.approx([0.0, 0.0, -9.8])  # level reads minus g
    assert recording.channel(Sensor.MAG).values[0] == pytest.approx([20.0, -5.0, 40.0])


@settings(max_examples=examples(30), deadline=None)
@given(
    angles=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    world=st.sampled_from(["ned", "enu"]),
    body=st.sampled_from(["frd", "flu"]),
)
def test_attitudes_in_every_frame(tmp_path_factory, angles, world, body):
    R_ned_frd = Rotation.from_euler("ZYX", angles)
    R_file_ned = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]]) if world == "enu" else Rotation.identity()
    R_frd_file = Rotation.from_euler("x", 180, degrees=True) if body == "flu" else Rotation.identity()
    x, y, z, w = (R_file_ned * R_ned_frd * R_frd_file).as_quat()
    path = tmp_path_factory.mktemp("q") / "q.csv"
    path.write_text(
        f"t,q_w,q_x,q_y,q_z\n0,{w!r},{x!r},{y!r},{z!r}\n1,{w!r},{x!r},{y!r},{z!r}\n".replace("np.float64(", "").replace(
            ")", ""
        )
    )
    q = read_table(path, world=world, body=body).channel(Sensor.ATTITUDE).values[0]
    found = Rotation.from_quat([q[1], q[2], q[3], q[0]])
    assert (found.inv() * R_ned_frd).magnitude() < 1e-9


def test_npz_by_canonical_and_by_foreign_names(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, t=np.arange(4.0), accel=np.ones((4, 3)), acc_raw=np.full((4, 3), 2.0), name="x", temp=np.arange(4.0))
    recording = read_table(
        path, mapping={"temperature": "temp", "mag_x": "acc_raw_0", "mag_y": "acc_raw_1", "mag_z": "acc_raw_2"}
    )
    assert recording.channel(Sensor.ACCEL).values.shape == (4, 3)
    assert recording.channel(Sensor.MAG).values[0].tolist() == [2.0, 2.0, 2.0]
    assert recording.channel(Sensor.TEMPERATURE).values[:, 0].tolist() == [0.0, 1.0, 2.0, 3.0]


def test_matlab_arrays(tmp_path):
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"gyr": np.ones((50, 3)), "time": np.arange(50.0)})
    recording = read_table(path, mapping={"t": "time", "gyro_x": "gyr_0", "gyro_y": "gyr_1", "gyro_z": "gyr_2"})
    assert len(recording.channel(Sensor.GYRO)) == 50
    ascii_mat = tmp_path / "b.mat"
    ascii_mat.write_text("   0.0e+00   1.0e+00   2.0e+00\n   1.0e+00   1.0e+00   2.0e+00\n")
    assert len(read_table(ascii_mat, mapping=MAG_BY_NUMBER).channel(Sensor.MAG)) == 2


def recording_of(rng, segments=True):
    t = np.arange(40) * 0.05
    return Recording(
        (
            Channel(Sensor.ACCEL, 0, t, rng.normal(size=(40, 3)), "m/s2", Stage.RAW, "table"),
            Channel(Sensor.MAG, 1, t[::5] + 0.01, rng.normal(size=(8, 3)), "uT", Stage.RAW, "table"),
            Channel(Sensor.TEMPERATURE, 0, t[::20], np.array([20.0, 21.5]), "degC", Stage.RAW, "table"),
            Channel(Sensor.MOTOR, 0, t, rng.uniform(size=(40, 4)), "1", Stage.RAW, "table"),
        ),
        segments=(Segment("xup", 0.0, 0.5), Segment("2", 0.5, 3.0)) if segments else (),
    )


@pytest.mark.parametrize("name", ["a.csv", "a.npz"])
@pytest.mark.parametrize("segments", [True, False])
def test_what_is_written_comes_back_bit_by_bit(tmp_path, name, segments):
    recording = recording_of(np.random.default_rng(1), segments=segments)
    write_table(recording, tmp_path / name)
    back = logs.read(tmp_path / name)
    assert {c.key[:2] for c in back.channels} == {c.key[:2] for c in recording.channels}
    for channel in recording.channels:
        same = back.channel(channel.sensor, channel.instance)
        assert (same.t == channel.t).all()
        assert (same.values == channel.values).all()
    assert [s.label for s in back.segments] == [s.label for s in recording.segments]
    assert [s.start for s in back.segments] == pytest.approx([s.start for s in recording.segments], abs=0.05)


def test_debiased_channels_are_not_written(tmp_path):
    bad = Channel(Sensor.GYRO, 0, np.arange(3.0), np.zeros((3, 3)), "rad/s", Stage.DEBIASED, "HIGHRES_IMU")
    with pytest.raises(InvalidInputError, match="no samples"):
        write_table(Recording((bad,)), tmp_path / "a.csv")


def test_another_ending_is_refused(tmp_path):
    with pytest.raises(InvalidInputError, match=r"\.csv or \.npz"):
        write_table(recording_of(np.random.default_rng(2)), tmp_path / "a.xlsx")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "empty"),
        ("# only\n# comments\n", "comments"),
        ("To whom it may concern:\nno numbers here\n", "no rows of numbers"),
        ("t,foo,bar\n0,1,2\n1,1,2\n", "t, foo, bar: name them with --map"),
        ("t,accel_x,accel_y\n0,1,2\n1,1,2\n", "accel_z is missing"),
        ("t,mag_x,mag_y,mag_z\n0,a,b,c\n1,d,e,f\n2,3,4,5\n", "holds texts such as 'a'"),
        ("t,mag_x,mag_y,mag_z\n" + "0,1,2\n" * 20 + "0,1,2,3\n" * 40, "20 of 60 rows"),
        ("t,mag_x,mag_y,mag_z\n0,,,\n1,,,\n", "hold no number in any row"),
    ],
)
def test_what_is_no_table_is_told_in_one_sentence(table, text, says):
    with pytest.raises(UnreadableError, match=says) as told:
        read_table(table(text))
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("t,mag_x,mag_y,mag_z\n0,1,2,3\n2,1,2,3\n1,1,2,3\n", "time goes back at row 3"),
        ("t,mag_x,mag_y,mag_z\n0,1,2,3\n,1,2,3\n", "row 2 of the table has no time"),
        ("t,q_w,q_x,q_y,q_z\n0,2,0,0,0\n1,1,0,0,0\n", "length 2"),
    ],
)
def test_impossible_content_is_told_with_its_row(table, text, says):
    with pytest.raises(InvalidInputError, match=says):
        read_table(table(text))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"mapping": {"accel_w": "1"}}, "'accel_w' is no column of a recording"),
        ({"mapping": {"accel": "1"}}, "accel=1 needs 3 columns 1_0, 1_1"),
        ({"mapping": {"mag_x": "nothing"}}, "no column 'nothing'; the table has t, mag_x"),
        ({"mapping": {"mag_x": "9"}}, "no column '9'"),
        ({"mapping": {"mag_x": "mag_x*two"}}, "'two' is no factor"),
        ({"mapping": {"mag_x": "mag_x*0"}}, "not zero"),
        ({"unit_mag": "tesla"}, "not 'tesla'"),
        ({"rate": -1.0}, "positive number"),
        ({"world": "up"}, "ned or enu"),
    ],
)
def test_wrong_options_are_told(table, options, says):
    path = table("t,mag_x,mag_y,mag_z\n0,1,2,3\n1,1,2,3\n")
    with pytest.raises(InvalidInputError, match=says):
        read_table(path, **options)


def test_a_cut_last_row_costs_only_itself(table):
    rows = "".join(f"{k},1,2,3\n" for k in range(30))
    recording = read_table(table("t,mag_x,mag_y,mag_z\n" + rows + "30,1,"))
    assert len(recording.channel(Sensor.MAG)) == 30
    assert [event.kind for event in recording.events] == ["damage"]


def test_a_few_texts_among_the_numbers_are_left_out_and_said(table):
    rows = "".join(f"{k},1,2,3\n" for k in range(30))
    recording = read_table(table("t,mag_x,mag_y,mag_z\n" + rows + "30,1,#REF!,3\n31,1,n/a,3\n32,1,2,3\n"))
    assert recording.channel(Sensor.MAG).t.tolist() == [*range(30), 32.0]
    assert [event.text for event in recording.events] == [
        "1 cells of mag_y are no numbers (such as '#REF!') and were left out"
    ]


def test_dispatch_by_content(table, tmp_path):
    with pytest.raises(UnreadableError, match="a ULog without a sensor"):
        logs.read(table(b"ULog\x01\x12\x35" + bytes(50), "a.csv"))
    with pytest.raises(UnreadableError, match="DataFlash"):
        logs.read(table(b"\xa3\x95\x80" + bytes(50), "a.bin"))
    with pytest.raises(UnreadableError, match="DataFlash log without a single sample"):
        logs.read(table("ArduCopter V3.1\nFMT, 128, 89, FMT, BBnNZ, Type,Length\n", "a.log"))
    with pytest.raises(UnreadableError, match="cannot be opened"):
        logs.read(tmp_path / "nothing.csv")
    with pytest.raises(UnreadableError, match="is a folder, a pipe or a device"):
        logs.read(tmp_path)
    with pytest.raises(UnreadableError, match="npz cannot be read"):
        logs.read(table(b"PK\x03\x04garbage", "a.npz"))
    with pytest.raises(UnreadableError, match="mat cannot be read"):
        logs.read(table(b"MATLAB 5.0 MAT-file" + bytes(200), "a.mat"))
    with pytest.raises(UnreadableError):
        logs.read(table(bytes(100), "a.csv"))
    with pytest.raises(InvalidInputError, match="leave the mapping out"):
        logs.read(table(b"\x00\x06" + bytes(6) + b"\xfd" + bytes(20), "a.tlog"), mapping={"mag_x": "0"})
    with pytest.raises(InvalidInputError, match="belongs to telemetry logs"):
        logs.read(table("1 2 3\n4 5 6\n"), mapping=MAG_BY_NUMBER, system=7)


def test_pickled_arrays_are_not_loaded(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, t=np.array([{"a": 1}], dtype=object))
    with pytest.raises(UnreadableError):
        logs.read(path)


@settings(max_examples=examples(150), deadline=None)
@given(
    st.one_of(
        st.text(max_size=300),
        st.lists(st.sampled_from(["1", "2.5", ",", ";", "\n", " ", "\t", "nan", "x", "", '"', "#"]), max_size=80).map(
            "".join
        ),
    )
)
def test_no_text_does_anything_but_read_or_refuse(text):
    try:
        columns = text_columns(text.encode("utf-8", "surrogatepass"))
    except UnreadableError:
        return
    assert columns.rows >= 1
    assert len({len(v) for v in columns.values}) == 1


@pytest.mark.shared
def test_foreign_recordings(shared_data):
    recording = read_table(
        shared_data / "mag_cuyo_qmc5883l" / "calibration_data__noisy_raw_data.csv",
        mapping=MAG_BY_NUMBER,
        unit_mag="counts",
    )
    assert len(recording.channel(Sensor.MAG)) == 22_743
    mikoff = dict(zip(("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z"), "012345", strict=True))
    assert (
        len(read_table(shared_data / "mikoff_mpu9150x5" / "imu0.log", mapping=mikoff, rate=100.0).channel(Sensor.GYRO))
        == 15_969
    )
    xsens = {"t": "0", "accel_x": "1", "accel_y": "2", "accel_z": "3"}
    accel = read_table(shared_data / "imu_tk_xsens" / "xsens_acc.mat", mapping=xsens, unit_accel="counts").channel(
        Sensor.ACCEL
    )
    assert len(accel) == 51_175
    with pytest.raises(UnreadableError, match="imu_gyr_0"):
        read_table(shared_data / "broad" / "01_undisturbed_slow_rotation_A.mat")


REFERENCE = (
    "t,accel_x,accel_y,accel_z,rotor_hz_1,rotor_hz_2,ref_accel_x,ref_accel_y,ref_accel_z,ref_q_w,ref_q_x,ref_q_y,ref_q_z,"
    "ref_pos_n,ref_pos_e,ref_pos_d,ref_vel_n,ref_vel_e,ref_vel_d\n"
    "0.0,1,2,3,80,81,4,5,6,1,0,0,0,7,8,9,1,2,3\n"
    "0.5,1,2,3,,,,,,,,,,,,,,,\n"
    "1.0,,,,82,83,4,5,7,0,1,0,0,,,,1,2,4\n"
)


def test_references_are_read_beside_the_channels(table):
    recording = read_table(table(REFERENCE))
    found = {c.sensor: c for c in recording.reference}
    assert set(found) == {Sensor.ACCEL, Sensor.ATTITUDE, Sensor.PLACE, Sensor.VELOCITY}
    assert found[Sensor.ACCEL].values.tolist() == [[4, 5, 6], [4, 5, 7]]
    assert found[Sensor.PLACE].values.tolist() == [[7, 8, 9]]
    assert found[Sensor.VELOCITY].t.tolist() == [0.0, 1.0]
    assert len(recording.channel(Sensor.ACCEL)) == 2
    assert recording.channel(Sensor.ROTOR_SPEED).values.tolist() == [[80, 81], [82, 83]]


@pytest.mark.parametrize("ending", [".csv", ".npz"])
def test_a_converted_table_with_references_is_the_same_recording(table, tmp_path, ending):
    first = read_table(table(REFERENCE))
    write_table(first, tmp_path / f"out{ending}")
    second = read_table(tmp_path / f"out{ending}")
    for a, b in zip((*first.channels, *first.reference), (*second.channels, *second.reference), strict=True):
        assert a.sensor == b.sensor
        np.testing.assert_array_equal(a.t, b.t)
        np.testing.assert_array_equal(a.values, b.values)


def test_units_of_the_sensors_do_not_touch_the_reference_but_frames_do(table):
    recording = read_table(table(REFERENCE), unit_accel="g", body="flu")
    np.testing.assert_allclose(recording.channel(Sensor.ACCEL).values[0], np.array([1, -2, -3]) * G)
    np.testing.assert_array_equal(recording.reference[0].values[0], [4, -5, -6])


def test_a_whole_array_is_mapped_by_its_name(tmp_path):
    rng = np.random.default_rng(3)
    acc, quat = rng.normal(size=(50, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (50, 1))
    scipy.io.savemat(tmp_path / "a.mat", {"imu_acc": acc, "opt_quat": quat})
    mapping = {"accel": "imu_acc*2", "ref_q": "opt_quat"}
    recording = read_table(tmp_path / "a.mat", mapping=mapping, rate=100.0)
    np.testing.assert_array_equal(recording.channel(Sensor.ACCEL).values, 2.0 * acc)
    assert recording.reference[0].sensor == Sensor.ATTITUDE
    with pytest.raises(UnreadableError, match="needs 4 columns imu_acc_0"):
        read_table(tmp_path / "a.mat", mapping={"q": "imu_acc"}, rate=100.0)


@pytest.mark.long
def test_archives_that_unfold_beyond_reason_are_refused(tmp_path):
    np.savez_compressed(tmp_path / "bomb.npz", t=np.zeros(20_000_000))
    with pytest.raises(UnreadableError, match="unfolds to"):
        read_table(tmp_path / "bomb.npz")
    scipy.io.savemat(tmp_path / "bomb.mat", {"t": np.zeros(20_000_000)}, do_compression=True)
    with pytest.raises(UnreadableError, match="unfolds to"):
        read_table(tmp_path / "bomb.mat")


@pytest.mark.parametrize("kind", ["f8", "i1", "?", "U1"])
def test_what_columns_will_take_counts_whatever_the_archive_holds(tmp_path, kind):
    """A byte becomes eight, a character a text of its own."""
    np.savez_compressed(tmp_path / "bomb.npz", **{f"a{k}": np.zeros(2_000_000, kind) for k in range(8)})
    with pytest.raises(UnreadableError, match="unfolds to"):
        read_table(tmp_path / "bomb.npz", mapping={"mag_x": "a0"})


def test_a_member_that_is_packed_otherwise_is_refused(tmp_path):
    """A step of bzip2 unfolds a thousandfold and more, whatever is asked of it."""
    array = io.BytesIO()
    np.save(array, np.arange(50.0))
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_BZIP2) as archive:
        archive.writestr("t.npy", array.getvalue())
    with pytest.raises(UnreadableError, match="packed in a way"):
        read_table(tmp_path / "a.npz")


def test_an_array_that_claims_more_than_it_holds_is_refused(tmp_path):
    np.savez(tmp_path / "a.npz", t=np.arange(64.0))
    data = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "b.npz").write_bytes(data.replace(b"(64,)", b"(4e9", 1).replace(b"(4e9", b"(9**9,)"[:5], 1))
    with pytest.raises(UnreadableError):
        read_table(tmp_path / "b.npz")
    (tmp_path / "c.npz").write_bytes(data.replace(b"'shape': (64,), }    ", b"'shape': (64000,), } ", 1))
    with pytest.raises(UnreadableError):
        read_table(tmp_path / "c.npz")
