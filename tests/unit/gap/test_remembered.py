"""The store of one diagnosis, and that nothing else in these rooms keeps results at module level."""

from __future__ import annotations

import ast
import contextvars
import gc
import threading
import weakref
from pathlib import Path

import numpy as np
import pytest

from mavcal.calib.gap.diagnose import diagnose
from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.remembered import ABSENT, ResultStore, SameArray, one_diagnosis, remembered
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import problem_of

ROOT = Path(__file__).resolve().parents[3] / "calib"
ROOMS = ("gap", "gap_report", "flight", "stats")


class Counted:
    """A function of two arguments, how often it was computed, and the same function remembered."""

    def __init__(self, most: int = 8) -> None:
        self.calls = 0
        self.ask = remembered(most)(self._compute)

    def _compute(self, a: object, b: object = 0) -> tuple[object, object]:
        self.calls += 1
        return a, b


def test_the_same_arguments_are_computed_once() -> None:
    counted = Counted()
    with one_diagnosis():
        assert counted.ask(1, 2) is counted.ask(1, 2)
        assert counted.calls == 1


def test_other_arguments_are_computed_by_themselves() -> None:
    counted = Counted()
    with one_diagnosis():
        assert counted.ask(1, 2) == (1, 2)
        assert counted.ask(2, 1) == (2, 1)
        assert counted.ask(1, b=2) == (1, 2)
        assert counted.ask(1, b=3) == (1, 3)
        assert counted.calls == 4
        assert counted.ask(1, b=3) == (1, 3)
        assert counted.calls == 4


def test_two_functions_never_share_a_result() -> None:
    one, other = Counted(), Counted()
    with one_diagnosis():
        one.ask(1)
        other.ask(1)
    assert (one.calls, other.calls) == (1, 1)


def test_none_is_a_result_like_any_other() -> None:
    calls = []
    ask = remembered(2)(calls.append)
    with one_diagnosis():
        ask(1)
        ask(1)
    assert calls == [1]


def test_an_error_is_not_remembered() -> None:
    calls = []

    @remembered(2)
    def failing(value: int) -> int:
        calls.append(value)
        if len(calls) == 1:
            raise ValueError(value)
        return value

    with one_diagnosis() as store:
        with pytest.raises(ValueError, match="7"):
            failing(7)
        assert len(store) == 0
        assert failing(7) == 7


def test_no_more_results_stay_than_allowed_and_the_one_not_asked_for_longest_goes_first() -> None:
    counted = Counted(most=3)
    with one_diagnosis() as store:
        for k in range(3):
            counted.ask(k)
        counted.ask(0)  # now 1 is the oldest
        counted.ask(3)
        assert len(store) == 3
        assert counted.calls == 4
        for k in (2, 0, 3):
            counted.ask(k)
        assert counted.calls == 4
        counted.ask(1)
        assert counted.calls == 5
        for k in range(100):
            counted.ask(k)
        assert len(store) == 3


def test_arrays_are_told_apart_by_identity_not_by_their_numbers() -> None:
    counted = Counted()
    one, equal = np.arange(3.0), np.arange(3.0)
    with one_diagnosis():
        assert counted.ask(one)[0] is one
        assert counted.ask(equal)[0] is equal
        assert counted.ask(one)[0] is one
    assert counted.calls == 2
    assert SameArray(one) == SameArray(one)
    assert SameArray(one) != SameArray(equal)
    assert SameArray(one) != one.tolist()


def test_a_key_keeps_its_array_so_that_no_other_array_gets_its_id() -> None:
    total = remembered(4)(lambda array: float(array.sum()))
    with one_diagnosis():
        found = []
        for k in range(200):  # without the key's hold these would share addresses
            array = np.full(5, float(k))
            held = weakref.ref(array)
            found.append(total(array))
            del array
            assert held() is not None
        assert found == [5.0 * k for k in range(200)]


def test_without_a_store_every_call_computes() -> None:
    counted = Counted()
    assert counted.ask(1) == counted.ask(1)
    assert counted.calls == 2


def test_a_nested_diagnosis_uses_the_outer_store_and_leaves_it() -> None:
    counted = Counted()
    with one_diagnosis() as outer:
        counted.ask(1)
        with one_diagnosis() as inner:
            assert inner is outer
            counted.ask(1)
        counted.ask(1)
    assert counted.calls == 1


def test_the_next_diagnosis_begins_with_nothing() -> None:
    counted = Counted()
    for _ in range(2):
        with one_diagnosis() as store:
            assert len(store) == 0
            counted.ask(1)
    assert counted.calls == 2


def test_a_store_ends_with_a_diagnosis_that_fails() -> None:
    counted = Counted()
    with pytest.raises(RuntimeError), one_diagnosis():
        raise RuntimeError
    counted.ask(1)
    counted.ask(1)
    assert counted.calls == 2


def test_as_a_decorator_each_call_has_a_store_of_its_own() -> None:
    counted = Counted()

    @one_diagnosis()
    def twice() -> None:
        counted.ask(1)
        counted.ask(1)

    twice()
    assert counted.calls == 1
    twice()
    assert counted.calls == 2


def test_a_thread_inside_a_diagnosis_has_no_store_and_computes() -> None:
    counted, found = Counted(), []
    with one_diagnosis():
        counted.ask(1)
        thread = threading.Thread(target=lambda: found.append(counted.ask(1)))
        thread.start()
        thread.join()
        assert counted.calls == 2
    assert found == [(1, 0)]


def test_two_contexts_share_nothing() -> None:
    counted = Counted()

    def once() -> None:
        with one_diagnosis():
            counted.ask(1)

    for _ in range(2):
        contextvars.Context().run(once)
    assert counted.calls == 2


def test_what_was_remembered_is_freed_after_the_diagnosis() -> None:
    made = []

    @remembered(4)
    def doubled(array: np.ndarray) -> np.ndarray:
        made.append(weakref.ref(array))
        found = 2.0 * array
        made.append(weakref.ref(found))
        return found

    with one_diagnosis():
        doubled(np.arange(4.0))
        assert all(ref() is not None for ref in made)
    gc.collect()
    assert [ref() for ref in made] == [None, None]


def test_nothing_of_a_problem_outlives_its_diagnosis() -> None:
    effects = tuple(e for e in catalogue() if e.id in {"gyro_bias", "gyro_delay", "gyro_noise"})
    problem = problem_of(np.random.default_rng(1), (Sensor.GYRO,))
    traces = [weakref.ref(trace) for trace in problem.traces]
    report = diagnose(problem, effects=effects, nested=False)
    del problem
    gc.collect()
    assert report.effects is not None
    assert [ref() for ref in traces] == [None] * len(traces)


CONSTANT = {
    "gap.effects.catalogue",
    "gap.effects.by_id",
    "gap.effects.forward_models",
    "gap.effects.parameter_table",
    "gap.telling.recordings.diagnoser_sha256",
    "gap.model.hypotheses._places",
    "gap.likelihood.fast_length",
    "gap.likelihood.bins_of",
}
"""Functions of nothing, or of a few integers: what they keep is of no recording, and bounded."""

_CACHES = {"cache", "lru_cache"}
_EMPTY = {"dict", "list", "set", "OrderedDict", "defaultdict", "deque", "Counter"}
_WEAK = {"WeakKeyDictionary", "WeakValueDictionary", "WeakSet"}
_CHANGES = {
    *("append", "extend", "insert", "add", "update", "setdefault", "pop", "popitem", "clear", "remove", "discard"),
    *("move_to_end", "appendleft", "popleft", "__setitem__"),
}


def _name(node: ast.AST) -> str:
    """The last part of a (dotted, called) name."""
    if isinstance(node, ast.Call):
        return _name(node.func)
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def _assigned(statement: ast.stmt) -> tuple[list[str], ast.expr | None]:
    targets = statement.targets if isinstance(statement, ast.Assign) else [getattr(statement, "target", None)]
    return [t.id for t in targets if isinstance(t, ast.Name)], getattr(statement, "value", None)


def _changed(node: ast.AST, names: set[str]) -> set[str]:
    """Which of the `names` a statement or call inside a function changes in place."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in _CHANGES:
        return {_name(node.func.value)} & names if isinstance(node.func.value, ast.Name) else set()
    if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store | ast.Del):
        return {_name(node.value)} & names
    return set(node.names) if isinstance(node, ast.Global) else set()


def caches(module: str, source: str) -> set[str]:
    """Caches of a module by dotted name, wherever a function or a name of the module keeps results."""
    tree = ast.parse(source)
    found: set[str] = set()
    names: set[str] = set()
    for statement in tree.body:
        if not isinstance(statement, ast.Assign | ast.AnnAssign):
            continue
        targets, value = _assigned(statement)
        names |= set(targets)
        empty = isinstance(value, ast.Dict | ast.List | ast.Set) and not any(ast.iter_child_nodes(value))
        called = isinstance(value, ast.Call) and (
            _name(value) in _WEAK | _CACHES or (_name(value) in _EMPTY and not (value.args or value.keywords))
        )
        wrapped = isinstance(value, ast.Call) and isinstance(value.func, ast.Call) and _name(value.func) in _CACHES
        if empty or called or wrapped:
            found |= set(targets)
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and any(_name(d) in _CACHES for d in node.decorator_list):
            found.add(node.name)
        if isinstance(node, ast.FunctionDef | ast.Lambda):
            found |= {name for inner in ast.walk(node) for name in _changed(inner, names)}
    return {f"{module}.{name}" for name in found}


@pytest.mark.long
def test_no_module_keeps_results_of_a_diagnosis() -> None:
    found: set[str] = set()
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")) or [ROOT / f"{room}.py"]:
            parts = path.relative_to(ROOT).with_suffix("").parts
            found |= caches(".".join(part for part in parts if part != "__init__"), path.read_text(encoding="utf-8"))
    assert found == CONSTANT


@pytest.mark.parametrize(
    ("source", "name"),
    [
        ("@lru_cache(maxsize=6)\ndef f(view): return view", "f"),
        ("@functools.cache\ndef f(view): return view", "f"),
        ("def outer():\n    @cache\n    def f(view): return view\n    return f", "f"),
        ("class A:\n    @lru_cache\n    def f(self): return 1", "f"),
        ("f = lru_cache(maxsize=2)(len)", "f"),
        ("f = cache(len)", "f"),
        ("_GRAMS: OrderedDict[int, int] = OrderedDict()", "_GRAMS"),
        ("_SPECTRA = {}", "_SPECTRA"),
        ("_SEEN = weakref.WeakKeyDictionary()", "_SEEN"),
        ("_T = {1: 2}\ndef f(k): _T[k] = 1", "_T"),
        ("_T = {1: 2}\ndef f(k): del _T[k]", "_T"),
        ("_T = [1]\nf = lambda k: _T.append(k)", "_T"),
        ("_T = None\ndef f(k):\n    global _T\n    _T = k", "_T"),
    ],
)
def test_a_cache_is_seen_however_it_is_written(source: str, name: str) -> None:
    assert caches("m", source) == {f"m.{name}"}


@pytest.mark.parametrize(
    "source",
    [
        "_T = {1: 2}\ndef f(k): return _T[k]",
        "def f():\n    found = {}\n    found[1] = 2\n    return found",
        "@cached_property\ndef f(self): return 1",
        "@remembered(4)\ndef f(view): return view",
    ],
)
def test_a_constant_is_no_cache(source: str) -> None:
    assert caches("m", source) == set()


def test_a_store_counts_what_it_holds() -> None:
    store = ResultStore()
    assert store.taken(len, "key") is ABSENT
    store.keep(len, "key", 3, 2)
    assert len(store) == 1
    assert store.taken(len, "key") == 3
    assert len(store) == 0
