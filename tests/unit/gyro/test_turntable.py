from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.gyro.turns import EARTH_RATE
from mavcal.calib.gyro.turntable import fit_turntable, steady_spans
from mavcal.calib.logs import read
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Channel, Segment, Sensor, Stage
from tests.examples import examples

M = np.array([[1.03, 0.01, -0.02], [0.005, 0.98, 0.015], [-0.01, 0.02, 1.04]])
B = np.array([0.0132, -0.0084, 0.0057])
W = np.radians(90.0)
WAYS = [sign * np.eye(3)[axis] for axis in range(3) for sign in (1.0, -1.0)]
LABELS = [f"{axis}{sign}" for axis in "xyz" for sign in "+-"]


def turned(rng, ways=WAYS, rate=W, sd=0.002, turning=8.0, resting=4.0, hz=50.0):
    """Turns with rests between them, as a channel with its labelled turns."""
    pieces, segments, t = [], [], 0.0
    for k, way in enumerate(ways):
        pieces += [np.zeros((int(resting * hz), 3)), np.tile(rate * way, (int(turning * hz), 1))]
        segments.append(Segment(LABELS[k] if len(ways) == 6 else f"turn{k}", t + resting, t + resting + turning))
        t += resting + turning
    true = np.vstack([*pieces, np.zeros((int(resting * hz), 3))])
    values = true @ M.T + B + sd * rng.normal(size=true.shape)
    gyro = Channel(Sensor.GYRO, 0, np.arange(len(true)) / hz, values, "rad/s", Stage.RAW, "test")
    return gyro, tuple(segments)


def test_the_columns_and_the_offset_of_labelled_turns():
    gyro, segments = turned(np.random.default_rng(1))
    fit = fit_turntable(gyro, W, segments=segments)
    assert fit.status == FitStatus.OK
    truth = np.concatenate([B, np.linalg.inv(M).ravel()])
    assert np.abs((fit.values - truth) / fit.sd).max() < 4.0
    assert np.array(fit.native["sensitivity"]) == pytest.approx(M, abs=2e-4)
    plus, minus = (np.array(fit.native["turns"][k]["mean"]) for k in (0, 1))
    assert fit.native["columns"]["x"] == pytest.approx((plus - minus) / (2 * W), abs=2e-5)  # METHODS S3
    assert fit.quality["dof"] == 6
    assert fit.quality["p_value"] > 1e-3
    assert fit.quality["attitude_sd_deg_per_min"] > 0.0


def test_turns_are_found_without_labels():
    gyro, segments = turned(np.random.default_rng(2))
    spans = steady_spans(gyro)
    assert len(spans) == 6
    assert np.abs(spans - [[s.start, s.end] for s in segments]).max() < 0.8
    assert fit_turntable(gyro, W).model.matrix == pytest.approx(np.linalg.inv(M), abs=3e-4)


def test_the_stated_uncertainty_holds():
    squares = []
    for seed in range(30):
        rng = np.random.default_rng([3, seed])
        gyro, segments = turned(rng, turning=3.0, resting=1.0)
        error = fit_turntable(gyro, W, segments=segments)
        truth = np.linalg.inv(M).ravel()
        squares.append(((error.model.matrix.ravel() - truth) / error.sd[3:]) ** 2)
    assert 0.75 < np.mean(squares) < 1.3  # 270 of them


def test_a_rate_that_is_not_exact_widens_the_scale():
    gyro, segments = turned(np.random.default_rng(4))
    exact, doubted = (fit_turntable(gyro, W, segments=segments, rate_sd=sd) for sd in (0.0, 0.01))
    assert any("--rate-sd" in text for text in exact.warnings)
    assert doubted.sd[3] == pytest.approx(0.01 / W / np.sqrt(2.0) / 1.03, rel=0.1)
    assert doubted.sd[3] > 20.0 * exact.sd[3]


def test_rates_by_label_with_a_rest():
    gyro, _ = turned(np.random.default_rng(5), ways=[np.eye(3)[2]])
    segments = (Segment("rest", 0.0, 4.0), Segment("forth", 4.0, 12.0))
    fit = fit_turntable(gyro, {"rest": 0.0, "forth": W}, segments=segments)
    assert fit.status == FitStatus.PARTIAL
    assert fit.native["scale"]["z"] == pytest.approx(1.04, abs=1e-3)
    assert "matrix_xx" in fit.undetermined
    assert "both ways" in fit.movements["matrix_xx"]
    with pytest.raises(InvalidInputError, match="no segment back"):
        fit_turntable(gyro, {"back": 1.0}, segments=segments)


def test_run_up_and_stop_inside_a_label_are_cut_off():
    gyro, segments = turned(np.random.default_rng(6))
    wide = tuple(Segment(s.label, s.start - 1.0, s.end + 1.0) for s in segments)
    fit = fit_turntable(gyro, W, segments=wide)
    assert np.array(fit.native["sensitivity"]) == pytest.approx(M, abs=5e-4)


def test_the_earth_turns_too():
    gyro, segments = turned(np.random.default_rng(7), sd=1e-6)
    up = Channel(Sensor.ACCEL, 0, gyro.t, np.tile([0.0, 0.0, -9.8], (len(gyro), 1)), "m/s2", Stage.RAW, "test")
    earth = M @ [0.0, 0.0, -EARTH_RATE]  # at the pole, about up
    moved = dataclasses.replace(gyro, values=gyro.values + earth)
    unknown = fit_turntable(moved, W, segments=segments, accel=up)
    known = fit_turntable(moved, W, segments=segments, accel=up, latitude=90.0)
    assert unknown.model.offset - B == pytest.approx(earth, abs=1e-6)
    assert np.abs((unknown.model.offset - B) / unknown.sd[:3]).max() < 3.0
    assert known.model.offset == pytest.approx(B, abs=1e-6)
    assert known.sd[2] < 1e-6


def test_what_cannot_be_told_is_refused():
    gyro, segments = turned(np.random.default_rng(8), ways=[np.eye(3)[0], np.eye(3)[0]])
    one_way = fit_turntable(gyro, W, segments=segments)
    assert one_way.status == FitStatus.REFUSED
    assert "not told apart" in one_way.message
    assert "both ways" in one_way.movements["matrix_xx"]
    assert fit_turntable(gyro.between(0.0, 3.0), W).status == FitStatus.REFUSED
    full, labels = turned(np.random.default_rng(9))
    wrong = fit_turntable(full, 4.0 * W, segments=labels)
    assert wrong.status == FitStatus.REFUSED
    assert "check the rate" in wrong.message
    dead = dataclasses.replace(full, values=np.full_like(full.values, np.nan))
    assert fit_turntable(dead, W, segments=labels).status == FitStatus.REFUSED
    for rate in (0.0, np.nan):
        with pytest.raises(InvalidInputError, match="rate"):
            fit_turntable(full, rate)
    with pytest.raises(InvalidInputError, match="latitude"):
        fit_turntable(full, W, latitude=91.0)


@settings(max_examples=examples(15))
@given(factor=st.floats(0.6, 1.6), shift=st.floats(-0.05, 0.05), later=st.floats(0.0, 1e6))
def test_scaling_and_shifting_the_data_moves_the_answer_accordingly(factor, shift, later):
    gyro, segments = turned(np.random.default_rng(10), turning=3.0, resting=1.0)
    fit = fit_turntable(gyro, W, segments=segments)
    moved = dataclasses.replace(gyro, values=factor * gyro.values + shift, t=gyro.t + later)
    spans = tuple(Segment(s.label, s.start + later, s.end + later) for s in segments)
    other = fit_turntable(moved, W, segments=spans)
    assert other.model.offset == pytest.approx(factor * fit.model.offset + shift, abs=1e-5)
    assert other.model.matrix == pytest.approx(fit.model.matrix / factor, abs=1e-4)


@pytest.mark.shared
@pytest.mark.parametrize(
    ("file", "bias"),
    [
        ("sitl_captures/turntable.tlog", (0.0132, -0.0084, 0.0057)),
        ("px4_captures/bench_turn.tlog", (0.0132, -0.0284, 0.0057)),
    ],
)
def test_turns_of_real_firmware(shared_data, file, bias):
    fits = METHODS["gyro-turntable"].run(read(shared_data / file), {"rate_true": "90", "instance": 0})
    assert fits[0].status == FitStatus.OK
    assert 1.0 / np.diag(fits[0].model.matrix) == pytest.approx([1.03, 0.98, 1.04], abs=1e-4)
    assert fits[0].model.offset == pytest.approx(bias, abs=5e-5)
