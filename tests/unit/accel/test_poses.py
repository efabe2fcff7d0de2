from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from mavcal.calib.accel.poses import fit_one_axis, fit_poses
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.recording import Channel, Sensor, Stage
from mavcal.calib.stats.stillness import PoseMean, Still, find_still, pose_means
from mavcal.calib.triad import TriadModel
from tests.examples import examples

G = 9.80665
TRUTH = TriadModel(
    offset=[0.31, -0.22, 0.17], matrix=np.array([[0.979, 0.004, -0.003], [0.004, 1.016, 0.002], [-0.003, 0.002, 0.987]])
)
FACES = np.vstack([np.eye(3), -np.eye(3)])
SYMMETRIC = [0, 1, 2, 3, 7, 11, 4, 5, 8]  # of the twelve parameters: b, diagonal, upper triangle


def directions(rng, oblique):
    tilted = FACES + rng.normal(0.0, 0.05, (6, 3))
    d = np.vstack([tilted, rng.normal(size=(oblique, 3))])
    return d / np.linalg.norm(d, axis=1)[:, None]


def poses_of(d, truth=TRUTH, sd=0.0, rng=None, n=100):
    means = truth.invert(G * d)
    if rng is not None:
        means = means + sd * rng.normal(size=means.shape)
    return [PoseMean(2.0 * k, 2.0 * k + 1.5, m, sd**2 * np.eye(3), n) for k, m in enumerate(means)]


def test_exact_poses_give_the_exact_answer():
    fit = fit_poses(poses_of(directions(np.random.default_rng(1), 6)), cross_sd=None)
    assert fit.status == FitStatus.OK
    assert fit.model.offset == pytest.approx(TRUTH.offset, abs=1e-9)
    assert fit.model.matrix == pytest.approx(TRUTH.matrix, abs=1e-9)
    assert fit.residual_rms < 1e-9


def test_scipy_finds_the_same_minimum():
    rng = np.random.default_rng(2)
    poses = poses_of(directions(rng, 6), sd=0.01, rng=rng)
    fit = fit_poses(poses, cross_sd=0.01)
    means = np.array([p.mean for p in poses])

    def residuals(x):
        C = np.array([[x[3], x[6], x[7]], [x[6], x[4], x[8]], [x[7], x[8], x[5]]])
        y = (means - x[:3]) @ C
        u = y / np.linalg.norm(y, axis=1)[:, None]
        return np.append((np.linalg.norm(y, axis=1) - G) / (0.01 * np.linalg.norm(u @ C, axis=1)), x[6:] / 0.01)

    other = least_squares(residuals, [0, 0, 0, 1, 1, 1, 0, 0, 0], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert fit.values[SYMMETRIC] == pytest.approx(other.x, abs=2e-5)
    assert fit.quality["chi2"] == pytest.approx(2.0 * other.cost, rel=1e-3)


@pytest.mark.sampled
@pytest.mark.parametrize(("oblique", "sd"), [(3, 0.002), (6, 0.01)])
def test_the_posterior_is_honest(oblique, sd):
    rng = np.random.default_rng(3)
    nees, p_values, inside = [], [], []
    for _ in range(150):
        S = np.diag(1.0 + rng.uniform(-0.025, 0.025, 3))
        for i, j in ((0, 1), (0, 2), (1, 2)):
            S[i, j] = S[j, i] = rng.normal(0.0, 0.01)
        truth = TriadModel(rng.uniform(-0.4, 0.4, 3), S)
        fit = fit_poses(poses_of(directions(rng, oblique), truth, sd, rng))
        used = [i for i in SYMMETRIC if fit.sd[i] > 0.0]
        error = (fit.values - np.concatenate([truth.offset, S.ravel()]))[used]
        nees.append(error @ np.linalg.solve(fit.covariance[np.ix_(used, used)], error) / len(used))
        inside.append(np.abs(error) < 1.96 * fit.sd[used])
        p_values.append(fit.quality["p_value"])
    assert np.mean(nees) == pytest.approx(1.0, abs=0.15)
    assert np.mean(np.concatenate(inside)) == pytest.approx(0.95, abs=0.025)
    assert 0.35 < np.mean(p_values) < 0.65


def test_six_faces_alone_determine_no_cross_term_and_no_test():
    rng = np.random.default_rng(4)
    fit = fit_poses(poses_of(directions(rng, 0), sd=0.002, rng=rng))
    assert fit.status == FitStatus.OK
    assert set(fit.undetermined) == {f"matrix_{ab}" for ab in ("xy", "yx", "xz", "zx", "yz", "zy")}
    assert fit.model.matrix[0, 1] == 0.0
    assert fit.quality["dof"] == 0
    assert fit.quality["p_value"] is None
    assert any("three oblique" in w for w in fit.warnings)
    assert np.abs((fit.model.offset - TRUTH.offset) / fit.sd[:3]).max() < 4.0
    assert fit.sd[:3].min() > 0.0025  # what the unknown cross terms do to tilted faces is inside


@pytest.mark.long
def test_cross_terms_that_six_faces_do_not_see_are_in_the_covariance():
    rng = np.random.default_rng(15)
    used = [0, 1, 2, 3, 7, 11]
    nees = []
    for _ in range(400):
        S = np.diag(1.0 + rng.uniform(-0.025, 0.025, 3))
        for i, j in ((0, 1), (0, 2), (1, 2)):
            S[i, j] = S[j, i] = rng.normal(0.0, 0.01)
        truth = TriadModel(rng.uniform(-0.4, 0.4, 3), S)
        fit = fit_poses(poses_of(directions(rng, 0), truth, 0.002, rng))
        error = (fit.values - np.concatenate([truth.offset, S.ravel()]))[used]
        nees.append(error @ np.linalg.solve(fit.covariance[np.ix_(used, used)], error) / 6.0)
    assert np.mean(nees) == pytest.approx(1.0, abs=0.12)


def test_cross_terms_may_be_held_at_zero():
    fit = fit_poses(
        poses_of(directions(np.random.default_rng(5), 4), sd=0.002, rng=np.random.default_rng(5)), cross_sd=0.0
    )
    assert fit.undetermined == ()
    assert fit.model.matrix[0, 1] == pytest.approx(0.0, abs=1e-9)
    assert fit.sd[4] == pytest.approx(0.0, abs=1e-8)


def test_the_upper_triangular_form_is_the_same_sensor():
    rng = np.random.default_rng(6)
    poses = poses_of(directions(rng, 6), sd=0.002, rng=rng)
    symmetric, upper = fit_poses(poses), fit_poses(poses, form="upper")
    x = rng.normal(size=(20, 3)) * G
    lengths = np.linalg.norm(symmetric.model.apply(x), axis=1)
    assert np.linalg.norm(upper.model.apply(x), axis=1) == pytest.approx(lengths, rel=1e-12)
    assert (np.tril(upper.model.matrix, -1) == 0.0).all()
    assert upper.sd[4] == pytest.approx(2.0 * symmetric.sd[4], rel=0.05)
    assert upper.sd[6] == pytest.approx(0.0, abs=1e-12)


@settings(max_examples=examples(25), deadline=None)
@given(seed=st.integers(0, 10_000), scale=st.floats(1e-2, 1e3), order=st.permutations(list(range(12))))
def test_order_and_unit_do_not_matter(seed, scale, order):
    rng = np.random.default_rng(seed)
    poses = poses_of(directions(rng, 6), sd=0.005, rng=rng)
    fit = fit_poses(poses)
    shuffled = [
        PoseMean(p.start, p.end, scale * p.mean, scale**2 * p.covariance, p.n) for p in (poses[i] for i in order)
    ]
    other = fit_poses(shuffled, unit="counts")
    assert other.model.offset == pytest.approx(scale * fit.model.offset, abs=3e-3 * scale)
    assert other.model.matrix == pytest.approx(fit.model.matrix / scale, abs=1e-3 / scale)
    assert fit_poses([poses[i] for i in order]).values == pytest.approx(fit.values, abs=1e-9)


@settings(max_examples=examples(20), deadline=None)
@given(seed=st.integers(0, 10_000), shift=st.tuples(*[st.floats(-0.5, 0.5)] * 3))
def test_a_shifted_sensor_has_a_shifted_offset(seed, shift):
    rng = np.random.default_rng(seed)
    poses = poses_of(directions(rng, 4), sd=0.005, rng=rng)
    moved = [PoseMean(p.start, p.end, p.mean + shift, p.covariance, p.n) for p in poses]
    before, after = fit_poses(poses, cross_sd=None), fit_poses(moved, cross_sd=None)
    assume(before.status == after.status == FitStatus.OK)
    assert after.model.offset - before.model.offset == pytest.approx(shift, abs=1e-5)
    assert after.model.matrix == pytest.approx(before.model.matrix, abs=1e-6)


def test_poses_seen_twice_do_not_move_the_answer():
    rng = np.random.default_rng(7)
    poses = poses_of(directions(rng, 6), sd=0.005, rng=rng)
    once, twice = fit_poses(poses, cross_sd=None), fit_poses([*poses, *poses], cross_sd=None)
    assert twice.values == pytest.approx(once.values, abs=1e-9)
    assert twice.sd[:3] == pytest.approx(once.sd[:3] / np.sqrt(2.0), rel=1e-6)


def test_counts_with_a_large_offset():
    truth = TriadModel([33_124.0, 33_275.0, 32_364.0], np.diag([1 / 414.4, 1 / 412.0, 1 / 414.6]))
    rng = np.random.default_rng(8)
    fit = fit_poses(poses_of(directions(rng, 10), truth, 0.5, rng), unit="counts")
    assert fit.model.offset == pytest.approx(truth.offset, abs=2.0)
    assert np.diag(fit.model.matrix) == pytest.approx(np.diag(truth.matrix), rel=1e-3)


def test_a_missing_face_is_named_with_the_movement():
    rng = np.random.default_rng(9)
    fit = fit_poses(poses_of(FACES[[0, 1, 3, 4, 5]], sd=0.002, rng=rng))
    assert fit.status == FitStatus.PARTIAL
    assert {"offset_z", "matrix_zz"} <= set(fit.undetermined)
    assert "offset_x" not in fit.undetermined
    assert "hold it on its back" in fit.message
    assert (fit.model.offset[2], fit.model.matrix[2, 2]) == (0.0, 1.0)
    assert np.abs((fit.model.offset[:2] - TRUTH.offset[:2]) / fit.sd[:2]).max() < 4.0


def test_five_tilted_faces_leave_every_axis_open():
    rng = np.random.default_rng(9)
    d = directions(rng, 0)
    fit = fit_poses(poses_of(d[d[:, 2] < 0.7], sd=0.002, rng=rng))  # what z is unknown by leaks through the tilts
    assert fit.status == FitStatus.REFUSED
    assert "hold it on its back" in fit.message


def test_one_attitude_determines_nothing():
    rng = np.random.default_rng(10)
    d = np.array([0.0, 0.0, -1.0]) + rng.normal(0.0, 0.02, (12, 3))
    fit = fit_poses(poses_of(d / np.linalg.norm(d, axis=1)[:, None], sd=0.002, rng=rng))
    assert fit.status == FitStatus.REFUSED
    assert "nose up" in fit.message


def test_sway_across_gravity_is_no_noise_along_it():
    rng = np.random.default_rng(16)
    t = np.arange(150) / 50.0
    stills, samples = [], []
    for k, d in enumerate(directions(rng, 4)):
        across = np.linalg.qr(np.column_stack([d, rng.normal(size=(3, 2))]))[0][:, 1:]
        sway = across @ (0.3 * np.vstack([np.sin(2 * t + k), np.cos(3 * t + 2 * k)]))
        samples.append(TRUTH.invert(G * d + sway.T) + 0.005 * rng.normal(size=(150, 3)))
        stills.append(Still(4.0 * k, 4.0 * k + 3.0, None, None))
    times = np.concatenate([still.start + t for still in stills])
    accel = Channel(Sensor.ACCEL, 0, times, np.concatenate(samples), "m/s2", Stage.RAW, "test")
    fit = fit_poses(pose_means(accel, tuple(stills)))
    assert fit.sd[:3].max() < 0.002  # 0.005/sqrt(150) a pose; the sway alone is a hundred times that
    assert fit.quality["chi2"] > 0.1


@pytest.mark.parametrize("count", [0, 1, 3])
def test_too_few_poses(count):
    fit = fit_poses(poses_of(FACES)[:count])
    assert fit.status == FitStatus.REFUSED
    assert f"{count} still poses" in fit.message


def test_a_contradicting_pose_is_found_and_the_sd_grows():
    rng = np.random.default_rng(11)
    poses = poses_of(directions(rng, 6), sd=0.002, rng=rng)
    p = poses[7]
    poses[7] = PoseMean(p.start, p.end, p.mean * 1.01, p.covariance, p.n)
    good, bad = fit_poses(poses[:7] + poses[8:]), fit_poses(poses)
    assert bad.quality["p_value"] < 1e-3
    assert bad.quality["worst_pose"] == 7
    assert any("pose 8, 14.0 to 15.5 s" in w for w in bad.warnings)
    assert bad.sd[0] > 2.0 * good.sd[0]


@pytest.mark.parametrize("unit", ["m/s2", "counts"])
@pytest.mark.parametrize(
    "means",
    [
        np.zeros((9, 3)),
        np.full((9, 3), 5.0),
        np.full((9, 3), np.nan),
        np.full((9, 3), 1e300),
        1e-300 * FACES,
        1e200 * FACES,
    ],
)
def test_what_is_no_gravity_is_refused_without_a_warning_of_numpy(means, unit):
    poses = [PoseMean(k, k + 1.0, m, 1e-6 * np.eye(3), 50) for k, m in enumerate(means)]
    fit = fit_poses(poses, unit=unit)
    assert fit.status == FitStatus.REFUSED
    assert "\n" not in fit.message


def test_a_wrong_unit_is_noticed():
    poses = [
        PoseMean(p.start, p.end, p.mean / G, p.covariance, p.n)
        for p in poses_of(directions(np.random.default_rng(1), 4))
    ]
    fit = fit_poses(poses)
    assert fit.status == FitStatus.REFUSED
    assert "(9.81)" in fit.message  # what the readings are not


@pytest.mark.parametrize("options", [{"gravity": 0.0}, {"gravity": np.nan}, {"cross_sd": -1.0}])
def test_impossible_options(options):
    with pytest.raises(InvalidInputError):
        fit_poses(poses_of(FACES), **options)


def test_a_warm_up_between_the_poses_is_said():
    poses = [
        PoseMean(p.start, p.end, p.mean, p.covariance, p.n, temperature=20.0 + k)
        for k, p in enumerate(poses_of(directions(np.random.default_rng(13), 4), sd=0.002))
    ]
    fit = fit_poses(poses)
    assert fit.temperature == pytest.approx(24.5)
    assert any("temperature moved by 9.0" in w for w in fit.warnings)


def test_from_held_poses_to_the_truth(held_poses):
    z = []
    for seed in range(6):
        recording = held_poses(
            np.random.default_rng(seed), accel_offset=TRUTH.offset, accel_matrix=np.linalg.inv(TRUTH.matrix), oblique=6
        )
        accel, gyro = recording.channel(Sensor.ACCEL), recording.channel(Sensor.GYRO)
        fit = fit_poses(pose_means(accel, find_still(recording), gyro=gyro))
        assert fit.quality["p_value"] > 1e-4
        z.append((fit.values - np.concatenate([TRUTH.offset, TRUTH.matrix.ravel()]))[SYMMETRIC] / fit.sd[SYMMETRIC])
    assert np.nanmax(np.abs(z)) < 4.5
    assert 0.4 < np.nanmean(np.square(z)) < 2.0


def vertical(mean, n=256, sd=0.005, unit="g"):
    values = np.asarray(mean) + sd * np.random.default_rng(14).normal(size=(n, 3))
    return Channel(Sensor.ACCEL, 0, np.arange(n) / 100.0, values, unit, Stage.RAW, "test")


@pytest.mark.parametrize(
    ("mean", "offset"), [((0.02, -0.03, 1.05), (0.02, -0.03, 0.05)), ((0.01, 0.02, -0.97), (0.01, 0.02, 0.03))]
)
def test_one_axis_vertical_of_the_specification(mean, offset):
    exact = Channel(Sensor.ACCEL, 0, np.arange(256.0), np.tile(mean, (256, 1)), "g", Stage.RAW, "test")
    assert fit_one_axis(exact, gravity=1.0).model.offset == pytest.approx(offset, abs=1e-12)
    fit = fit_one_axis(vertical(mean), gravity=1.0)
    assert fit.status == FitStatus.OK
    assert fit.sd[:3] == pytest.approx(0.005 / 16.0, rel=0.4)
    assert fit.native["vertical"] == "z"


def test_the_tilt_of_the_fixture_is_inside_the_covariance():
    fit = fit_one_axis(vertical((0.0, 0.0, 1.0)), gravity=1.0, fixture_sd=1.0)
    assert fit.sd[:2] == pytest.approx(np.radians(1.0), rel=0.01)
    assert fit.sd[2] < 0.001
    assert fit.warnings == ()
    assert any("one degree of tilt" in w for w in fit_one_axis(vertical((0.0, 0.0, 1.0)), gravity=1.0).warnings)


@pytest.mark.parametrize(("mean", "says"), [((0.5, 0.5, 0.6), "no axis reads"), ((0.95, 0.0, 0.95), "2 axes read")])
def test_one_axis_must_be_vertical(mean, says):
    fit = fit_one_axis(vertical(mean), gravity=1.0)
    assert fit.status == FitStatus.REFUSED
    assert says in fit.message


def test_a_shaken_axis_is_refused_and_so_are_few_samples():
    assert "it moved" in fit_one_axis(vertical((0.0, 0.0, 1.0), sd=0.2), gravity=1.0).message
    assert "16 are needed" in fit_one_axis(vertical((0.0, 0.0, 1.0), n=5), gravity=1.0).message


@pytest.mark.parametrize("mean", [(0.0, 0.0, 1.0), (0.02, -0.03, -0.97)])
def test_one_axis_says_what_its_offset_does_to_the_level(mean):
    quality = fit_one_axis(vertical(mean), gravity=1.0, fixture_sd=0.5).quality
    assert quality["attitude_sd_deg"] == pytest.approx(0.5, rel=0.02)
    assert {"chi2", "dof", "p_value", "first_correlation", "white"} <= set(quality)
    assert quality["white"]


def test_refusals_name_the_movement():
    assert "one axis vertical" in fit_one_axis(vertical((0.5, 0.5, 0.6)), gravity=1.0).movements["offset_x"]
    assert "six sides" in fit_poses([]).movements["matrix_xx"]
