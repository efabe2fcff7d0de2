from __future__ import annotations

import math
from dataclasses import asdict

import numpy as np
import pytest

from mavcal.calib.blind.airframe.effects import KINDS, MASS
from mavcal.calib.blind.airframe.flight import Events
from mavcal.calib.blind.airframe.seen import Seen, hover_ratio, see
from mavcal.calib.blind.airframe.sides import Entry, Pair
from tests.unit.blind.airframe.flights import calm_pair

SEEN = {
    "thrust": "thrust_scale",
    "expo": "thrust_expo",
    "exponent": "battery_sag",
    "rotor_drag": "rotor_drag",
    "body_drag": "body_drag",
    "inflow": "inflow",
    "lift": "translational_lift",
    "lever": "inertia",
    "yaw": "yaw_coefficient",
    "damping": "angular_damping",
}
"""Numbers of a model and the effect that each belongs to. Trim follows many effects."""
BY_ID = {kind.id: kind for kind in KINDS}
WEAK = {"thrust_scale", "inertia", "yaw_coefficient"}
"""What one weak motor does to the sums over all of them."""
STATIC = [i for i in BY_ID if i not in {"motor_lag", "actuator_delay", "ground_effect", "payload_step", "battery_sag"}]


def put(name: str, seed: int) -> tuple[Pair, Entry]:
    pair = BY_ID[name].put(np.random.default_rng(seed), calm_pair(seed))
    return pair, pair.entries[0]


def at_one_voltage(pair: Pair) -> tuple[Seen, Seen]:
    ratio = hover_ratio(pair.sim.vehicle)
    return see(pair.real.vehicle, ratio), see(pair.sim.vehicle, ratio)


def moved(pair: Pair) -> set[str]:
    """Effects whose numbers differ between the sides by more than 2 %."""
    real, sim = (asdict(seen) for seen in at_one_voltage(pair))
    return {SEEN[key] for key in SEEN if not np.allclose(real[key], sim[key], rtol=0.02, atol=1e-3)}


@pytest.mark.parametrize("name", STATIC)
def test_a_change_is_seen_in_its_own_number_and_in_those_that_the_label_admits(name):
    for seed in range(12):
        pair, entry = put(name, seed)
        trims = {"motor_weak", "cg_offset", "torque_bias"}
        assert moved(pair) <= {name, *entry.also} | (WEAK if name == "motor_weak" else set())
        if name not in trims:
            ratio = max((abs(math.log(r)) for r in entry.ratios.values()), default=1.0)
            assert name in moved(pair) or ratio < 0.05


def test_another_mass_divides_every_force_and_says_so():
    for seed in range(12):
        pair = MASS.put(np.random.default_rng(seed), calm_pair(seed))
        (entry,) = pair.entries
        assert moved(pair) <= {"thrust_scale", *entry.also}
        masses = [side.vehicle.hull.mass for side in (pair.real, pair.sim)]
        assert entry.params["s"] == pytest.approx(masses[1] / masses[0] - 1.0)


RATIOS = {
    "thrust_scale": ("s", lambda s: s.thrust),
    "rotor_drag": ("c1", lambda s: s.rotor_drag),
    "body_drag": ("c2", lambda s: s.body_drag),
    "yaw_coefficient": ("s", lambda s: s.yaw),
}


@pytest.mark.parametrize("name", RATIOS)
def test_the_label_is_the_ratio_of_what_is_seen(name):
    pair, entry = put(name, 4)
    key, get = RATIOS[name]
    real, sim = at_one_voltage(pair)
    ratio = get(real) / get(sim)
    assert entry.params[key] == pytest.approx(ratio - 1.0)
    assert entry.ratios[key] == pytest.approx(ratio)


def test_inertia_is_labelled_by_axis():
    for seed in range(8):
        pair, entry = put("inertia", seed)
        for axis, real, sim in zip("xyz", pair.real.vehicle.hull.inertia, pair.sim.vehicle.hull.inertia, strict=True):
            assert real / sim == pytest.approx(1.0 + entry.params.get(axis, 0.0))


def test_a_weak_motor_is_labelled_by_its_number_and_its_thrust():
    pair, entry = put("motor_weak", 3)
    factors = [r.factor for r in pair.real.vehicle.rotors]
    assert factors[int(entry.params["motor"]) - 1] == pytest.approx(1.0 + entry.params["s"])
    assert sum(f != 1.0 for f in factors) == 1
    assert entry.instances == (int(entry.params["motor"]),)


def test_a_shifted_centre_is_labelled_in_arms():
    pair, entry = put("cg_offset", 3)
    real, sim = at_one_voltage(pair)
    v = pair.sim.vehicle
    turned = (real.trim[1] - sim.trim[1]) * v.hull.inertia[1] / (v.weight * v.arm)
    assert -turned == pytest.approx(entry.params["x"], rel=0.05, abs=1e-3)


@pytest.mark.parametrize("seed", range(6))
def test_a_bias_is_the_moment_at_equal_commands(seed):
    pair, entry = put("torque_bias", seed)
    real, sim = (seen.trim for seen in at_one_voltage(pair))
    (axis,) = entry.params
    k = "xyz".index(axis)
    assert real[k] - sim[k] == pytest.approx(entry.params[axis])
    others = [abs(real[j] - sim[j]) for j in range(3) if j != k]
    assert max(others) < 0.1 * abs(entry.params[axis]) + 0.02


def test_a_dropped_load_is_a_step_of_mass():
    pair, entry = put("payload_step", 2)
    t = np.arange(0.0, 100.0, 0.0025)
    mass = pair.real.happenings[0](Events(), t, np.random.default_rng(0)).mass
    assert mass[0] == 1.0
    assert mass[-1] == pytest.approx(1.0 + entry.params["s"])
    assert t[np.flatnonzero(np.diff(mass))[0] + 1] == pytest.approx(entry.params["t"], abs=0.003)


def test_sizes_spread_over_their_range():
    sizes = [put("thrust_scale", seed)[1].ratios["s"] for seed in range(120)]
    assert 0.76 < min(sizes) < 0.85
    assert 1.18 < max(sizes) < 1.31
    assert np.median(np.abs(np.log(sizes))) == pytest.approx(math.sqrt(math.log(1.02) * math.log(1.3)), rel=0.3)


def test_every_number_of_a_model_has_an_effect():
    assert set(SEEN) | {"trim"} == set(Seen.__dataclass_fields__)
