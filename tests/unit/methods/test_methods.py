from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.logs import read, read_tlog
from mavcal.calib.logs.tables import NO_TIME
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Channel, Event, Identity, ParameterTimeline, Recording, Segment, Sensor, Stage
from mavcal.calib.report import to_json

G = 9.80665
ACCELCAL = np.array(
    [
        [-9.6490, 0.2225, -0.1925],
        [0.0146, -9.5593, 0.0153],
        [-0.0210, 0.1928, -9.9271],
        [9.9363, 0.1840, -0.0210],
        [0.0008, 9.9094, -0.0655],
        [0.2828, 0.1528, 9.7232],
    ]
)
WITHOUT_TIME = (Event(0.0, NO_TIME, "rows are counted"),)


def raw(sensor, values, unit, rate=50.0, instance=0):
    return Channel(
        sensor, instance, np.arange(len(values)) / rate, np.asarray(values, dtype=float), unit, Stage.RAW, "t"
    )


def test_the_registry_names_every_method_of_this_issue():
    assert set(METHODS) == {
        *("accel-one-axis", "accel-six-face", "accel-multi", "gyro-rest", "mag-minmax", "mag-sphere"),
        *(
            "mag-ellipsoid-axis",
            "mag-ellipsoid",
            "mag-rings",
            "mag-align",
            "mag-flight",
            "mag-motor",
            "rest-reference",
            "thermal-linear",
            "thermal-poly",
            "mag-thermal",
            "allan",
            "accel-thermal",
        ),
        *("gyro-turntable", "gyro-thread", "gyro-g-sensitivity", "mag-gyro", "imu-multi"),
    }
    for name, method in METHODS.items():
        assert method.name == name
        assert method.summary
        assert method.needs
        assert all(option.help for option in method.options)


def test_the_rows_of_accelcal_without_time():
    recording = Recording((raw(Sensor.ACCEL, ACCELCAL, "m/s2"),), events=WITHOUT_TIME)
    (fit,) = METHODS["accel-six-face"].run(recording, {"convention": "accelcal"})
    assert fit.native["A"][0][0] == pytest.approx(1.0017879105, abs=1e-9)
    assert fit.native["b"][2] == pytest.approx(0.0778741103, abs=1e-9)
    assert fit.relative  # a table does not say which calibration was in force
    json.dumps(to_json(fit), allow_nan=False)


def test_labelled_segments_are_faces():
    rng = np.random.default_rng(1)
    labels = ["level", "back", "left", "right", "nose_up", "nose_down"]
    force = G * np.array([[0, 0, -1], [0, 0, 1], [0, 1, 0], [0, -1, 0], [1, 0, 0], [-1, 0, 0]])
    values = np.repeat(force, 50, axis=0) + [0.3, -0.2, 0.1] + 0.01 * rng.normal(size=(300, 3))
    segments = tuple(Segment(label, k * 1.0, k * 1.0 + 1.0) for k, label in enumerate(labels))
    recording = Recording((raw(Sensor.ACCEL, values, "m/s2"),), segments=segments)
    (fit,) = METHODS["accel-six-face"].run(recording)
    assert fit.status == FitStatus.OK
    assert fit.model.offset == pytest.approx([0.3, -0.2, 0.1], abs=0.01)
    assert fit.quality["p_value"] > 1e-3
    (published,) = METHODS["accel-six-face"].run(recording, {"samples": "all"})
    assert published.n_used == 300
    swapped = dataclasses.replace(
        recording, segments=(Segment("back", 0.0, 1.0), Segment("level", 1.0, 2.0), *segments[2:])
    )
    (wrong,) = METHODS["accel-six-face"].run(swapped)
    assert wrong.status == FitStatus.REFUSED


def test_poses_and_rest_from_a_recording_of_still_and_moving(held_poses):
    recording = held_poses(np.random.default_rng(2))
    (fit,) = METHODS["accel-multi"].run(recording, {"form": "upper"})
    assert fit.status == FitStatus.OK
    assert np.abs((fit.model.offset - (0.3, -0.2, 0.15)) / fit.sd[:3]).max() < 4.5
    assert fit.quality["poses"] == 10
    (gyro,) = METHODS["gyro-rest"].run(held_poses(np.random.default_rng(3), oblique=0, tremor_deg=0.0, hold=6.0))
    assert np.abs((gyro.model.offset - (0.013, -0.008, 0.005)) / gyro.sd[:3]).max() < 4.5


def test_every_instance_or_the_one_that_is_asked_for():
    rng = np.random.default_rng(4)
    channels = [
        raw(Sensor.GYRO, 0.01 * (i + 1) + 1e-3 * rng.normal(size=(400, 3)), "rad/s", instance=i) for i in range(3)
    ]
    recording = Recording(tuple(channels))
    assert [fit.instance for fit in METHODS["gyro-rest"].run(recording)] == [0, 1, 2]
    (one,) = METHODS["gyro-rest"].run(recording, {"instance": "2"})
    assert one.instance == 2
    assert one.model.offset == pytest.approx([0.03] * 3, abs=1e-3)
    with pytest.raises(InvalidInputError, match="no usable gyro of instance 7"):
        METHODS["gyro-rest"].run(recording, {"instance": 7})


def test_known_parameters_make_a_fit_absolute():
    gyro = raw(Sensor.GYRO, 1e-3 * np.random.default_rng(5).normal(size=(400, 3)), "rad/s")
    unknown = Recording((gyro,))
    known = dataclasses.replace(unknown, parameters=ParameterTimeline.constant({"A": 1.0}))
    unwatched = dataclasses.replace(known, parameters=dataclasses.replace(known.parameters, end_observed=False))
    assert METHODS["gyro-rest"].run(unknown)[0].relative
    assert not METHODS["gyro-rest"].run(known)[0].relative
    assert any("not read again" in w for w in METHODS["gyro-rest"].run(unwatched)[0].warnings)


def test_thermal_methods_fit_both_sensors_against_their_thermometer():
    rng = np.random.default_rng(6)
    T = 50.0 - 30.0 * np.exp(-np.arange(1500) / 500.0)
    accel = raw(Sensor.ACCEL, np.outer(T - 35.0, [0.01, -0.02, 0.005]) + 0.01 * rng.normal(size=(1500, 3)), "m/s2")
    gyro = raw(Sensor.GYRO, np.outer(T - 35.0, [1e-3, 2e-3, -1e-3]) + 1e-3 * rng.normal(size=(1500, 3)), "rad/s")
    thermometer = raw(Sensor.TEMPERATURE, T[::10, None], "degC", rate=5.0)
    recording = Recording((accel, gyro, thermometer))
    for name in ("thermal-linear", "thermal-poly"):
        first, second = METHODS[name].run(recording, {"tref": 35})
        assert (first.sensor, second.sensor) == (Sensor.ACCEL, Sensor.GYRO)
        assert first.model.polynomial is not None
        assert first.model.polynomial.coefficients[:, 0] == pytest.approx([0.01, -0.02, 0.005], abs=5e-4)
        assert first.temperature == 35.0
    with pytest.raises(InvalidInputError, match="--map temperature=COLUMN"):
        METHODS["thermal-poly"].run(Recording((accel, gyro)))


@pytest.mark.parametrize("name", ["mag-minmax", "mag-sphere", "mag-ellipsoid-axis", "mag-ellipsoid"])
def test_magnetometer_methods_find_the_centre(name):
    rng = np.random.default_rng(7)
    d = rng.normal(size=(2000, 3))
    field = 50.0 * d / np.linalg.norm(d, axis=1)[:, None] + [10.0, -20.0, 5.0] + 0.2 * rng.normal(size=(2000, 3))
    (fit,) = METHODS[name].run(Recording((raw(Sensor.MAG, field, "uT"),)))
    assert fit.model.offset == pytest.approx([10.0, -20.0, 5.0], abs=1.0)


def test_a_known_field_ties_the_scale():
    rng = np.random.default_rng(9)
    d = rng.normal(size=(500, 3))
    field = 40.0 * d / np.linalg.norm(d, axis=1)[:, None] + 0.1 * rng.normal(size=(500, 3))
    recording = Recording((raw(Sensor.MAG, field, "uT"),))
    (open_scale,) = METHODS["mag-ellipsoid"].run(recording)
    (tied,) = METHODS["mag-ellipsoid"].run(recording, {"field": 50.0})
    assert np.linalg.det(open_scale.model.matrix) == pytest.approx(1.0, abs=1e-6)
    assert np.diag(tied.model.matrix) == pytest.approx([1.25] * 3, rel=2e-3)
    with pytest.raises(InvalidInputError, match="no position"):
        METHODS["mag-ellipsoid"].run(recording, {"year": 2026.0})
    with pytest.raises(InvalidInputError, match="positive"):
        METHODS["mag-ellipsoid"].run(recording, {"field": -1.0})


def test_a_one_axis_rest_in_g():
    values = [0.02, -0.03, 1.05] + 0.002 * np.random.default_rng(8).normal(size=(256, 3))
    recording = Recording((raw(Sensor.ACCEL, G * values, "m/s2"),))
    (fit,) = METHODS["accel-one-axis"].run(recording, {"fixture_sd": "0.5"})
    assert fit.model.offset / G == pytest.approx([0.02, -0.03, 0.05], abs=1e-3)
    counts = Recording((raw(Sensor.ACCEL, 4096 * values, "counts"),))
    with pytest.raises(InvalidInputError, match="state it with --gravity"):
        METHODS["accel-one-axis"].run(counts)
    assert METHODS["accel-one-axis"].run(counts, {"gravity": 4096})[0].status == FitStatus.OK


def test_a_slope_through_a_point_is_one_sensors_and_says_so():
    T = np.array([25.0, 35.0, 45.0, 55.0, 65.0, 55.0, 45.0])
    y = np.column_stack([[400.0, 411.0, 419.0, 431.0, 440.0, 429.0, 420.0]] * 3)
    recording = Recording(
        (raw(Sensor.ACCEL, y, "counts"), raw(Sensor.GYRO, y, "counts"), raw(Sensor.TEMPERATURE, T[:, None], "degC"))
    )
    (fit,) = METHODS["thermal-linear"].run(recording, {"through": "400,400,400", "sensor": "gyro"})
    assert fit.sensor == Sensor.GYRO
    assert fit.native["form"] == "through_point"
    assert fit.native["slopes"] == pytest.approx([0.997674] * 3, abs=1e-6)
    (free, _) = METHODS["thermal-linear"].run(recording)
    assert free.native["slopes"] == pytest.approx([753 / 760] * 3, abs=1e-12)
    with pytest.raises(InvalidInputError, match="one sensor's"):
        METHODS["thermal-linear"].run(recording, {"through": "400,400,400"})


def test_labelled_sweeps_of_an_accelerometer_are_poses_of_their_own():
    rng = np.random.default_rng(6)
    T = 40.0 - 20.0 * np.cos(2 * np.pi * np.arange(4000) / 4000)
    pose = np.where(np.arange(4000)[:, None] < 2000, [0.0, 0.0, -9.8], [-9.8, 0.0, 0.0])
    values = pose + np.outer(T - 35.0, [0.01, -0.02, 0.005]) + 0.01 * rng.normal(size=(4000, 3))
    recording = Recording(
        (raw(Sensor.ACCEL, values, "m/s2"), raw(Sensor.TEMPERATURE, T[:, None], "degC")),
        segments=(Segment("P0", 0.0, 40.0), Segment("P1", 40.0, 80.0)),
    )
    (fit,) = METHODS["thermal-poly"].run(recording, {"degree": 1})
    assert fit.quality["poses"] == 2
    assert np.abs((fit.model.polynomial.coefficients[:, 0] - [0.01, -0.02, 0.005]) / fit.sd[12:]).max() < 4.0
    assert min(fit.quality["cross_validation"]["explained"]) > 0.9


def test_gravity_of_the_place():
    values = [0.02, -0.03, -9.832] + 0.002 * np.random.default_rng(8).normal(size=(256, 3))
    recording = Recording((raw(Sensor.ACCEL, values, "m/s2"),))
    (fit,) = METHODS["accel-one-axis"].run(recording, {"latitude": 90.0})
    assert fit.quality["gravity"] == pytest.approx(9.832185, abs=1e-6)
    (high,) = METHODS["accel-one-axis"].run(recording, {"latitude": "90", "altitude": 1000.0})
    assert high.quality["gravity"] == pytest.approx(9.829, abs=2e-4)
    with pytest.raises(InvalidInputError, match="not both"):
        METHODS["accel-one-axis"].run(recording, {"latitude": 90.0, "gravity": 9.8})
    with pytest.raises(InvalidInputError, match="without a latitude"):
        METHODS["accel-multi"].run(recording, {"altitude": 100.0})
    with pytest.raises(InvalidInputError, match="latitude 95"):
        METHODS["accel-six-face"].run(recording, {"latitude": 95.0})
    counts = Recording((raw(Sensor.ACCEL, 418.0 * values, "counts"),))
    with pytest.raises(InvalidInputError, match="state it with --gravity"):
        METHODS["accel-one-axis"].run(counts, {"latitude": 90.0})


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("gyro-rest", {"speed": 1}, "no option speed; it takes from, instance, until"),
        ("accel-six-face", {"convention": "up"}, "one of specific-force, accelcal"),
        ("thermal-poly", {"degree": "three"}, "degree must be a whole number"),
        ("thermal-poly", {"tref": float("nan")}, "tref must be a finite number"),
        ("accel-multi", {"cross_sd": True}, "cross_sd must be a finite number"),
        ("thermal-linear", {"through": "1,2"}, "three numbers X,Y,Z"),
        ("thermal-linear", {"through": "1,2,nan"}, "three numbers X,Y,Z"),
    ],
)
def test_wrong_options_are_told(name, options, says):
    with pytest.raises(InvalidInputError, match=says):
        METHODS[name].run(Recording((raw(Sensor.GYRO, np.zeros((9, 3)), "rad/s"),)), options)


@pytest.mark.parametrize("name", sorted(METHODS))
def test_a_recording_without_the_sensor_says_what_it_has(name):
    with pytest.raises(InvalidInputError, match=r"it has current|it has nothing|neither"):
        METHODS[name].run(Recording((raw(Sensor.CURRENT, np.zeros((9, 1)), "A"),)))


def test_still_poses_need_time():
    recording = Recording((raw(Sensor.ACCEL, ACCELCAL, "m/s2"),), events=WITHOUT_TIME)
    with pytest.raises(InvalidInputError, match="give --rate"):
        METHODS["accel-multi"].run(recording)


def within(fit, names, truth, sigmas=4.5):
    """Whether the fit contains the truth, and how far off it is in standard deviations."""
    index = [fit.names.index(name) for name in names]
    z = (fit.values[index] - np.asarray(truth).ravel()) / fit.sd[index]
    assert np.isfinite(z).all()
    assert np.abs(z).max() < sigmas, z
    return z


OFFSETS = ("offset_x", "offset_y", "offset_z")
SCALES = ("matrix_xx", "matrix_yy", "matrix_zz")


def polynomial(axes="xyz", degree=2):
    return [f"poly{j}_{a}" for a in axes for j in range(1, degree + 1)]


@pytest.mark.shared
def test_the_table_of_the_specification(shared_data):
    recording = read(
        shared_data / "ntars.csv", mapping={"temperature": "temp_c"}, unit_accel="counts", unit_gyro="counts"
    )
    accel, gyro = METHODS["thermal-linear"].run(recording)
    assert accel.native["slopes"] == pytest.approx([6.79942, 9.19042, 3.15345], abs=5e-6)
    assert gyro.native["slopes"][:2] == pytest.approx([0.87682, 0.46056], abs=5e-6)
    assert gyro.native["slopes"][2] is None
    assert "poly1_z" in gyro.undetermined
    assert gyro.status == FitStatus.PARTIAL
    assert accel.quality["repeated_rows"] == 24
    assert np.array(accel.native["residual_sd"]) * np.sqrt(47 / 49) == pytest.approx([7.0, 7.0, 4.4], abs=0.05)


@pytest.mark.sampled
@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "centre", "tolerance"),
    [
        ("mag_cuyo_qmc5883l/calibration_data__filtered_raw_data.csv", (6194.2, 248.6, 3479.8), 8.0),
        ("mag_cuyo_qmc5883l/calibration_data__noisy_raw_data.csv", (6155.0, 257.1, 3444.8), 8.0),
        ("mag_ellipsoid_fit_python/mag_out.txt", (-68.15, 82.77, -133.50), 0.5),
    ],
)
def test_magnetometers_in_counts(shared_data, name, centre, tolerance):
    by_number = {"mag_x": "0", "mag_y": "1", "mag_z": "2"}
    (fit,) = METHODS["mag-ellipsoid"].run(read(shared_data / name, mapping=by_number, unit_mag="counts"))
    assert fit.model.offset == pytest.approx(centre, abs=tolerance)
    assert fit.unit == "counts"


@pytest.mark.long
@pytest.mark.shared
def test_the_real_ardupilot(shared_data):
    captures = shared_data / "sitl_captures"
    first, second = METHODS["accel-multi"].run(read_tlog(captures / "six_faces.tlog"))
    within(first, OFFSETS + SCALES, (0.31, -0.22, 0.17, 1.021, 0.984, 1.013))
    within(second, OFFSETS + SCALES, (0, 0, 0, 1, 1, 1))
    assert not first.relative
    face, _ = METHODS["accel-six-face"].run(read_tlog(captures / "six_faces.tlog"))
    within(face, OFFSETS + SCALES, (0.31, -0.22, 0.17, 1.021, 0.984, 1.013))
    gyro = METHODS["gyro-rest"].run(read_tlog(captures / "turntable.tlog"))[0]
    within(gyro, OFFSETS, (0.0132, -0.0084, 0.0057))
    accel, _, gyro, still = METHODS["thermal-poly"].run(read_tlog(captures / "warm_up.tlog"))
    within(accel, polynomial(), np.array([7000, 60, -4000, -30, 9000, 40]) * 1e-6)
    within(gyro, polynomial(degree=1), np.array([350, -250, 150]) * 1e-6)
    assert still.status == FitStatus.PARTIAL  # clean and truncated: it never leaves its bins
    mag = METHODS["mag-ellipsoid"].run(read_tlog(captures / "tumble.tlog"))[0]
    within(mag, OFFSETS, (-9.0, 5.5, -3.5))
    assert mag.model.offset == pytest.approx([-9.0, 5.5, -3.5], abs=0.01)


@pytest.mark.long
@pytest.mark.shared
def test_the_real_px4(shared_data):
    captures = shared_data / "px4_captures"
    (accel,) = METHODS["accel-multi"].run(read_tlog(captures / "bench_faces.tlog"))
    within(accel, OFFSETS + SCALES, (0.31, -0.22, 0.17, 1 / 1.021, 1 / 0.984, 1 / 1.013))
    (gyro,) = METHODS["gyro-rest"].run(read_tlog(captures / "bench_turn.tlog"))
    within(gyro, OFFSETS, (0.0132, -0.0284, 0.0057))
    (mag,) = METHODS["mag-ellipsoid"].run(read_tlog(captures / "bench_tumble.tlog"))
    within(mag, OFFSETS, (9.0, -5.5, 3.5))
    accel, gyro = METHODS["thermal-poly"].run(read_tlog(captures / "bench_warm.tlog"), {"tref": 25.0})
    within(accel, polynomial(), np.array([7000, 60, -4000, -30, 9000, 40]) * 1e-6)
    within(gyro, polynomial(degree=1), np.array([350, -250, 150]) * 1e-6)
    within(gyro, OFFSETS, (0.0132, -0.0284, 0.0057))


@pytest.mark.shared
@pytest.mark.parametrize(("file", "y", "z"), [("dev_P0_z", 0.466, 0.120), ("dev_P1_x", 0.449, None)])
def test_a_drift_that_does_not_repeat_is_declined(shared_data, file, y, z):
    names = {f"accel_{a}": f"acc_mps2_{k}" for k, a in enumerate("xyz")}
    names |= {f"gyro_{a}": f"gyro_mradps_{k}" for k, a in enumerate("xyz")}
    recording = read(
        shared_data / "temp_cats_imu" / f"{file}.npz",
        mapping={**names, "t": "t_s", "temperature": "temp_C"},
        unit_gyro="mrad/s",
    )
    accel, gyro = METHODS["thermal-poly"].run(recording, {"degree": 1, "tref": 10.0})
    assert "poly1_x" in gyro.undetermined
    assert gyro.model.polynomial is not None
    assert gyro.model.polynomial.coefficients[1, 0] * 1e3 == pytest.approx(y, abs=0.01)
    if z is not None:
        assert gyro.model.polynomial.coefficients[2, 0] * 1e3 == pytest.approx(z, abs=0.01)
    assert accel.model.polynomial is not None
    assert accel.model.polynomial.coefficients[1:, 0] == pytest.approx([-0.022, 0.024], abs=0.0015)


@pytest.mark.shared
def test_counts_of_a_hand_held_sensor_give_the_certificate(shared_data):
    recording = read(
        shared_data / "imu_tk_xsens" / "xsens_acc.mat",
        mapping={"t": "0", "accel_x": "1", "accel_y": "2", "accel_z": "3"},
        unit_accel="counts",
    )
    (fit,) = METHODS["accel-multi"].run(recording, {"gravity": 9.81744})
    assert fit.quality["poses"] == pytest.approx(38, abs=2)
    assert fit.model.offset == pytest.approx([33_123.9, 33_275.2, 32_364.4], abs=1.0)
    assert 1.0 / np.diag(fit.model.matrix) == pytest.approx([414.4, 412.0, 414.6], rel=5e-4)


@pytest.mark.shared
@pytest.mark.parametrize(
    ("file", "scale", "offset"),
    [
        ("imu0.log", (0.9961, 0.9966, 0.9934), (0.103, 0.097, 0.344)),
        ("imu1.log", (0.9951, 0.9950, 0.9904), (0.090, 0.070, 0.338)),
    ],
)
def test_two_hand_held_boards(shared_data, file, scale, offset):
    names = ("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z")
    recording = read(
        shared_data / "mikoff_mpu9150x5" / file, mapping=dict(zip(names, "012345", strict=True)), rate=100.0
    )
    (fit,) = METHODS["accel-multi"].run(recording)
    assert np.diag(fit.model.matrix) == pytest.approx(scale, abs=5e-4)
    assert fit.model.offset == pytest.approx(offset, abs=2e-3)
    assert fit.quality["p_value"] > 1e-3


@pytest.mark.parametrize("method", ["accel-multi", "accel-thermal"])
def test_residuals_in_counts_are_counts(method):
    rng = np.random.default_rng(11)
    rows = rng.normal(size=(24, 3))
    rows = 4000.0 * rows / np.linalg.norm(rows, axis=1)[:, None]
    values = np.repeat(rows, 100, axis=0) + [120.0, -80.0, 40.0] + 20.0 * rng.normal(size=(2400, 3))
    warm = raw(Sensor.TEMPERATURE, np.linspace(20.0, 45.0, 2400)[:, None], "degC")
    segments = tuple(Segment(f"p{k}", 2.0 * k, 2.0 * k + 2.0) for k in range(24))
    found = []
    for unit, scale in (("counts", 1.0), ("m/s2", G / 4000.0)):
        recording = Recording((raw(Sensor.ACCEL, scale * values, unit), warm), segments=segments)
        found.append(METHODS[method].run(recording)[0])
    assert found[0].unit == "counts"
    assert found[0].residual_rms == pytest.approx(found[1].residual_rms * 4000.0 / G, rel=0.05)


def test_the_advice_on_a_missing_temperature_is_one_that_works():
    recording = Recording((raw(Sensor.ACCEL, np.ones((100, 3)), "m/s2"),))
    of_vehicle = dataclasses.replace(recording, identity=Identity(autopilot="ardupilot"), source="a.bin")
    for method in ("thermal-poly", "thermal-linear", "accel-thermal"):
        with pytest.raises(InvalidInputError, match="--map temperature=COLUMN"):
            METHODS[method].run(recording)
        with pytest.raises(InvalidInputError, match=r"a\.bin has no temperature of this sensor: log it"):
            METHODS[method].run(of_vehicle)


def test_every_method_has_a_row_on_the_page_of_methods():
    page = (Path(__file__).resolve().parents[3] / "docs" / "methods.md").read_text(encoding="utf-8")
    assert [name for name in METHODS if f"| `{name}` |" not in page] == []


def test_an_array_named_as_its_sensor_may_be_mapped(tmp_path):
    path = tmp_path / "named.npz"
    np.savez(path, time=np.arange(5.0), mag=np.arange(15.0).reshape(5, 3))
    mapped = read(path, mapping={"t": "time", "mag": "mag*0.1"})
    assert mapped.channel(Sensor.MAG).values[1] == pytest.approx([0.3, 0.4, 0.5])
