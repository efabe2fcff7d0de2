"""Words for effects of airframe and air, and for what a report says of the airframe beside them."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pytest

from mavcal.calib.airframe.answer import AirframePart, Commands, Domain, Quantity, Rollout, RolloutStep
from mavcal.calib.gap.schema import RE_ESTIMATED, GapVerdict, MultipleTesting, NotTestable, Rival, Unknown
from mavcal.calib.gap_report.airframe_effects import claims, known, phrase, plain_name, rival_phrase, wind_from
from mavcal.calib.gap_report.airframe_words import (
    closed_words,
    commands_sentence,
    effects_of,
    error_words,
    geometry_sentence,
    groups,
    rollout_sentence,
    sized,
)
from mavcal.calib.gap_report.words import effect_phrase, sim_patch, verdict_sentence
from mavcal.calib.recording import Sensor
from tests.unit.gap.export.making import effect, report
from tests.unit.gap_report.flown import (
    CENTRE,
    DOMAINS,
    DRAG,
    PLUS,
    TURBULENCE,
    WEAK,
    WIND,
    absolute,
    drag_flight,
    flown,
    relative,
    rollouts,
    stated,
    weak_motor,
    windy_null,
)

FOUND = {
    "thrust_scale": (relative("s", 22.64, 25.15, 0.01),),
    "thrust_expo": (absolute("expo", 0.47, 0.65, 0.02, "1"),),
    "motor_lag": (absolute("tau_up", 0.105, 0.06, 0.005, "s"), absolute("tau_down", 0.11, 0.06, 0.005, "s")),
    "actuator_delay": (absolute("delay", 0.014, 0.002, 0.002, "s"),),
    "motor_weak": (relative("s", 0.921, 1.0, 0.005), stated("motor", 3.0)),
    "rotor_drag": (relative("c1", 0.392, 0.245, 0.06),),
    "body_drag": (relative("c2", 0.058, 0.0341, 0.04),),
    "inflow": (absolute("cz", 0.5, 0.38, 0.02, "1/s"),),
    "translational_lift": (absolute("ch", 0.012, 0.004, 0.001, "1/m"),),
    "inertia": (relative("x", 1.25, 1.0, 0.02), relative("y", 1.24, 1.0, 0.02)),
    "cg_offset": (absolute("x", 0.048, 0.0, 0.004, "1"), absolute("y", -0.028, 0.0, 0.005, "1")),
    "torque_bias": (absolute("z", 0.5, 0.0, 0.04, "rad/s2"),),
    "yaw_coefficient": (relative("s", 9.62, 7.2, 0.03),),
    "angular_damping": (relative("x", 3.2, 2.02, 0.06),),
    "battery_sag": (absolute("exponent", 2.0, 0.0, 0.2, "1"),),
    "air_density": (relative("s", 0.94, 1.0, 0.01),),
    "ground_effect": (absolute("a", 0.12, 0.0, 0.02, "1"),),
    "payload_step": (relative("s", 1.15, 1.0, 0.02), stated("t", 62.0, "s")),
    "wind": WIND.params,
    "turbulence": TURBULENCE.params,
    "gust": (stated("t", 61.3, "s"), absolute("size", 1.5, 0.0, 0.2, "m/s2")),
    "gps_glitch": (stated("t", 40.0, "s"), absolute("size", 3.0, 0.0, 0.2, "m/s")),
    "ekf_reset": (stated("t", 41.0, "s"), absolute("size", 1.2, 0.0, 0.2, "m/s")),
}
SAID = {
    "thrust_scale": "the real vehicle has 0.90 times the thrust for its mass (0.89 to 0.91)",
    "thrust_expo": "the thrust curve of the real vehicle has an expo that is 0.18 lower (0.16 to 0.20)",
    "motor_lag": "the real motors take 45 ms longer (40 to 50) to speed up and 50 ms longer (45 to 55) to slow down",
    "actuator_delay": "commands reach the real motors 12 ms later (10 to 14)",
    "motor_weak": "motor 3 is 7.9 % weak (7.4 to 8.4)",
    "rotor_drag": "the real vehicle has 1.60 times the rotor drag (1.54 to 1.66)",
    "body_drag": "the real vehicle has 1.70 times the body drag (1.66 to 1.74)",
    "inflow": "each m/s of climb costs the real vehicle 0.12 m/s2 more (0.10 to 0.14)",
    "translational_lift": "level flight at 10 m/s lifts the real vehicle by 0.8 m/s2 more (0.7 to 0.9)",
    "inertia": (
        "the real vehicle has 1.25 times the inertia in roll (1.23 to 1.27) and 1.24 times that in pitch (1.22 to 1.26)"
    ),
    "cg_offset": (
        "the centre of gravity of the real vehicle is 4.8 % of an arm further forward (4.4 to 5.2) and 2.8 % of an arm "
        "further left (2.3 to 3.3)"
    ),
    "torque_bias": "a steady torque turns the real vehicle: 0.50 rad/s2 in yaw (0.46 to 0.54)",
    "yaw_coefficient": "the real vehicle has 1.34 times the yaw torque (1.31 to 1.37)",
    "angular_damping": "the real vehicle has 1.58 times the damping of turns in roll (1.52 to 1.64)",
    "battery_sag": "thrust follows the voltage of the real battery with an exponent of 2.0 more (1.8 to 2.2)",
    "air_density": "the air was 0.94 times as dense (0.93 to 0.95)",
    "ground_effect": "with its rotors 0.25 m above the ground the real vehicle has 12 % of thrust more (10 to 14)",
    "payload_step": "at 62.0 s the real vehicle became 1.15 times as heavy (1.13 to 1.17)",
    "wind": "wind of 4.1 m/s from 75 deg",
    "turbulence": "the air was rougher by 0.47 m/s2 rms",
    "gust": "a gust of 1.5 m/s2 at 61.3 s",
    "gps_glitch": "a jump of the GPS place of 3.0 m at 40.0 s",
    "ekf_reset": "a reset of the estimator's velocity of 1.2 m/s at 41.0 s",
}


def found(id_):
    return flown(id_, *FOUND[id_], instances=(3,) if id_ == "motor_weak" else ())


def test_every_effect_of_airframe_and_air_has_an_example_here():
    assert set(FOUND) == set(SAID) == set(DOMAINS)
    assert all(map(known, DOMAINS))
    assert not known("accel_bias")


@pytest.mark.parametrize("id_", DOMAINS)
def test_every_effect_is_said_in_plain_words_with_its_size(id_):
    assert phrase(found(id_)) == SAID[id_]
    assert "_" not in plain_name(id_)


def test_a_product_of_inertia_is_a_difference():
    params = (relative("z", 0.8, 1.0, 0.02), absolute("xy", 0.206, 0.0, 0.008, "1"))
    assert phrase(flown("inertia", *params)) == (
        "the real vehicle has 0.80 times the inertia in yaw (0.78 to 0.82) and the product of inertia of roll and "
        "pitch is 0.206 larger (0.198 to 0.214)"
    )


@pytest.mark.parametrize(
    ("forms", "said"),
    [
        ({"thrust": 0.97, "mass": 0.03}, "; of the two, its thrust differs (97 %)"),
        ({"thrust": 0.02, "mass": 0.98}, "; of the two, its mass differs, it is 1.10 times as heavy (98 %)"),
        ({"thrust": 0.3, "mass": 0.7}, "; the flight does not tell thrust from mass (70 % mass)"),
    ],
)
def test_a_thrust_scale_says_whether_thrust_or_mass_differs(forms, said):
    params = (relative("s", 1.0 / 1.1, 1.0, 0.003),)
    told = phrase(replace(flown("thrust_scale", *params), forms=forms))
    assert told.startswith("the real vehicle has 0.909 times the thrust for its mass")
    assert told.endswith(said)


def test_thin_air_says_where_a_simulator_has_it():
    params = (relative("s", 0.87, 1.0, 0.003), stated("altitude", 2010.0))
    assert phrase(flown("air_density", *params)).endswith(
        "times as dense (0.867 to 0.873), as at 2010 m in the standard atmosphere"
    )


@pytest.mark.parametrize("id_", DOMAINS)
def test_what_belongs_to_the_day_says_that_it_is_not_exported(id_):
    said = effect_phrase(found(id_))
    assert said.startswith(SAID[id_])
    assert said.endswith("a finding about the day, not exported") is (DOMAINS[id_] is Domain.ENVIRONMENT)


def test_an_effect_of_a_sensor_names_its_units():
    shaken = replace(flown("motor_weak"), id="gyro_vibration", sensor=Sensor.GYRO, instances=(1, 2))
    assert phrase(shaken) == "gyro vibration, unit 1, 2"


@pytest.mark.parametrize("id_", DOMAINS)
def test_every_parameter_but_the_number_of_a_motor_is_a_claim(id_):
    told = claims(found(id_))
    assert len(told) == sum(p.name != "motor" for p in FOUND[id_])
    for claim, p in zip(told, FOUND[id_], strict=False):
        assert claim.label
        assert ("times" in claim.difference) is (p.ratio is not None)


@pytest.mark.parametrize("id_", DOMAINS)
def test_an_effect_whose_parameters_are_missing_keeps_its_name(id_):
    for bare in (replace(found(id_), params=()), replace(found(id_), params=(stated("new", 1.0),))):
        assert plain_name(id_).split()[-1] in phrase(bare)


@pytest.mark.parametrize(
    ("params", "said"),
    [
        (("motor_weak", relative("s", 1.05, 1.0, 0.01)), "motor 3 is 5 % strong (4 to 6)"),
        (("inflow", absolute("cz", 0.3, 0.4, 0.02, "1/s")), "costs the real vehicle 0.10 m/s2 less (0.08 to 0.12)"),
        (("motor_lag", absolute("slew", 1.2, 150.0, 0.1, "1/s")), "by at most 1.2 of the full command a second"),
        (("motor_lag", stated("slew", -3.0, "1/s")), "changes 3.00 1/s slower"),
        (("battery_sag", relative("s", 0.92, 1.0, 0.02)), "leaves the real vehicle 0.92 times the thrust"),
        (("turbulence", absolute("sigma", 0.1, 0.3, 0.05, "m/s2")), "the air was calmer by 0.20 m/s2 rms"),
        (("cg_offset", absolute("x", -0.05, 0.0, 0.01, "1"), absolute("y", 0.001, 0.0, 0.01, "1")),
         "is 5 % of an arm further back (4 to 6)"),
    ],
)  # fmt: skip
def test_the_words_go_with_the_sign(params, said):
    id_, *values = params
    assert said in phrase(flown(id_, *values, instances=(3,)))
    assert "right" not in phrase(flown(id_, *values, instances=(3,)))


def test_a_relative_parameter_without_a_ratio_is_one_and_its_value():
    bare = replace(DRAG.params[0], ratio=None, ratio_ci95=None)
    assert "1.60 times the rotor drag (1.54 to 1.66)" in phrase(replace(DRAG, params=(bare,)))


def test_an_unbounded_interval_is_said_in_words_and_no_number_is_endless():
    wild = replace(DRAG.params[0], ratio_ci95=(-math.inf, math.inf))
    said = phrase(replace(DRAG, params=(wild,)))
    assert "not determined by itself" in said
    assert "inf" not in said


def test_a_claim_has_both_sides_where_they_have_a_unit():
    [drag] = claims(DRAG)
    assert (drag.difference, drag.interval, drag.sides) == (
        "1.60 times", "1.54 to 1.66", "real 0.392, simulated 0.245 1/s"
    )  # fmt: skip
    [weak] = claims(WEAK)
    assert weak.sides == ""  # of a motor only the ratio means anything
    forward, right = claims(CENTRE)
    assert (forward.difference, right.difference) == ("+0.048", "-0.028")


def test_an_effect_of_another_version_is_told_by_its_name():
    new = replace(DRAG, id="blade_stall", instances=(2,))
    assert phrase(new) == "blade stall, motor 2"
    assert not known("blade_stall")


@pytest.mark.parametrize(
    ("north", "east", "speed", "direction"),
    [(-4.0, 0.0, 4.0, 0.0), (0.0, -3.0, 3.0, 90.0), (5.0, 0.0, 5.0, 180.0), (0.0, 2.0, 2.0, 270.0)],
)
def test_wind_is_told_by_where_it_comes_from(north, east, speed, direction):
    assert wind_from(north, east) == pytest.approx((speed, direction))


def test_a_rival_says_what_decides():
    said = rival_phrase(Rival("cg_offset", 0.86, 48.0, "hover at two thrusts"))
    assert said == "a shifted centre of gravity, 86 % alike; what decides: hover at two thrusts"
    assert "alike" not in rival_phrase(Rival("accel_bias", math.nan, 1.0, "x"))


def test_effects_stand_by_domain_the_airframe_first_and_the_day_last():
    bias = effect("accel_bias", bias=(0.3, 0.0, 0.0))
    grouped = groups(report(WIND, bias, DRAG, CENTRE))
    assert [[e.id for e in effects] for _, effects in grouped] == [
        ["rotor_drag", "cg_offset"],
        ["accel_bias"],
        ["wind"],
    ]
    assert effects_of(report(WIND, bias), Domain.SENSOR) == (bias,)


@pytest.mark.parametrize(
    ("effects", "verdict", "said"),
    [
        ((DRAG,), GapVerdict.EXPLAINED, "The real vehicle flies differently from the simulated one, and known effects"),
        ((DRAG, WIND), GapVerdict.EXPLAINED, "The real vehicle flies differently"),
        ((DRAG, effect("accel_bias")), GapVerdict.EXPLAINED, "flies differently from the simulated one and its"),
        ((effect("accel_bias"), WIND), GapVerdict.EXPLAINED, "The real sensors differ"),
        ((WIND,), GapVerdict.NO_GAP, "The vehicle and its sensors are as simulated"),
        ((WIND,), GapVerdict.EXPLAINED, "The vehicle and its sensors are as simulated"),
        ((), GapVerdict.NO_GAP, "No difference beyond the noise"),
        ((), GapVerdict.UNKNOWN, "The real flight differs from the simulated one"),
        ((DRAG,), GapVerdict.REFERENCE, "the vehicle itself flies differently"),
    ],
)  # fmt: skip
def test_the_verdict_is_of_what_was_compared(effects, verdict, said):
    compared = AirframePart(probabilities={"rotor_drag": 0.5})
    assert said in verdict_sentence(replace(report(*effects), verdict=verdict, airframe=compared))


def test_what_has_no_name_is_of_the_sensors_where_it_is_on_one() -> None:
    """Halves of a real flight differ by what lay beside the compass on the ground: "the real flight differs"."""
    nameless = Unknown(flag=True, share=0.7, shape="a difference on mag that no effect describes")
    compared = AirframePart(probabilities={"rotor_drag": 0.5})
    one = replace(report(), verdict=GapVerdict.UNKNOWN, airframe=compared, unknown=nameless)
    assert verdict_sentence(one).startswith("The real sensors differ")


def test_a_flight_alone_is_not_said_to_differ_from_a_simulated_one():
    alone = replace(report(), verdict=GapVerdict.UNKNOWN, airframe=AirframePart())
    assert "flight differs" not in verdict_sentence(alone)


def test_the_day_is_told_apart_from_the_vehicle():
    said = verdict_sentence(replace(report(DRAG, WIND), airframe=AirframePart()))
    assert "Found: the real vehicle has 1.60 times the rotor drag (1.54 to 1.66)." in said
    assert said.endswith("Of the day, and not exported: wind of 4.1 m/s from 75 deg.")
    assert "Of the day" in verdict_sentence(windy_null())
    assert "Of the day" not in verdict_sentence(windy_null(), listed=False)


def test_what_is_doubtful_is_no_finding_of_the_day():
    guess = replace(WIND, evidence=replace(WIND.evidence, probability=0.3))
    said = verdict_sentence(replace(windy_null(), effects=(guess,)))
    assert "In doubt, since something else is likelier: wind" in said
    assert "Of the day" not in said


def test_the_likeliest_of_several_is_no_certain_finding():
    """A thrust of probability 0.58 beside its curve was "Found"."""
    first = replace(DRAG, evidence=replace(DRAG.evidence, probability=0.58))
    said = verdict_sentence(replace(report(first, WIND), airframe=AirframePart()))
    assert "Likely, or else one of the rivals below: (58 %) the real vehicle has 1.60 times the rotor drag" in said
    assert "One of several known effects explains it; these recordings do not tell which." in said
    assert "known effects explain the difference" not in said
    assert "Found" not in said


def test_a_sensor_with_a_rival_is_no_certain_finding():
    """A bias of probability 0.6 beside a scale of 0.4 was "Found"."""
    bias = effect("accel_bias", bias=(0.0, 0.0, 0.2))
    likely = replace(bias.evidence, probability=0.6)
    unsure = replace(bias, evidence=likely, confusable_with=(Rival("accel_scale", 0.98, 0.0, "turn it over"),))
    said = verdict_sentence(report(unsure))
    assert said.startswith("The real sensors differ from the simulated ones. One of several known effects explains it")
    assert "Likely, or else one of the rivals below: (60 %)" in said
    assert "Found" not in said


def test_an_airframe_that_was_not_compared_is_said_beside_the_verdict():
    """A hexacopter beside a simulated quadcopter was "no difference beyond the noise", and no more."""
    other = NotTestable("airframe", "the vehicles have 6 and 4 motors", "a simulator of the same frame")
    one = replace(report(), not_testable=(other,))
    assert verdict_sentence(one).endswith("The airframe was not compared: the vehicles have 6 and 4 motors.")
    assert "compared" not in verdict_sentence(replace(one, verdict=GapVerdict.NOT_TESTABLE))


def test_beside_a_useless_reference_the_flight_still_speaks():
    lost = replace(weak_motor().inputs, reference_kind="estimator", att_sigma_deg=9.0)
    said = verdict_sentence(
        replace(weak_motor(), inputs=lost, verdict=GapVerdict.REFERENCE, multiple_testing=MultipleTesting(9, 0.005))
    )
    assert "No sensor was compared: the reference's attitude is known to 9.0 degrees only" in said
    assert "motor 3 is 7.9 % weak" in said


def test_a_patch_leaves_tables_of_a_file_to_the_export():
    patch = {"SIM_ENGINE_MUL": 0.96, "frame_json": {"mass": 3.0}, "sdf": "<sdf/>"}
    assert sim_patch(replace(WEAK, sim_patch=patch)) == "SIM_ENGINE_MUL 0.96"


@pytest.mark.parametrize(
    ("commands", "said"),
    [
        (Commands("rate_mixer", 400.0, 0.5, 0.021), "RATE and MOTB at 400 Hz; 0.5 us from the logged outputs (median)"),
        (Commands("actuator_motors", 125.0, None, 0.0), "logged at 125 Hz; nothing to check them against."),
        (Commands("another source", 50.0, None, 0.0), ": another source at 50 Hz"),
    ],
)
def test_commands_are_told_in_one_sentence(commands, said):
    told = commands_sentence(commands)
    assert said in told
    assert ("2.1 % of the flight is left out" in told) is (commands.masked > 0.0)


@pytest.mark.parametrize(("source", "said"), [("parameters", "parameters say"), ("assumed", "state --frame")])
def test_the_frame_says_whence_it_is_known(source, said):
    told = geometry_sentence(replace(PLUS, source=source))
    assert told.startswith("Frame: quad plus, 4 motors")
    assert said in told


ONE = Rollout(1.0, Quantity.VELOCITY, "m/s", 0.82, 0.143, 0.1, 0.94, (0.91, 0.96), sequence=(RolloutStep("a", 0.143),))


def test_the_prediction_is_told_before_and_after_with_its_floor():
    assert error_words(ONE) == "0.820 m/s, 0.143 with the effects, floor 0.100"
    assert closed_words(ONE) == "94 % closed (91 to 96 %)"
    assert closed_words(replace(ONE, closed=None)) == "the part that is closed is not known"
    assert closed_words(replace(ONE, ci95=None)) == "94 % closed"
    bare = replace(ONE, sequence=(), closed=None, after=0.82)
    assert (error_words(bare), closed_words(bare)) == ("0.820 m/s, floor 0.100", "")


@pytest.mark.parametrize(("before", "said"), [(12.0, "0.1"), (1.58, "0.14"), (0.05, "0.1430")])
def test_errors_have_the_decimals_that_the_largest_needs(before, said):
    assert sized(replace(ONE, before=before), 0.143) == said
    assert sized(ONE, math.nan) == "not known"


def test_of_the_horizons_one_of_each_kind_is_told():
    said = rollout_sentence(AirframePart(rollout=rollouts("motor_weak")))
    assert re.findall(r"after ([\d.]+) s", said) == ["1", "0.2"]
    assert rollout_sentence(AirframePart()) == ""
    assert "after 3 s" in rollout_sentence(AirframePart(rollout=(replace(ONE, h_s=3.0),)))
    assert "doublets held out" in rollout_sentence(AirframePart(rollout=(replace(ONE, part="doublets"),)))


def test_reports_of_flights_are_what_they_say():
    assert [e.id for e in drag_flight().effects] == ["rotor_drag", "cg_offset"]
    assert windy_null().verdict is GapVerdict.NO_GAP


def test_a_flight_is_told_of_first_where_no_sensor_could_be_compared() -> None:
    """Nine lines about a reference of no use stood before a motor that was weak for certain."""
    slow = replace(weak_motor().inputs, att_sigma_deg=7.6, reference_kind=RE_ESTIMATED)
    part = weak_motor().airframe
    assert part is not None
    compared = replace(part, probabilities={"motor_weak": 1.0})
    weak = replace(weak_motor(), inputs=slow, airframe=compared)
    assert weak.inputs.useless
    said = verdict_sentence(weak, listed=False)
    assert said.startswith("The real vehicle flies differently from the simulated one")
    assert "No sensor was compared: the reference's attitude is known to 7.6 degrees only, 3 are needed." in said
    listed = verdict_sentence(weak)
    assert listed.index("motor 3 is 7.9 % weak") < listed.index("No sensor was compared")  # what was found comes first
    none = replace(weak, effects=(), verdict=GapVerdict.NO_GAP)
    assert verdict_sentence(none).startswith("The vehicle flies as the simulated one, as far as these flights show.")
    apart = replace(none, airframe=None)
    assert verdict_sentence(apart).startswith("The reference is of no use: its attitude is known to 7.6 degrees")
