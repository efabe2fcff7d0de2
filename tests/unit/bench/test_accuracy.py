from __future__ import annotations

import numpy as np
import pytest

from bench.accuracy import peers, rows_imu, rows_mag, rows_thermal
from bench.accuracy.__main__ import main
from bench.accuracy.campaign import Answer, Case, Contender, Drawn, Settings, run_case
from bench.accuracy.tables import accuracy_part

TRUTH = np.array([1.0, -2.0])


def draw(rng: np.random.Generator) -> Drawn:
    samples = TRUTH + 0.5 * rng.normal(size=(50, 2))
    return Drawn(samples, TRUTH, 50 / 0.25 * np.eye(2))


def mean(samples):
    found = samples.mean(axis=0)
    return Answer(found, found, samples.std(axis=0, ddof=1) / np.sqrt(len(samples)))


def broken(samples):
    raise ValueError(samples.shape)


def half_blind(samples):
    found = samples.mean(axis=0)
    found[1] = np.nan
    return Answer(found, found, np.array([0.5 / 50**0.5, np.nan]))


CASE = Case("means", 50, draw, 300, 7)


def test_an_efficient_estimator_is_at_the_bound_and_its_intervals_hold() -> None:
    (tally,) = run_case(CASE, [Contender("mean", mean, target=1.02)])
    assert tally.ratio == pytest.approx(1.0, abs=4 * tally.ratio_sd)
    assert tally.ratio_sd == pytest.approx(1 / np.sqrt(2 * 300 * 2), rel=0.2)
    assert tally.coverage == pytest.approx(0.95, abs=3 * tally.coverage_sd)
    assert tally.met is True


@pytest.mark.parametrize(
    "fit",
    [
        lambda s: Answer(s[:20].mean(axis=0)),  # wastes more than half of the samples
        lambda s: Answer(s.mean(axis=0), s.mean(axis=0), np.full(2, 0.03)),  # believes itself too much
        lambda s: mean(s) if s[0, 0] < 1.5 else None,  # refuses sometimes
        broken,
    ],
    ids=["wasteful", "proud", "shy", "broken"],
)
def test_a_promise_that_is_not_kept_is_seen(fit) -> None:
    (tally,) = run_case(CASE, [Contender("bad", fit, ours=True, target=1.05)])
    assert tally.met is False


def test_intervals_may_be_judged_from_one_side_and_on_their_own() -> None:
    def wide(samples):
        found = samples.mean(axis=0)
        return Answer(found, found, np.full(2, 0.2))

    def narrow(samples):
        return Answer(samples.mean(axis=0), samples.mean(axis=0), np.full(2, 0.05))

    exact, enough, proud = run_case(
        CASE,
        [
            Contender("exact", wide, honest=True),
            Contender("enough", wide, honest=True, exact=False),
            Contender("proud", narrow, honest=True, exact=False),
        ],
    )
    assert (exact.met, enough.met, proud.met) == (False, True, False)


def test_contenders_see_the_same_draws_and_failures_are_counted() -> None:
    one, two, dead, blind = run_case(
        CASE, [Contender(n, f) for n, f in (("one", mean), ("two", mean), ("dead", broken), ("blind", half_blind))]
    )
    assert one.squares == two.squares
    assert (dead.failed, dead.squares, dead.runs) == (300, [], 300)
    assert blind.declined == 300
    assert blind.ratio == pytest.approx(1.0, abs=0.15)
    text = accuracy_part("Means", [one, two, dead, blind], ["peer: not installed"]).body
    assert "none of 300 runs" in text
    assert "Not measured: peer: not installed." in text
    assert "Seeds: 7 (N = 50, 300 runs)." in text


def test_a_peer_that_takes_too_long_makes_fewer_runs_and_ours_all() -> None:
    slow, ours = run_case(CASE, [Contender("slow", mean), Contender("ours", mean, ours=True)], budget=1e-4)
    assert 1 <= slow.runs < 300
    assert ours.runs == 300


def test_a_slice_of_the_magnetometer(capsys: pytest.CaptureFixture[str]) -> None:
    settings = Settings(quick=True, silent=True)
    contenders, missing = rows_mag.contenders(rows_mag.CLEAN)
    assert len(contenders) + len(missing) == 9 + len(peers.MAGNETOMETER)
    (case, *_) = rows_mag.cases(settings)["tilt up to 45 degrees"]
    tallies = {t.contender.name: t for t in run_case(case, contenders[:4])}
    ours = tallies["**mavcal mag-ellipsoid**"]
    assert ours.met is True
    assert ours.runs == 12
    assert capsys.readouterr().err == ""


def test_seeds_are_fixed_and_differ() -> None:
    one = Settings()
    assert one.seed_of("a", 100) == Settings().seed_of("a", 100)
    assert (
        len({one.seed_of("a", 100), one.seed_of("b", 100), one.seed_of("a", 200), Settings(seed=2).seed_of("a", 100)})
        == 4
    )
    assert [one.runs(n) for n in (100, 10_000, 100_000, 1_000_000)] == [200, 200, 60, 40]


@pytest.mark.long
def test_the_command_prints_its_tables(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["six-face", "allan", "--quick"]) == 0
    printed = capsys.readouterr().out
    assert "## Six faces, noise of 3 mG" in printed
    if peers.version_of("imucal") is None:
        assert "Not measured: imucal Ferraris: not installed." in printed


def test_what_a_peer_is_missing_is_named() -> None:
    assert peers.usable("no-such-distribution", mean, None) == "not installed"
    assert peers.usable("numpy", broken, np.zeros((2, 3))).startswith("does not run here: ValueError")


def test_unwary_forms_answer_on_clean_data() -> None:
    data = rows_thermal._warmup(np.random.default_rng(1), 5000, 0.0)
    own = rows_thermal._ours(data)
    assert own is not None
    for form in (rows_thermal._polyfit, rows_thermal._averaged):
        np.testing.assert_allclose(form(data).values, own.values, atol=6 * own.stored_sd.max())


def test_poses_are_held_and_turned() -> None:
    data = rows_imu.held(np.random.default_rng(2), 3)
    assert len(data.spans) == 3
    for start, end in data.spans:
        still = (data.accel.t >= start) & (data.accel.t < end)
        assert not data.rates[still].any()
    np.testing.assert_allclose(np.linalg.norm(data.downs, axis=1), 1.0)
