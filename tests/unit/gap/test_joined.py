"""One report: airframe and air first, sensors as far as they are borne out, and one verdict."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from mavcal.calib.airframe.air import Jump, Turbulence
from mavcal.calib.airframe.answer import AirframePart, Domain
from mavcal.calib.airframe.found import AirframeAnswer, FoundEffect, FoundRival, FoundValue, HeldOut, NoAirframe
from mavcal.calib.airframe.testable import Missing
from mavcal.calib.gap.joined import joined
from mavcal.calib.gap.progress import GapStage
from mavcal.calib.gap.schema import (
    EffectEstimate,
    GapReport,
    GapVerdict,
    LocatedGap,
    MultipleTesting,
    Regime,
    Rival,
    SeriesFit,
    Unknown,
    as_json,
)
from mavcal.calib.gap.unknown.verdict import NOT_LASTING
from mavcal.calib.recording import Channel, Event, Recording, Sensor, Stage
from tests.unit.gap.export.making import effect, report

G = 9.80665
T = np.arange(0.0, 60.0, 0.01)
REST = np.tile([0.0, 0.0, -G], (len(T), 1))


def ratio(name: str, value: float, sd: float, real: float | None = None, sim: float | None = None) -> FoundValue:
    return FoundValue(name, value, sd, "1", relative=True, real=real, sim=sim)


def difference(name: str, real: float, sim: float, sd: float, unit: str) -> FoundValue:
    return FoundValue(name, real - sim, sd, unit, relative=False, real=real, sim=sim)


def thrust(nats: float = 300.0) -> FoundEffect:
    rival = FoundRival("thrust_expo", 0.02, 4.0, "throttle steps over 0.3")
    values = (ratio("s", -0.1, 0.005, 22.6, 25.1),)
    return FoundEffect("thrust_scale", Domain.AIRFRAME, (), values, nats, 1, 0.98, 1.0, (rival,))


def wind(nats: float = 100.0) -> FoundEffect:
    values = (difference("north", -1.05, 0.05, 0.1, "m/s"), difference("east", -4.0, 0.0, 0.1, "m/s"))
    return FoundEffect("wind", Domain.ENVIRONMENT, (), values, nats, 2, 1.0, 0.0)


def weak() -> FoundEffect:
    values = (ratio("s", -0.08, 0.004), FoundValue("motor", 3.0, 0.0, "1", relative=False))
    return FoundEffect("motor_weak", Domain.AIRFRAME, (3,), values, 500.0, 1, 1.0, 1.0)


def answer(*found: FoundEffect, **more: object) -> AirframeAnswer:
    return replace(AirframeAnswer(found, (), AirframePart(), 40), **more)


def noise(seed: int, size: float) -> np.ndarray:
    return size * np.random.default_rng(seed).normal(size=(len(T), 3))


def units(*values: np.ndarray) -> Recording:
    return Recording(
        tuple(Channel(Sensor.ACCEL, k, T, v, "m/s2", Stage.FILTERED, "IMU") for k, v in enumerate(values))
    )  # fmt: skip


def of_noise(left: np.ndarray) -> GapReport:
    """The sensors' own answer to whatever shakes unit 1."""
    one = effect("accel_noise")
    series = SeriesFit(Sensor.ACCEL, (1,), T, left, 0.0 * left, np.ones(3), "m/s2", {})
    cells = (
        LocatedGap("accel.x", 1, Regime("all", (0.0, 1.0)), 0.5, 0.3, "m/s2", 1e-9),
        LocatedGap("mag.x", 1, Regime("all", (0.0, 1.0)), 0.1, 0.3, "uT", 1e-3),
    )
    return replace(report(one), series=(series,), where=cells, multiple_testing=MultipleTesting(61, 0.005))


BARE = Recording(())


def test_without_an_airframe_the_report_of_the_sensors_stays_and_says_why() -> None:
    before = report(effect("mag_hard_iron"))
    after = joined(before, NoAirframe("no commands of the motors are logged", "LOG_BITMASK with bit 17"), BARE)
    (gone,) = after.not_testable
    assert (gone.id, gone.reason, gone.need) == (
        "airframe", "no commands of the motors are logged", "LOG_BITMASK with bit 17",
    )  # fmt: skip
    assert (after.verdict, after.effects, after.airframe) == (before.verdict, before.effects, None)


def test_without_an_airframe_what_every_unit_feels_is_no_sensors() -> None:
    air = noise(1, 0.3)
    real = units(REST + air + noise(2, 0.02), REST + air + noise(3, 0.02))
    gone = NoAirframe("only 2 % of the flight can be judged", "LOG_BITMASK with bit 17")
    after = joined(of_noise(air), gone, real)
    assert (after.verdict, after.effects, after.airframe) == (GapVerdict.NOT_TESTABLE, (), None)
    assert [w.channel for w in after.where] == ["mag.x"]
    (said,) = after.warnings
    assert said.startswith("not a sensor's: accel_noise; all units show it alike in flight")
    own = units(REST + air, REST + noise(3, 0.02))
    assert [e.id for e in joined(of_noise(air), gone, own).effects] == ["accel_noise"]


def test_a_sensors_effect_beside_a_flight_needs_the_probability_of_an_airframes() -> None:
    def likely(id_: str) -> EffectEstimate:
        made = effect(id_, (1, 2))
        return replace(made, evidence=replace(made.evidence, probability=0.58))

    before = report(likely("mag_low_pass"), likely("mag_temp_poly"), effect("mag_hard_iron"))
    after = joined(before, answer(thrust()), BARE)
    # a temperature goes with no movement
    assert [e.id for e in after.effects] == ["thrust_scale", "mag_temp_poly", "mag_hard_iron"]
    assert after.warnings == ("mag_low_pass of units 1, 2 is not named: its probability is 0.58, 0.9 is needed",)


@pytest.mark.parametrize("stage", [GapStage.SELECTION, GapStage.RIVALS])
def test_a_search_that_was_cut_short_names_nothing_in_doubt(stage: GapStage) -> None:
    """A calm flight whose time was over before the rivals were tried had a random walk of probability 0.36."""
    walk = effect("accel_random_walk", (1,))
    before = report(replace(walk, evidence=replace(walk.evidence, probability=0.36)))
    assert [e.id for e in joined(before, answer(thrust()), BARE).effects] == ["thrust_scale", "accel_random_walk"]
    cut = joined(replace(before, left_out=(stage.value,)), answer(thrust()), BARE)
    assert [e.id for e in cut.effects] == ["thrust_scale"]
    assert cut.warnings == ("accel_random_walk of unit 1 is not named: its probability is 0.36, 0.9 is needed",)


def test_a_large_effect_of_a_sensor_is_named_though_its_unit_is_in_doubt() -> None:
    scale = effect("gyro_scale", (1,), scale=(0.1, 0.0, 0.0))
    scale = replace(scale, evidence=replace(scale.evidence, probability=0.5))
    left = noise(1, 0.01)
    for size, named in ((0.1, ["thrust_scale", "gyro_scale"]), (0.001, ["thrust_scale"])):
        part = size * np.sin(T)[:, None].repeat(3, axis=1)
        series = SeriesFit(Sensor.GYRO, (1, 2), T, left + part, part, np.ones(3), "rad/s", {"gyro_scale": part})
        after = joined(replace(report(scale), series=(series,)), answer(thrust()), BARE)
        assert [e.id for e in after.effects] == named


def test_a_large_effect_is_not_named_where_another_may_be_in_its_place_or_the_sensor_has_more() -> None:
    """Of half a flight of a real quad: a soft iron (.29) and a hard iron (.84) beside what had no name."""
    scale = effect("gyro_scale", (1,), scale=(0.1, 0.0, 0.0))
    scale = replace(scale, evidence=replace(scale.evidence, probability=0.5))
    part = 0.1 * np.sin(T)[:, None].repeat(3, axis=1)
    series = SeriesFit(Sensor.GYRO, (1, 2), T, noise(1, 0.01) + part, part, np.ones(3), "rad/s", {"gyro_scale": part})
    rival = replace(scale, confusable_with=(Rival("gyro_misalignment", 0.9, 1.0, "turn"),))
    nameless = Unknown(flag=True, share=0.4, shape="function of throttle on gyro")
    for one, unknown in ((rival, Unknown(flag=False)), (scale, nameless)):
        before = replace(report(one), series=(series,), unknown=unknown)
        assert [e.id for e in joined(before, answer(thrust()), BARE).effects] == ["thrust_scale"]
        alone = joined(before, NoAirframe("no commands", "a log"), BARE)
        assert alone.effects == ()
        assert any("its probability is 0.50" in warning for warning in alone.warnings)


@pytest.mark.parametrize(("off", "named"), [(3.0, ["thrust_scale"]), (8.0, ["thrust_scale", "mag_hard_iron"])])
def test_an_offset_of_a_compass_within_its_error_is_not_named_by_its_size(off: float, named: list[str]) -> None:
    """A compass without noise had one of 0.4 uT, where the attitude was known to 0.7 degrees."""
    iron = effect("mag_hard_iron", (1,), hard_iron=(off, 0.0, 0.0))
    evidence = replace(iron.evidence, probability=0.25)
    iron = replace(iron, params=tuple(replace(p, se=1.0) for p in iron.params), evidence=evidence)
    part = np.full((len(T), 3), off)
    series = SeriesFit(Sensor.MAG, (1,), T, noise(1, 0.01) + part, part, np.ones(3), "uT", {"mag_hard_iron": part})
    before = replace(report(iron), series=(series,))
    assert [e.id for e in joined(before, answer(thrust()), BARE).effects] == named


def test_loud_noise_is_named_though_its_unit_is_in_doubt() -> None:
    """87 Hz of 1 m/s2 beside a second unit that is logged at 40 Hz was "no gap"."""
    quiet = SeriesFit(Sensor.ACCEL, (1,), T, noise(1, 0.01), np.zeros((len(T), 3)), np.ones(3), "m/s2", {})
    for each, named in ((3.0, ["thrust_scale", "accel_vibration"]), (0.5, ["thrust_scale"])):
        shaking = effect("accel_vibration", (1,))
        evidence = replace(shaking.evidence, probability=0.6, two_delta_loglik=2.0 * each * 3 * len(T))
        before = replace(report(replace(shaking, evidence=evidence)), series=(quiet,))
        assert [e.id for e in joined(before, answer(thrust()), BARE).effects] == named


def test_an_airframes_effect_explains_a_gap_that_no_sensor_has() -> None:
    after = joined(report(), answer(thrust(), wind()), BARE)
    assert after.verdict is GapVerdict.EXPLAINED
    scale, air = after.effects
    assert (scale.id, scale.domain, scale.sensor, scale.instances) == ("thrust_scale", Domain.AIRFRAME, None, ())
    (s,) = scale.params
    assert (s.value, s.se, s.unit, s.value_real, s.value_sim) == (-0.1, 0.005, "1", 22.6, 25.1)
    assert s.ratio == pytest.approx(0.9)
    assert s.ratio_ci95 == (pytest.approx(0.9 - 1.96 * 0.005, abs=1e-5), pytest.approx(0.9 + 1.96 * 0.005, abs=1e-5))
    assert scale.evidence.two_delta_loglik == 600.0
    assert scale.evidence.share == pytest.approx(0.75)
    assert 0.0 < scale.evidence.p_adj < 1e-100
    (rival,) = scale.confusable_with
    assert (rival.id, rival.delta, rival.fix) == ("thrust_expo", 8.0, "throttle steps over 0.3")
    assert 0.9 < rival.kappa <= 1.0
    north = air.params[0]
    assert (air.domain, north.ratio, north.ratio_ci95) == (Domain.ENVIRONMENT, None, None)
    assert after.airframe is not None


def test_the_day_alone_is_no_gap() -> None:
    after = joined(replace(report(), verdict=GapVerdict.UNKNOWN), answer(wind()), BARE)
    assert after.verdict is GapVerdict.NO_GAP
    assert [e.id for e in after.effects] == ["wind"]


def test_a_weak_motor_has_its_number() -> None:
    (found,) = joined(report(), answer(weak()), BARE).effects
    assert found.instances == (3,)
    assert [p.name for p in found.params] == ["s", "motor"]
    assert found.params[1].ratio is None


def test_what_has_no_name_in_the_flight_is_said() -> None:
    text = "torque that follows earlier commands"
    alone = joined(report(), answer(unknown=text, unknown_share=1.0, nameless=0.99), BARE)
    assert alone.verdict is GapVerdict.UNKNOWN
    assert (alone.unknown.flag, alone.unknown.shape, alone.unknown.share) == (True, text, 1.0)
    beside = joined(report(), answer(thrust(), unknown=text, unknown_share=0.2, nameless=0.99), BARE)
    assert beside.verdict is GapVerdict.PARTLY_EXPLAINED


def test_a_bias_by_which_the_simulators_units_differ_as_well_is_no_gap() -> None:
    off = np.array([0.0, 0.03, -0.04])
    before = report(effect("accel_bias", (2,), bias=tuple(off)))
    real = units(REST + noise(1, 0.02), REST + off + noise(2, 0.02))
    alike, right = (units(REST + noise(3, 0.02), REST + k * off + noise(4, 0.02)) for k in (0.9, 0.0))
    after = joined(before, answer(wind()), real, alike)
    assert [e.id for e in after.effects] == ["wind"]
    assert after.warnings == ("accel_bias is no gap: the simulator's units differ from each other by as much",)
    assert [e.id for e in joined(before, answer(wind()), real, right).effects] == ["wind", "accel_bias"]


def test_a_scale_that_gravity_at_rest_contradicts_is_no_gap_and_says_so() -> None:
    scale = effect("accel_scale", (2,), scale=(0.05, 0.05, 0.05))
    real = units(REST + noise(1, 0.02), REST + noise(2, 0.02))
    real = replace(real, events=(Event(20.0, "armed", ""),))
    after = joined(report(scale), answer(wind()), real)
    assert [e.id for e in after.effects] == ["wind"]
    (said,) = after.warnings
    assert said == "accel_scale of unit 2 is no gap: the readings of gravity at rest contradict it"


def test_noise_that_both_units_feel_becomes_turbulence() -> None:
    air = noise(1, 0.3)
    real = units(REST + air + noise(2, 0.02), REST + air + noise(3, 0.02))
    after = joined(of_noise(air), answer(turbulence=Turbulence(0.15, 0.01, 0.99)), real)
    (found,) = after.effects
    assert (found.id, found.domain, found.sensor) == ("turbulence", Domain.ENVIRONMENT, None)
    (sigma,) = found.params
    assert sigma.value == pytest.approx(np.sqrt(0.15**2 - 0.01**2))
    assert (sigma.value_real, sigma.value_sim, sigma.unit) == (0.15, 0.01, "m/s2")
    assert after.verdict is GapVerdict.NO_GAP
    assert [w.channel for w in after.where] == ["mag.x"]
    assert any("accel_noise" in warning for warning in after.warnings)


def test_air_that_is_no_louder_than_the_simulators_is_no_turbulence() -> None:
    air = noise(1, 0.3)
    real = units(REST + air + noise(2, 0.02), REST + air + noise(3, 0.02))
    for loud in (Turbulence(0.15, 0.15, 0.99), Turbulence(0.004, 0.001, 0.99)):
        assert joined(of_noise(air), answer(turbulence=loud), real).effects == ()


def test_noise_of_one_unit_stays_a_sensors() -> None:
    own = noise(1, 0.3)
    real = units(REST + own, REST + noise(3, 0.02))
    after = joined(of_noise(own), answer(turbulence=Turbulence(0.15, 0.01, 0.1)), real)
    (found,) = after.effects
    assert (found.id, found.domain, found.sensor, found.instances) == (
        "accel_noise", Domain.SENSOR, Sensor.ACCEL, (1,),
    )  # fmt: skip
    assert after.verdict is GapVerdict.EXPLAINED
    assert {w.channel for w in after.where} == {"accel.x", "mag.x"}
    assert after.warnings == ()


def test_a_sensor_and_an_airframe_stand_side_by_side() -> None:
    own = noise(1, 0.3)
    real = units(REST + own, REST + noise(3, 0.02))
    after = joined(of_noise(own), answer(thrust()), real)
    assert {e.id: e.domain for e in after.effects} == {"thrust_scale": Domain.AIRFRAME, "accel_noise": Domain.SENSOR}
    assert sum(e.evidence.share for e in after.effects) == pytest.approx(1.0)
    assert after.verdict is GapVerdict.EXPLAINED


def test_a_jump_of_the_estimator_is_of_the_day() -> None:
    after = joined(report(), answer(jumps=(Jump(12.0, 0.8), Jump(30.0, 1.9))), BARE)
    (found,) = after.effects
    assert (found.id, found.domain) == ("ekf_reset", Domain.ENVIRONMENT)
    assert {p.name: p.value for p in found.params} == {"t": 30.0, "size": 1.9}
    assert [rival.id for rival in found.confusable_with] == ["gps_glitch"]  # no place of the GPS parts them
    assert after.verdict is GapVerdict.NO_GAP


def test_a_jump_of_the_gps_is_of_the_day() -> None:
    after = joined(report(), answer(glitches=(Jump(12.0, 22.0),)), BARE)
    (found,) = after.effects
    assert (found.id, found.domain) == ("gps_glitch", Domain.ENVIRONMENT)
    assert {p.name: (p.value, p.unit) for p in found.params} == {"t": (12.0, "s"), "size": (22.0, "m")}
    assert after.verdict is GapVerdict.NO_GAP


def test_every_test_counts_and_what_could_not_be_tested_is_told_once() -> None:
    missing = (Missing("inertia", "first", "a"), Missing("inertia", "second", "b"), Missing("inflow", "third", "c"))
    after = joined(of_noise(noise(1, 0.3)), answer(missing=missing), BARE)
    assert [(m.id, m.reason) for m in after.not_testable] == [("inertia", "first"), ("inflow", "third")]
    assert after.multiple_testing.m == 101


def test_what_the_sensors_could_not_name_is_no_unknown_where_the_flight_explains_it() -> None:
    left = Unknown(flag=True, share=0.4, shape="noise on accel from 12 to 14 s")
    before = replace(report(), unknown=left, verdict=GapVerdict.UNKNOWN)
    assert not joined(before, answer(thrust()), BARE).unknown.flag
    passing = replace(before, unknown=replace(left, shape=NOT_LASTING))
    assert not joined(passing, answer(thrust()), BARE).unknown.flag
    turned = replace(report(effect("gyro_scale")), unknown=replace(left, shape="square of current on accel.z"))
    assert not joined(turned, answer(thrust()), BARE).unknown.flag  # a gyroscope's effect says nothing of a force
    magnetic = replace(before, unknown=replace(left, shape="jumps on mag"))
    after = joined(magnetic, answer(thrust()), BARE)
    assert after.unknown.flag
    assert after.verdict is GapVerdict.PARTLY_EXPLAINED


def test_how_far_the_prediction_improves_is_that_of_the_airframe() -> None:
    held = HeldOut(2.0, 0.1, (("thrust_scale", 0.5), ("unknown", 0.1)))
    after = joined(report(), answer(thrust(), heldout=held), BARE)
    assert after.shrink is not None
    assert (after.shrink.before, after.shrink.after, after.shrink.floor) == (2.0, 0.1, 0.0)
    assert after.shrink.closed == pytest.approx(0.95)
    assert [(s.add, pytest.approx(s.closed)) for s in after.shrink.sequence] == [
        ("thrust_scale", 0.75), ("unknown", 0.95),
    ]  # fmt: skip
    assert joined(report(), answer(wind(), heldout=held), BARE).shrink is None


def test_the_report_is_written_as_json() -> None:
    data = as_json(joined(report(), answer(thrust(), wind(), weak()), BARE))
    assert {e["id"]: e["domain"] for e in data["effects"]} == {
        "thrust_scale": "airframe", "wind": "environment", "motor_weak": "airframe",
    }  # fmt: skip
    assert json.loads(json.dumps(data, allow_nan=False))["airframe"] is not None
