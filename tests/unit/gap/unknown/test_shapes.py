"""Shapes beyond the catalogue: what is drawn over which covariate, and that a low order is found in its columns."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from mavcal.calib.gap.diagnose import diagnose
from mavcal.calib.gap.effects import by_id
from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.model.joint import setting_of
from mavcal.calib.gap.model.noise_fit import model_without_effects
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.search import prices
from mavcal.calib.gap.search.contest import Contest
from mavcal.calib.gap.search.projection import Projection
from mavcal.calib.gap.search.terms import with_score
from mavcal.calib.gap.unknown.shapes import shapes_of
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import SIGMA, problem_of


def model_of(sensor=Sensor.ACCEL, gap=None, *, instances=1, seed=1, **over):
    problem = problem_of(np.random.default_rng(seed), (sensor,), gap, instances=instances)
    traces = tuple(dataclasses.replace(t, **over) for t in problem.traces)
    setting = setting_of(views_of(dataclasses.replace(problem, traces=traces), {}, {}))
    return model_without_effects(setting)


def named(model):
    return {h.effect.excited_by: h for shape in shapes_of(model.setting) for h in shape.hypotheses}


def test_a_shape_has_a_family_that_has_a_price_and_its_parts_are_parts():
    found = shapes_of(model_of(instances=2).setting)
    assert {s.whole.effect.family for s in found} <= set(prices.SHAPE_PRICES)
    assert all(s.whole.effect.nameless and not s.whole.effect.part for s in found)
    parts = [h.effect for s in found for h, _ in s.parts]
    assert all(part.nameless and part.part for part in parts)
    assert len({h.key for s in found for h in s.hypotheses}) == len(found) + len(parts)


def gains(model):
    contest, beside = Contest((), budget=0), Projection(model)
    return {name: contest.score(h, beside) for name, h in named(model).items()}


def test_every_covariate_that_is_recorded_has_its_line_and_none_that_is_not():
    all_of_it = named(model_of())
    for covariate in ("a_x", "w_z", "|a|", "time", "temperature", "current", "throttle", "the slope of temperature"):
        assert f"function of {covariate} on accel" in all_of_it
        assert f"function of {covariate} on accel.y" in all_of_it
    bare = named(model_of(temperature=None, current=None))
    assert not [name for name in bare if "temperature" in name or "current" in name]
    still = named(model_of(throttle=np.full(2000, 0.5)))
    assert "function of throttle on accel" not in still


def test_shapes_are_told_apart_by_instance_and_from_the_catalogue():
    found = [h for shape in shapes_of(model_of(instances=2).setting) for h in shape.hypotheses]
    assert len({h.key for h in found}) == len(found)
    assert {h.instances for h in found} == {(0,), (1,), (0, 1)}
    together = {h.effect.excited_by for h in found if h.instances == (0, 1)}
    assert all(text.startswith("time since the start on ") for text in together)  # the clock of the test begins at zero
    assert together
    assert all(h.effect.nameless for h in found)
    assert not {h.effect.id for h in found} & set(by_id())


@pytest.mark.parametrize(
    ("sensor", "letter", "ids"),
    [
        (Sensor.ACCEL, "a", {"accel_scale", "accel_misalignment"}),
        (Sensor.GYRO, "w", {"gyro_scale", "gyro_misalignment"}),
        (Sensor.GYRO, "a", {"gyro_g_sensitivity"}),
        (Sensor.MAG, "m", {"mag_soft_iron", "mag_rotation"}),
    ],
)
def test_one_entry_of_a_matrix_that_has_a_name_is_no_shape(sensor, letter, ids):
    def linear(named):
        shapes = (h.effect.excited_by for s in shapes_of(model_of(sensor).setting, named=named) for h in s.hypotheses)
        return {name for name in shapes if name.startswith((f"linear in {letter}", f"{letter}_x on"))}

    assert ids <= set(by_id())
    assert linear(by_id()) == set()
    for missing in ids:
        assert linear(set(by_id()) - {missing})


@pytest.mark.parametrize(
    ("sensor", "offset", "factor"),
    [
        (Sensor.ACCEL, "accel_bias", "accel_scale"),
        (Sensor.GYRO, "gyro_bias", "gyro_scale"),
        (Sensor.MAG, "mag_hard_iron", "mag_soft_iron"),
    ],
)
def test_an_offset_and_a_factor_are_shapes_where_the_catalogue_does_without(sensor, offset, factor):
    model, names = model_of(sensor), set(by_id())
    assert {offset, factor} <= names

    def simplest(named):
        shapes = (h.effect.excited_by for s in shapes_of(model.setting, named=named) for h in s.hypotheses)
        return {name for name in shapes if name.startswith(("an offset on", "in proportion to"))}

    assert simplest(names) == set()
    assert f"an offset on {sensor}" in simplest(names - {offset})
    assert f"in proportion to the reading on {sensor}" in simplest(names - {factor})


@pytest.mark.long
def test_where_no_effect_is_an_offset_it_is_unknown_and_not_a_temperature():
    rest = tuple(e for e in by_id().values() if e.id != "gyro_bias")
    problem = problem_of(np.random.default_rng(4), (Sensor.GYRO,), lambda t: np.array([0.002, -0.001, 0.0015]))
    report = diagnose(problem, effects=rest, nested=False)
    assert report.effects == ()
    assert report.unknown.shape == "an offset on gyro"


def test_columns_are_finite_and_none_changes_its_trace():
    model = model_of(Sensor.MAG)
    trace = model.setting.views[0].traces[0]
    before = trace.ideal.copy()
    for h in named(model).values():
        columns = h.effect.columns(trace, math.nan)
        assert columns.shape[1:] == (len(trace.t), 3)
        assert np.isfinite(columns).all()
    np.testing.assert_array_equal(trace.ideal, before)


LOW = {
    "square of the reading on accel": lambda t: (t.ideal / 10.0) ** 2,
    "cube of the reading on accel": lambda t: (t.ideal / 10.0) ** 3,
    "size of the reading on accel": lambda t: np.abs(t.ideal) / 10.0,
    "direction of the reading's change on accel": lambda t: np.sign(np.gradient(t.ideal, axis=0)),
    "approach with 10 s on accel": lambda t: np.exp(-t.t / 10.0)[:, None],
    "square of current on accel": lambda t: ((t.current / 20.0) ** 2)[:, None],
    "dead travel of 10.0% of the range on accel": lambda t: played(t.ideal, 0.05 * np.ptp(t.ideal, axis=0)),
}


def played(x, half):
    """A pointer that the reading drags along between two stops: what it lacks of the reading, -1..1."""
    pointer = x.copy()
    for i in range(1, len(x)):
        pointer[i] = np.clip(pointer[i - 1], x[i] - half, x[i] + half)
    return (x - pointer) / half


ALONE = {
    "dw_y on accel.x": lambda t: np.outer(t.spin[:, 1], [0.05, 0.0, 0.0]),
    "a_x times a_z on accel.y": lambda t: np.outer(t.force[:, 0] * t.force[:, 2], [0.0, 0.003, 0.0]),
    "throttle on accel.z": lambda t: np.outer(t.throttle, [0.0, 0.0, 0.05]),
}


@pytest.mark.parametrize("name", list(ALONE))
def test_one_signal_on_one_axis_is_worth_most_as_itself(name):
    found = gains(model_of(gap=ALONE[name]))
    own = found[name]
    assert own.p < 1e-6
    assert own.df == 1
    assert own.delta == max(s.delta for s in found.values())


def test_current_and_the_charge_it_has_drawn_are_a_sagging_battery():
    def sagging(trace):
        charge = np.cumsum(trace.current) / trace.fs
        return np.outer(0.002 * trace.current + 0.0003 * charge, [0.0, 1.0, 0.0])

    found = gains(model_of(gap=sagging))
    best = max(found, key=lambda name: found[name].delta)
    assert found[best].df == 2
    assert all(token in best for token in ("current", "charge", "accel.y"))


def test_a_square_wave_has_overtones_of_the_tone_that_was_found():
    model = model_of(gap=lambda t: np.outer(np.sign(np.sin(2 * np.pi * 0.5 * t.t)), [0.02, 0.0, 0.0]))
    tone = Hypothesis(by_id()["accel_tone"], (0,))
    score = Contest((tone,)).score(tone, Projection(model))
    with_tone = with_score(model, score)
    shapes = {s.whole.effect.excited_by: s.whole for s in shapes_of(model.setting, with_tone.terms)}
    overtones = Contest((), budget=0).score(shapes["overtones of 0.5 Hz on accel"], Projection(with_tone))
    assert overtones.p < 1e-6
    assert not any("overtones" in s.whole.effect.excited_by for s in shapes_of(model.setting))


@pytest.mark.parametrize(("part", "sign"), [(0.3, 1.0), (0.55, -1.0)])
def test_what_switches_on_and_off_is_told_from_the_tone_that_was_found(part, sign):
    def switched(trace):
        return np.outer(sign * (trace.t % 5.0 < 5.0 * part), [0.03, 0.0, 0.01])

    model = model_of(gap=switched)
    tone = Hypothesis(by_id()["accel_tone"], (0,))
    with_tone = with_score(model, Contest((tone,)).score(tone, Projection(model)))
    shapes = [h for s in shapes_of(model.setting, with_tone.terms) for h in s.hypotheses]
    switches = [h for h in shapes if ", on for" in h.effect.excited_by]
    contest, beside = Contest((), budget=0), Projection(model)
    best = max(switches, key=lambda h: contest.score(h, beside).delta)
    on = int(best.effect.excited_by.partition("on for ")[2].partition("%")[0])
    assert on == pytest.approx(100 * part, abs=5.1)
    assert contest.score(best, beside).delta > contest.score(tone, beside).delta + 10.0


@pytest.mark.sampled
@pytest.mark.parametrize("name", list(LOW))
def test_a_low_order_is_worth_more_as_itself_than_as_a_broken_line(name):
    size = np.array([0.5, -0.3, 0.2]) * SIGMA[Sensor.ACCEL]
    found = gains(model_of(gap=lambda trace: size * LOW[name](trace)))
    own = found[name]
    assert own.p < 1e-6
    assert own.delta > max(s.delta for other, s in found.items() if other.startswith("function of"))


@pytest.mark.long
def test_noise_is_worth_no_shape():
    worst = max(s.delta for seed in range(3) for s in gains(model_of(seed=seed)).values())
    assert worst < 0.0


def test_a_shape_of_one_axis_touches_that_axis_alone():
    model = model_of()
    trace = model.setting.views[0].traces[0]
    h: Hypothesis = named(model)["function of a_x on accel.z"]
    columns = h.effect.columns(trace, math.nan)
    assert not columns[:, :, :2].any()
    assert columns[:, :, 2].sum(axis=0) == pytest.approx(np.ones(len(trace.t)))


def taken(trace, rows, by=0.0):
    """The rows of a trace alone, `by` seconds later."""
    arrays = {f.name: getattr(trace, f.name) for f in dataclasses.fields(trace)}
    rowwise = {k: v[rows] for k, v in arrays.items() if isinstance(v, np.ndarray) and len(v) == len(trace.t)}
    return dataclasses.replace(trace, **{**rowwise, "t": rowwise["t"] + by})


@pytest.mark.parametrize("rows", [slice(7, None), slice(None, -5), slice(3, -11), slice(None, None, 2)])
def test_a_shape_along_a_trace_with_other_rows_has_its_values_there(rows):
    model = model_of(Sensor.GYRO)
    trace = model.setting.views[0].traces[0]
    part = taken(trace, rows)
    for h in named(model).values():
        columns = h.effect.columns(part, math.nan)
        assert columns.shape[1:] == (len(part.t), 3)
        np.testing.assert_allclose(columns, h.effect.columns(trace, math.nan)[:, rows], rtol=1e-6, atol=1e-9)
        if h.effect.signals is not None:
            signals = h.effect.signals(part, math.nan)
            assert signals.shape == (columns.shape[0] // 3, len(part.t))
            for c in range(3):
                np.testing.assert_array_equal(columns[c::3, :, c], signals)


def test_between_the_rows_of_its_own_trace_a_shape_goes_straight():
    model = model_of(Sensor.GYRO)
    trace = model.setting.views[0].traces[0]
    half = taken(trace, slice(None, -1), 0.5 / trace.fs)
    h = named(model)["throttle on gyro.y"]
    expected = 0.5 * (trace.throttle[1:] + trace.throttle[:-1])
    np.testing.assert_allclose(h.effect.columns(half, math.nan)[0, :, 1], expected, atol=1e-9)


def test_as_many_rows_at_other_times_are_other_rows():
    model = model_of(Sensor.GYRO)
    (view,) = model.setting.views
    trace = view.traces[0]
    early, late = taken(trace, slice(None, -9)), taken(trace, slice(9, None))
    setting = setting_of((dataclasses.replace(view, traces={0: early}),))
    h = named(dataclasses.replace(model, setting=setting))["throttle on gyro.y"]
    columns = h.effect.columns(late, math.nan)[0, :-9, 1]
    np.testing.assert_allclose(columns, late.throttle[:-9], atol=1e-9)


def test_an_instance_with_a_reference_and_a_longer_difference_has_one_shape_for_both():
    problem = problem_of(np.random.default_rng(3), (Sensor.GYRO,), instances=3)
    zero, one, two = problem.traces
    pairs = [dataclasses.replace(t, ideal=two.measured, against=2) for t in (zero, one)]
    views = views_of(dataclasses.replace(problem, traces=(taken(two, slice(20, -30)), *pairs)), {}, {})
    assert len({len(t.t) for view in views for t in view.traces.values()}) == 2
    setting = setting_of(views)
    model = model_without_effects(setting)
    h = next(h for s in shapes_of(setting) for h in s.hypotheses if h.instances == (2,) and "throttle on" in h.key[0])
    assert Contest((), budget=0).score(h, Projection(model)).df > 0
