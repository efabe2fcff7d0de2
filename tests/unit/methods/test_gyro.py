"""The gyroscope's methods as the command line asks for them: rates by text, turns by label, what is missing."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.logs.tables import NO_TIME
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Channel, Event, Recording, Segment, Sensor, Stage

G = 9.80665
RATE = 50.0
SCALE = np.array([1.02, 0.97, 1.01])
OFFSET = np.array([0.01, -0.02, 0.005])
LABELS = ("x+", "x-", "y+", "y-", "z+", "z-")
WITHOUT_TIME = (Event(0.0, NO_TIME, "rows are counted"),)


def raw(sensor, values, unit, *, instance=0):
    values = np.asarray(values, dtype=float)
    return Channel(sensor, instance, np.arange(len(values)) / RATE, values, unit, Stage.RAW, "made")


def turns(deg_per_s=(90.0,) * 6, *, seed=1, labelled=True, seconds=6.0):
    """Turns of the stated rates about x, y and z, both ways, with rests between them."""
    rng = np.random.default_rng(seed)
    n, rest = int(seconds * RATE), int(3.0 * RATE)
    pieces, segments = [np.zeros((rest, 3))], []
    for k, speed in enumerate(deg_per_s):
        start = sum(map(len, pieces)) / RATE
        way = np.radians(speed) * np.eye(3)[k // 2] * (1.0 if k % 2 == 0 else -1.0)
        pieces += [np.tile(way, (n, 1)), np.zeros((rest, 3))]
        segments.append(Segment(LABELS[k], start, start + seconds))
    true = np.concatenate(pieces)
    gyro = raw(Sensor.GYRO, true * SCALE + OFFSET + 1e-3 * rng.normal(size=true.shape), "rad/s")
    return Recording((gyro,), segments=tuple(segments) if labelled else ())


@pytest.mark.parametrize("labelled", [True, False])
def test_one_rate_serves_all_turns(labelled):
    (fit,) = METHODS["gyro-turntable"].run(turns(labelled=labelled), {"rate_true": "90"})
    assert fit.status == FitStatus.OK
    assert np.diag(fit.model.matrix) == pytest.approx(1.0 / SCALE, rel=1e-3)
    assert fit.model.offset == pytest.approx(OFFSET, abs=1e-3)


def test_every_label_may_have_its_own_rate():
    recording = turns((90.0, 45.0, 60.0, 60.0, 120.0, 30.0))
    text = "x+=90, x-=-45,y+=60,y-=-60,z+=120,z-=-30"
    (fit,) = METHODS["gyro-turntable"].run(recording, {"rate_true": text})
    assert np.diag(fit.model.matrix) == pytest.approx(1.0 / SCALE, rel=1e-3)


@pytest.mark.parametrize("text", ["fast", "x+=fast", "90,45"])
def test_what_is_no_rate_is_told(text):
    with pytest.raises(
        InvalidInputError, match=f"a rate is a number of degrees a second, or .*'{text}' is neither".replace("+", r"\+")
    ):
        METHODS["gyro-turntable"].run(turns(), {"rate_true": text})


def test_a_turntable_needs_its_rate_and_time_or_labels():
    with pytest.raises(InvalidInputError, match="the rate of the table is needed: --rate-true 90"):
        METHODS["gyro-turntable"].run(turns())
    counted = Recording(turns(labelled=False).channels, events=WITHOUT_TIME)
    with pytest.raises(InvalidInputError, match="turns are found by time: the table has none"):
        METHODS["gyro-turntable"].run(counted, {"rate_true": "90"})


def test_the_uncertainty_of_the_table_is_in_degrees():
    """Nine degrees a second of ninety, each way: a tenth of the scale over the root of two."""
    (sure,) = METHODS["gyro-turntable"].run(turns(), {"rate_true": "90"})
    (unsure,) = METHODS["gyro-turntable"].run(turns(), {"rate_true": "90", "rate_sd": 9.0})
    assert unsure.sd[[3, 7, 11]] == pytest.approx(0.1 / np.sqrt(2.0) / SCALE, rel=0.01)
    assert sure.sd[3] < 1e-3


def test_a_thread_counts_what_is_stated():
    n = int(8.0 * RATE)
    turn = np.full(n, 2.0 * np.pi * 5.0 / 8.0)  # five turns in eight seconds
    rest = np.zeros(int(3.0 * RATE))
    true = np.outer(np.concatenate([rest, turn, rest, -turn, rest]), [0.0, 0.0, 1.0])
    gyro = raw(Sensor.GYRO, true * SCALE + OFFSET + 1e-3 * np.random.default_rng(2).normal(size=true.shape), "rad/s")
    (fit,) = METHODS["gyro-thread"].run(Recording((gyro,)), {"turns": 5.0})
    assert fit.model.matrix[2, 2] == pytest.approx(1.0 / SCALE[2], rel=2e-3)
    (rough,) = METHODS["gyro-thread"].run(Recording((gyro,)), {"turns": 5.0, "angle_sd": 90.0})
    assert rough.sd[11] == pytest.approx(0.05 / np.sqrt(2.0) / SCALE[2], rel=0.01)  # a quarter of five turns, each way
    assert fit.sd[11] < 1e-4
    with pytest.raises(InvalidInputError, match="the turns must be counted: give --turns, or a recording with a comp"):
        METHODS["gyro-thread"].run(Recording((gyro,)))
    with pytest.raises(InvalidInputError, match="turns are integrated over time: the table has none"):
        METHODS["gyro-thread"].run(Recording((gyro,), events=WITHOUT_TIME), {"turns": 5.0})


def sides(*, sensitivity=2e-3, drift=0.0, unit="m/s2"):
    """Rests on six sides twice, of a gyroscope that acceleration pulls, with an offset that moves."""
    rng = np.random.default_rng(3)
    ways = [(0, 0), (180, 0), (90, 0), (-90, 0), (0, 90), (0, -90)] * 2
    force = np.repeat(Rotation.from_euler("xy", ways, degrees=True).inv().apply([0.0, 0.0, -G]), 600, axis=0)
    t = np.arange(len(force)) / RATE
    pull = force * [sensitivity, 0.0, 0.0]
    values = OFFSET + pull + np.outer(drift * t, [1.0, 1.0, 1.0]) + 1e-3 * rng.normal(size=force.shape)
    accel = raw(Sensor.ACCEL, force + 0.01 * rng.normal(size=force.shape), unit)
    segments = tuple(Segment(f"side {k}", 12.0 * k + 0.5, 12.0 * k + 11.5) for k in range(12))
    warmth = raw(Sensor.TEMPERATURE, np.full((len(t), 1), 31.0), "degC")
    return Recording((accel, raw(Sensor.GYRO, values, "rad/s"), warmth), segments=segments)


def test_the_pull_of_acceleration_is_found_by_labelled_rests():
    (fit,) = METHODS["gyro-g-sensitivity"].run(sides())
    assert fit.temperature == 31.0
    assert fit.native["K"][0][0] == pytest.approx(2e-3, rel=0.05)
    assert fit.native["K"][1][1] == pytest.approx(0.0, abs=5e-5)


def test_an_offset_that_moves_is_fitted_where_it_is_asked_for():
    (plain,) = METHODS["gyro-g-sensitivity"].run(sides(drift=1e-4))
    (moving,) = METHODS["gyro-g-sensitivity"].run(sides(drift=1e-4), {"drift": "yes"})
    assert moving.residual_rms < 0.2 * plain.residual_rms
    assert moving.native["K"][0][0] == pytest.approx(2e-3, rel=0.05)


def test_the_pull_of_acceleration_needs_acceleration_and_rests():
    whole = sides()
    accel, gyro, _ = whole.channels
    with pytest.raises(InvalidInputError, match="the recording has no accelerometer 0: acceleration must be known"):
        METHODS["gyro-g-sensitivity"].run(Recording((gyro,), segments=whole.segments))
    with pytest.raises(InvalidInputError, match="rests are found by time: the table has none"):
        METHODS["gyro-g-sensitivity"].run(Recording((accel, gyro), events=WITHOUT_TIME))
    with pytest.raises(InvalidInputError, match="gravity in g is not known"):
        METHODS["gyro-g-sensitivity"].run(sides(unit="g"))


@pytest.mark.parametrize(
    ("asked", "sensors"),
    [("all", {Sensor.ACCEL, Sensor.GYRO, Sensor.MAG}), ("gyro", {Sensor.GYRO}), ("mag", {Sensor.MAG})],
)
def test_noise_is_told_of_every_sensor_or_of_the_one_that_is_asked_for(asked, sensors):
    rng = np.random.default_rng(4)
    units = {Sensor.ACCEL: "m/s2", Sensor.GYRO: "rad/s", Sensor.MAG: "uT"}
    recording = Recording(tuple(raw(s, rng.normal(size=(6000, 3)), unit) for s, unit in units.items()))
    fits = METHODS["allan"].run(recording, {"sensor": asked})
    assert {fit.sensor for fit in fits} == sensors


def test_noise_over_time_needs_times_and_a_sensor():
    recording = Recording((raw(Sensor.GYRO, np.ones((10, 3)), "rad/s"),), events=WITHOUT_TIME)
    with pytest.raises(InvalidInputError, match="noise over time needs times: the table has none"):
        METHODS["allan"].run(recording)
    with pytest.raises(InvalidInputError, match="accel"):
        METHODS["allan"].run(Recording((raw(Sensor.CURRENT, np.ones((10, 1)), "A"),)))


def test_both_sensors_of_a_unit_need_time_and_each_other():
    gyro, accel = raw(Sensor.GYRO, np.ones((10, 3)), "rad/s"), raw(Sensor.ACCEL, np.ones((10, 3)), "m/s2", instance=1)
    with pytest.raises(InvalidInputError, match="movements are integrated over time: the table has none"):
        METHODS["imu-multi"].run(Recording((gyro, accel), events=WITHOUT_TIME))
    with pytest.raises(InvalidInputError, match="no inertial unit has both an accelerometer and a gyroscope here"):
        METHODS["imu-multi"].run(Recording((gyro, accel)))
    with pytest.raises(InvalidInputError, match=r"no (usable )?gyro"):
        METHODS["imu-multi"].run(Recording((accel,)))
