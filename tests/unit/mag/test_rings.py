"""Six rings: the digits of METHODS S3, the uncertainty, and what cannot be told."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavcal.calib.c_array import homogeneous
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.mag.ring_centres import CENTRES, Ring, centre_of, fit_circle
from mavcal.calib.mag.ring_solve import by_dominant, columns_of, published
from mavcal.calib.mag.rings import fit_rings
from tests.examples import examples
from tests.fields import field_of

WAYS = np.vstack([np.eye(3), -np.eye(3)])
STRENGTH, DIP = 49.0, np.radians(66.0)
FIELD = field_of(STRENGTH, DIP)
MATRIX = np.array([[1.08, 0.03, -0.02], [0.12, 0.95, 0.04], [-0.05, 0.04, 1.02]])
OFFSET = np.array([12.0, -8.5, 21.0])
TRUTH = np.concatenate([OFFSET, np.linalg.inv(MATRIX).ravel()])

V = np.array([[11.0, 2.0, 3.0], [4.0, 10.0, 4.0], [3.0, 1.0, 12.0]])
CENTRES_OF_METHODS = np.array(
    [[131, 24, 33], [109, 16, 27], [122, 30, 31], [118, 10, 29], [123, 24, 42], [117, 16, 18]], dtype=np.float64
)
PAIRED = np.array([sign * np.eye(3)[axis] for axis in range(3) for sign in (1.0, -1.0)])


def turned(
    rng: np.random.Generator,
    *,
    n: int = 400,
    noise: float = 0.3,
    tilt_deg: float = 0.0,
    dip: float = DIP,
    uneven: float = 0.0,
    matrix: Any = MATRIX,
) -> list[Any]:
    """Six rings in the order of WAYS."""
    rings = []
    for k in WAYS:
        first = np.roll(k, 1)
        angle = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
        angle = angle + uneven * np.sin(angle)
        field = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * np.cross(k, first)
        field = STRENGTH * (np.sin(dip) * k + np.cos(dip) * field)
        tilt = np.radians(tilt_deg) * rng.normal(size=3) * (k == 0.0)
        turned_field = Rotation.from_rotvec(tilt).apply(field)
        rings.append(turned_field @ np.asarray(matrix).T + OFFSET + noise * rng.normal(size=(n, 3)))
    return rings


def test_the_digits_of_the_exact_columns() -> None:
    """METHODS S3: centres, half differences, adjugate over determinant, homogeneous 4 x 4."""
    offset, columns = columns_of(CENTRES_OF_METHODS, PAIRED)
    np.testing.assert_allclose(offset, [120.0, 20.0, 30.0], atol=1e-12)
    np.testing.assert_allclose(columns, V, atol=1e-12)
    inverse = np.linalg.inv(columns)
    assert np.linalg.det(columns) == pytest.approx(1126.0)
    np.testing.assert_allclose(1126.0 * inverse, [[116, -21, -22], [-36, 123, -32], [-26, -5, 102]], atol=1e-10)
    expected = [
        [0.1030195382, -0.0186500888, -0.0195381883, -11.4031971581],
        [-0.0319715808, 0.1092362345, -0.0284191829, 2.5044404973],
        [-0.0230905861, -0.0044404973, 0.0905861456, 0.1420959147],
        [0.0, 0.0, 0.0, 1.0],
    ]
    whole = homogeneous(inverse, offset)
    np.testing.assert_allclose(whole, expected, atol=5e-11)
    np.testing.assert_allclose(whole @ [131.0, 24.0, 33.0, 1.0], [1.0, 0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(whole @ [118.0, 10.0, 29.0, 1.0], [0.0, -1.0, 0.0, 1.0], atol=1e-12)


def test_the_digits_of_the_published_variant() -> None:
    """METHODS S3: each column by its dominant component; rows instead of columns would give the transpose."""
    D = by_dominant(V)
    np.testing.assert_allclose(D, [[1.0, 0.2, 0.25], [4 / 11, 1.0, 1 / 3], [3 / 11, 0.1, 1.0]], atol=1e-15)
    assert np.linalg.det(D) == pytest.approx(0.853030303, abs=5e-10)
    expected = [
        [1.1332149201, -0.2051509769, -0.2149200710],
        [-0.3197158082, 1.0923623446, -0.2841918295],
        [-0.2770870337, -0.0532859680, 1.0870337478],
    ]
    inverse = np.linalg.inv(D)
    np.testing.assert_allclose(inverse, expected, atol=5e-11)
    np.testing.assert_allclose(inverse @ V, np.diag([11.0, 10.0, 12.0]), atol=1e-12)
    assert np.abs(np.linalg.inv(by_dominant(V.T)) @ V[:, 0] - [11.0, 0.0, 0.0]).max() > 0.5


def test_the_gains_of_the_published_variant_make_every_axis_as_long_as_the_diameter() -> None:
    samples = np.random.default_rng(1).normal(size=(200, 3)) @ V.T + OFFSET
    matrix, gains = published(samples, OFFSET, V, 100.0)
    np.testing.assert_allclose(np.ptp((samples - OFFSET) @ matrix.T, axis=0), 100.0)
    np.testing.assert_allclose(matrix, gains[:, None] * np.linalg.inv(by_dominant(V)))


@pytest.mark.parametrize("centre", CENTRES)
def test_every_centre_finds_the_matrix_with_its_mounting(centre: str) -> None:
    fit = fit_rings(turned(np.random.default_rng(2)), list(WAYS), centre=centre, field=FIELD)
    assert fit.status == FitStatus.OK
    error = fit.values - TRUTH
    assert np.abs(error / fit.sd).max() < 4.5
    assert fit.native["centre"] == centre
    assert fit.quality["dip_deg"] == pytest.approx(66.0, abs=0.3)
    assert fit.quality["mounting_deg"] == pytest.approx(np.degrees(_angle(np.linalg.inv(MATRIX))), abs=0.5)


def _angle(matrix: Any) -> float:
    u, _, vt = np.linalg.svd(matrix)
    return float(np.linalg.norm(Rotation.from_matrix(u @ vt).as_rotvec()))


@pytest.mark.long
@pytest.mark.parametrize(("centre", "tilt"), [("circle", 0.0), ("mean", 0.0), ("circle", 0.3)])
def test_the_covariance_holds(centre: str, tilt: float) -> None:
    rng = np.random.default_rng(3)
    nees = []
    for _ in range(40):
        rings = turned(rng, n=120, tilt_deg=tilt)
        fit = fit_rings(rings, list(WAYS), centre=centre, fixture_sd=tilt, field=FIELD)
        error = fit.values - TRUTH
        nees.append(error @ np.linalg.solve(fit.covariance, error) / 12.0)
    assert np.mean(nees) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / (12 * 40)))


@pytest.mark.long
def test_the_mean_of_rings_gives_the_measured_angle() -> None:
    """METHODS S3: 400 samples a face of 3 mG at dip 66: the mean 0.017 deg rms, the ring fit 0.024."""
    rng = np.random.default_rng(4)
    for centre, expected in (("mean", 0.017), ("circle", 0.024)):
        angles = []
        for _ in range(25):
            rings = turned(rng)
            angles.append(np.degrees(_angle(fit_rings(rings, list(WAYS), centre=centre).model.matrix @ MATRIX)))
        assert np.sqrt(np.mean(np.square(angles))) == pytest.approx(expected, rel=0.3)


def test_the_circle_is_the_one_that_scipy_finds() -> None:
    from scipy.optimize import least_squares

    ring = turned(np.random.default_rng(5), uneven=0.5, n=80)[2]
    points = ring @ np.linalg.inv(MATRIX).T
    circle = fit_circle(points, WAYS[2])
    assert circle is not None
    found = least_squares(lambda p: np.hypot(points[:, 0] - p[0], points[:, 1] - p[1]) - p[2], [0.0, 0.0, 10.0])
    np.testing.assert_allclose([*circle.centre[:2], circle.radius], found.x, atol=1e-6)


def test_an_uneven_turn_is_noticed_and_does_not_move_the_circle() -> None:
    rng = np.random.default_rng(6)
    rings = turned(rng, uneven=0.4)
    circle = fit_rings(rings, list(WAYS), field=FIELD)
    mean = fit_rings(rings, list(WAYS), centre="mean", field=FIELD)
    thinned = fit_rings(rings, list(WAYS), centre="thinned", field=FIELD)
    for fit in (circle, mean, thinned):
        assert np.abs((fit.values - TRUTH) / fit.sd).max() < 4.5
    assert any("unevenly" in w for w in mean.warnings)
    assert not any("unevenly" in w for w in (*circle.warnings, *thinned.warnings))
    assert mean.sd[3] > 3.0 * circle.sd[3]


@pytest.mark.parametrize("centre", ["circle", "minmax", "mean"])
def test_spikes_are_left_out(centre: str) -> None:
    rng = np.random.default_rng(20)
    rings = turned(rng)
    rings[0][17] += 1000.0
    rings[3][100:110] += 20.0
    fit = fit_rings(rings, list(WAYS), centre=centre, field=FIELD)
    assert np.abs((fit.values - TRUTH) / fit.sd).max() < 4.5
    assert fit.n_samples - fit.n_used == pytest.approx(11, abs=1)
    assert any("left out" in w for w in fit.warnings)
    for ring in rings:
        ring[::2] += 100.0 * rng.normal(size=(200, 3))
    assert fit_rings(rings, list(WAYS), centre=centre, field=FIELD).status == FitStatus.REFUSED


def test_half_a_ring_is_enough_for_the_circle() -> None:
    rings = [ring[:220] for ring in turned(np.random.default_rng(7))]
    fit = fit_rings(rings, list(WAYS), field=FIELD)
    assert np.abs((fit.values - TRUTH) / fit.sd).max() < 4.5


def test_four_readings_a_ring() -> None:
    rings = turned(np.random.default_rng(8), n=4, noise=0.05)
    fit = fit_rings(rings, list(WAYS), centre="4", field=FIELD)
    assert fit.model.offset == pytest.approx(OFFSET, abs=0.2)
    assert any("evenly spaced" in w for w in fit.warnings)
    assert fit.quality["noise_sd"] is None


def test_rings_are_told_apart_by_where_they_lie() -> None:
    rings = turned(np.random.default_rng(9))
    seen, told = fit_rings(rings, [None] * 6), fit_rings(rings, list(WAYS))
    np.testing.assert_allclose(seen.values, told.values, atol=1e-12)
    oblique = Rotation.from_euler("z", 45, degrees=True).as_matrix()
    unclear = fit_rings(turned(np.random.default_rng(9), matrix=oblique), [None] * 6)
    assert unclear.status == FitStatus.REFUSED
    assert "two faces" in unclear.message
    assert fit_rings(turned(np.random.default_rng(9), matrix=oblique), list(WAYS)).status == FitStatus.OK


def test_labels_of_what_is_up_and_the_southern_hemisphere_give_the_same_matrix() -> None:
    rng = np.random.default_rng(10)
    south = fit_rings(turned(rng, dip=-DIP), list(WAYS), field=FIELD)
    assert np.abs((south.values - TRUTH) / south.sd).max() < 4.5
    assert any("southern" in w for w in south.warnings)


@pytest.mark.parametrize("dip", [0.0, 0.5])
def test_near_the_equator_the_offset_alone_is_determined(dip: float) -> None:
    fit = fit_rings(turned(np.random.default_rng(11), dip=np.radians(dip), n=60), list(WAYS), field=FIELD)
    assert fit.status == FitStatus.PARTIAL
    assert len(fit.undetermined) == 9
    assert fit.undetermined[0] == "matrix_xx"
    assert "magnetic equator" in fit.movements["matrix_yz"]
    assert np.abs((fit.model.offset - OFFSET) / fit.sd[:3]).max() < 4.5


def test_a_worse_fixture_than_stated_is_seen_where_faces_repeat() -> None:
    rng = np.random.default_rng(12)
    twice = [*turned(rng, tilt_deg=1.0), *turned(rng, tilt_deg=1.0)]
    fit = fit_rings(twice, [*WAYS, *WAYS], field=FIELD)
    assert fit.quality["p_value"] < 1e-3
    assert any("fixture is worse" in w for w in fit.warnings)


def test_the_diameter_ties_the_scale() -> None:
    rings = turned(np.random.default_rng(13))
    fit = fit_rings(rings, list(WAYS), diameter=2000.0, unit="counts")
    corrected = fit.model.apply(np.concatenate(rings))
    assert np.linalg.norm(corrected, axis=1).mean() == pytest.approx(1000.0, rel=1e-3)
    assert fit.native["published"]["diameter"] == 2000.0


def test_native_forms_are_the_model() -> None:
    rings = turned(np.random.default_rng(14))
    fit = fit_rings(rings, list(WAYS), field=FIELD)
    json.dumps(dict(fit.native), allow_nan=False)
    whole = np.array(fit.native["homogeneous"])
    np.testing.assert_allclose(whole[:3, :3] @ rings[0][0] + whole[:3, 3], fit.model.apply(rings[0][0]))
    assert "mag_0[4][4]" in fit.native["c_array"]


@pytest.mark.long
@settings(max_examples=examples(15))
@given(
    shift=st.tuples(*[st.floats(-100.0, 100.0)] * 3),
    scale=st.floats(0.05, 50.0),
    order=st.permutations(range(6)),
    turn=st.floats(-20.0, 20.0),
)
def test_moved_data_move_the_answer(shift: Any, scale: float, order: Any, turn: float) -> None:
    rings = turned(np.random.default_rng(15), n=24)
    R = Rotation.from_euler("x", turn, degrees=True).as_matrix()
    base = fit_rings(rings, list(WAYS), diameter=2.0)
    moved = fit_rings([scale * rings[i] @ R.T + shift for i in order], [WAYS[i] for i in order], diameter=2.0)
    np.testing.assert_allclose(moved.model.offset, scale * R @ base.model.offset + shift, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(moved.model.matrix * scale, base.model.matrix @ R.T, rtol=1e-5, atol=1e-8)


def test_points_at_equal_angles_are_chosen_whatever_their_order() -> None:
    ring = turned(np.random.default_rng(16), n=360, noise=0.0)[0]
    shuffled = Ring(np.random.default_rng(17).permutation(ring), WAYS[0])
    matrix = np.linalg.inv(MATRIX)
    circle = fit_circle(shuffled.samples @ matrix.T, WAYS[0])
    for way in ("4", "3", "2"):
        centre = centre_of(shuffled, way, matrix, circle, 0.0)
        np.testing.assert_allclose(centre.value, ring.mean(axis=0), atol=1e-9)


@pytest.mark.parametrize(
    ("rings", "word"),
    [
        ([], "six are needed"),
        ([np.ones((20, 3))] * 6, "does not turn"),
        ([np.zeros((0, 3))] * 6, "does not turn"),
    ],
)
def test_refused(rings: Any, word: str) -> None:
    fit = fit_rings(rings, [None] * len(rings))
    assert fit.status == FitStatus.REFUSED
    assert word in fit.message


def test_a_missing_face_is_named() -> None:
    rings = turned(np.random.default_rng(18))
    fit = fit_rings(rings, [*WAYS[:5], WAYS[0]])
    assert "z-up" in fit.message


@pytest.mark.parametrize(
    "change",
    [
        {"centre": "median"},
        {"fixture_sd": -1.0},
        {"diameter": 0.0},
        {"downs": [None] * 5},
        {"rings": [np.full((20, 3), np.nan)] * 6},
        {"rings": [np.ones((20, 2))] * 6},
    ],
)
def test_impossible_input(change: Any) -> None:
    with pytest.raises(InvalidInputError):
        fit_rings(**{"rings": turned(np.random.default_rng(19), n=10), "downs": list(WAYS), **change})
