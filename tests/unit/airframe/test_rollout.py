"""The error of a predicted flight: closed forms for errors of force and torque that are known."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.airframe.answer import Quantity
from mavcal.calib.airframe.physics import Airframe
from mavcal.calib.airframe.rollout import Predicted, folds, rollouts
from tests.unit.airframe.made import HZ, G, airframe, flight, hover

N = 6000


@pytest.fixture(scope="module")
def model() -> Airframe:
    """A minute whose velocity and rates follow from force and torque."""
    t = np.arange(N) / HZ
    speed = np.column_stack([2.0 * np.sin(0.5 * t), np.cos(0.3 * t), 0.2 * np.sin(t)])
    rate = np.column_stack([0.5 * np.sin(2.0 * t), 0.4 * np.cos(1.5 * t), 0.1 * np.sin(t)])
    force = np.gradient(speed, 1.0 / HZ, axis=0) - [0.0, 0.0, G]
    return airframe(flight(hover(N / HZ), velocity=speed, rate=rate, force=force))


def off(model: Airframe, add: str, force: float, torque: float) -> Predicted:
    """A prediction that is wrong by so much along x."""
    true = model.measured
    return Predicted(add, true[0] + [force, 0.0, 0.0], true[1] + [torque, 0.0, 0.0])


def whole(model: Airframe, *predictions: Predicted, torque: bool = True):
    return rollouts(model, [(rows, predictions) for rows in folds(model)], torque=torque)


def test_an_error_of_the_force_grows_with_the_time_that_is_predicted(model: Airframe) -> None:
    found = whole(model, off(model, "", 0.2, 0.5), off(model, "rotor_drag", 0.1, 0.5), off(model, "inertia", 0.05, 0.1))
    assert [(r.h_s, r.quantity, r.unit) for r in found] == [
        (0.5, Quantity.VELOCITY, "m/s"), (1.0, Quantity.VELOCITY, "m/s"), (2.0, Quantity.VELOCITY, "m/s"),
        (0.1, Quantity.BODY_RATE, "rad/s"), (0.2, Quantity.BODY_RATE, "rad/s"),
    ]  # fmt: skip
    for one in found:
        before, after = (0.2, 0.05) if one.quantity is Quantity.VELOCITY else (0.5, 0.1)
        assert one.before == pytest.approx(before * one.h_s, rel=0.02)
        assert one.after == pytest.approx(after * one.h_s, rel=0.05)
        assert one.floor < 0.02 * one.before
        assert one.floor < one.after < one.before
        assert one.closed == pytest.approx(1.0 - after / before, abs=0.02)
        assert one.ci95 is not None
        assert one.ci95[0] <= one.closed <= one.ci95[1]
        assert [s.add for s in one.sequence] == ["rotor_drag", "inertia"]
        assert one.sequence[-1].error == one.after
        assert one.part == "blocks"


def test_without_an_effect_nothing_is_closed(model: Airframe) -> None:
    for one in whole(model, off(model, "", 0.2, 0.5)):
        assert one.before == one.after
        assert one.closed is None
        assert one.sequence == ()


def test_where_the_simulator_is_as_good_as_the_measurement_nothing_is_to_be_closed(model: Airframe) -> None:
    for one in whole(model, off(model, "", 0.0, 0.0)):
        assert one.closed is None
        assert one.ci95 is None


def test_body_rates_are_predicted_only_where_torque_is_judged(model: Airframe) -> None:
    found = whole(model, off(model, "", 0.2, 0.5), torque=False)
    assert {r.quantity for r in found} == {Quantity.VELOCITY}


def test_stretches_are_held_out_by_turns_of_ten_seconds(model: Airframe) -> None:
    first, second = folds(model)
    np.testing.assert_array_equal(first, ~second)
    t = model.flight.t
    assert not first[t < 9.9].any()
    assert first[(t > 10.1) & (t < 19.9)].all()
    assert first.sum() == pytest.approx(N / 2, abs=2)


def test_only_rows_that_were_held_out_and_are_usable_count(model: Airframe) -> None:
    """Wrong anywhere else does not matter."""
    rows, others = folds(model)
    wrong = off(model, "", 0.2, 0.0)
    wrong.force[others] += 5.0
    (half, *_) = rollouts(model, [(rows, [wrong])], torque=False)
    assert half.before == pytest.approx(0.2 * half.h_s, rel=0.02)
    usable = np.ones(N, dtype=bool)
    usable[1500:1700] = False
    wrong.force[1500:1700] += 5.0
    left_out = airframe(
        flight(hover(N / HZ), velocity=model.flight.velocity, force=model.flight.force, usable=usable)
    )  # fmt: skip
    (half, *_) = rollouts(left_out, [(rows, [wrong])], torque=False)
    assert half.before == pytest.approx(0.2 * half.h_s, rel=0.02)


def test_too_few_starts_say_nothing(model: Airframe) -> None:
    rows = np.zeros(N, dtype=bool)
    rows[:400] = True
    assert rollouts(model, [(rows, [off(model, "", 0.2, 0.5)])], torque=True) == ()


def test_intervals_do_not_depend_on_chance(model: Airframe) -> None:
    made = [off(model, "", 0.2, 0.5), off(model, "rotor_drag", 0.1, 0.2)]
    assert whole(model, *made) == whole(model, *made)
