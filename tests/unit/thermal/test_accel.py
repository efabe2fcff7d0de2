from __future__ import annotations

import dataclasses
import itertools
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Channel, Recording, Sensor, Stage
from mavcal.calib.report import to_json
from mavcal.calib.stats.stillness import Still, find_still
from mavcal.calib.thermal.accel import fit_accel_thermal
from mavcal.calib.thermal.accel_solve import within_poses

G = 9.80665
FACES = np.array([[0, 0, -1], [0, 0, 1], [0, 1, 0], [0, -1, 0], [1, 0, 0], [-1, 0, 0]], dtype=float)
OBLIQUE = np.array([[1, 1, -1], [1, -1, -1], [-1, 1, 1], [-1, -1, -1], [1, 0, 1], [0, 1, 1]], dtype=float)
OBLIQUE /= np.linalg.norm(OBLIQUE, axis=1)[:, None]
ROUND = np.vstack([FACES, OBLIQUE])
TWICE = np.vstack([ROUND, ROUND[::-1]])
MATRIX = np.array([[1.01, 0.004, -0.003], [0.004, 0.985, 0.002], [-0.003, 0.002, 1.002]])  # C, symmetric
OFFSET = np.array([0.2, -0.1, 0.3])
DRIFT = np.array([[7e-3, 1.5e-4], [-4e-3, -1e-4], [9e-3, 2e-4]])


def warming(u):
    return 40.0 - 20.0 * np.exp(-2.0 * u)


def held(rng, directions=TWICE, temperature=warming, *, noise=0.03, hold=3.0, tilt=2.0, drift=DRIFT, scale=0.0):
    """Poses held with a tilt that nobody knows; `scale` moves per degC. Samples, spans and thermometer."""
    rate, n = 50.0, int(hold * 50.0)
    t = np.arange(len(directions) * n) / rate + np.repeat(np.arange(len(directions)), n) * 1.0
    T = temperature(t / t[-1])
    turned = [Rotation.from_rotvec(np.radians(tilt) * rng.normal(size=3)).apply(d) for d in directions]
    force = np.repeat(G * np.array(turned) @ np.linalg.inv(MATRIX).T, n, axis=0)
    x = (T - 35.0)[:, None]
    values = force * (1.0 + scale * x) + OFFSET + sum(drift[:, j] * x ** (j + 1) for j in range(drift.shape[1]))
    values = values + noise * rng.normal(size=values.shape)
    stills = tuple(Still(t[k * n] - 1e-6, t[(k + 1) * n - 1] + 1e-6, None, None) for k in range(len(directions)))
    accel = Channel(Sensor.ACCEL, 0, t, values, "m/s2", Stage.RAW, "test")
    return accel, stills, Channel(Sensor.TEMPERATURE, 0, t, T[:, None], "degC", Stage.RAW, "test")


TRUTH = np.concatenate([OFFSET, MATRIX.ravel(), DRIFT.ravel()])
FREE = [i for i in range(18) if i not in (6, 9, 10)]  # the symmetric matrix counts once


def nees(fit):
    error = (fit.values - TRUTH)[FREE]
    return float(error @ np.linalg.solve(fit.covariance[np.ix_(FREE, FREE)], error)) / len(FREE)


def test_exact_data_give_the_exact_sensor():
    fit = fit_accel_thermal(*held(np.random.default_rng(1), noise=0.0), t_ref=35.0, cross_sd=None)
    assert fit.status == FitStatus.OK
    assert fit.values == pytest.approx(TRUTH, abs=2e-6)


@pytest.mark.long
def test_errors_are_those_of_the_covariance():
    rng = np.random.default_rng(2)
    fits = [fit_accel_thermal(*held(rng, hold=2.0), t_ref=35.0, cross_sd=None) for _ in range(40)]
    assert np.mean([nees(f) for f in fits]) == pytest.approx(1.0, abs=0.25)
    inside = [np.abs((f.values - TRUTH)[FREE] / f.sd[FREE]) < 1.96 for f in fits]
    assert np.mean(inside) > 0.92
    assert 0.2 < np.median([f.quality["p_value"] for f in fits]) < 0.85


def test_ignoring_the_temperature_or_its_square_is_noticed():
    rng = np.random.default_rng(3)
    data = held(rng, drift=np.array([[2e-2, 2e-3], [-2e-2, -2e-3], [2e-2, 2e-3]]))
    assert fit_accel_thermal(*data).quality["p_value"] > 1e-3
    line = fit_accel_thermal(*data, degree=1)
    assert line.quality["p_value"] < 1e-3
    assert any("needs a higher degree" in w for w in line.warnings)


def test_scipy_finds_the_same_maximum_between_poses():
    rng = np.random.default_rng(4)
    K = len(TWICE)
    accel, stills, thermometer = held(rng, hold=2.0, temperature=lambda u: 20.0 + np.floor(u * K - 1e-9) * 20.0 / K)
    fit = fit_accel_thermal(accel, stills, thermometer, t_ref=35.0, cross_sd=None)
    means = np.array([accel.between(s.start, s.end).values.mean(axis=0) for s in stills])
    at = np.array([thermometer.between(s.start, s.end).values.mean() for s in stills])
    d = (at - 35.0)[:, None]

    def cost(p):
        c = p[3:9]
        C = np.array([[c[0], c[3], c[4]], [c[3], c[1], c[5]], [c[4], c[5], c[2]]])
        return np.linalg.norm((means - p[:3] - d * p[9:12] - d**2 * p[12:15]) @ C, axis=1) - G

    start = np.concatenate([np.zeros(3), np.ones(3), np.zeros(9)])
    x = least_squares(cost, start, x_scale=[1] * 3 + [0.01] * 6 + [1e-2] * 3 + [1e-3] * 3, xtol=1e-14).x
    assert fit.model.offset == pytest.approx(x[:3], abs=0.5 * fit.sd[:3].min())
    assert fit.model.polynomial.coefficients[:, 0] == pytest.approx(x[9:12], abs=0.5 * fit.sd[12])
    assert np.diag(fit.model.matrix) == pytest.approx(x[3:6], abs=0.5 * fit.sd[3])


def test_what_shows_within_long_poses_is_used():
    rng = np.random.default_rng(5)
    short, long = (fit_accel_thermal(*held(rng, ROUND, hold=h), cross_sd=None) for h in (2.0, 30.0))
    assert long.quality["within_samples"] > 10_000
    assert long.sd[12:].max() < 0.3 * short.sd[12:].max()


def test_each_face_once_is_said_to_confound():
    rng = np.random.default_rng(6)
    once = fit_accel_thermal(*held(rng, ROUND, lambda u: 30.0 + 15.0 * u), cross_sd=None)
    twice = fit_accel_thermal(*held(rng, TWICE), cross_sd=None)
    assert twice.quality["confounding"] < 4.0 < once.quality["confounding"]
    assert any("opposite order" in w for w in once.warnings)
    assert not twice.warnings


def test_six_faces_leave_the_cross_terms_to_the_prior():
    fit = fit_accel_thermal(*held(np.random.default_rng(7), np.vstack([FACES, FACES[::-1]]), tilt=0.0), t_ref=35.0)
    assert fit.status == FitStatus.OK
    assert {"matrix_xy", "matrix_yx"} <= set(fit.undetermined)
    assert "obliquely between x and y" in fit.movements["matrix_xy"]
    known = [i for i in range(18) if fit.sd[i] > 0]
    assert np.abs((fit.values - TRUTH)[known] / fit.sd[known]).max() < 4.5


def test_a_face_that_is_missing_is_named():
    half = np.array([d for d in TWICE if abs(d[2]) < 0.1] * 2)
    fit = fit_accel_thermal(*held(np.random.default_rng(8), half, lambda u: 20.0 + np.floor(u * 15.999), tilt=0.0))
    assert fit.status == FitStatus.REFUSED
    assert "hold it on its back and level" in fit.message


def test_faces_at_one_temperature_only_leave_their_drift_open():
    cold = FACES[:2].repeat(2, axis=0)
    half = np.vstack([cold, FACES[2:], FACES[2:], FACES[2:]])

    def steps(u):
        pose = np.floor(u * 62.98 / 4.0 + 1e-9)  # three seconds and one of turning
        return np.where(pose < 4, 20.0, 20.0 + 5.0 * np.floor((pose - 4) / 4))

    fit = fit_accel_thermal(*held(np.random.default_rng(8), half, steps, tilt=0.0), degree=1, t_ref=20.0, cross_sd=0.0)
    assert fit.status == FitStatus.PARTIAL
    assert "poly1_z" in fit.undetermined
    assert "hold z up and down again at another temperature" in fit.movements["poly1_z"]
    assert not {"offset_x", "offset_y", "poly1_x", "poly1_y"} & set(fit.undetermined)
    slope = DRIFT[:2, 0] - 20.0 * DRIFT[:2, 1]
    assert fit.model.polynomial.coefficients[:2, 0] == pytest.approx(slope, abs=2e-3)


def test_a_scale_that_moves_is_reported():
    still, moving = (fit_accel_thermal(*held(np.random.default_rng(9), scale=s)) for s in (0.0, 3e-4))
    assert moving.native["scale_per_degc"] == pytest.approx([3e-4] * 3, abs=1.5e-4)
    assert any("scale moves with temperature" in w for w in moving.warnings)
    assert not any("scale moves" in w for w in still.warnings)


@pytest.mark.long
@settings(max_examples=5)
@given(scale=st.floats(0.1, 1e4), seed=st.integers(0, 100))
def test_counts_find_their_own_scale(scale, seed):
    accel, stills, thermometer = held(np.random.default_rng(seed), hold=1.0)
    counts = dataclasses.replace(accel, values=scale * accel.values, unit="counts")
    one = fit_accel_thermal(accel, stills, thermometer, t_ref=30.0, cross_sd=None)
    other = fit_accel_thermal(counts, stills, thermometer, t_ref=30.0, cross_sd=None)
    assert other.model.offset / scale == pytest.approx(one.model.offset, abs=0.1 * one.sd[:3].min())
    assert other.model.matrix * scale == pytest.approx(one.model.matrix, abs=0.1 * one.sd[3])


def test_through_the_method_with_json():
    accel, _, thermometer = held(np.random.default_rng(10), hold=4.0)
    recording = Recording((accel, thermometer))
    (fit,) = METHODS["accel-thermal"].run(recording, {"tref": 35.0, "cross_sd": 0.02})
    assert len(find_still(recording)) == 24
    assert fit.status == FitStatus.OK
    assert np.abs((fit.values - TRUTH)[FREE] / fit.sd[FREE]).max() < 4.5
    assert 0.0 < fit.quality["attitude_sd_deg"] < 0.5
    json.dumps(to_json(fit), allow_nan=False)
    with pytest.raises(InvalidInputError, match="--map temperature"):
        METHODS["accel-thermal"].run(Recording((accel,)))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda a, s, t: (a, s[:3], t), "3 still poses"),
        (lambda a, s, t: (a, s, dataclasses.replace(t, values=np.full_like(t.values, 30.0))), "moved by 0.00 degC"),
        (lambda a, s, t: (a, s, dataclasses.replace(t, values=np.full_like(t.values, np.nan))), "no finite sample"),
        (lambda a, s, t: (dataclasses.replace(a, values=a.values / G), s, t), "not gravity"),
        (lambda a, s, t: (dataclasses.replace(a, values=np.full_like(a.values, np.nan)), s, t), "24 still poses"),
        (lambda a, s, t: (dataclasses.replace(a, values=np.ones_like(a.values) * 5.7), s, t), "on one sphere"),
        (lambda a, s, t: (dataclasses.replace(a, values=np.zeros_like(a.values)), s, t), "not gravity"),
        (
            lambda a, s, t: (dataclasses.replace(a, values=np.zeros_like(a.values), unit="counts"), s, t),
            "not gravity",
        ),
    ],
)
def test_what_determines_nothing_is_refused(change, says):
    fit = fit_accel_thermal(*change(*held(np.random.default_rng(11))))
    assert fit.status == FitStatus.REFUSED
    assert says in fit.message
    assert set(fit.movements) == set(fit.names)


def test_impossible_options_are_errors():
    data = held(np.random.default_rng(12))
    with pytest.raises(InvalidInputError, match="degree"):
        fit_accel_thermal(*data, degree=4)
    with pytest.raises(InvalidInputError, match="gravity"):
        fit_accel_thermal(*data, gravity=-1.0)
    with pytest.raises(InvalidInputError, match="cross terms"):
        fit_accel_thermal(*data, cross_sd=-1.0)


RATE = 50.0


def poses(*parts):
    """A channel of still poses, each (samples, first temperature, last one), with their scaled temperatures."""
    rng = np.random.default_rng(11)
    x = np.concatenate([np.linspace(low, high, n) for n, low, high in parts])
    edges = np.cumsum([0, *(n for n, _, _ in parts)])
    t = np.arange(len(x)) / RATE
    stills = [Still(t[i] - 1e-6, t[j - 1] + 1e-6, None, None) for i, j in itertools.pairwise(edges)]
    offsets = np.repeat(rng.normal(size=(len(parts), 3)), [n for n, _, _ in parts], axis=0)
    values = offsets + x[:, None] * [0.3, -0.2, 0.1] + 1e-3 * rng.normal(size=(len(x), 3))
    return Channel(Sensor.ACCEL, 0, t, values, "m/s2", Stage.RAW, "test"), x, stills


@pytest.mark.parametrize(
    ("pose", "used"),
    [
        ((16, 0.0, 0.1), True),
        ((15, 0.0, 0.1), False),  # too short to have a slope of its own
        ((100, 0.5, 0.519), False),  # 1.9 % of the span: a hand's sway is all that it shows
        ((100, 0.5, 0.521), True),
        ((100, 0.521, 0.5), True),
    ],
)
def test_short_poses_and_those_that_stay_as_warm_tell_nothing_of_the_drift_within(pose, used):
    accel, x, stills = poses((200, 0.0, 0.4), (200, 0.6, 1.0), pose)
    found = within_poses(accel, x, stills, 1)
    assert found.n == 400 + used * pose[0]
    np.testing.assert_allclose(found.coefficients, [[0.3, -0.2, 0.1]], atol=2e-3)
    longer = within_poses(accel, 2.0 * x, stills, 1)  # of the span, whatever its unit
    assert longer.n == found.n


def test_where_no_pose_warms_nothing_is_told():
    accel, x, stills = poses((200, 0.0, 0.001), (200, 1.0, 1.001))
    found = within_poses(accel, x, stills, 2)
    assert (found.n, found.coefficients.any(), found.information.any()) == (0, False, False)
    assert found.information.shape == (3, 2, 2)


@pytest.mark.parametrize(("samples", "used"), [(63, 0), (64, 64)])
def test_fewer_samples_than_64_tell_nothing_within(samples, used):
    assert within_poses(*poses((samples, 0.0, 1.0)), 1).n == used


def test_the_information_within_is_that_of_the_noise_left_there():
    accel, x, stills = poses((4000, 0.0, 1.0), (4000, 0.0, 1.0))
    found = within_poses(accel, x, stills, 1)
    sd = 1.0 / np.sqrt(found.information[:, 0, 0])
    np.testing.assert_allclose(sd, 1e-3 / np.sqrt(8000 / 12.0), rtol=0.35)
