"""The exported remedy flown again by the project's simulated vehicle, on another path, and what is said of it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mavcal.calib import gap
from mavcal.calib.gap.export import Target, exported
from mavcal.calib.gap.problem import ReferenceKind
from mavcal.calib.gap.reference import build
from mavcal.calib.gap.schema import EffectEstimate, GapReport, ParameterEstimate
from mavcal.calib.gap.verify import (
    _is_same_flight,
    _left_flying,
    agreements,
    distance,
    remainders,
    verified_json,
    verify,
)
from mavcal.calib.recording import Channel, Identity, Recording, Sensor, Stage
from mavcal.calib.simulate import SensorErrors, SensorSuite
from mavcal.calib.simulate.document import stated_in
from tests.examples import examples
from tests.unit.gap.export.making import airframe, effect

from .reference.test_recorded import channel

Array = NDArray[np.float64]

RATE, SECONDS = 100.0, 60.0
EARTH = np.array([22.0, 5.0, -52.0])
G = np.array([0.0, 0.0, 9.80665])
GYRO_BIAS = np.array([-0.012, 0.018, 0.020])
IRON = np.array([-6.0, 4.0, -3.0])
LATE_S = 0.05
"""Delay of the simulator's compasses: what every flight of it shows beside an ideal one."""
FRESH_OFFSET = np.array([-0.5, -1.3, 1.8])
"""That of a fresh SITL's compass, uT, as a sensor reads it: its own calibration takes it off."""


def path(t: Array, phase: float) -> tuple[Rotation, Array]:
    velocity = np.column_stack(
        [
            3.0 * np.sin(0.5 * t + phase),
            2.0 * np.cos((0.35 + 0.05 * phase) * t),
            0.5 * np.sin(0.8 * t + 2.0 * phase),
        ]
    )
    angles = np.column_stack([(0.15 - 0.01 * phase) * t, 0.25 * np.sin(0.6 * t + phase), 0.2 * np.sin(0.9 * t + 1.0)])
    return Rotation.from_euler("ZYX", angles), velocity


def flown(suite: SensorSuite, seed: int) -> Recording:
    """Two inertial units at 100 Hz and a compass at 10 Hz; `suite` are the errors of the first unit and the compass."""
    rng, phase, h = np.random.default_rng(seed), 0.7 * seed, 1e-4
    t = np.arange(int(RATE * SECONDS)) / RATE
    turn, _ = path(t, phase)
    ahead, after = path(t + h, phase)
    _, before = path(t - h, phase)
    force = turn.inv().apply((after - before) / (2.0 * h) - G)
    rate = (turn.inv() * ahead).as_rotvec() / h
    channels: list[Channel] = []
    for i in range(2):
        own = suite if i == 0 else SensorSuite()
        accel = force @ own.accel.matrix.T + own.accel.bias + 0.02 * rng.standard_normal(force.shape)
        gyro = rate @ own.gyro.matrix.T + own.gyro.bias + 0.001 * rng.standard_normal(rate.shape)
        channels += [channel(Sensor.ACCEL, t, accel, i, "IMU"), channel(Sensor.GYRO, t, gyro, i, "IMU")]
    slow = t[::10]
    field = path(slow - LATE_S, phase)[0].inv().apply(EARTH) @ suite.mag.matrix.T + suite.mag.bias
    channels.append(channel(Sensor.MAG, slow, field + 0.2 * rng.standard_normal(field.shape), 0, "MAG"))
    gps = t[::20]
    velocity = path(gps, phase)[1] + 0.03 * rng.standard_normal((len(gps), 3))
    channels.append(Channel(Sensor.VELOCITY, 0, gps + 0.12, velocity, "m/s", Stage.RAW, "GPS"))
    attitude = path(slow, phase)[0].as_quat()[:, [3, 0, 1, 2]]
    channels.append(channel(Sensor.ATTITUDE, slow, attitude, 0, "ATT"))
    return Recording(tuple(channels), identity=Identity(autopilot="ardupilot"))


REAL = SensorSuite(gyro=SensorErrors(bias=GYRO_BIAS), mag=SensorErrors(bias=IRON))


def flown_again(text: str, seed: int, share: float = 1.0) -> Recording:
    """The sensors that an exported file states, or a share of their offsets, on a path of their own."""
    stated = stated_in(text, ".parm").suite
    mag = dataclasses.replace(stated.mag, bias=share * (stated.mag.bias - FRESH_OFFSET))
    gyro = dataclasses.replace(stated.gyro, bias=share * stated.gyro.bias)
    return flown(SensorSuite(accel=stated.accel, gyro=gyro, mag=mag), seed)


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_remedy_that_was_flown_again_closes_the_gap_and_brings_nothing_in() -> None:
    real, sim = flown(REAL, 1), flown(SensorSuite(), 2)
    report = gap.run(real, sim, nested=False)
    assert {e.id for e in report.effects} == {"gyro_bias", "mag_hard_iron"}
    text = exported(report, real, Target.SITL).text
    found = verified_json(verify(report, real, sim, flown_again(text, 3)))
    assert found["same_flight"] is False
    assert found["verdict"] == "no_gap"
    assert found["added"] == []
    assert found["closed"] > 0.999
    assert all(e["share"] == 0.0 and e["agrees"] for e in found["effects"])
    for said in found["effects"]:  # the new flight shows the same numbers by itself
        assert said["again"] == pytest.approx(said["before"], abs=2e-4 if said["id"] == "gyro_bias" else 0.3)
    half = verified_json(verify(report, real, sim, flown_again(text, 3, share=0.5)))
    assert half["verdict"] == "explained"
    assert half["added"] == []
    assert not any(e["agrees"] for e in half["effects"])
    assert [e["share"] for e in half["effects"]] == pytest.approx([0.25, 0.25], abs=0.1)


def test_a_log_with_the_truth_of_its_own_flight_is_not_the_same_flight_as_another() -> None:
    def with_truth(made: Recording) -> Recording:
        return dataclasses.replace(made, reference=tuple(c for c in made.channels if c.sensor is Sensor.ATTITUDE))

    real, other = (with_truth(flown(SensorSuite(), seed)) for seed in (1, 3))
    direct = build(real, other)
    assert direct.reference.kind is ReferenceKind.SIM
    assert not _is_same_flight(direct, real, other)


def told(
    *values: float, se: float = 0.01, instances: tuple[int, ...] = (1,), id_: str = "accel_bias"
) -> EffectEstimate:
    params = tuple(ParameterEstimate(f"p{k}", v, se, (v - se, v + se), "m/s2") for k, v in enumerate(values))
    return dataclasses.replace(effect("accel_bias", instances), id=id_, params=params)


@settings(max_examples=examples(40))
@given(st.floats(-5.0, 5.0), st.floats(0.001, 1.0), st.floats(0.001, 1.0))
def test_one_number_agrees_within_two_of_both_errors(difference: float, first: float, second: float) -> None:
    one, other = told(0.0, se=first), told(difference, se=second)
    apart = abs(difference) / math.hypot(first, second)
    assert distance(one, other) == pytest.approx(apart / 2.0, rel=1e-3)
    assert distance(one, other) == pytest.approx(distance(other, one))


def test_the_largest_of_several_may_differ_by_more() -> None:
    """As many more standard errors as the largest of several differs by chance: nothing is gained by more numbers."""
    rng = np.random.default_rng(1)
    for count in (1, 3, 12):
        far = [
            distance(told(*np.zeros(count), se=math.sqrt(0.5)), told(*rng.normal(size=count), se=math.sqrt(0.5))) > 1.0
            for _ in range(400)
        ]
        assert np.mean(far) == pytest.approx(0.0455, abs=0.035)


def test_only_what_both_know_is_compared() -> None:
    one, other = told(0.0, 0.0), told(0.0, 9.0)
    assert distance(one, other) > 1.0
    assert distance(one, told(0.0)) == 0.0
    endless = dataclasses.replace(other, params=(other.params[0], dataclasses.replace(other.params[1], se=math.inf)))
    assert distance(one, endless) == distance(endless, one) == 0.0
    assert distance(one, dataclasses.replace(other, params=())) == math.inf


def test_numbers_that_are_exact_agree_only_with_themselves() -> None:
    assert distance(told(1.0, se=0.0), told(1.0, se=0.0)) == 0.0
    assert distance(told(1.0, se=0.0), told(1.1, se=0.0)) > 1e6


def test_an_effect_agrees_with_the_same_one_of_the_same_instances() -> None:
    mine = told(0.3)
    for other in (told(0.3, id_="accel_scale"), told(0.3, instances=(2,)), told(0.3, instances=(1, 2))):
        [found] = agreements([mine], [other])
        assert (found.other, found.holds) == (None, False)
    [found] = agreements([mine], [told(0.31), told(0.9)])
    assert (found.other, found.holds) == (told(0.31), True)
    assert agreements([mine], [told(0.327)])[0].holds  # by 1.9 standard errors of the difference
    assert not agreements([mine], [told(0.33)])[0].holds  # by 2.1
    [found] = agreements([mine], [told(0.9)])
    assert (found.other, found.holds) == (told(0.9), False)  # it is there, and differs


def test_of_several_steps_each_has_a_counterpart_of_its_own() -> None:
    mine = [told(1.0), told(5.0), told(9.0)]
    found = agreements(mine, [told(5.001), told(1.001)])
    assert [f.other and f.other.params[0].value for f in found] == [1.001, 5.001, None]
    assert [f.holds for f in found] == [True, True, False]
    twice = agreements([told(1.0), told(1.0)], [told(1.0)])
    assert [f.holds for f in twice] == [True, False]


@settings(max_examples=examples(30))
@given(st.lists(st.floats(-9.0, 9.0), max_size=6), st.lists(st.floats(-9.0, 9.0), max_size=6))
def test_every_effect_has_a_row_and_no_counterpart_is_used_twice(mine: list[float], theirs: list[float]) -> None:
    others = [told(value) for value in theirs]
    found = agreements([told(value) for value in mine], others)
    assert [f.effect.params[0].value for f in found] == mine
    used = [id(f.other) for f in found if f.other is not None]
    assert len(used) == len(set(used)) == min(len(mine), len(theirs))


def stated(value: float, se: float, effect_id: str = "gyro_bias", instances: tuple[int, ...] = (1,)) -> EffectEstimate:
    axes = tuple(ParameterEstimate(f"bias.{a}", value, se, (value, value), "rad/s") for a in "xyz")
    return dataclasses.replace(effect(effect_id, instances), params=axes)


def test_what_differs_within_two_standard_errors_agrees() -> None:
    before = stated(0.020, 3e-5)
    near, far = stated(0.02008, 4e-5), stated(0.02015, 4e-5)  # 1.6 and 3 standard errors of the difference
    assert [a.holds for a in agreements([before], [near])] == [True]
    assert [a.holds for a in agreements([before], [far])] == [False]
    one = dataclasses.replace(before, params=before.params[:1])
    assert distance(one, dataclasses.replace(one, params=(stated(0.0201, 4e-5).params[0],))) == pytest.approx(
        1.0, rel=1e-3
    )


def test_what_no_number_determines_is_not_the_same() -> None:
    assert not agreements([stated(0.02, float("inf"))], [stated(0.02, 1e-5)])[0].holds


THRUST = airframe("thrust_scale", s=0.9, sim=25.0)


def test_an_airframe_is_closed_where_the_new_flight_has_its_parameters() -> None:
    near, far = airframe("thrust_scale", s=0.9015, sim=25.0), airframe("thrust_scale", s=0.95, sim=25.0)
    assert [a.holds for a in agreements([THRUST], [near])] == [True]
    [left] = map(_left_flying, agreements([THRUST], [near]))
    assert (left.share, left.agrees) == (0.0, True)
    assert left.left["s"] == pytest.approx(0.9 / 0.9015 - 1.0)
    assert left.remainders["s"].ratio
    assert left.remainders["s"].within
    [left] = map(_left_flying, agreements([THRUST], [far]))
    assert not left.agrees
    assert left.left["s"] == pytest.approx(0.9 / 0.95 - 1.0)
    assert not left.remainders["s"].within
    assert left.share == pytest.approx((0.0526 / 0.1) ** 2, rel=0.01)


def test_the_error_of_a_ratio_of_two_flights_is_that_of_both() -> None:
    """Against draws: real by new of numbers that are known to 2 and 3 %."""
    rng = np.random.default_rng(5)
    real, new = (
        dataclasses.replace(THRUST, params=(dataclasses.replace(THRUST.params[0], value=v, se=se),))
        for v, se in ((-0.1, 0.018), (-0.2, 0.024))
    )
    [found] = agreements([real], [new])
    left = remainders(found)["s"]
    drawn = rng.normal(0.9, 0.018, 100_000) / rng.normal(0.8, 0.024, 100_000) - 1.0
    assert left.value == pytest.approx(0.125)
    assert left.se == pytest.approx(float(drawn.std()), rel=0.03)


def test_an_airframe_that_the_new_flight_does_not_show_is_left_as_a_whole() -> None:
    lag = airframe("motor_lag", tau_up=0.03, tau_down=0.05)
    [left] = map(_left_flying, agreements([lag], [airframe("motor_lag", tau_up=0.03, tau_down=0.02)]))
    assert left.left == pytest.approx({"tau_up": 0.0, "tau_down": 0.03})
    assert left.again == pytest.approx({"tau_up": 0.03, "tau_down": 0.02})
    [gone] = map(_left_flying, agreements([lag], []))
    assert (gone.again, gone.share, gone.agrees) == (None, 1.0, False)
    assert gone.left == gone.before


@pytest.mark.long
@pytest.mark.timeout(900)
def test_what_is_left_and_brought_in_of_the_airframe_is_told_beside_the_sensors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The sensors are diagnosed; the airframe's effects are stated, as the simulated vehicle has no motors."""
    real, sim, new = (flown(SensorSuite(), seed) for seed in (1, 2, 3))
    wind, drag = airframe("wind", north=3.0), airframe("rotor_drag", c1=1.2)
    report = dataclasses.replace(gap.run(real, sim, nested=False), effects=(THRUST, wind))

    def diagnosed(*effects: EffectEstimate) -> Callable[..., GapReport]:
        def run(*given: Any, **how: Any) -> GapReport:
            found = gap.run(*given, **how)
            return dataclasses.replace(found, effects=(*found.effects, *effects))

        return run

    monkeypatch.setattr("mavcal.calib.gap.verify.run", diagnosed(THRUST, airframe("wind", north=-1.0)))
    closed = verified_json(verify(report, real, sim, new))
    assert (closed["verdict"], closed["added"]) == ("no_gap", [])
    assert [(e["id"], e["agrees"]) for e in closed["effects"]] == [("thrust_scale", True)]
    monkeypatch.setattr("mavcal.calib.gap.verify.run", diagnosed(drag))
    left = verified_json(verify(report, real, sim, new))
    assert (left["verdict"], left["added"]) == ("explained", ["rotor_drag"])
    assert [e["id"] for e in left["rest"]["effects"]] == ["thrust_scale", "rotor_drag"]
