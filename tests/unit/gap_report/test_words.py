from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.progress import GapStage
from mavcal.calib.gap.schema import (
    RE_ESTIMATED,
    USELESS_DEG,
    GapVerdict,
    Gates,
    LocatedGap,
    MultipleTesting,
    NotTestable,
    Regime,
    Shrink,
    Unknown,
)
from mavcal.calib.gap_report.words import (
    chance,
    closed_sentence,
    effect_phrase,
    held_out,
    interval,
    not_compared,
    number,
    quantity,
    regime,
    sensor_name,
    sim_patch,
    verdict_sentence,
    with_error,
)
from tests.examples import examples
from tests.unit.gap.export.making import effect, report

BIAS = effect("accel_bias", bias=(0.3, 0.0, -0.1))


def useless(found, sigma=USELESS_DEG + 1.0):
    inputs = replace(found.inputs, reference_kind=RE_ESTIMATED, att_sigma_deg=sigma)
    return replace(found, inputs=inputs, verdict=GapVerdict.REFERENCE)


@pytest.mark.parametrize("verdict", GapVerdict)
def test_every_verdict_is_a_sentence_of_its_own(verdict):
    said = {verdict_sentence(replace(report(), verdict=each)) for each in GapVerdict}
    assert len(said) == len(GapVerdict)
    assert verdict_sentence(replace(report(), verdict=verdict)).endswith(".")


@pytest.mark.parametrize("verdict", [GapVerdict.UNKNOWN, GapVerdict.NO_GAP, GapVerdict.NOT_TESTABLE])
def test_effects_are_listed_where_they_explain_something(verdict):
    assert "(accel_bias)" in verdict_sentence(report(BIAS))
    assert "(accel_bias)" in verdict_sentence(replace(report(BIAS), verdict=GapVerdict.PARTLY_EXPLAINED))
    assert "(accel_bias)" not in verdict_sentence(replace(report(BIAS), verdict=verdict))
    assert "(accel_bias)" not in verdict_sentence(report(BIAS), listed=False)


@pytest.mark.parametrize(
    ("verdict", "said"), [(GapVerdict.PARTLY_EXPLAINED, "no time to try"), (GapVerdict.NOT_TESTABLE, "no time for an")]
)
def test_a_diagnosis_that_ended_early_says_so(verdict, said):
    whole = replace(report(), verdict=verdict)
    assert said not in verdict_sentence(whole)
    assert said in verdict_sentence(replace(whole, left_out=(GapStage.SELECTION.value,)))
    assert said not in verdict_sentence(replace(whole, left_out=(GapStage.BLOCKS.value,)))  # which only judges it


def test_a_useless_reference_says_how_badly_it_is_known_and_what_helps():
    said = verdict_sentence(useless(report()))
    assert f"known to {USELESS_DEG + 1.0:.1f} degrees only, {USELESS_DEG:g} are needed" in said
    assert "--sim of the same trajectory" in said
    contradicted = verdict_sentence(useless(report(), math.nan))
    assert "contradicts the inertial unit" in contradicted
    assert "nan" not in contradicted


def test_beside_a_useless_reference_units_are_still_compared():
    tested = replace(useless(report()), multiple_testing=MultipleTesting(10, 0.005))
    assert "the units of the vehicle show no difference" in verdict_sentence(tested)
    assert "units of the vehicle" not in verdict_sentence(useless(report()))
    for found in (replace(tested, unknown=Unknown(flag=True)), replace(tested, effects=(BIAS,))):
        assert "only what units of the vehicle show against each other" in verdict_sentence(found)
    assert "(accel_bias)" in verdict_sentence(replace(tested, effects=(BIAS,)))


def test_a_reference_that_is_good_enough_is_no_finding_by_itself():
    found = replace(report(), verdict=GapVerdict.REFERENCE)
    assert "No difference" in verdict_sentence(found)
    differs = verdict_sentence(replace(found, effects=(BIAS,)))
    assert "No difference" not in differs
    assert "reference" in differs


def test_sensors_that_were_not_compared_are_named_once():
    lost = [NotTestable(name, "It is silent.", "its samples") for name in ("gyro", "mag", "gyro", "accel_bias")]
    found = replace(report(BIAS), not_testable=tuple(lost))
    assert not_compared(found).startswith("Not compared, at least in part: gyroscope, magnetometer;")
    assert not_compared(replace(found, verdict=GapVerdict.NOT_TESTABLE)) == ""  # which says it
    assert not_compared(useless(found)) == ""
    assert not_compared(report(BIAS)) == ""


@pytest.mark.parametrize(
    ("instances", "said"), [((1,), "accelerometer 1"), ((1, 2, 3), "accelerometers 1, 2, 3"), ((2,), "accelerometer 2")]
)
def test_sensors_are_counted(instances, said):
    assert sensor_name(replace(BIAS, instances=instances)) == said


@pytest.mark.sampled
@pytest.mark.parametrize("known", catalogue(), ids=lambda known: known.id)
def test_every_effect_of_the_catalogue_has_plain_words(known):
    said = effect_phrase(replace(BIAS, id=known.id))
    assert said.startswith(known.plain)
    assert said.endswith(f"({known.id})")
    assert ("accelerometer 1" in said.removeprefix(known.plain)) is not known.shared


def test_an_effect_of_another_version_is_told_by_its_name():
    said = effect_phrase(replace(BIAS, id="accel_new_thing"))
    assert "accelerometer 1" in said
    assert "(accel_new_thing)" in said


@pytest.mark.parametrize(
    ("blocks", "said"), [(None, "not held out"), (True, "holds on held-out"), (False, "does not hold on held-out")]
)
def test_held_out_blocks_confirm_or_not(blocks, said):
    assert held_out(replace(BIAS, gates=Gates(blocks))).startswith(said)


def test_a_patch_leaves_out_what_it_does_not_change():
    patch = {"SIM_ACC1_BIAS_X": 0.3, "SIM_ACC1_BIAS_Y": 0.0, "SIM_ACC1_BIAS_Z": -0.1234567}
    assert sim_patch(replace(BIAS, sim_patch=patch)) == "SIM_ACC1_BIAS_X 0.3, SIM_ACC1_BIAS_Z -0.123457"
    assert sim_patch(BIAS) == ""


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (None, "not known"),
        (math.nan, "not known"),
        (math.inf, "unbounded"),
        (-math.inf, "unbounded"),
        (1 / 3, "0.3333"),
    ],
)
def test_a_number_that_is_none_is_said_in_words(value, said):
    assert number(value) == said
    assert quantity(value, "uT") == f"{said} uT"


@settings(max_examples=examples(50))
@given(st.floats(-1e200, 1e200))
def test_a_number_is_told_to_four_digits(value):
    assert float(number(value)) == pytest.approx(value, rel=1e-3, abs=1e-300)


@pytest.mark.parametrize("unit", ["", "1"])
def test_a_pure_number_has_no_unit(unit):
    assert quantity(0.5, unit) == "0.5"


@pytest.mark.parametrize(("low", "high"), [(-math.inf, 1.0), (0.0, math.inf), (math.nan, 1.0), (0.0, 1e301)])
def test_an_interval_without_an_end_is_none(low, high):
    assert "not determined" in interval(low, high)
    assert not any(digit in interval(low, high) for digit in "0123456789")
    assert "not determined" not in (whole := interval(-0.1, 0.25))
    assert whole.startswith("-0.1 ")
    assert whole.endswith(" 0.25")


SHRINK = Shrink(2.0, 0.5, 0.25, "declared_noise", 0.857, (0.8, 0.9), nested=True)


def test_how_far_the_gap_shrinks_has_its_interval_and_its_floor():
    said = closed_sentence(SHRINK)
    assert "closes 85.7 % of the gap (95 % interval 0.800 to 0.900): from 2 to 0.5 nats" in said
    assert "the floor being 0.25 (declared noise)" in said
    assert "interval" not in closed_sentence(replace(SHRINK, ci95=None))


def test_a_share_whose_blocks_disagree_is_not_stated():
    unsure = replace(SHRINK, closed=1.0, ci95=(-12.598, 13.608))
    assert unsure.known is None
    said = closed_sentence(unsure)
    assert "100" not in said
    assert "-12.6 to 13.6" in said
    agreed = replace(SHRINK, closed=0.8, ci95=(0.3, 1.3))
    assert agreed.known == 0.8
    assert "closes 80.0 %" in closed_sentence(agreed)


def test_the_one_line_summary_keeps_silent_where_the_blocks_disagree():
    told = replace(report(BIAS), shrink=replace(SHRINK, closed=1.0, ci95=(-12.0, 13.0)))
    assert "close" not in repr(told).splitlines()[0]
    assert "close 97 %" in repr(replace(told, shrink=replace(SHRINK, closed=0.97, ci95=None))).splitlines()[0]


def test_what_cannot_shrink_is_said():
    assert "too short" in closed_sentence(None)
    nothing = closed_sentence(replace(SHRINK, closed=None))
    assert "%" not in nothing
    assert "2 nats" in nothing
    assert "0.5 after" in nothing


@pytest.mark.parametrize(
    ("kind", "limits", "unit", "said"),
    [
        ("all", (0.0, 1.0), "", "whole recording"),
        ("temperature", (20.0, 24.0), "degC", "temperature 20..24 degC"),
        ("throttle", (0.5, 0.5), "1", "throttle 0.5"),
        ("band", (0.0, 12.5), "Hz", "band 0..12.5 Hz"),
        ("time", (-1e-15, 10.0), "s", "time 0..10 s"),
    ],
)
def test_a_regime_is_where_it_lies(kind, limits, unit, said):
    assert regime(LocatedGap("accel.x", 1, Regime(kind, limits, unit), 1.0, 1.0, "m/s2", 1e-9)) == said


@pytest.mark.parametrize(
    ("value", "se", "said"),
    [
        (-6.00021, 0.009162, "-6.0002 +- 0.0092 uT"),
        (0.0080031, 5.378e-05, "0.008003 +- 5.4e-05 uT"),
        (350.2, 12.0, "350 +- 12 uT"),
        (1.5, None, "1.5 +- not known uT"),
    ],
)
def test_a_number_has_the_digits_that_its_error_leaves_it(value, se, said):
    assert with_error(value, se, "uT") == said


@pytest.mark.parametrize(
    ("probability", "said"), [(0.9082, "91 %"), (0.9999, "over 99 %"), (0.0001, "under 1 %"), (0.5, "50 %")]
)
def test_a_probability_is_told_in_percent(probability, said):
    assert chance(probability) == said
