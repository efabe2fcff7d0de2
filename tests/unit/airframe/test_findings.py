"""From the posterior to words: what to fly next, and the thrust that a weak pulse leaves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mavcal.calib.airframe.answer import Domain
from mavcal.calib.airframe.diagnose import airframe_gap
from mavcal.calib.airframe.effects import catalogue
from mavcal.calib.airframe.findings import _by_name, _likely, doubtful, latent, needed_manoeuvres, with_rivals
from mavcal.calib.airframe.found import AirframeAnswer, FoundEffect, FoundRival
from mavcal.calib.airframe.physics import Kind, Layout
from mavcal.calib.airframe.testable import Missing
from mavcal.calib.airframe.words import FIXES, STANDARD_FLIGHT
from mavcal.calib.inference.model import Block, Evidence, Model, Posterior
from mavcal.calib.inference.search import Answer, Visited
from mavcal.calib.recording import Recording
from tests.unit.airframe.flights import flight


def found(*rivals: FoundRival) -> FoundEffect:
    return FoundEffect("thrust_scale", Domain.AIRFRAME, (), (), 10.0, 1, 0.9, 1.0, rivals)


def test_what_parts_rivals_is_asked_for_once() -> None:
    rivals = [FoundRival(name, 0.1, 2.0, FIXES[name]) for name in ("rotor_drag", "body_drag", "inertia")]
    asked = needed_manoeuvres([found(*rivals[:2]), found(rivals[2])], [])
    assert asked == (FIXES["rotor_drag"], FIXES["inertia"])
    assert needed_manoeuvres([found()], []) == ()


def test_the_standard_flight_is_asked_for_where_it_would_show_more() -> None:
    (asked,) = needed_manoeuvres([], [Missing("inflow", "climbs at 0.2 m/s", "climbs")])
    assert STANDARD_FLIGHT in asked
    assert needed_manoeuvres([], [Missing("air_density", "the altitude stays", "a climb")]) == ()


def test_what_could_not_be_tested_is_a_rival_of_the_thrust() -> None:
    """Foreign physics: thrust that fell with 4 % of the voltage was told as a thrust of 0.9."""
    drag = replace(found(), id="rotor_drag")
    told = with_rivals([found(), drag], ["battery_sag"])
    assert [[r.id for r in one.rivals] for one in told] == [["battery_sag"], []]
    assert with_rivals([found()], []) == (found(),)


class Nothing:
    """Evidence of no data."""

    blocks: tuple[Block, ...] = ()

    def posterior(self, model: Model) -> Posterior:
        return Posterior(0.0, np.zeros(0), np.zeros((0, 0)))

    def refined(self, model: Model) -> Evidence:
        return self


def answered(weights: dict[str, float], *everywhere: str) -> Answer:
    """Models of one effect each, "" for none, with what all of them have."""
    kept = tuple(
        Visited(frozenset({*([name] if name else []), *everywhere}), float(np.log(p)), Nothing().posterior(frozenset()))
        for name, p in weights.items()
    )
    return Answer(kept, (), Nothing(), len(kept))


EFFECTS = catalogue(Layout(4), Kind(), (300.0, 300.0, 8.0))


def test_what_is_likelier_than_not_and_not_named_says_what_would_decide() -> None:
    weights = {"thrust_by_mass": 0.4, "thrust_scale": 0.25, "": 0.15, "motor_pulse_2": 0.11, "inflow": 0.09}
    answer = answered(weights, "wind", "rotor_drag")
    told = doubtful(answer, EFFECTS, least=0.5, most=0.9)
    assert told == (
        f"thrust_scale has a probability of 65 %, too little to name it; fly {FIXES['thrust_scale']}",
    )  # of both its forms; a certain drag is named, and wind is of the day
    (motor,) = doubtful(answer, EFFECTS, least=0.1, most=0.11 + 1e-9)
    assert motor.startswith("motor_weak of motor 2")


@pytest.mark.parametrize(("none", "named"), [(0.05, {"rotor_drag", "thrust_expo"}), (0.15, {"rotor_drag"})])
def test_of_several_effects_of_which_one_is_there_the_likeliest_is_named(none: float, named: set[str]) -> None:
    """A mass of 1.1 was thrust or its curve for certain, and the verdict was that there is no gap."""
    answer = answered({"thrust_expo": 0.55, "thrust_by_mass": 0.45 - none, "": none}, "rotor_drag")
    likely = _likely(answer, _by_name(EFFECTS), 0.9)
    assert {id_ for id_, _ in likely} == named
    assert bool(doubtful(answer, EFFECTS, least=0.5, most=0.9)) is ("thrust_expo" not in named)


def test_of_three_effects_none_of_which_is_likelier_than_not_none_is_named() -> None:
    answer = answered({"thrust_expo": 0.4, "thrust_by_mass": 0.3, "inflow": 0.3})
    assert _likely(answer, _by_name(EFFECTS), 0.9) == set()


def test_what_the_flights_are_too_poor_to_name_is_said() -> None:
    effects = catalogue(Layout(4), Kind(), (300.0, 300.0, 8.0))
    posterior = Nothing().posterior(frozenset())
    kept = (Visited(frozenset({"body_drag"}), np.log(0.7), posterior), Visited(frozenset(), np.log(0.3), posterior))
    answer = Answer(kept, (), Nothing(), 2)
    slow = Missing("body_drag", "the real vehicle reaches 5.0 m/s through the air", "runs at 8 m/s", latent=True)
    (said,) = latent(answer, effects, (slow, replace(slow, id="inflow"), slow), least=0.5)
    assert said == (
        "body_drag has a probability of 70 %, but is not named: the real vehicle reaches 5.0 m/s through the air; "
        "fly runs at 8 m/s"
    )
    assert latent(answer, effects, (replace(slow, latent=False),), least=0.5) == ()


@pytest.mark.long
@pytest.mark.parametrize(("motor", "multiplier", "left"), [(1, 0.97, 0.9403), (4, 0.94, 0.883)])
def test_a_weak_pulse_is_told_as_the_thrust_that_it_leaves(
    tmp_path: Path, simulated: Recording, motor: int, multiplier: float, left: float
) -> None:
    """SITL multiplies the pulse above 1000 us: 3 % of it are 6 % of the thrust at the hover command of 0.551."""
    real = flight(
        tmp_path / "x.bin", other=True, SIM_ENGINE_FAIL=float(1 << (motor - 1)), SIM_ENGINE_MUL=multiplier
    )  # fmt: skip
    answer = airframe_gap(real, simulated)
    assert isinstance(answer, AirframeAnswer)
    (weak,) = answer.found
    assert (weak.id, weak.motors) == ("motor_weak", (motor,))
    values = {v.name: v for v in weak.values}
    assert 1.0 + values["s"].value == pytest.approx(left, abs=0.005)
    assert 0.0 < values["s"].sd < 0.006
