"""PX4's simulation in hardware flies as the effects say: its formulas (AIRFRAME 4.2) with the patched parameters."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.calib.gap.export.airframe import airframe_patch
from mavcal.calib.gap.schema import EffectEstimate
from tests.examples import examples
from tests.unit.gap.export.making import airframe

FRESH = {"SIH_MASS": 1.0, "SIH_T_MAX": 5.0, "SIH_T_TAU": 0.05, "SIH_KDV": 1.0, "SIH_KDW": 0.025, "SIH_Q_MAX": 0.1}
FRESH |= {"SIH_IXX": 0.025, "SIH_IYY": 0.025, "SIH_IZZ": 0.03, "SIH_L_ROLL": 0.2, "SIH_L_PITCH": 0.2}


def flown(p: dict[str, float]) -> dict[str, float]:
    """Thrust over mass at full output, drag, gains of a full differential output, damping, lag."""
    return {
        "k": 4.0 * p["SIH_T_MAX"] / p["SIH_MASS"],
        "c1": p["SIH_KDV"] / p["SIH_MASS"],
        "x": 4.0 * p["SIH_L_ROLL"] * p["SIH_T_MAX"] / p["SIH_IXX"],
        "y": 4.0 * p["SIH_L_PITCH"] * p["SIH_T_MAX"] / p["SIH_IYY"],
        "z": 4.0 * p["SIH_Q_MAX"] / p["SIH_IZZ"],
        **{f"d{a}": p["SIH_KDW"] / p[f"SIH_I{a.upper() * 2}"] for a in "xyz"},
        "tau": p["SIH_T_TAU"],
    }


def after(*effects: EffectEstimate, mass: float | None = None) -> tuple[dict[str, float], tuple[str, ...]]:
    made = airframe_patch(effects, FRESH, mass=mass)
    assert dict(made.frame_json) == {}
    return {**FRESH, **made.parameters}, made.lost


def test_parameters_of_the_reference_flights() -> None:
    assert after(airframe("thrust_scale", s=0.9), airframe("yaw_coefficient", s=1 / 0.9))[0] == pytest.approx(
        FRESH | {"SIH_T_MAX": 4.5}
    )
    assert after(airframe("rotor_drag", c1=0.6))[0] == FRESH | {"SIH_KDV": 0.6}
    assert after(airframe("motor_lag", tau_up=0.04))[0] == pytest.approx(FRESH | {"SIH_T_TAU": 0.09})


def test_another_mass_changes_all_forces_alike() -> None:
    """At the simulator's mass, thrust and drag grow by as much as the vehicle is lighter; at the real one they stay."""
    lighter = replace(airframe("thrust_scale", s=1.1), forms={"mass": 0.98, "thrust": 0.02})
    expected = flown(FRESH) | {"k": 22.0, "c1": 1.1}
    assert flown(after(lighter)[0]) == pytest.approx(expected)
    real, _ = after(lighter, mass=1.0 / 1.1)
    assert real == pytest.approx(FRESH | {"SIH_MASS": 1.0 / 1.1})


def test_lags_that_differ_become_one() -> None:
    found, lost = after(airframe("motor_lag", tau_up=0.02, tau_down=0.06))
    assert found["SIH_T_TAU"] == pytest.approx(0.09)
    assert "one for both directions; +0.02 s up and +0.06 s down" in lost[0]
    found, lost = after(airframe("motor_lag", tau_up=-0.08, tau_down=-0.08))
    assert found["SIH_T_TAU"] == 0.0
    assert "stays at 0" in lost[0]
    assert "no limit of the rate" in after(airframe("motor_lag", slew=-100.0))[1][0]


def test_one_damper_is_for_all_axes() -> None:
    found, lost = after(airframe("angular_damping", x=1.5, y=1.5, z=1.5))
    assert found["SIH_KDW"] == pytest.approx(0.0375)
    assert lost == ()
    found, lost = after(airframe("angular_damping", x=1.5, y=1.0))
    assert found["SIH_KDW"] == pytest.approx(0.03125)
    assert [text.split(";")[0].split(" also")[0] for text in lost] == [
        "angular_damping: SIH_KDW is one for all axes",
        "angular_damping: SIH_KDW",
    ]


def test_a_product_of_inertia_grows_with_the_moment_of_its_second_axis() -> None:
    """A share of 0.2: SIH_IXY of 0.005 made it, at moments of 0.025."""
    assert after(airframe("inertia", xy=0.2))[0] == pytest.approx(FRESH | {"SIH_IXY": 0.005})
    found, lost = after(airframe("inertia", z=1.5, xz=-0.1), mass=2.0)
    assert (found["SIH_IXZ"], found["SIH_IZZ"]) == pytest.approx((-0.009, 0.09))
    assert lost == ()


@pytest.mark.parametrize(
    ("effect_id", "name"),
    [
        ("thrust_expo", "expo"), ("actuator_delay", "delay"), ("motor_weak", "s"), ("body_drag", "c2"),
        ("inflow", "cz"), ("translational_lift", "ch"), ("cg_offset", "x"), ("torque_bias", "z"),
        ("battery_sag", "exponent"), ("payload_step", "s"),
    ],
)  # fmt: skip
def test_what_the_simulator_cannot_do_is_named(effect_id: str, name: str) -> None:
    motor = 2 if effect_id == "motor_weak" else None
    found, lost = after(airframe(effect_id, motor=motor, **{name: 0.9}))
    assert found == FRESH
    assert lost[0].startswith(f"{effect_id}{' of motor 2' if motor else ''}: SIH")


def ratio() -> st.SearchStrategy[float]:
    return st.floats(math.log(0.4), math.log(2.5)).map(math.exp)


@given(ratio(), ratio(), st.tuples(ratio(), ratio(), ratio()), ratio(), ratio(), st.none() | ratio())
@settings(max_examples=examples(100))
def test_any_mixture_gives_every_effect_its_ratio(
    thrust: float, drag: float, inertia: tuple[float, float, float], yaw: float, damping: float, mass: float | None
) -> None:
    x, y, z = inertia
    effects = (
        airframe("thrust_scale", s=thrust),
        airframe("rotor_drag", c1=drag),
        airframe("inertia", x=x, y=y, z=z),
        airframe("yaw_coefficient", s=yaw),
        airframe("angular_damping", x=damping, y=damping, z=damping),
    )
    found, lost = after(*effects, mass=mass)
    assert lost == ()
    before, now = flown(FRESH), flown(found)
    wanted = {"k": thrust, "c1": drag, "x": thrust / x, "y": thrust / y, "z": thrust * yaw / z, "tau": 1.0}
    wanted |= {"dx": damping / x, "dy": damping / y, "dz": damping / z}
    assert {name: now[name] / before[name] for name in wanted} == pytest.approx(wanted)
