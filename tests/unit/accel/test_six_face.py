from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.accel.faces import Face, down_of
from mavcal.calib.accel.six_face import fit_six_face
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus

G = 9.80665
ACCELCAL = np.array(  # METHODS S4: XUP YUP ZUP XDOWN YDOWN ZDOWN
    [
        [-9.6490, 0.2225, -0.1925],
        [0.0146, -9.5593, 0.0153],
        [-0.0210, 0.1928, -9.9271],
        [9.9363, 0.1840, -0.0210],
        [0.0008, 9.9094, -0.0655],
        [0.2828, 0.1528, 9.7232],
    ]
)
A = np.array(
    [
        [1.0017879105, 0.0019492416, -0.0086625047],
        [0.0006320105, 1.0077751064, 0.0041462596],
        [-0.0154136555, 0.0020293504, 0.9985557849],
    ]
)
B = np.array([-0.0955688838, -0.1851535241, 0.0778741103])
WAYS = np.vstack([np.eye(3), -np.eye(3)])  # down


def faces_of(rng, M, offset, sd=0.0, tilt_deg=0.0, n=100):
    force = -G * WAYS
    tilted = force + np.cross(np.radians(tilt_deg) * rng.normal(size=(6, 3)), force)
    U = tilted @ M.T + offset + sd / np.sqrt(n) * rng.normal(size=(6, 3))
    return [Face(u, sd**2 / n * np.eye(3), n=n) for u in U]


def test_the_digits_of_accelcal():
    fit = fit_six_face([Face(row) for row in ACCELCAL], convention="accelcal")
    assert np.array(fit.native["A"]) == pytest.approx(A, abs=1e-9)
    assert np.array(fit.native["b"]) == pytest.approx(B, abs=1e-9)
    assert fit.native["gravity"] == 9.81
    assert fit.residual_rms == pytest.approx(0.0427, abs=5e-5)
    assert fit.status == FitStatus.OK


def test_the_model_is_the_same_correction():
    fit = fit_six_face([Face(row) for row in ACCELCAL], convention="accelcal")
    assert fit.model.apply(ACCELCAL) == pytest.approx(ACCELCAL @ A + B, abs=1e-8)


def test_another_gravity_gives_another_scale():
    fit = fit_six_face([Face(row) for row in ACCELCAL], convention="accelcal", gravity=G)
    assert fit.native["A"][0][0] == pytest.approx(1.0014, abs=5e-5)


def test_in_g_the_target_is_one():
    fit = fit_six_face([Face(row / 9.81) for row in ACCELCAL], convention="accelcal")
    assert fit.native["gravity"] == 1.0
    assert np.array(fit.native["A"]) == pytest.approx(A, abs=1e-9)


def test_numpy_finds_the_same_answer_by_another_route():
    T = 9.81 * np.vstack([-np.eye(3), np.eye(3)])
    X = np.column_stack([ACCELCAL, np.ones(6)])
    normal = np.linalg.solve(X.T @ X, X.T @ T)
    fit = fit_six_face([Face(row) for row in ACCELCAL], convention="accelcal")
    assert np.vstack([fit.native["A"], fit.native["b"]]) == pytest.approx(normal, abs=1e-12)


@pytest.mark.parametrize(
    ("sd", "tilt", "offset_sd"), [(0.05, 0.0, 0.3), (0.5, 0.0, 0.3), (0.05, 0.2, 0.3), (0.5, 0.0, 30.0)]
)
def test_the_covariance_holds_with_and_without_a_perfect_fixture(sd, tilt, offset_sd):
    rng = np.random.default_rng(1)
    nees, p_values = [], []
    for _ in range(200):
        M, offset = np.eye(3) + rng.normal(0.0, 0.05, (3, 3)), rng.normal(0.0, offset_sd, 3)
        fit = fit_six_face(faces_of(rng, M, offset, sd, tilt), fixture_sd=tilt, gravity=G)
        error = fit.values - np.concatenate([offset, np.linalg.inv(M).ravel()])
        nees.append(error @ np.linalg.solve(fit.covariance, error) / 12.0)
        p_values.append(fit.quality["p_value"])
    assert np.mean(nees) == pytest.approx(1.0, abs=0.12)
    assert 0.4 < np.mean(p_values) < 0.6


def test_face_means_attain_the_bound():
    rng = np.random.default_rng(2)
    T = np.column_stack([-G * WAYS, np.ones(6)])
    information = np.kron(np.eye(3), T.T @ T) / (0.2**2 / 1000)
    squares = []
    for _ in range(300):
        M, offset = np.eye(3) + rng.normal(0.0, 0.01, (3, 3)), rng.normal(0.0, 0.3, 3)
        fit = fit_six_face(faces_of(rng, M, offset, 0.2, n=1000))
        forward = np.column_stack([np.linalg.inv(fit.model.matrix) - M, fit.model.offset - offset]).ravel()
        squares.append(forward @ information @ forward / 12.0)
    assert np.sqrt(np.mean(squares)) <= 1.02 + 2.0 / np.sqrt(2 * 300 * 12)


def test_all_samples_of_a_face_share_its_tilt():
    rng = np.random.default_rng(3)
    means = faces_of(rng, np.eye(3), np.zeros(3), 0.05, 0.5, n=400)
    samples = [Face(f.mean + 0.05 * rng.normal(size=3)) for f in means for _ in range(50)]
    shared = fit_six_face(samples, fixture_sd=0.5)
    assert shared.sd[4] == pytest.approx(fit_six_face(means, fixture_sd=0.5).sd[4], rel=0.2)


def test_a_worse_fixture_than_stated_inflates_the_sd():
    rng = np.random.default_rng(4)
    faces = faces_of(rng, np.eye(3), np.zeros(3), 0.02, 2.0, n=1000)
    fit = fit_six_face(faces)
    assert fit.quality["p_value"] < 1e-6
    assert any("fixture is worse" in w for w in fit.warnings)
    assert fit.sd[0] > 10 * 0.02 / np.sqrt(1000)


@given(order=st.permutations(range(6)))
def test_the_order_of_the_faces_does_not_matter(order):
    fit = fit_six_face([Face(ACCELCAL[i]) for i in order], convention="accelcal")
    assert np.array(fit.native["A"]) == pytest.approx(A, abs=1e-9)


@pytest.mark.parametrize(
    ("label", "down"),
    [
        *(("level", [0, 0, 1]), ("Left", [0, -1, 0]), ("nose-down", [1, 0, 0]), ("BACK", [0, 0, -1])),
        *(("xup", [-1, 0, 0]), ("Z_DOWN", [0, 0, 1]), ("+y", [0, -1, 0]), ("y down", [0, 1, 0]), ("-x", [1, 0, 0])),
    ],
)
def test_labels(label, down):
    assert down_of(label) == pytest.approx(down)


def test_a_label_that_says_nothing():
    assert down_of("face 3") is None
    assert down_of("") is None


def test_a_label_against_the_sign_names_the_convention():
    labelled = [
        Face(row, None, down_of(label))
        for row, label in zip(ACCELCAL, ["xup", "yup", "zup", "xdown", "ydown", "zdown"], strict=True)
    ]
    assert fit_six_face(labelled, convention="accelcal").status == FitStatus.OK
    wrong = fit_six_face(labelled, convention="specific-force")
    assert wrong.status == FitStatus.REFUSED
    assert "other convention" in wrong.message


def test_a_label_of_another_face_is_noticed():
    labels = ["yup", "xup", "zup", "xdown", "ydown", "zdown"]
    fit = fit_six_face(
        [Face(r, None, down_of(n)) for r, n in zip(ACCELCAL, labels, strict=True)], convention="accelcal"
    )
    assert fit.status == FitStatus.REFUSED
    assert "reading 1" in fit.message
    assert "label" in fit.message


def test_missing_faces_are_named():
    fit = fit_six_face([Face(row) for row in [*ACCELCAL[:5], ACCELCAL[4]]], convention="accelcal")
    assert fit.status == FitStatus.REFUSED
    assert "z down" in fit.message


def test_an_oblique_reading_is_no_face():
    fit = fit_six_face([Face(row) for row in [*ACCELCAL, [5.7, 5.7, 5.7]]], convention="accelcal")
    assert fit.status == FitStatus.REFUSED
    assert "reading 7" in fit.message
    assert "5.7, 5.7" in fit.message


def test_counts_need_a_stated_gravity():
    faces = [Face(row * 100.0) for row in ACCELCAL]
    assert "state --gravity" in fit_six_face(faces, convention="accelcal", unit="counts").message
    assert fit_six_face(faces, convention="accelcal", unit="counts", gravity=9.81).native["A"][0][0] == pytest.approx(
        A[0, 0] / 100
    )


@pytest.mark.parametrize("faces", [[], [Face(ACCELCAL[0])] * 5, [Face(np.full(3, np.nan))] * 6])
def test_too_few_or_not_finite_faces(faces):
    assert fit_six_face(faces).status == FitStatus.REFUSED


@pytest.mark.parametrize("options", [{"convention": "up"}, {"form": "x"}, {"fixture_sd": -1.0}, {"gravity": -9.8}])
def test_impossible_options(options):
    with pytest.raises(InvalidInputError):
        fit_six_face([Face(row) for row in ACCELCAL], **{"convention": "accelcal", **options})


def all_samples(rng, sd, n):
    return [Face(-G * way + [0.3, -0.2, 0.1] + sd * rng.normal(size=3)) for way in WAYS for _ in range(n)]


def test_the_columns_are_half_the_difference_of_two_faces():
    """The algebra of six rings: v_i = g A e_i, and the offset is the mean of the six."""
    rng = np.random.default_rng(5)
    M = np.eye(3) + rng.normal(0.0, 0.05, (3, 3))
    faces = faces_of(rng, M, [0.3, -0.2, 0.1], 0.05)
    fit = fit_six_face(faces, form="forward", gravity=G)
    U = np.array([face.mean for face in faces])  # down x y z, then up
    np.testing.assert_allclose(np.array(fit.native["columns"]), (U[3:] - U[:3]).T / (2.0 * G), atol=1e-12)
    np.testing.assert_allclose(fit.native["offset"], U.mean(axis=0), atol=1e-12)
    whole = np.array(fit.native["homogeneous"])
    np.testing.assert_allclose(whole[:3, :3] @ U[0] + whole[:3, 3], fit.model.apply(U[0]), atol=1e-12)


def test_exact_faces_give_the_same_by_both_forms():
    M = np.eye(3) + np.random.default_rng(6).normal(0.0, 0.05, (3, 3))
    faces = [Face(M @ (-G * way) + [0.3, -0.2, 0.1], np.zeros((3, 3))) for way in WAYS]
    forward, published = fit_six_face(faces, form="forward"), fit_six_face(faces)
    np.testing.assert_allclose(forward.values, published.values, atol=1e-9)


def test_single_noisy_samples_shrink_the_published_form_by_what_is_predicted():
    """METHODS S4: 1 / (1 + 3 s^2/g^2); the forward form is right, and the warning says by how much the other is not."""
    sd, rng = 1.0, np.random.default_rng(7)
    samples = all_samples(rng, sd, 3000)
    published, forward = fit_six_face(samples, gravity=G), fit_six_face(samples, gravity=G, form="forward")
    expected = 1.0 / (1.0 + 3.0 * sd**2 / G**2)
    assert np.diag(published.model.matrix).mean() == pytest.approx(expected, abs=2e-3)
    assert np.diag(forward.model.matrix).mean() == pytest.approx(1.0, abs=2e-3)
    assert np.abs((forward.values - [0.3, -0.2, 0.1, *np.eye(3).ravel()]) / forward.sd).max() < 4.5
    assert any("too small by 3.0e-02" in w or "too small by 3.1e-02" in w for w in published.warnings)
    assert not forward.warnings
    means = [Face(np.mean([f.mean for f in samples[3000 * k : 3000 * (k + 1)]], axis=0)) for k in range(6)]
    assert np.diag(fit_six_face(means, gravity=G).model.matrix).mean() == pytest.approx(1.0, abs=2e-3)


def test_the_published_example_is_not_noisy_enough_for_a_warning():
    assert not fit_six_face([Face(row) for row in ACCELCAL], convention="accelcal").warnings


@pytest.mark.parametrize(("sd", "tilt", "offset_sd"), [(0.05, 0.0, 0.3), (0.5, 0.2, 30.0)])
def test_the_covariance_of_the_forward_form_holds(sd, tilt, offset_sd):
    rng = np.random.default_rng(8)
    nees = []
    for _ in range(150):
        M, offset = np.eye(3) + rng.normal(0.0, 0.05, (3, 3)), rng.normal(0.0, offset_sd, 3)
        fit = fit_six_face(faces_of(rng, M, offset, sd, tilt), fixture_sd=tilt, gravity=G, form="forward")
        error = fit.values - np.concatenate([offset, np.linalg.inv(M).ravel()])
        nees.append(error @ np.linalg.solve(fit.covariance, error) / 12.0)
    assert np.mean(nees) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / (12 * 150)))


def test_all_samples_forward_attain_the_bound_at_any_noise():
    rng = np.random.default_rng(9)
    for sd in (0.03, 1.0):
        design = np.column_stack([np.repeat(-G * WAYS, 40, axis=0), np.ones(240)])
        information = np.kron(np.eye(3), design.T @ design) / sd**2
        squares = []
        for _ in range(60):
            fit = fit_six_face(all_samples(rng, sd, 40), gravity=G, form="forward")
            error = np.column_stack([np.linalg.inv(fit.model.matrix) - np.eye(3), fit.model.offset - [0.3, -0.2, 0.1]])
            squares.append(error.ravel() @ information @ error.ravel() / 12.0)
        assert np.sqrt(np.mean(squares)) <= 1.02 + 2.0 / np.sqrt(2 * 60 * 12)


def test_the_tilt_of_a_level_vehicle_is_predicted():
    faces = faces_of(np.random.default_rng(10), np.eye(3), np.zeros(3), 0.02, n=100)
    fit = fit_six_face(faces, gravity=G, fixture_sd=0.2)
    assert 0.02 < fit.quality["attitude_sd_deg"] < 0.4
    assert {"chi2", "dof", "p_value", "first_correlation", "white"} <= set(fit.quality)


def test_refusals_name_the_movement():
    fit = fit_six_face([Face(row) for row in ACCELCAL[:5]], convention="accelcal")
    assert "six sides" in fit.movements["offset_x"]
    stuck = fit_six_face([Face(np.array([0.0, 0.0, -G]))] * 6)
    assert stuck.status == FitStatus.REFUSED


@given(scale=st.floats(0.2, 5.0), shift=st.tuples(*[st.floats(-3.0, 3.0)] * 3))
def test_scaled_and_shifted_readings_move_the_answer(scale, shift):
    base = fit_six_face([Face(row) for row in ACCELCAL], convention="accelcal", gravity=9.81)
    moved = fit_six_face([Face(scale * row + shift) for row in ACCELCAL], convention="accelcal", gravity=9.81)
    assert moved.model.offset == pytest.approx(scale * base.model.offset + shift, abs=1e-8)
    assert moved.model.matrix * scale == pytest.approx(base.model.matrix, abs=1e-9)
