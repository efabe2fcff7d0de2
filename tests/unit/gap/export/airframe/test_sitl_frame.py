"""The patched frame of ArduPilot's simulator flies as the effects say, in a physics that was written apart."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib.gap.export.airframe import Patch, airframe_patch, own_patches
from mavcal.calib.gap.schema import EffectEstimate
from tests.examples import examples
from tests.unit.gap.export.making import PLUS, airframe

from .flying import G, Simulated

STOCK = Simulated({}).shown()
SHOWN = [name for name in STOCK if not name.startswith(("trim", "slew", "angular_damping"))]


def patched(
    *effects: EffectEstimate, frame: dict[str, Any] | None = None, **how: Any
) -> tuple[Patch, dict[str, float]]:
    parameters = how.pop("simulator", {})
    made = airframe_patch(effects, parameters, frame, geometry=PLUS, **how)
    flown = Simulated({**(frame or {}), **made.frame_json}, {**parameters, **made.parameters})
    return made, flown.shown()


def ratios(after: dict[str, float], before: dict[str, float] = STOCK) -> dict[str, float]:
    return {name: after[name] / before[name] for name in SHOWN}


def test_the_stock_frame_is_that_of_the_reference_flights() -> None:
    """Theory of the null flights: k 25.145, e .65, c_1 .2413, c_2 .0336, gains 287.4 and 7.18, damping 1.99."""
    assert STOCK["thrust_scale.s"] == pytest.approx(25.145, abs=1e-3)
    assert STOCK["thrust_expo.expo"] == pytest.approx(0.65)
    assert STOCK["rotor_drag.c1"] == pytest.approx(0.2413, abs=1e-4)
    assert STOCK["body_drag.c2"] == pytest.approx(0.03361, abs=2e-5)
    assert STOCK["gain.x"] == pytest.approx(4 * 287.4, rel=1e-3)  # of all four motors; the mixer's ones are a quarter
    assert STOCK["angular_damping.x"] == pytest.approx(1.99, abs=0.01)


def test_a_lighter_vehicle_keeps_its_turns_and_changes_all_forces_by_its_mass() -> None:
    lighter = replace(airframe("thrust_scale", s=1.21), forms={"mass": 0.98, "thrust": 0.02})
    made, shown = patched(lighter)
    after = ratios(shown)
    assert "thrust_scale: another mass (probability 0.98); weigh the vehicle and state --mass" in made.notes
    assert after["thrust_scale.s"] == pytest.approx(1.21)
    assert after["rotor_drag.c1"] == pytest.approx(1.1)
    assert after["body_drag.c2"] == pytest.approx(1.21)
    assert [after[f"gain.{axis}"] for axis in "xyz"] == pytest.approx([1.0] * 3)
    stronger = replace(lighter, forms={"mass": 0.02, "thrust": 0.98})
    made, _ = patched(stronger)
    assert made.frame_json == patched(airframe("thrust_scale", s=1.21))[0].frame_json
    assert "thrust_scale: another thrust (probability 0.98)" in made.notes


SINGLE: dict[str, tuple[EffectEstimate, dict[str, float]]] = {
    "weaker": (airframe("thrust_scale", s=0.9), {"thrust_scale.s": 0.9, "gain.x": 0.9, "gain.y": 0.9, "gain.z": 0.9}),
    "curve": (airframe("thrust_expo", expo=-0.17), {"thrust_expo.expo": 0.48 / 0.65}),
    "rotors": (airframe("rotor_drag", c1=1.6), {"rotor_drag.c1": 1.6}),
    "clean": (airframe("rotor_drag", c1=0.4), {"rotor_drag.c1": 0.4}),
    "body": (airframe("body_drag", c2=1.7), {"body_drag.c2": 1.7}),
    "heavy arms": (airframe("inertia", x=1.25, y=1.25), {"gain.x": 0.8, "gain.y": 0.8}),
    "heavy rim": (airframe("inertia", z=0.75), {"gain.z": 1 / 0.75}),
    "yaw": (airframe("yaw_coefficient", s=1.3), {"gain.z": 1.3}),
    "one motor": (airframe("motor_weak", motor=3, s=0.92), {"motor3": 0.92}),
    "strong motor": (airframe("motor_weak", motor=2, s=1.07), {"motor2": 1.07}),
}


@pytest.mark.parametrize("name", SINGLE)
def test_one_effect_moves_what_it_names_and_nothing_else(name: str) -> None:
    effect, wanted = SINGLE[name]
    _, after = patched(effect)
    expected = dict.fromkeys(SHOWN, 1.0) | wanted
    assert ratios(after) == pytest.approx(expected, rel=2e-5)


@pytest.mark.parametrize("name", SINGLE)
def test_the_keys_of_the_reference_flights_are_found_again(name: str) -> None:
    """What flew with a stated ratio had these keys (labels of the reference flights)."""
    known: dict[str, dict[str, Any]] = {
        "weaker": {"hoverThrOut": 0.433333},
        "curve": {"propExpo": 0.48},
        "rotors": {"mdrag_coef": 0.32, "refSpd": 14.0045},
        "body": {"refSpd": 11.9055},
        "heavy arms": {"moment_inertia": [0.028711, 0.028711, 0.045937]},
        "heavy rim": {"moment_inertia": [0.022969, 0.022969, 0.034453]},
    }
    if name in known:
        made, _ = patched(SINGLE[name][0])
        assert {k: pytest.approx(v, rel=2e-5) for k, v in known[name].items()} == dict(made.frame_json)
        assert dict(made.parameters) == {}


def test_the_pulse_of_a_weak_motor_is_the_one_that_flew() -> None:
    for motor, ratio, mask, factor in ((3, 0.9207, 4.0, 0.96), (1, 0.9403, 1.0, 0.97)):
        made, _ = patched(airframe("motor_weak", motor=motor, s=ratio))
        assert made.parameters["SIM_ENGINE_FAIL"] == mask
        assert made.parameters["SIM_ENGINE_MUL"] == pytest.approx(factor, abs=2e-5)
        assert dict(made.frame_json) == {}
        assert "hover command only" in made.lost[0]
        assert "4.7" in made.notes[0]


def test_a_shifted_centre_of_mass_trims_as_it_flew() -> None:
    made, after = patched(airframe("cg_offset", x=0.012 / 0.35, y=-0.007 / 0.35))
    assert made.frame_json["motor1_position"] == pytest.approx([-0.012, 0.357, 0.0])
    assert made.frame_json["motor4_position"] == pytest.approx([-0.362, 0.007, 0.0])
    assert (after["trim.x"], after["trim.y"]) == pytest.approx((-8.966, -15.37), rel=1e-3)
    assert ratios(after) == pytest.approx(dict.fromkeys(SHOWN, 1.0), rel=1e-5)


def test_a_constant_torque_is_there_at_any_thrust() -> None:
    made, after = patched(airframe("torque_bias", x=0.5, z=-0.2))
    assert (after["trim.x"], after["trim.y"], after["trim.z"]) == pytest.approx((0.5, 0.0, -0.2), abs=1e-6)
    assert "hour" in made.notes[0]
    more, _ = patched(airframe("torque_bias", x=0.5), simulator={"SIM_TWIST_X": 1.0, "SIM_TWIST_TIME": 1e6})
    assert more.parameters["SIM_TWIST_X"] == 1.5


def test_damping_beyond_the_rotors_is_left_to_the_rotation_rate() -> None:
    made, after = patched(airframe("angular_damping", x=1.5, y=1.5, z=1.5))
    for axis in "xyz":
        assert after[f"angular_damping.{axis}"] == pytest.approx(1.5 * STOCK[f"angular_damping.{axis}"], rel=1e-4)
    assert made.lost == ()
    assert set(made.frame_json) == {"refRotRate"}
    cleaner = airframe("rotor_drag", c1=0.6)
    followed = patched(cleaner)[1]["angular_damping.y"]
    assert followed == pytest.approx(0.6 * 1.93 + 0.058, abs=0.01)
    both, after = patched(cleaner, airframe("angular_damping", x=1.6, y=1.6, z=1.6))
    assert after["angular_damping.y"] == pytest.approx(1.6 * followed, rel=1e-4)
    assert after["rotor_drag.c1"] == pytest.approx(0.6 * STOCK["rotor_drag.c1"], rel=1e-4)
    assert both.lost == ()


def test_damping_below_that_of_the_rotors_is_said_to_be_lost() -> None:
    made, after = patched(airframe("angular_damping", x=0.5, y=0.5, z=0.5))
    assert made.frame_json["refRotRate"] == 0.0
    assert after["angular_damping.x"] == pytest.approx(1.93, abs=0.01)
    assert made.lost[0].startswith("angular_damping: 0.994 1/s is wanted, the rotors")


def test_damping_that_differs_between_axes_is_said_to_be_lost() -> None:
    made, _ = patched(airframe("angular_damping", x=2.0, y=1.5))
    assert "one for all axes; wanted are x 3.98, y 2.98" in made.lost[0]
    assert made.lost[1] == "angular_damping: refRotRate also acts about z"


def test_weak_motors_share_one_factor() -> None:
    made, after = patched(airframe("motor_weak", motor=1, s=0.9), airframe("motor_weak", motor=4, s=0.8))
    assert made.parameters["SIM_ENGINE_FAIL"] == 9.0
    assert [after[f"motor{n}"] for n in (1, 2, 3, 4)] == pytest.approx([0.85, 1.0, 1.0, 0.85], rel=1e-5)
    assert "one factor for all motors of SIM_ENGINE_FAIL, 0.85; wanted are 1: 0.9, 4: 0.8" in made.lost[-1]
    again, after = patched(
        airframe("motor_weak", motor=1, s=0.95), simulator={"SIM_ENGINE_FAIL": 1, "SIM_ENGINE_MUL": 0.97}
    )
    assert after["motor1"] == pytest.approx(0.9403 * 0.95, rel=1e-4)
    assert len(again.lost) == 1


def test_a_limit_of_the_rate_is_the_real_one() -> None:
    made, _ = patched(airframe("motor_lag", sim=400.0, slew=1.2 - 400.0))
    assert made.frame_json == {"slew_max": pytest.approx(1.2)}
    assert made.lost == ()


@pytest.mark.parametrize(
    "effect",
    [
        airframe("motor_lag", tau_up=0.05, tau_down=0.08),
        airframe("actuator_delay", delay=0.02),
        airframe("inflow", cz=0.3),
        airframe("translational_lift", ch=0.01),
        airframe("payload_step", s=1.2, t=30.0),
        airframe("battery_sag", exponent=1.0),
        airframe("something_new", s=1.2),
    ],
    ids=lambda e: e.id,
)
def test_what_the_simulator_cannot_do_is_named(effect: EffectEstimate) -> None:
    made, after = patched(effect)
    assert (dict(made.frame_json), dict(made.parameters)) == ({}, {})
    assert made.lost[0].startswith(f"{effect.id}: ")
    assert after == STOCK


def test_the_air_is_no_airframe() -> None:
    assert patched(airframe("wind", north=3.0), airframe("ground_effect", a=0.1))[0] == Patch()


def test_a_battery_falls_as_much_more_as_it_should() -> None:
    frame = {"battCapacityAh": 4.0, "refBatRes": 0.02}
    made, _ = patched(airframe("battery_sag", s=1.6), frame=frame)
    assert dict(made.frame_json) == pytest.approx({"battCapacityAh": 2.5, "refBatRes": 0.032})
    made, _ = patched(airframe("battery_sag", exponent=2.0), vehicle={"BATT_CAPACITY": 5200})
    assert dict(made.frame_json) == {"battCapacityAh": 5.2}
    assert "BAT.Res" in made.lost[0]
    made, _ = patched(airframe("battery_sag", exponent=-0.5), frame=frame)
    assert "square of the voltage" in made.lost[0]


@pytest.mark.parametrize("ratio", [0.0, -1.0, math.inf, math.nan])
def test_a_ratio_that_no_simulator_can_have_is_refused(ratio: float) -> None:
    made, after = patched(airframe("rotor_drag", c1=ratio))
    assert "rotor_drag: c1" in made.lost[0]
    assert after == STOCK


def test_an_impossible_setting_is_said() -> None:
    assert "could not hover" in patched(airframe("thrust_scale", s=0.3))[0].lost[0]
    made, _ = patched(airframe("thrust_expo", expo=0.6))
    assert made.frame_json["propExpo"] == 1.0
    assert "propExpo would be 1.25" in made.lost[0]
    assert "more than full" in " ".join(patched(airframe("motor_weak", motor=1, s=3.0))[0].lost)


def test_where_the_motors_are_must_be_known_to_move_them() -> None:
    made = airframe_patch((airframe("cg_offset", x=0.1, y=0.0), airframe("yaw_coefficient", s=1.2)), {}, None)
    assert [text.split(":")[0] for text in made.lost] == ["cg_offset", "yaw_coefficient"]
    assert dict(made.frame_json) == {}
    places = {
        f"motor{n + 1}_position": p
        for n, p in enumerate([[0.2, 0.2, 0], [-0.2, -0.2, 0], [0.2, -0.2, 0], [-0.2, 0.2, 0]])
    }
    made = airframe_patch((airframe("cg_offset", x=0.1, y=0.0),), {}, places)
    assert made.frame_json["motor1_position"] == pytest.approx([0.2 - 0.1 * math.hypot(0.2, 0.2), 0.2, 0.0])


def test_parameters_of_the_log_go_before_the_file() -> None:
    log = {"SIM_FRM_MASS": 2.0, "SIM_FRM_MDRAG": 0.3, "SIM_FRM_BBDRAG": 0.8, "SIM_FRM_OTHER": 1.0}
    before = Simulated({}, log).shown()
    made, after = patched(airframe("rotor_drag", c1=1.2), airframe("body_drag", c2=1.5), simulator=log)
    assert set(made.parameters) == {"SIM_FRM_MDRAG", "SIM_FRM_BBDRAG"}
    assert dict(made.frame_json) == {}
    expected = dict.fromkeys(SHOWN, 1.0) | {"rotor_drag.c1": 1.2, "body_drag.c2": 1.5}
    assert ratios(after, before) == pytest.approx(expected, rel=1e-5)
    much, after = patched(airframe("rotor_drag", c1=4.0), simulator=log)
    assert set(much.frame_json) == {"refSpd"}
    assert ratios(after, before)["body_drag.c2"] == pytest.approx(1.0, rel=1e-5)
    assert "SIM_FRM_OTHER" in " ".join(much.notes)


def test_with_the_mass_stated_accelerations_stay() -> None:
    made, after = patched(airframe("thrust_scale", s=0.9), mass=4.2)
    assert made.frame_json["mass"] == 4.2
    expected = dict.fromkeys([*SHOWN, *(f"angular_damping.{a}" for a in "xyz")], 1.0)
    expected |= dict.fromkeys(("thrust_scale.s", "gain.x", "gain.y", "gain.z"), 0.9)
    assert {name: after[name] / STOCK[name] for name in expected} == pytest.approx(expected, rel=1e-5)


def test_a_mass_must_be_one() -> None:
    with pytest.raises(ValueError, match="above 0"):
        airframe_patch((), {}, None, mass=0.0)


BASES: tuple[dict[str, Any], ...] = (
    {},
    {"mass": 1.4, "moment_inertia": [0.01, 0.012, 0.02], "hoverThrOut": 0.3, "propExpo": 0.4, "refSpd": 12.0},
    {"mass": 25.7, "diagonal_size": 1.3, "refAngle": 30.0, "refSpd": 25.0, "refVoltage": 46.9, "refCurrent": 65.0,
     "disc_area": 2.08, "mdrag_coef": 0.1, "maxVoltage": 50.4, "spin_min": 0.2, "spin_max": 0.975, "pwmMax": 1940},
    {"mdrag_coef": 0.9},  # rotors that alone drag more than the reference flight: they are cut
)  # fmt: skip


def scaled(low: float = 0.4, high: float = 2.5) -> st.SearchStrategy[float]:
    return st.floats(math.log(low), math.log(high)).map(math.exp)


@given(
    frame=st.sampled_from(BASES),
    thrust=st.none() | scaled(0.75, 1.3),
    expo=st.none() | st.floats(-0.35, 0.3),
    rotor=st.none() | scaled(),
    body=st.none() | scaled(),
    inertia=st.none() | st.tuples(scaled(), scaled(), scaled()),
    cg=st.none() | st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)),
    yaw=st.none() | scaled(0.5, 1.5),
    weak=st.none() | st.tuples(st.integers(1, 4), st.floats(0.6, 1.1)),
    mass=st.none() | scaled(),
)
@settings(max_examples=examples(200))
def test_any_mixture_gives_every_effect_its_ratio(
    frame: dict[str, Any],
    thrust: float | None,
    expo: float | None,
    rotor: float | None,
    body: float | None,
    inertia: tuple[float, float, float] | None,
    cg: tuple[float, float] | None,
    yaw: float | None,
    weak: tuple[int, float] | None,
    mass: float | None,
) -> None:
    effects = []
    if thrust is not None:
        effects.append(airframe("thrust_scale", s=thrust))
    if expo is not None:
        effects.append(airframe("thrust_expo", expo=expo))
    if rotor is not None:
        effects.append(airframe("rotor_drag", c1=rotor))
    if body is not None:
        effects.append(airframe("body_drag", c2=body))
    if inertia is not None:
        effects.append(airframe("inertia", **dict(zip("xyz", inertia, strict=True))))
    if cg is not None:
        effects.append(airframe("cg_offset", x=cg[0], y=cg[1]))
    if yaw is not None:
        effects.append(airframe("yaw_coefficient", s=yaw))
    if weak is not None:
        effects.append(airframe("motor_weak", motor=weak[0], s=weak[1]))
    start = Simulated(frame)
    before = start.shown()
    weight = None if mass is None else mass * start.keys["mass"]
    _, after = patched(*effects, frame=frame, mass=weight)
    i = inertia or (1.0, 1.0, 1.0)
    k, y = thrust or 1.0, yaw or 1.0
    wanted = dict.fromkeys(SHOWN, 1.0)
    wanted |= {"thrust_scale.s": k, "gain.x": k / i[0], "gain.y": k / i[1], "gain.z": k * y / i[2]}
    wanted |= {"rotor_drag.c1": rotor or 1.0, "body_drag.c2": body or 1.0}
    if weak is not None:
        wanted[f"motor{weak[0]}"] = weak[1]
    wanted["thrust_expo.expo"] = 1.0 + (expo or 0.0) / before["thrust_expo.expo"]
    if before["body_drag.c2"] < 1e-9:  # a body without drag has no ratio: it stays without
        assert after["body_drag.c2"] < 1e-6
        del wanted["body_drag.c2"]
    shown = {name: after[name] / before[name] for name in wanted}
    assert shown == pytest.approx(wanted, rel=1e-4)
    ahead, right = cg or (0.0, 0.0)
    arm, heavy = start.keys["diagonal_size"], start.keys["mass"]
    assert after["trim.x"] == pytest.approx(right * arm * heavy * G / start.inertia[0] / i[0], rel=1e-4, abs=1e-4)
    assert after["trim.y"] == pytest.approx(-ahead * arm * heavy * G / start.inertia[1] / i[1], rel=1e-4, abs=1e-4)
    parts = own_patches(effects, {}, frame, geometry=PLUS)
    whole = airframe_patch(effects, {}, frame, geometry=PLUS)
    joined: dict[str, Any] = {}
    for part in parts:
        joined |= part.get("frame_json", {})
    assert joined == dict(whole.frame_json)
