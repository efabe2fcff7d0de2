from __future__ import annotations

import json

import numpy as np
import pytest

from mavcal.calib.blind.airframe.cases import HOVERS, AirTier, drafted, make_air_case, make_air_label
from mavcal.calib.blind.airframe.changes import hovers
from mavcal.calib.blind.airframe.effects import KINDS
from mavcal.calib.blind.airframe.seal import AIR_PLAN, air_generator_sha256, air_scorer_sha256
from mavcal.calib.blind.airframe.strange import STRANGE
from mavcal.calib.blind.airframe.surroundings import ENVIRONMENT
from mavcal.calib.blind.airframe.thinned import THINNINGS
from mavcal.calib.blind.airframe.vehicle import GRAVITY
from mavcal.calib.recording import Sensor


def labels(tier: AirTier, count: int) -> list[dict]:
    return [make_air_label(tier, seed) for seed in range(count)]


def test_a_flight_of_full_length_goes_as_planned(log):
    t = log["t"] - log["t"][0]
    assert 95.0 < t[-1] < 135.0
    motors = np.stack([log[k] for k in log if k.startswith("motor_")], axis=1)
    flying = motors.max(axis=1) > 0.05
    assert 75.0 < t[flying][-1] - t[flying][0] < 120.0
    assert ((motors[flying] <= 0.0) | (motors[flying] >= 1.0)).any(axis=1).mean() < 0.05
    speed = np.linalg.norm([log[f"vel_{k}"] for k in "ne"], axis=0)
    assert 6.0 < np.nanmax(speed) < 11.0
    assert np.nanmax(np.abs(log["vel_d"])) > 1.5
    assert 6.0 < np.nanmax(log["height"]) < 30.0
    down = 1.0 - 2.0 * (log["q_x"] ** 2 + log["q_y"] ** 2)
    assert np.nanmin(down) > np.cos(np.radians(60.0))
    rates = [np.nanmax(np.abs(log[f"gyro_{k}"])) for k in "xyz"]
    assert min(rates) > 0.5
    assert max(rates) < 6.0
    for rest in (t < 7.5, t > t[-1] - 2.0):  # before and after: gravity
        assert np.nanmean(log["accel_z"][rest]) == pytest.approx(-GRAVITY, abs=0.15)


@pytest.mark.long
def test_a_case_is_its_seed_and_two_flights():
    case = make_air_case(AirTier.SINGLE, 5)
    again = make_air_case(AirTier.SINGLE, 5)
    assert case.label == again.label == make_air_label(AirTier.SINGLE, 5)
    assert all(np.array_equal(case.real[k], again.real[k], equal_nan=True) for k in case.real)
    assert set(case.real) == set(case.sim)
    assert case.label["air"]["real"] != case.label["air"]["sim"]
    real, sim = case.recordings()
    assert real.parameters == sim.parameters
    assert real.instances(Sensor.ACCEL) == (0, 1)


@pytest.mark.long
@pytest.mark.parametrize("tier", AirTier)
@pytest.mark.parametrize("seed", range(2))
def test_every_case_flies_and_lands(tier, seed):
    case = make_air_case(tier, seed)
    assert case.frame == case.label["frame"]
    assert len(case.id) == 16


@pytest.mark.parametrize("tier", AirTier)
def test_a_label_is_its_seed_and_can_be_written(tier):
    for seed in range(4):
        label = make_air_label(tier, seed)
        assert label == make_air_label(tier, seed)
        assert json.loads(json.dumps(label)) == label
    assert make_air_label(tier, 0)["id"] != make_air_label(tier, 1)["id"]


def test_every_tier_holds_what_it_says():
    names = {tier: [{e["id"] for e in x["effects"]} for x in labels(tier, 60)] for tier in AirTier}
    assert not any(names[AirTier.NULL])
    assert {n for each in names[AirTier.SINGLE] for n in each} <= {k.id for k in (*KINDS, *ENVIRONMENT)}
    assert all(len(each) == 1 for each in names[AirTier.SINGLE])
    assert {len(each) for each in names[AirTier.MIXED]} == {2, 3, 4}
    assert any("accel_bias" in each and "rotor_drag" in each for each in names[AirTier.MIXED])
    for label in labels(AirTier.LEFT_OUT, 10):
        assert label["without"] == [label["effects"][0]["id"]]
    assert {x["frame"] for x in labels(AirTier.FOREIGN, 20)} >= {"quad-x", "hexa-x", "octa-x"}
    strange = labels(AirTier.UNKNOWN, 40)
    assert {x["unknown"][0]["id"] for x in strange} == {k.id for k in STRANGE}
    assert not any(x["effects"] for x in strange)
    for label in labels(AirTier.LOGGING, 20):
        assert label["effects"][0]["id"] in THINNINGS[label["thinning"]].hides


def test_every_kind_of_single_is_drawn():
    seen = {make_air_label(AirTier.SINGLE, seed)["effects"][0]["id"] for seed in range(200)}
    assert seen == {k.id for k in (*KINDS, *ENVIRONMENT)}


def test_both_vehicles_can_fly():
    for seed in range(20):
        pair = drafted(AirTier.MIXED, seed)[1].pair
        for side in (pair.real, pair.sim):
            assert HOVERS[0] <= hovers(side.vehicle) <= HOVERS[1]


def test_what_makes_cases_and_what_judges_them_are_sealed_apart():
    assert air_generator_sha256() != air_scorer_sha256()
    assert set(AIR_PLAN) == set(AirTier)
