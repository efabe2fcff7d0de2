"""Numbers with several values: the answers are those of a run for each value."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.variants import Variant, VariantNumber, VariantProcess, value_in
from tests.examples import examples

pytestmark = pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")

Table = Mapping[str, float]
Others = Mapping[Variant, float]
BASE = {"a": 2.0, "b": 10.0, "n": 3}
OTHERS: Others = {("a", 0): 1.0, ("a", 1): 3.0, ("b", 0): 7.0, ("b", 1): 13.0, ("n", 0): 2, ("n", 1): 4}


def run(program: Callable[[Table], Any], base: Table = BASE, others: Others = OTHERS) -> tuple[Any, dict[Variant, Any]]:
    """The answer of `program` and those of the variants whose answer comes from a fork."""
    process = VariantProcess(others)
    table = {
        name: VariantNumber(plain, {v: one for v, one in others.items() if v[0] == name}, process)
        for name, plain in base.items()
    }
    try:
        answer = value_in(process.own, program(table))
        process.end_child(answer)
    except BaseException:
        process.fail_child()
        raise
    return answer, process.answers


def separately(program: Callable[[Table], Any]) -> tuple[Any, dict[Variant, Any]]:
    """The same by a run for each variant."""
    return program(BASE), {v: program({**BASE, v[0]: other}) for v, other in OTHERS.items()}


def rows(table: Table) -> list[float]:
    return [float(x) for x in np.arange(6.0) if x > table["a"]]


PROGRAMS: dict[str, Callable[[Table], Any]] = {
    "a comparison": lambda t: "more" if t["a"] > 2.5 else "less",
    "a reflected comparison": lambda t: "more" if np.float64(1.5) <= t["a"] else "less",
    "sums and products": lambda t: 3.0 * t["a"] - t["b"] / 2.0 + 1.0 < 0.5,
    "a reflected difference and quotient": lambda t: [1.0 - t["a"] < -1.5, 6.0 / t["a"] > 2.5, t["a"] ** 2 > 5.0],
    "numbers of NumPy": lambda t: bool(np.float64(4.0) - t["a"] > np.float64(1.5)),
    "an array of comparisons": rows,
    "a function of NumPy": lambda t: bool(np.log(t["b"]) > 2.2),
    "a function of math": lambda t: math.log(t["b"]),
    "a slice": lambda t: list(range(10))[: t["n"]],  # type: ignore[misc]
    "a range": lambda t: len(range(t["n"] + 1)),  # type: ignore[arg-type]
    "the largest": lambda t: max(t["a"], 2.5, t["b"] - 9.0) > 2.6,
    "an order": lambda t: [k for k, _ in sorted({"x": t["a"], "y": 2.5, "z": -t["b"]}.items(), key=lambda p: p[1])],
    "a sum": lambda t: sum([t["a"], t["a"], t["b"]]) > 14.5,
    "an array made of it": lambda t: float(np.array([t["a"], 1.0]).sum()),
    "truth": lambda t: bool(t["a"] - 3.0) and bool(abs(t["a"] - 2.0)),
    "text": lambda t: f"{t['a']:.1f} {t['b']!r} {round(t['b'])}",
    "a key": lambda t: {2.0: "two"}.get(t["a"], "other"),
    "equality": lambda t: t["a"] == 3.0,
    "a second comparison after a fork": lambda t: [t["a"] > 2.5, t["a"] > 1.5, t["b"] > t["a"] * 4.0],
}


@pytest.mark.parametrize("what", PROGRAMS)
def test_the_answers_are_those_of_a_run_for_each_variant(what: str) -> None:
    program = PROGRAMS[what]
    plain, others = run(program)
    expected, expected_others = separately(program)
    assert plain == expected
    assert {v: others.get(v, plain) for v in OTHERS} == expected_others


def test_variants_that_decide_alike_share_a_process() -> None:
    plain, others = run(lambda t: (t["a"] < 5.0, (np.arange(4.0) > t["a"] + 10.0).any(), min(t["b"], 1.0)))
    assert (plain, others) == ((True, False, 1.0), {})


def test_only_the_variant_that_differs_is_forked() -> None:
    assert run(lambda t: t["a"] > 2.5) == (False, {("a", 1): True})


def test_a_variant_that_is_closed_is_not_forked() -> None:
    process = VariantProcess(OTHERS)
    number = VariantNumber(2.0, {("a", 1): 3.0}, process)
    process.close(("a", 1), "known")
    assert not number > 2.5
    assert process.answers == {("a", 1): "known"}


def test_a_variant_that_fails_is_an_error(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(RuntimeError, match="the run with another a failed"):
        run(lambda t: 1 // 0 if t["a"] > 2.5 else 1)
    assert "ZeroDivisionError" in capfd.readouterr().err


@settings(max_examples=examples(25), deadline=None)
@given(steps=st.lists(st.tuples(st.sampled_from(["a", "b"]), st.floats(-2.0, 2.0), st.floats(-20.0, 40.0)), max_size=4))
def test_any_row_of_steps_answers_as_separate_runs(steps: list[tuple[str, float, float]]) -> None:
    def program(table: Table) -> list[bool]:
        total: Any = 0.0
        taken = []
        for name, factor, limit in steps:
            total = total + factor * table[name]
            taken.append(bool(total > limit))
        return taken

    plain, others = run(program)
    expected, expected_others = separately(program)
    assert plain == expected
    assert {v: others.get(v, plain) for v in OTHERS} == expected_others
