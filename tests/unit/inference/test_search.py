"""One posterior over sets of blocks: found by a search, and the same as if every set had been looked at."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from mavcal.calib.inference.model import Block, Evidence, Model
from mavcal.calib.inference.search import KEPT_NATS, search
from tests.unit.inference.linear import Columns, brute_force, drawn, models_of

BLOCKS = (
    Block("a", (1.0,), 0.1),
    Block("b", (0.5, 0.5), 0.2),
    Block("c", (2.0,), 0.05),
    Block("d", (1.0,), 0.1, nameless=True),
    Block("e", (0.3,), 1.0),
    Block("f", (1.0, 1.0, 1.0), 0.05, nameless=True),
)
TRUTHS: list[dict[str, tuple[float, ...]]] = [
    {},
    {"a": (0.9,)},
    {"c": (-3.0,), "e": (0.6,)},
    {"b": (0.8, -0.7), "d": (1.5,), "f": (1.0, 0.0, -1.0)},
]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("truth", TRUTHS, ids=lambda t: "".join(t) or "nothing")
def test_what_is_there_is_found_with_the_probability_of_all_sets_together(truth: dict, seed: int) -> None:
    evidence = drawn(BLOCKS, truth, seed)
    answer, known = search(evidence), brute_force(evidence)
    assert set(truth) <= set(answer.best.model)
    assert answer.best.model == max(known, key=lambda m: known[m])
    for block in BLOCKS:
        exact = math.fsum(p for model, p in known.items() if block.name in model)
        assert answer.probability(block.name) == pytest.approx(exact, abs=0.02)
    either = math.fsum(p for model, p in known.items() if model & {"a", "d"})
    assert answer.probability("a", "d") == pytest.approx(either, abs=0.02)


@pytest.mark.parametrize("seed", range(3))
def test_kept_models_have_weights_in_proportion_to_their_posterior(seed: int) -> None:
    evidence = drawn(BLOCKS, TRUTHS[1], seed, size=0.3)  # weak: many models are alive
    answer, known = search(evidence), brute_force(evidence)
    kept = {v.model: w for v, w in zip(answer.kept, answer.weights, strict=True)}
    assert math.fsum(kept.values()) == pytest.approx(1.0)
    assert list(answer.weights) == sorted(answer.weights, reverse=True)
    share = math.fsum(known[m] for m in kept)
    assert share > 0.9
    for model, weight in kept.items():
        assert weight == pytest.approx(known[model] / share, rel=1e-6)


def test_models_are_forgotten_beyond_twelve_nats_and_no_sooner() -> None:
    evidence = drawn(BLOCKS, TRUTHS[2], 1)
    answer = search(evidence)
    logs = [v.log_weight for v in answer.kept]
    assert logs[0] - logs[-1] <= KEPT_NATS == 12.0
    assert len(answer.kept) < answer.visited
    neighbours = [answer.best.model ^ {b.name} for b in BLOCKS]
    known = brute_force(evidence)
    near = {m for m in neighbours if math.log(known[answer.best.model] / known[m]) < KEPT_NATS - 1e-6}
    assert near <= {v.model for v in answer.kept}


def test_two_of_one_exclusive_group_are_never_together() -> None:
    """Two forms of one effect that are told apart badly: the sum is sure although neither form is."""
    rng = np.random.default_rng(3)
    blocks = (
        Block("weak", (1.0,), 0.1, exclusive="m"),
        Block("pulse", (1.0,), 0.1, exclusive="m"),
        Block("z", (1.0,), 0.1),
    )
    x = rng.normal(size=(50, 1))
    columns = {"weak": x, "pulse": x + 0.05 * rng.normal(size=(50, 1)), "z": rng.normal(size=(50, 1))}
    evidence = Columns(blocks, columns, (x[:, 0] + rng.normal(size=50)))
    answer, known = search(evidence), brute_force(evidence)
    assert all(not {"weak", "pulse"} <= v.model for v in answer.kept)
    for name in ("weak", "pulse"):
        exact = math.fsum(p for m, p in known.items() if name in m)
        assert 0.05 < exact < 0.95
        assert answer.probability(name) == pytest.approx(exact, abs=0.02)
    assert answer.probability("weak", "pulse") > 0.99


def test_amplitudes_are_averaged_over_the_models_that_have_them() -> None:
    evidence = drawn(BLOCKS, TRUTHS[2], 2)
    answer = search(evidence)
    mean, covariance = answer.amplitudes("c")
    known = brute_force(evidence)
    total = math.fsum(p for m, p in known.items() if "c" in m)
    parts = [(p / total, *evidence.posterior(m).of("c")) for m, p in known.items() if "c" in m]
    exact = sum(p * m[0] for p, m, _ in parts)
    spread = sum(p * (c[0, 0] + (m[0] - exact) ** 2) for p, m, c in parts)
    assert mean[0] == pytest.approx(exact, abs=0.02 * math.sqrt(spread))
    assert covariance[0, 0] == pytest.approx(spread, rel=0.02)
    assert abs(mean[0] + 3.0) < 4.0 * math.sqrt(covariance[0, 0])


def test_a_rival_takes_the_place_of_the_block_that_it_resembles() -> None:
    rng = np.random.default_rng(11)
    x = rng.normal(size=(60, 1))
    columns = {"true": x, "twin": x + 0.3 * rng.normal(size=(60, 1)), "other": rng.normal(size=(60, 1))}
    blocks = tuple(Block(name, (1.0,), 0.05) for name in columns)
    answer = search(Columns(blocks, columns, 0.7 * x[:, 0] + rng.normal(size=60)))
    assert "true" in answer.best.model
    rivals = answer.rivals("true")
    probability, nats = rivals["twin"]
    without = {v.model: w for v, w in zip(answer.kept, answer.weights, strict=True) if "true" not in v.model}
    assert probability == pytest.approx(math.fsum(w for m, w in without.items() if "twin" in m))
    best_with = max(v.log_weight for v in answer.kept if "true" in v.model)
    best_twin = max(v.log_weight for v in answer.kept if "twin" in v.model and "true" not in v.model)
    assert nats == pytest.approx(best_with - best_twin)
    assert answer.confusable("true", 0.5 * probability) == ("twin",)
    assert answer.confusable("true", 1.0) == ()


def test_blocks_that_help_only_together_are_found() -> None:
    """Two columns that are nearly one, with opposite amplitudes: neither alone explains much."""
    rng = np.random.default_rng(5)
    common, own = rng.normal(size=80), rng.normal(size=80)
    columns = {"p": (common + 0.3 * own)[:, None], "q": (common - 0.3 * own)[:, None]}
    columns |= {name: rng.normal(size=(80, 1)) for name in "xy"}
    blocks = tuple(Block(name, (2.0,), 0.1) for name in columns)
    y = 2.0 * (columns["p"] - columns["q"])[:, 0] + rng.normal(size=80)
    evidence = Columns(blocks, columns, y)
    known = brute_force(evidence)
    assert search(evidence).best.model == max(known, key=lambda m: known[m]) == frozenset("pq")


def test_the_start_does_not_change_the_answer() -> None:
    evidence = drawn(BLOCKS, TRUTHS[3], 4)
    usual = search(evidence)
    for start in itertools.islice(models_of(BLOCKS), 3, 40, 9):
        other = search(evidence, start)
        assert other.best.model == usual.best.model
        for block in BLOCKS:
            assert other.probability(block.name) == pytest.approx(usual.probability(block.name), abs=0.02)


def test_a_search_that_is_out_of_time_answers_with_what_it_has() -> None:
    evidence = drawn(BLOCKS, TRUTHS[2], 1)
    answer = search(evidence, ended=lambda: True)
    assert answer.best.model == frozenset()
    assert answer.weights == (1.0,)
    calls = iter(range(10_000))
    part = search(evidence, ended=lambda: next(calls) >= 1)
    assert part.visited < search(evidence).visited


def test_data_are_expanded_again_about_what_was_found() -> None:
    asked: list[Model] = []

    class Expanding(Columns):
        def refined(self, model: Model) -> Evidence:
            asked.append(model)
            return Expanding(self.blocks, self.columns, self.y)

    made = drawn(BLOCKS, TRUTHS[1], 0)
    answer = search(Expanding(made.blocks, made.columns, made.y))
    assert asked[0] == answer.best.model
    assert len(asked) <= 4


def test_the_search_goes_on_until_what_it_tells_stands() -> None:
    """Each expansion comes half-way nearer to where the best point of curved data is."""
    made = drawn(BLOCKS, TRUTHS[1], 0)

    class Curved(Columns):
        def refined(self, model: Model) -> Evidence:
            return Curved(self.blocks, self.columns, 0.5 * (self.y + made.y))

    answer = search(Curved(made.blocks, made.columns, 3.0 * made.y))
    for name in answer.best.model:
        (found, spread), (there, _) = answer.best.posterior.of(name), made.posterior(answer.best.model).of(name)
        assert (np.abs(found - there) < 0.6 * np.sqrt(np.diag(spread))).all()


def test_probabilities_come_true_as_often_as_they_say() -> None:
    """300 problems drawn from the prior itself: of blocks with a probability of p, a part p is there."""
    rng = np.random.default_rng(2)
    blocks = tuple(Block(name, (0.5,), odds) for name, odds in zip("abcd", (0.3, 0.3, 0.6, 1.0), strict=True))
    said, there = [], []
    for seed in range(300):
        truth = {
            b.name: (rng.normal() * b.sd[0],) for b in blocks if rng.random() < b.prior_odds / (1.0 + b.prior_odds)
        }
        answer = search(drawn(blocks, truth, seed, n=20))
        said += [answer.probability(b.name) for b in blocks]
        there += [b.name in truth for b in blocks]
    p, true = np.array(said), np.array(there, dtype=float)
    assert abs((true - p).sum()) < 3.0 * math.sqrt((p * (1.0 - p)).sum())
    for low, high in itertools.pairwise((0.0, 0.1, 0.2, 0.4, 0.6, 0.8, 0.95, 1.001)):
        rows = (p >= low) & (p < high)
        assert rows.sum() >= 15
        error = math.sqrt(max((p[rows] * (1.0 - p[rows])).sum(), 0.25))
        assert abs((true[rows] - p[rows]).sum()) < 3.0 * error
