"""No effect is named with a number that the data do not bound."""

import math

import numpy as np
import pytest

from mavcal.calib.gap.diagnose import _setup_of, diagnose
from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.progress import GapPace
from mavcal.calib.gap.search.selection import select
from mavcal.calib.gap.telling.identifiability import unbounded_causes, unbounded_parameters
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import problem_of


def effects(*ids):
    return tuple(e for e in catalogue() if e.id in ids)


def chosen_of(problem, few):
    setup = _setup_of(problem, few, GapPace())
    return select(setup.bare, setup.contest, 0.005)


@pytest.mark.long
def test_a_temperature_beside_an_offset_is_a_choice_and_the_offset_the_one_there():
    slopes, offset = np.array([0.02, -0.01, 0.015]), np.array([0.3, 0.5, -0.4])
    problem = problem_of(
        np.random.default_rng(2),
        (Sensor.ACCEL,),
        lambda trace: np.outer(trace.temperature, slopes) + offset,
    )
    report = diagnose(problem, effects=effects("accel_bias", "accel_temp_linear"), nested=False)
    found = {e.id: e.params for e in report.effects}
    assert set(found) == {"accel_bias", "accel_temp_linear"}
    assert all(math.isfinite(p.se) for params in found.values() for p in params)
    t_ref = found["accel_temp_linear"][-1]
    assert t_ref.se == 0.0
    for p, slope, own in zip(found["accel_bias"], slopes, offset, strict=True):
        assert abs(p.value - (own + slope * t_ref.value)) < 4.0 * p.se


def test_an_effect_with_a_number_that_may_be_anything_has_no_name(monkeypatch):
    problem = problem_of(np.random.default_rng(3), (Sensor.ACCEL,), lambda _: np.array([0.3, 0.0, 0.1]))
    few = effects("accel_bias")
    chosen = chosen_of(problem, few)
    assert unbounded_parameters(chosen) == {}
    estimate = "mavcal.calib.gap.telling.identifiability.estimates_of"
    from mavcal.calib.gap.telling.estimates import estimates_of

    def loose(*arguments):
        first, *others = estimates_of(*arguments)
        return (type(first)(first.name, first.value, math.inf, (-math.inf, math.inf), first.unit), *others)

    monkeypatch.setattr(estimate, loose)
    (key,) = unbounded_parameters(chosen)
    (cause,) = unbounded_causes(chosen, unbounded_parameters(chosen))
    assert cause.keys == (key,)
    assert cause.text == "a difference on accel like a constant offset, whose bias.x these data do not bound"
    report = diagnose(problem, effects=few, nested=False)
    assert report.effects == ()
    assert report.unknown.flag
