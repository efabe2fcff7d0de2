"""Magnetometer against accelerometer: digits, bound, a second route, lag, and what cannot be told."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation, RotationSpline

from mavcal.calib.errors import InvalidInputError, UndeterminedError
from mavcal.calib.fit import FitStatus
from mavcal.calib.mag.align import Vertical, fit_alignment
from mavcal.calib.mag.align_solve import AlignmentNoise, align, linear_start
from tests.fields import field_of

G = 9.80665
STRENGTH, DIP = 49.0, math.radians(66.0)
FIELD = field_of(STRENGTH, DIP)
OFFSET = np.array([12.0, -8.5, 21.0])
SOFT = np.array([[1.08, 0.03, -0.02], [0.03, 0.95, 0.04], [-0.02, 0.04, 1.02]])
MATRIX = SOFT @ Rotation.from_rotvec(np.radians([3.0, 3.2, -2.4])).as_matrix()
TRUTH = np.concatenate([OFFSET, np.linalg.inv(MATRIX).ravel()])
NOISE, TREMOR = 0.3, 0.003  # uT; rad


def seen(attitudes: Rotation, rng: Any, dip: float = DIP, noise: float = NOISE, tremor: float = TREMOR) -> Any:
    """Times, samples and accelerations of a vehicle held in `attitudes` (body to north-east-down)."""
    back = attitudes.inv()
    field = back.apply(STRENGTH * np.array([math.cos(dip), 0.0, math.sin(dip)]))
    accel = back.apply([0.0, 0.0, -G]) + tremor * G * rng.normal(size=field.shape)
    samples = field @ MATRIX.T + OFFSET + noise * rng.normal(size=field.shape)
    return 0.02 * np.arange(len(field)), samples, accel


def anywhere(count: int, rng: Any) -> Rotation:
    return Rotation.random(count, random_state=rng)


def fitted(data: Any, **options: Any) -> Any:
    t, samples, accel = data
    return fit_alignment(t, samples, Vertical(t, accel), **{"field": FIELD, **options})


def test_the_digits_of_the_rotation() -> None:
    """METHODS 3.2: Q = 5 degrees about z, dip 60: .9961946981, .0871557427, sine .8660254038."""
    down = anywhere(100, np.random.default_rng(1)).apply([0.0, 0.0, 1.0])
    east = np.cross(down, np.roll(down, 1, axis=0))
    north = np.cross(east / np.linalg.norm(east, axis=1)[:, None], down)
    field = 0.5 * north + math.sqrt(0.75) * down
    Q = Rotation.from_euler("z", 5, degrees=True).as_matrix()
    t = np.arange(100.0)
    fit = fit_alignment(t, 50.0 * field @ Q, Vertical(t, -G * down, timed=False))
    rotation = np.array(fit.native["rotation"])
    assert rotation[0, 0] == pytest.approx(0.9961946981, abs=1e-9)
    assert rotation[1, 0] == pytest.approx(0.0871557427, abs=1e-9)
    assert fit.native["sin_dip"] == pytest.approx(0.8660254038, abs=1e-9)
    assert fit.quality["mounting_deg"] == pytest.approx(5.0, abs=1e-7)


def information_at_truth(attitudes: Rotation) -> Any:
    """Fisher information (12, 12) on offset and correction matrix with each attitude, and the dip, eliminated."""

    def forward(theta: Any, turns: Any) -> Any:
        back = (attitudes * Rotation.from_rotvec(turns)).inv()
        field = back.apply(STRENGTH * np.array([math.cos(theta[12]), 0.0, math.sin(theta[12])]))
        samples = np.linalg.solve(theta[3:12].reshape(3, 3), field.T).T + theta[:3]
        return np.hstack([samples / NOISE, back.apply([0.0, 0.0, 1.0]) / TREMOR])

    def slope(k: int, of: Any, size: int, step: float) -> Any:
        change = np.zeros(size)
        change[k] = step
        return (of(change) - of(-change)) / (2.0 * step)

    n, truth = len(attitudes), np.append(TRUTH, DIP)
    rows = np.stack([slope(k, lambda d: forward(truth + d, np.zeros((n, 3))), 13, 1e-5) for k in range(13)], axis=2)
    nuisance = np.stack([slope(k, lambda d: forward(truth, np.tile(d, (n, 1))), 3, 1e-5) for k in range(3)], axis=2)
    own = np.einsum("nij,nik->njk", nuisance, nuisance)
    cross = np.einsum("nij,nik->njk", nuisance, rows)
    whole = np.einsum("nij,nik->jk", rows, rows) - np.einsum("nji,njk->ik", cross, np.linalg.solve(own, cross))
    return whole[:12, :12] - np.outer(whole[:12, 12], whole[12, :12]) / whole[12, 12]


@pytest.mark.long
def test_angle_and_offset_attain_the_joint_bound() -> None:
    rng = np.random.default_rng(2)
    runs, angle, offset, all_of_it, nees = 60, 0.0, 0.0, 0.0, 0.0
    for _ in range(runs):
        attitudes = anywhere(300, rng)
        fit = fitted(seen(attitudes, rng))
        information = information_at_truth(attitudes)
        bound = np.linalg.inv(information)
        error = fit.values - TRUTH
        offset += error[:3] @ np.linalg.solve(bound[:3, :3], error[:3]) / 3.0
        turn = MATRIX.T @ error[3:].reshape(3, 3).T  # (dC M)^T: its skew part turns the corrected field
        angle += float(np.sum(np.triu(turn - turn.T) ** 2)) / _turn_variance(bound)
        all_of_it += error @ information @ error / 12.0
        nees += error @ np.linalg.solve(fit.covariance, error) / 12.0
    assert math.sqrt(angle / runs) <= 1.10 + 2.0 / math.sqrt(2 * runs * 3)
    assert math.sqrt(offset / runs) <= 1.10 + 2.0 / math.sqrt(2 * runs * 3)
    assert math.sqrt(all_of_it / runs) <= 1.10 + 2.0 / math.sqrt(2 * runs * 12)
    assert nees / runs == pytest.approx(1.0, abs=4.0 * math.sqrt(2.0 / (12 * runs)))


def _turn_variance(bound: Any) -> float:
    """Expectation of the squared skew part of ``(dC M)^T`` under the covariance `bound`."""
    total = 0.0
    for i, j in ((0, 1), (0, 2), (1, 2)):
        row = np.zeros(12)
        for k in range(3):
            row[3 + 3 * j + k] += MATRIX[k, i]
            row[3 + 3 * i + k] -= MATRIX[k, j]
        total += float(row @ bound @ row)
    return total


def test_the_second_route_is_maximum_likelihood_with_every_attitude_as_an_unknown() -> None:
    rng = np.random.default_rng(3)
    attitudes = anywhere(40, rng)
    _, samples, accel = seen(attitudes, rng)
    down = -accel / np.linalg.norm(accel, axis=1)[:, None]
    field = (samples - OFFSET) / STRENGTH
    found = align(
        field, down, linear_start(field, down), AlignmentNoise(NOISE / STRENGTH, TREMOR), AlignmentNoise(0.0, 0.0)
    )

    def residuals(x: Any) -> Any:
        B, b, dip = x[:9].reshape(3, 3), x[9:12], x[12]
        back = (attitudes * Rotation.from_rotvec(x[13:].reshape(-1, 3))).inv()
        true = back.apply([math.cos(dip), 0.0, math.sin(dip)])
        of_field = (np.linalg.solve(B, true.T).T + b - field) / (NOISE / STRENGTH)
        return np.concatenate([of_field.ravel(), ((back.apply([0.0, 0.0, 1.0]) - down) / TREMOR).ravel()])

    start = np.concatenate([np.linalg.inv(MATRIX).ravel(), np.zeros(3), [DIP], np.zeros(120)])
    best = least_squares(residuals, start, method="lm", xtol=1e-14, ftol=1e-14).x
    other = np.append(best[:12], math.sin(best[12]))
    sd = np.sqrt(np.diag(np.linalg.inv(found.information)))
    assert np.abs((found.unknowns - other) / sd).max() < 0.05


def test_the_noises_are_told_apart() -> None:
    rng = np.random.default_rng(4)
    fit = fitted(seen(anywhere(2000, rng), rng))
    assert fit.quality["noise_sd"] == pytest.approx(NOISE, rel=0.05)
    assert math.radians(fit.quality["vertical_noise_deg"]) == pytest.approx(TREMOR, rel=0.3)
    assert fit.quality["dip_deg"] == pytest.approx(66.0, abs=4.0 * fit.quality["dip_sd_deg"])
    assert fit.quality["white"]
    json.dumps({**fit.quality, **fit.native}, allow_nan=False)


def test_the_bias_of_curvature_is_taken_out() -> None:
    """Without it the sine of the dip is a standard deviation off at 20 000 samples."""
    z = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        _, samples, accel = seen(anywhere(10_000, rng), rng, noise=1.0)
        field, down = (samples - OFFSET) / STRENGTH, -accel / np.linalg.norm(accel, axis=1)[:, None]
        found = align(field, down, linear_start(field, down), None, AlignmentNoise(0.0, 0.0))
        sd = math.sqrt(np.linalg.inv(found.information)[12, 12])
        z.append((found.unknowns[12] - math.sin(DIP)) / sd)
    assert abs(np.mean(z)) < 3.0 / math.sqrt(len(z))


def moving(rng: Any, lag: float, *, gyro: bool, seconds: float = 30.0) -> Any:
    """A vehicle turned by hand at 1 rad/s, compass at 50 Hz and `lag` late, accelerometer at 100 Hz."""
    turns = [Rotation.identity()]
    for _ in range(int(seconds) + 3):
        turns.append(turns[-1] * Rotation.from_rotvec(0.6 * rng.normal(size=3)))
    motion = RotationSpline(np.arange(len(turns)) - 1.0, Rotation.concatenate(turns))
    t, slow = np.arange(0.0, seconds, 0.01), np.arange(0.5, seconds - 0.5, 0.02)
    _, samples, _ = seen(motion(slow - lag), rng)
    _, _, accel = seen(motion(t), rng)
    rates = motion(t, 1) if gyro else None
    return slow, samples, Vertical(t, accel, gyro_t=t if gyro else None, gyro=rates)


@pytest.mark.parametrize(("lag", "gyro"), [(0.0, False), (0.03, False), (-0.08, True)])
def test_a_time_offset_is_found_and_taken_out(lag: float, gyro: bool) -> None:
    fit = fit_alignment(*moving(np.random.default_rng(5), lag, gyro=gyro), field=FIELD)
    found = fit.quality["time_offset"] + fit.quality["time_offset_left"]
    assert abs(found - lag) < 4.0 * fit.quality["time_offset_sd"]
    assert fit.quality["time_offset_sd"] < 0.002
    assert np.abs((fit.values - TRUTH) / fit.sd).max() < 4.5
    assert bool(fit.quality["time_offset"]) == (lag != 0.0)


def test_a_stated_time_offset_is_not_searched() -> None:
    fit = fit_alignment(*moving(np.random.default_rng(6), 0.03, gyro=False), field=FIELD, time_offset=0.03)
    assert fit.quality["time_offset"] == 0.03
    assert fit.quality["time_offset_left"] is None
    assert np.abs((fit.values - TRUTH) / fit.sd).max() < 4.5


def test_jolts_are_gated_and_disturbed_samples_left_out() -> None:
    rng = np.random.default_rng(7)
    t, samples, accel = seen(anywhere(1000, rng), rng)
    accel[::50] *= 1.5
    samples[1::50] += 10.0 * rng.normal(size=(20, 3))
    fit = fitted((t, samples, accel))
    assert fit.quality["n_gated"] == 20
    assert 12 <= fit.quality["n_outliers"] <= 22
    assert np.abs((fit.values - TRUTH) / fit.sd).max() < 4.5


@settings(max_examples=10)
@given(
    turn=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    shift=st.tuples(*[st.floats(-200.0, 200.0)] * 3),
    scale=st.floats(0.1, 30.0),
    seed=st.integers(0, 5),
)
def test_moved_data_move_the_answer(turn: Any, shift: Any, scale: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    t, samples, accel = seen(anywhere(120, rng), rng)
    R = Rotation.from_rotvec(turn).as_matrix()
    base = fitted((t, samples, accel))
    moved = fitted((t, scale * samples @ R.T + shift, accel))
    expected = scale * R @ base.model.offset + shift
    assert np.abs(moved.model.offset - expected).max() < 0.03 * scale * base.sd[:3].max() + 1e-6
    assert np.abs(scale * moved.model.matrix @ R - base.model.matrix).max() < 0.03 * base.sd[3:].max()


def test_the_southern_hemisphere_and_the_magnetic_equator() -> None:
    for dip in (-DIP, 0.0):
        rng = np.random.default_rng(8)
        fit = fitted(seen(anywhere(500, rng), rng, dip=dip))
        assert np.abs((fit.values - TRUTH) / fit.sd).max() < 4.5
        assert fit.quality["dip_deg"] == pytest.approx(math.degrees(dip), abs=0.2)


@pytest.mark.parametrize("dip_deg", [90.0, -89.0])
def test_a_vertical_field_shows_no_rotation(dip_deg: float) -> None:
    rng = np.random.default_rng(9)
    fit = fitted(seen(anywhere(1000, rng), rng, dip=math.radians(dip_deg)))
    assert fit.status == FitStatus.REFUSED
    assert "of the vertical" in fit.message or "does not determine" in fit.message
    assert "magnetic pole" in fit.message or "turn the vehicle" in fit.message


def test_one_axis_alone_is_refused_with_the_movement() -> None:
    rng = np.random.default_rng(10)
    level = Rotation.from_euler("z", rng.uniform(0, 360, (400, 1)), degrees=True)
    fit = fitted(seen(level, rng))
    assert fit.status == FitStatus.REFUSED
    assert "top-bottom axis points up and down" in fit.message


def test_little_tilt_says_so() -> None:
    rng = np.random.default_rng(11)
    angles = np.column_stack([rng.uniform(0, 360, 300), *rng.uniform(-4.0, 4.0, (2, 300))])
    fit = fitted(seen(Rotation.from_euler("ZYX", angles, degrees=True), rng))
    if fit.status == FitStatus.REFUSED:
        assert "axis" in fit.message
    else:
        assert np.abs((fit.values - TRUTH) / fit.sd).max() < 4.5


def test_a_vehicle_that_is_shaken_has_no_vertical() -> None:
    rng = np.random.default_rng(12)
    t, samples, accel = seen(anywhere(200, rng), rng)
    fit = fitted((t, samples, 3.0 * accel))
    assert fit.status == FitStatus.REFUSED
    assert "show the vertical" in fit.message


def test_noise_is_no_field() -> None:
    rng = np.random.default_rng(13)
    t, _, accel = seen(anywhere(200, rng), rng)
    fit = fitted((t, 50.0 * rng.normal(size=(200, 3)), accel))
    assert fit.status == FitStatus.REFUSED


@pytest.mark.parametrize(
    "change",
    [
        {"gate": 0.0},
        {"time_offset": math.nan},
        {"samples": np.full((200, 3), math.inf)},
        {"samples": np.ones((200, 2))},
        {"t": np.arange(200.0)[::-1]},
        {"t": np.arange(100.0)},
        {"vertical": {"gravity": -1.0}},
        {"vertical": {"accel": np.full((200, 3), math.nan)}},
    ],
)
def test_impossible_input(change: Any) -> None:
    rng = np.random.default_rng(14)
    t, samples, accel = seen(anywhere(200, rng), rng)
    given_vertical = Vertical(**{"t": t, "accel": accel, **change.pop("vertical", {})})
    with pytest.raises(InvalidInputError):
        fit_alignment(**{"t": t, "samples": samples, "vertical": given_vertical, **change})


@pytest.mark.parametrize("samples", [np.ones((200, 3)), np.eye(3)])
def test_refused(samples: Any) -> None:
    t = np.arange(float(len(samples)))
    fit = fit_alignment(t, samples, Vertical(t, np.tile([0.0, 0.0, -G], (len(t), 1))))
    assert fit.status == FitStatus.REFUSED


def test_no_start_is_typed() -> None:
    down = np.tile([0.0, 0.0, 1.0], (50, 1))
    with pytest.raises(UndeterminedError):
        align(np.full((50, 3), 0.1), down, linear_start(np.zeros((50, 3)), down), None, AlignmentNoise(0.0, 0.0))
