from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import InvalidInputError, UndeterminedError
from mavcal.calib.mag.blur import Rates
from mavcal.calib.mag.blur_fit import fit_ellipsoid_deblurred
from mavcal.calib.mag.coverage import CENTRES, N_SECTIONS, mask_bytes, sections, visited
from mavcal.calib.mag.samples import (
    CHUNK,
    Cloud,
    axis_word,
    check_not_flat,
    check_real_samples,
    check_samples,
    counted_as,
    not_repeated,
    real_array,
    still_stretches,
)
from tests.examples import examples
from tests.unit.mag.turned import deviations

RNG = np.random.default_rng(3)
ROUND = RNG.normal(size=(500, 3))
STEP = 0.1


@pytest.mark.parametrize("shape", [(5,), (5, 2), (5, 4), (2, 5, 3), (0,)])
def test_samples_are_rows_of_three(shape: tuple[int, ...]) -> None:
    with pytest.raises(InvalidInputError, match=r"shape \(N, 3\)"):
        check_samples(np.ones(shape), 1)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_rows_that_are_not_finite_are_counted(bad: float) -> None:
    samples = ROUND.copy()
    samples[[3, 7], 1] = bad
    samples[7, 2] = bad
    with pytest.raises(InvalidInputError, match="2 of 500 magnetometer samples are not finite"):
        check_samples(samples, 4)


def test_numbers_that_are_no_field_are_said_to_be() -> None:
    with pytest.raises(InvalidInputError, match="check the unit"):
        check_samples(np.full((10, 3), 1e308), 4)


@pytest.mark.parametrize(
    ("samples", "said"),
    [
        (ROUND[:3], "3 magnetometer samples are too few: at least 4"),
        (np.zeros((0, 3)), "0 magnetometer samples are too few"),
        (np.tile([1.0, 2.0, 3.0], (50, 1)), "all 50 magnetometer samples are the same"),
        (np.repeat(ROUND[:3], 20, axis=0), "only 3 of 60 magnetometer samples differ"),
    ],
)
def test_samples_that_say_nothing_are_refused_with_what_helps(samples: np.ndarray, said: str) -> None:
    with pytest.raises(UndeterminedError, match=said) as raised:
        check_samples(samples, 4)
    assert raised.value.remedy


def test_repeats_are_allowed_where_they_mean_something() -> None:
    check_samples(np.tile([1.0, 2.0, 3.0], (50, 1)), 4, may_repeat=True)
    check_samples(np.repeat(ROUND[:3], 20, axis=0), 4, may_repeat=True)
    check_samples(np.repeat(ROUND[:4], 20, axis=0), 4)


def test_samples_that_differ_in_one_axis_alone_are_different() -> None:
    samples = np.zeros((6, 3))
    samples[:, 1] = np.arange(6.0)
    check_samples(samples, 4)


@pytest.mark.parametrize("kind", ["int16", "uint8", "int64", "float32", "float64"])
def test_numbers_are_taken_as_they_are(kind: str) -> None:
    samples = np.arange(30).reshape(10, 3).astype(kind)
    assert real_array(samples) is samples
    check_real_samples(samples, 4)


@pytest.mark.parametrize("kind", ["float16", "bool"])
def test_what_is_no_number_of_a_sensor_becomes_one(kind: str) -> None:
    assert real_array(np.ones((4, 3), dtype=kind)).dtype == np.float64


@pytest.mark.parametrize("samples", [[["a", "b", "c"]], [[{}, 1, 2]]])
def test_what_is_no_number_is_refused(samples: object) -> None:
    with pytest.raises(InvalidInputError, match="must be numbers"):
        real_array(samples)  # type: ignore[arg-type]


def test_a_reading_that_was_sent_twice_counts_once() -> None:
    samples = np.array([[1.0, 2, 3], [1, 2, 3], [1, 2, 4], [1, 2, 3], [1, 2, 3], [1, 2, 3]])
    assert not_repeated(samples).tolist() == [True, False, True, True, False, False]
    assert not_repeated(samples[:0]).tolist() == []
    assert not_repeated(samples[:1]).tolist() == [True]


@settings(max_examples=examples(25))
@given(st.integers(0, 1000), st.floats(-1e4, 1e4), st.floats(1e-2, 1e3))
def test_a_cloud_is_looked_at_in_its_own_units(seed: int, middle: float, width: float) -> None:
    samples = middle + width * np.random.default_rng(seed).normal(size=(200, 3))
    cloud = Cloud.of(samples)
    scaled = cloud.scaled()
    np.testing.assert_allclose(scaled.mean(axis=0), 0.0, atol=1e-12 * (1.0 + abs(middle) / width))
    assert np.mean(np.sum(scaled**2, axis=1)) == pytest.approx(1.0)
    np.testing.assert_allclose(cloud.rows(0), scaled.T, atol=1e-9)
    np.testing.assert_allclose(cloud.scale * scaled + cloud.centre, samples, atol=1e-9 * (abs(middle) + width))


def test_chunks_are_the_whole_cloud_one_after_the_other() -> None:
    samples = RNG.normal(size=(2 * CHUNK + 5, 3))
    cloud = Cloud.of(samples)
    parts = [cloud.rows(start) for start in range(0, len(cloud), CHUNK)]
    assert [part.shape for part in parts] == [(3, CHUNK), (3, CHUNK), (3, 5)]
    np.testing.assert_allclose(np.hstack(parts).T, cloud.scaled())


def test_a_part_of_a_cloud_keeps_its_units_and_its_precision() -> None:
    cloud = Cloud.of(ROUND, precision=np.arange(500.0))
    part = cloud.take(ROUND[:, 0] > 0.0)
    assert (part.scale, part.centre.tolist()) == (cloud.scale, cloud.centre.tolist())
    np.testing.assert_array_equal(part.samples, ROUND[ROUND[:, 0] > 0.0])
    np.testing.assert_array_equal(part.precision, np.arange(500.0)[ROUND[:, 0] > 0.0])
    assert Cloud.of(ROUND).take(slice(3)).precision is None


def test_a_cloud_of_one_point_has_a_scale_all_the_same() -> None:
    assert Cloud.of(np.ones((4, 3))).scale > 0.0


@settings(max_examples=examples(25))
@given(st.integers(0, 10_000), st.floats(0.05, 1.0))
def test_a_cloud_with_thickness_is_none_however_it_lies(seed: int, thickness: float) -> None:
    turn = Rotation.random(random_state=seed).as_matrix()
    check_not_flat(turn @ np.diag([1.0, 0.8, thickness**2]) @ turn.T)


@pytest.mark.parametrize(
    ("normal", "word"), [((0, 0, 1), "top-bottom"), ((0, 1, 0), "left-right"), ((-1, 0, 0), "nose-tail")]
)
def test_a_plane_is_named_by_the_axis_that_never_tilted(normal: tuple[int, ...], word: str) -> None:
    n = np.array(normal, dtype=float)
    with pytest.raises(UndeterminedError, match="lie in one plane") as raised:
        check_not_flat(np.eye(3) - 0.9999 * np.outer(n, n))
    assert f"its {word} axis" in str(raised.value.remedy)
    assert axis_word(n) == word


def test_a_line_is_told_from_a_plane() -> None:
    with pytest.raises(UndeterminedError, match="lie on a line"):
        check_not_flat(np.diag([1.0, 1e-5, 1e-5]))
    with pytest.raises(UndeterminedError, match="in one plane"):
        check_not_flat(np.diag([1.0, 1.0, 0.03**2]), limit=0.1)
    check_not_flat(np.diag([1.0, 1.0, 0.03**2]))


def test_every_section_is_nearest_to_its_own_centre() -> None:
    assert sections(CENTRES).tolist() == list(range(N_SECTIONS))
    assert sections(7.5 * CENTRES[[3]]).tolist() == [3]  # whatever its length
    np.testing.assert_allclose(np.linalg.norm(CENTRES, axis=1), 1.0)


def test_sections_are_about_equal() -> None:
    counts = np.bincount(sections(np.random.default_rng(5).normal(size=(40_000, 3))), minlength=N_SECTIONS)
    assert counts.min() > 350
    assert counts.max() < 650


@settings(max_examples=examples(25))
@given(st.sets(st.integers(0, N_SECTIONS - 1)))
def test_a_mask_has_a_bit_for_every_section(seen: set[int]) -> None:
    flags = np.zeros(N_SECTIONS, dtype=bool)
    flags[list(seen)] = True
    mask = int.from_bytes(bytes(mask_bytes(flags)), "little")
    assert {bit for bit in range(N_SECTIONS) if mask >> bit & 1} == seen
    if seen:
        np.testing.assert_array_equal(visited(CENTRES[sorted(seen)]), flags)


def rounded(values):
    return (np.floor(values / STEP) + 0.5) * STEP


def worth(noise, lengths=20, stretches=400):
    """Mean of what stretches of `lengths` readings at random fields are stated to be worth, and what they are."""
    rng = np.random.default_rng(11)
    truth = rng.uniform(-40.0, 40.0, (stretches, 1, 3))
    readings = rounded(truth + noise * rng.normal(size=(stretches, lengths, 3)))
    stated = np.concatenate([counted_as(r, np.array([0]), STEP) for r in readings])
    single = np.mean((readings[:, 0] - truth[:, 0]) ** 2)
    return float(np.mean(1.0 / stated)), float(np.mean((readings.mean(axis=1) - truth[:, 0]) ** 2) / single)


@pytest.mark.parametrize("noise", [0.0001, 0.003, 0.01, 0.02, 0.03, 0.05])
def test_the_mean_of_a_stretch_is_worth_what_its_error_says(noise) -> None:
    """One reading without noise, all twenty at half a step; in between the variance is up to three times too large."""
    stated, true = worth(noise)
    assert 0.8 * true < stated < (1.3 if noise in (0.0001, 0.003, 0.05) else 3.0) * true


def test_a_reading_that_moved_on_is_a_stretch_of_its_own() -> None:
    samples = np.array([0.0, 0.1, 0.0, 0.1, 5.0, 9.0, 9.1, 9.0])[:, None] * [1.0, 0.0, 0.0]
    starts = still_stretches(samples, STEP)
    assert starts.tolist() == [0, 4, 5]
    assert counted_as(samples, starts, STEP)[1] == 1.0
    assert (counted_as(samples, starts, STEP) < 1.5).all()  # two axes never left their step


def held(seed):
    """Deviations of a fit to forty attitudes held for two seconds, next to one step's edge in one of the axes."""
    rng = np.random.default_rng([seed, 3])
    directions = rng.normal(size=(40, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    offset = rng.uniform(-20.0, 20.0, 3)
    field = 50.0 * directions + offset
    field[np.arange(40), rng.integers(0, 3, 40)] = np.nan
    field = np.where(np.isnan(field), np.round((50.0 * directions + offset) / STEP) * STEP, field)
    samples = rounded(np.repeat(field, 20, axis=0) + 0.003 * rng.normal(size=(800, 3)))
    still = Rates(np.arange(800) / 10.0, *np.zeros((1, 800, 3)), *np.zeros((2, 800, 3, 3)), np.ones(800, bool), 0.0)
    fit = fit_ellipsoid_deblurred(samples, still, quantum=STEP)
    assert fit.n_samples == 40
    return deviations(fit, np.concatenate([offset, [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]]))


def test_the_uncertainty_of_a_compass_that_was_held_still_is_that_of_its_attitudes() -> None:
    """With every jump between two steps for a reading of its own, the rms is 2.3 and 56 % of the intervals hold."""
    found = np.array([held(seed) for seed in range(25)])
    assert 0.8 < np.sqrt(np.mean(found**2)) < 1.2
    assert 0.91 < np.mean(np.abs(found) < 1.96) < 0.99
