"""Rings, alignment and reference vectors as methods on recordings."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.compose.plan import compose
from mavcal.calib.firmware.plan import Fingerprint
from mavcal.calib.fit import FitStatus
from mavcal.calib.logs import read_tlog
from mavcal.calib.logs.tables import NO_TIME
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Channel, Event, Recording, Segment, Sensor, Stage

G = 9.80665
FIELD = 49.0 * np.array([np.cos(1.15), 0.0, np.sin(1.15)])
OFFSET = np.array([12.0, -8.5, 21.0])
MATRIX = np.array([[1.08, 0.03, -0.02], [0.10, 0.95, 0.04], [-0.05, 0.04, 1.02]])
LEVEL_FROM = {  # which rotation of a level body puts that axis down
    "z-down": Rotation.identity(),
    "z-up": Rotation.from_euler("x", 180, degrees=True),
    "y-down": Rotation.from_euler("x", 90, degrees=True),
    "y-up": Rotation.from_euler("x", -90, degrees=True),
    "x-up": Rotation.from_euler("y", 90, degrees=True),
    "x-down": Rotation.from_euler("y", -90, degrees=True),
}
WITHIN = np.concatenate([OFFSET, np.linalg.inv(MATRIX).ravel()])


def channel(sensor, values, unit, rate=20.0):
    return Channel(sensor, 0, np.arange(len(values)) / rate, np.asarray(values), unit, Stage.RAW, "table")


def turned(rng, n=120):
    """Six rings in a row, with an accelerometer and a label each."""
    attitudes = [Rotation.from_euler("z", 2 * np.pi * np.arange(n)[:, None] / n) * face for face in LEVEL_FROM.values()]
    back = Rotation.concatenate(attitudes).inv()
    mag = back.apply(FIELD) @ MATRIX.T + OFFSET + 0.1 * rng.normal(size=(6 * n, 3))
    accel = back.apply([0.0, 0.0, -G]) + 0.02 * rng.normal(size=(6 * n, 3))
    segments = tuple(Segment(label, k * n / 20.0, (k + 1) * n / 20.0) for k, label in enumerate(LEVEL_FROM))
    return Recording(
        (channel(Sensor.MAG, mag, "uT"), channel(Sensor.ACCEL, accel, "m/s2")),
        segments=segments,
    )


def assert_true(fit, scale=True):
    truth = WITHIN.copy()
    if not scale:
        truth[3:] /= np.cbrt(np.linalg.det(truth[3:].reshape(3, 3)))
    assert np.abs((fit.values - truth) / fit.sd).max() < 4.5


def test_rings_by_label_by_order_and_by_the_accelerometer_are_the_same():
    recording = turned(np.random.default_rng(1))
    (labelled,) = METHODS["mag-rings"].run(recording, {"field": 49.0})
    assert_true(labelled)
    numbered = dataclasses.replace(
        recording, segments=tuple(dataclasses.replace(s, label=str(k)) for k, s in enumerate(recording.segments))
    )
    (ordered,) = METHODS["mag-rings"].run(numbered, {"field": 49.0, "order": ",".join(LEVEL_FROM)})
    (seen,) = METHODS["mag-rings"].run(numbered, {"field": 49.0})
    np.testing.assert_allclose(ordered.values, labelled.values)
    np.testing.assert_allclose(seen.values, labelled.values)
    (by_accel,) = METHODS["mag-rings"].run(dataclasses.replace(recording, segments=()), {"field": 49.0})
    np.testing.assert_allclose(by_accel.values, labelled.values, atol=1e-9)


def test_rings_that_nothing_tells_apart():
    recording = turned(np.random.default_rng(2))
    mag = recording.channel(Sensor.MAG)
    with pytest.raises(InvalidInputError, match="nothing tells the rings apart"):
        METHODS["mag-rings"].run(Recording((mag,)))
    with pytest.raises(InvalidInputError, match="names 2 rings, the recording has 6"):
        METHODS["mag-rings"].run(recording, {"order": "x-up,y-up"})
    with pytest.raises(InvalidInputError, match="names no axis"):
        METHODS["mag-rings"].run(recording, {"order": "sideways"})


def test_the_same_rings_by_their_alignment_with_the_accelerometer():
    (fit,) = METHODS["mag-align"].run(turned(np.random.default_rng(3)), {"field": 49.0})
    assert_true(fit)
    assert fit.quality["accel_instance"] == 0
    (open_scale,) = METHODS["mag-align"].run(turned(np.random.default_rng(4)))
    assert_true(open_scale, scale=False)


def test_the_accelerometer_that_reads_gravity_is_taken():
    recording = turned(np.random.default_rng(5))
    accel = recording.channel(Sensor.ACCEL)
    crooked = dataclasses.replace(accel, values=accel.values + np.array([1.0, -0.5, 0.3]))
    both = recording.with_channels((recording.channel(Sensor.MAG), crooked, dataclasses.replace(accel, instance=1)))
    (fit,) = METHODS["mag-align"].run(both, {"field": 49.0})
    assert fit.quality["accel_instance"] == 1
    (asked,) = METHODS["mag-align"].run(both, {"field": 49.0, "accel": 0, "gate": 0.3})
    assert asked.quality["accel_instance"] == 0
    with pytest.raises(InvalidInputError, match="state it with --gravity"):
        METHODS["mag-align"].run(both.with_channels(dataclasses.replace(c, unit="counts") for c in both.channels))


def test_a_table_without_time_says_nothing_of_a_lag():
    recording = dataclasses.replace(
        turned(np.random.default_rng(6)), events=(Event(0.0, NO_TIME, "rows are counted"),), segments=()
    )
    (fit,) = METHODS["mag-align"].run(recording, {"field": 49.0})
    assert fit.quality["time_offset_sd"] is None
    with pytest.raises(InvalidInputError, match="nothing tells"):
        METHODS["mag-rings"].run(recording)


def test_reference_vectors_of_a_rest():
    rng = np.random.default_rng(7)
    attitude = Rotation.from_euler("ZYX", [30, 4, -2], degrees=True).inv()
    accel = attitude.apply([0.0, 0.0, -G]) + 0.02 * rng.normal(size=(300, 3))
    mag = attitude.apply(FIELD) + 0.1 * rng.normal(size=(300, 3))
    recording = Recording((channel(Sensor.ACCEL, accel, "m/s2", 50.0), channel(Sensor.MAG, mag, "uT", 50.0)))
    (fit,) = METHODS["rest-reference"].run(recording, {"accel_sd": 0.01})
    assert fit.native["heading_deg"] == pytest.approx(30.0, abs=0.2)
    assert (fit.native["roll_deg"], fit.native["pitch_deg"]) == pytest.approx((-2.0, 4.0), abs=0.1)
    assert fit.n_used == 100
    with pytest.raises(InvalidInputError, match="no position"):
        METHODS["rest-reference"].run(recording, {"year": 2026.0})


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_reference_is_never_written(autopilot):
    (fit,) = METHODS["rest-reference"].run(
        Recording((channel(Sensor.ACCEL, np.tile([0.0, 0.0, -G], (200, 1)), "m/s2", 50.0),))
    )
    parameters = {f"INS_ACCOFFS_{a}": 0.1 for a in "XYZ"} | {f"INS_ACCSCAL_{a}": 1.1 for a in "XYZ"}
    parameters |= {f"CAL_ACC0_{a}OFF": 0.1 for a in "XYZ"} | {f"CAL_ACC0_{a}SCALE": 1.1 for a in "XYZ"}
    parameters |= {"CAL_ACC0_ID": 1, "CAL_ACC0_ROT": -1, "SENS_BOARD_ROT": 0, "AHRS_ORIENTATION": 0}
    parameters |= {f"SENS_BOARD_{a}_OFF": 0.0 for a in "XYZ"}
    plan = compose([dataclasses.replace(fit, relative=False)], parameters, Fingerprint(autopilot, "0", "4.6.0", ()))
    assert plan.blockers == ("there is nothing to write: no sensor has a usable fit",)
    assert any("rest-reference finds nothing that can be written" in text for text in plan.warnings)
    assert not plan.changes


@pytest.mark.long
@pytest.mark.shared
@pytest.mark.parametrize("name", ["tumble", "turntable"])
def test_the_compass_of_a_real_ardupilot_lies_along_its_accelerometer(shared_data, name):
    fit = METHODS["mag-align"].run(read_tlog(shared_data / "sitl_captures" / f"{name}.tlog"))[0]
    assert fit.status == FitStatus.OK
    assert np.abs((fit.model.offset - (-9.0, 5.5, -3.5)) / fit.sd[:3]).max() < 5.0
    assert fit.model.offset == pytest.approx([-9.0, 5.5, -3.5], abs=0.01)
    assert fit.quality["mounting_deg"] < 4.0 * fit.quality["mounting_sd_deg"] < 0.05
    assert fit.quality["accel_instance"] == 1  # the other one has errors that were injected
