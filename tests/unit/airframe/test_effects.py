"""The catalogue: what each effect does to a flight's parameters, and that its derivative is one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcal.calib.airframe.answer import Domain
from mavcal.calib.airframe.density import Densities, Density
from mavcal.calib.airframe.effects import IDS, AirframeEffect, applied, catalogue, nameless, of_density
from mavcal.calib.airframe.ground import ID as GROUND
from mavcal.calib.airframe.nameless import GROUPS
from mavcal.calib.airframe.physics import Airframe, Kind, Layout
from mavcal.calib.airframe.words import FIXES
from tests.unit.airframe.made import airframe, flight, hover, theta


@pytest.fixture(scope="module")
def model() -> Airframe:
    rng = np.random.default_rng(2)
    n = 400
    c = hover(4.0) + 0.05 * rng.normal(size=(n, 4))
    return airframe(flight(c, velocity=rng.normal(size=(n, 3)), rate=0.1 * rng.normal(size=(n, 3))))


def every(layout: Layout, *, rotors_damp: bool = True) -> tuple[AirframeEffect, ...]:
    air = of_density(Densities(Density(1.0, 0.01), Density(1.2, 0.01)), rotors_damp=rotors_damp)
    gain = (280.0, 280.0, 7.0)
    named = catalogue(layout, Kind(drag_by_rotor=rotors_damp), gain)
    return (*named, air, *nameless(layout))


def flying(model: Airframe) -> np.ndarray:
    return theta(
        model, expo=0.65, c1=0.24, c2=0.03, cz=0.2, damping_x=2.0, damping_y=2.0, damping_z=1.9, tau=0.02, torque_x=1.0,
        torque_z=-0.5, flap_x=0.1,
    )  # fmt: skip


def block(model: Airframe, name: str) -> AirframeEffect:
    return next(e for e in every(model.layout) if e.block == name)


def real(model: Airframe, name: str, *amplitudes: float, damps: bool = True) -> dict[str, tuple[float, float]]:
    """Parameters that an effect changes: before and after. `damps`: its rotors drag and damp."""
    before = flying(model)
    effect = next(e for e in every(model.layout, rotors_damp=damps) if e.block == name)
    after, _ = applied(model.layout, before, [effect], np.array(amplitudes))
    changed = np.flatnonzero(before != after)
    return {model.layout.names[k]: (float(before[k]), float(after[k])) for k in changed}


def test_without_effects_both_flights_have_one_airframe(model: Airframe) -> None:
    before = flying(model)
    after, slope = applied(model.layout, before, [], np.empty(0))
    np.testing.assert_array_equal(after, before)
    np.testing.assert_array_equal(slope, np.eye(len(before)))


def test_the_derivative_is_that_of_finite_differences(model: Airframe) -> None:
    rng = np.random.default_rng(5)
    effects, before = every(model.layout), flying(model)
    for _ in range(12):
        chosen = [effects[k] for k in sorted(rng.choice(len(effects), 5, replace=False))]
        z = 0.2 * rng.normal(size=sum(len(e.names) for e in chosen))
        _, slope = applied(model.layout, before, chosen, z)
        whole, step = np.concatenate([before, z]), 1e-6
        for k in range(len(whole)):
            ends = []
            for way in (1.0, -1.0):
                moved = whole.copy()
                moved[k] += way * step
                ends.append(applied(model.layout, moved[: len(before)], chosen, moved[len(before) :])[0])
            np.testing.assert_allclose(slope[:, k], (ends[0] - ends[1]) / (2.0 * step), atol=2e-7, rtol=1e-6)


def test_a_lift_by_itself_leaves_yaw_as_it_was(model: Airframe) -> None:
    assert real(model, "thrust_by_lift", -0.1, damps=False) == {
        "k": (25.0, pytest.approx(22.5)), "gain_x": (280.0, pytest.approx(252.0)),
        "gain_y": (280.0, pytest.approx(252.0)),
    }  # fmt: skip


def test_linear_drag_goes_with_the_mass_where_it_does_not_follow_the_rotors(model: Airframe) -> None:
    """As in SIH, where a mass of 1.25 was a thrust beside a drag of .88."""
    for damps, share in ((True, 0.9), (False, 0.8)):
        before, after = real(model, "thrust_by_mass", -0.2, damps=damps)["c1"]
        assert after / before == pytest.approx(share)


def test_a_force_on_all_motors_scales_thrust_and_what_turns(model: Airframe) -> None:
    assert real(model, "thrust_scale", -0.1) == {
        "k": (25.0, pytest.approx(22.5)), "gain_x": (280.0, pytest.approx(252.0)),
        "gain_y": (280.0, pytest.approx(252.0)), "gain_z": (7.0, pytest.approx(6.3)),
    }  # fmt: skip


def test_inertia_divides_all_that_turns_about_its_axis_and_nothing_else(model: Airframe) -> None:
    found = real(model, "inertia_x", 0.25)
    assert {name: after / before for name, (before, after) in found.items()} == {
        name: pytest.approx(0.8) for name in ("gain_x", "damping_x", "torque_x", "flap_x")
    }
    assert {n[-1] for n in real(model, "inertia_xy", 0.25)} == {"x", "y"}


def test_drag_of_rotors_damps_turns_where_rotors_do(model: Airframe) -> None:
    """Measured in ArduPilot's simulator (AIRFRAME 8); PX4's has a constant of its own."""
    assert {"c1", "cz", "damping_x", "damping_y", "damping_z"} <= set(real(model, "rotor_drag", 0.6))
    bare = next(e for e in every(model.layout, rotors_damp=False) if e.id == "rotor_drag")
    assert {c.parameter for c in bare.changes} == {"c1", "cz"}
    alone = real(model, "rotor_drag_across", 0.6, 0.5, 0.4)
    assert {name: after / before for name, (before, after) in alone.items()} == {
        "c1": pytest.approx(1.6), "flap_x": pytest.approx(1.5), "damping_z": pytest.approx(1.4),
    }  # fmt: skip


def test_another_mass_leaves_torques_alone_but_those_of_the_rotors_speed(model: Airframe) -> None:
    found = {name: after / before for name, (before, after) in real(model, "thrust_by_mass", 0.2).items()}
    root = math.sqrt(1.2)
    assert found == {
        "k": pytest.approx(1.2), "c1": pytest.approx(root, rel=0.01), "cz": pytest.approx(root, rel=0.01),
        "c2_x": pytest.approx(1.2), "c2_y": pytest.approx(1.2), "flap_x": pytest.approx(1.0 / root, rel=0.02),
    }  # fmt: skip


@pytest.mark.parametrize(
    ("name", "amplitudes", "changes"),
    [
        ("thrust_expo", (-0.17,), {"expo": -0.17}),
        ("cg_offset", (0.03, -0.02), {"cg_x": 0.03, "cg_y": -0.02}),
        ("motor_weak_3", (-0.08,), {"weak_3": -0.08}),
        ("motor_pulse_1", (-0.04,), {"pulse_1": -0.04}),
        ("battery_sag", (2.0,), {"sag": 2.0}),
        ("motor_lag", (0.04,), {"tau": 0.04}),
        ("actuator_delay", (0.01,), {"delay": 0.01}),
        ("inflow_of_turns", (0.1, 0.6, 0.4), {"cz": 0.1, "damping_x": 0.6, "damping_y": 0.4}),
        ("wind", (-1.1, -4.0), {"wind_north": -1.1, "wind_east": -4.0}),
        ("torque_bias", (1.0, 2.0, 3.0), {"torque_x": 1.0, "torque_y": 2.0, "torque_z": 3.0}),
    ],
)
def test_differences_are_added(
    model: Airframe, name: str, amplitudes: tuple[float, ...], changes: dict[str, float]
) -> None:
    found = real(model, name, *amplitudes)
    assert {n: pytest.approx(after - before) for n, (before, after) in found.items()} == changes


def test_effects_apply_one_after_the_other(model: Airframe) -> None:
    chosen = [block(model, "thrust_scale"), block(model, "inertia_x"), block(model, "yaw_coefficient")]
    after, _ = applied(model.layout, flying(model), chosen, np.array([0.1, 0.25, -0.2]))
    place = model.layout.place
    assert after[place["gain_x"]] == pytest.approx(280.0 * 1.1 / 1.25)
    assert after[place["gain_z"]] == pytest.approx(7.0 * 1.1 * 0.8)


def test_every_block_changes_something_and_no_two_have_one_name(model: Airframe) -> None:
    effects = every(model.layout)
    assert len({e.block for e in effects}) == len(effects)
    assert {e.id for e in effects if not e.nameless} == IDS
    assert {e.id for e in effects if e.nameless} <= {g.id for g in GROUPS}
    for effect in effects:
        assert len(effect.names) == len(effect.sd)
        assert all(s > 0.0 for s in effect.sd)
        if not effect.slew:
            assert {c.amplitude for c in effect.changes} == set(range(len(effect.names)))
        assert {c.parameter for c in effect.changes} <= set(model.layout.names)


def test_what_the_day_makes_is_no_airframe(model: Airframe) -> None:
    of_air = {e.id for e in every(model.layout) if e.domain is Domain.ENVIRONMENT}
    assert of_air == {"wind", "slow_force_world", "air_density"}


def test_each_motor_is_as_likely_to_be_weak_and_all_together_as_any_effect(model: Airframe) -> None:
    weak = [e for e in every(model.layout) if e.id == "motor_weak"]
    assert {e.motor for e in weak} == {1, 2, 3, 4}
    assert sum(e.odds for e in weak) == pytest.approx(block(model, "thrust_scale").odds)
    for motor in range(1, 5):
        assert len({e.exclusive for e in weak if e.motor == motor}) == 1
    hexa = catalogue(Layout(6), Kind(), (280.0, 280.0, 7.0))
    assert {e.motor for e in hexa} == {None, *range(1, 7)}


def test_of_every_effect_it_is_known_what_to_fly() -> None:
    assert set(FIXES) == IDS | {GROUND}  # judged beside the posterior


def test_a_nameless_column_acts_on_its_axis_and_has_unit_size(model: Airframe) -> None:
    assert model.layout.free == tuple(n for n in model.layout.names if n.startswith("free_"))
    for column, signal in zip(model.free, model.free_signals, strict=True):
        assert np.sqrt((column.values**2).reshape(400, -1).sum(axis=1).mean()) == pytest.approx(
            np.sqrt(column.values.reshape(400, -1).shape[1]), rel=0.01
        )
        acts = np.flatnonzero(np.abs(signal).max(axis=0) > 1e-12)
        assert set(acts) <= ({0, 1, 2} if column.values.ndim == 2 else {column.axis})
        assert ("torque" in column.group) == bool(set(acts) & {3, 4, 5})
