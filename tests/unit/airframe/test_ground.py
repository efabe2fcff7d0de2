"""Ground effect: what rows near the ground say, with a known truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import toeplitz

from mavcal.calib.airframe.diagnose import airframe_gap
from mavcal.calib.airframe.effects import ODDS
from mavcal.calib.airframe.found import AirframeAnswer, FoundEffect
from mavcal.calib.airframe.ground import ID, TOLD_AT_M, compared, gain_at, power
from mavcal.calib.airframe.low import LowFlight, Pass, noise_by_lag
from mavcal.calib.recording import Recording, Sensor
from tests.unit.airframe.flights import flight

LEGS = 0.15
RADIUS = 0.2
"""Of one rotor that has the ground effect of the vehicle, m."""


def told(s: float) -> float:
    return float(gain_at(s, np.array([TOLD_AT_M]))[0])


@pytest.mark.parametrize(("height", "gain"), [(0.25, 1.0 / 0.96 - 1.0), (0.5, 1.0 / 0.99 - 1.0), (10.0, 2.5e-5)])
def test_the_gain_is_cheeseman_and_bennetts(height: float, gain: float) -> None:
    assert gain_at(0.04, np.array([height]))[0] == pytest.approx(gain, rel=1e-3)


def low(s: float, *, seed: int, sd: float = 0.003, legs: float = LEGS, hover_s: float = 8.0) -> LowFlight:
    """A descent from 3 m at 0.4 m/s and a hover 0.15 m above the stand, 10 rows a second."""
    rng = np.random.default_rng(seed)
    height = np.concatenate([np.arange(3.0, 0.15, -0.04), np.full(round(10.0 * hover_s), 0.15)])
    gain = gain_at(s, height + legs) + 0.004 * rng.normal() + sd * rng.normal(size=len(height))
    noise = np.zeros(30)
    noise[0] = sd**2
    return LowFlight((Pass(gain, height + 0.02 * rng.normal()),), noise, 0.1, 0.03)


@pytest.mark.parametrize("period", [0.4, 0.7, 1.9, 5.0])
def test_the_noise_of_thrust_is_a_covariance_in_swinging_flight(period: float) -> None:
    """A thrust that swung ended the diagnosis: not positive definite."""
    swing = 0.1 * np.sin(2.0 * np.pi * 0.1 * np.arange(600) / period)
    swing[200:260] = np.nan
    noise = noise_by_lag(swing, 30)
    assert noise is not None
    longer = np.concatenate([noise, np.zeros(170)])
    assert np.linalg.eigvalsh(toeplitz(longer)).min() > 0.0


def test_a_gain_that_only_the_real_flight_has_is_found_with_its_size() -> None:
    inside = 0
    for seed in range(20):
        found = compared(low(0.03, seed=seed, legs=0.12), low(0.0, seed=100 + seed), ODDS)
        assert found.probability > 0.99
        inside += abs(found.value - told(0.03)) < 1.96 * found.sd
    assert inside >= 17


@pytest.mark.parametrize("s", [0.0, 0.03])
def test_what_both_flights_have_is_no_gap(s: float) -> None:
    chances = [compared(low(s, seed=seed), low(s, seed=100 + seed), ODDS).probability for seed in range(20)]
    assert max(chances) < 0.5


def test_a_gain_that_only_the_simulator_has_is_a_gap_below_zero() -> None:
    found = compared(low(0.0, seed=1), low(0.03, seed=2), ODDS)
    assert found.probability > 0.99
    assert found.value == pytest.approx(-told(0.03), abs=3.0 * found.sd)


def test_loud_rows_have_no_power() -> None:
    assert power(low(0.0, seed=1)) > 50.0
    assert power(low(0.0, seed=1, sd=0.05)) < 5.0


def diagnosed(real: Recording, sim: Recording) -> AirframeAnswer:
    found = airframe_gap(real, sim)
    assert isinstance(found, AirframeAnswer), found
    return found


def named(answer: AirframeAnswer) -> list[FoundEffect]:
    return [f for f in answer.found if f.id != "wind"]


@pytest.fixture(scope="module")
def low_sim(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return low_flown(tmp_path_factory.mktemp("low") / "x.bin")


def low_flown(
    path: Path, frame: dict[str, Any] | None = None, *, other: bool = False, **parameters: float
) -> Recording:
    return flight(path, frame, other=other, low=True, RNGFND1_TYPE=1.0, **parameters)


def without_rangefinder(recording: Recording) -> Recording:
    return replace(recording, dynamics=tuple(c for c in recording.dynamics if c.sensor != Sensor.HEIGHT))


@pytest.mark.long
def test_a_vehicle_with_ground_effect_is_told_from_a_simulator_without(tmp_path: Path, low_sim: Recording) -> None:
    real = low_flown(tmp_path / "x.bin", {"groundRadius": RADIUS}, other=True)
    (found,) = named(diagnosed(real, low_sim))
    assert found.id == ID
    assert found.probability > 0.99
    (value,) = found.values
    assert value.sim == pytest.approx(0.0, abs=0.005)
    assert abs(value.value - told(RADIUS**2)) < 1.96 * value.sd
    left_out = airframe_gap(real, low_sim, without={ID})
    assert isinstance(left_out, AirframeAnswer)
    assert ID not in {f.id for f in left_out.found} | {m.id for m in left_out.missing}
    # with the estimator's height only, which wanders by a decimetre, it is no other name
    blind = diagnosed(without_rangefinder(real), without_rangefinder(low_sim))
    assert {f.id for f in named(blind)} <= {ID}


@pytest.mark.long
def test_take_off_low_hover_and_landing_of_alike_vehicles_show_nothing(tmp_path: Path, low_sim: Recording) -> None:
    real = low_flown(tmp_path / "x.bin", other=True, SIM_WIND_SPD=2.0, SIM_WIND_DIR=200.0)
    answer = diagnosed(real, low_sim)
    assert named(answer) == []
    assert ID not in {m.id for m in answer.missing}
    blind = diagnosed(without_rangefinder(real), without_rangefinder(low_sim))
    assert named(blind) == []


@pytest.mark.long
def test_flights_that_stay_high_say_what_they_lack(usual: Recording, simulated: Recording) -> None:
    (lacks,) = (m for m in diagnosed(usual, simulated).missing if m.id == ID)
    assert "hovers for less than 6 s" in lacks.reason
    assert "0.3 m" in lacks.need
    bare = replace(usual, dynamics=tuple(c for c in usual.dynamics if c.sensor != Sensor.PLACE))
    (lacks,) = (m for m in diagnosed(bare, simulated).missing if m.id == ID)
    assert lacks.reason == "the real flight logs no height"
