"""Air density: what two logs tell of it, and thrust that follows it, with a known truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavcal.calib.airframe.answer import Domain
from mavcal.calib.airframe.density import Densities, Density, altitude_of, densities, density_of
from mavcal.calib.airframe.diagnose import airframe_gap
from mavcal.calib.airframe.found import AirframeAnswer, FoundEffect
from mavcal.calib.airframe.testable import Missing
from mavcal.calib.recording import Channel, ParameterTimeline, Recording, Sensor, Stage
from tests.unit.airframe.flights import flight
from tests.unit.airframe.made import recording

HIGH_M, HOME_M = 2000.0, 584.0


def standard(altitude: float) -> float:
    """Standard atmosphere of 1976, kg/m3."""
    return 1.225 * (1.0 - 0.0065 * altitude / 288.15) ** 4.2559


def in_air(pressure: float, warm: float, **parameters: float) -> Recording:
    t = np.arange(0.0, 60.0, 0.1)
    air = Channel(Sensor.AIR, 0, t, np.tile([pressure, warm], (len(t), 1)), "Pa degC", Stage.RAW, "BARO")
    made = recording()
    kept = ParameterTimeline.constant({**made.parameters.final(), **parameters})
    return replace(made, dynamics=(*made.dynamics, air), parameters=kept)


def at_altitude(altitude: float) -> Recording:
    t = np.arange(0.0, 60.0, 0.2)
    place = np.tile([47.0, 8.0, altitude], (len(t), 1))
    made = recording()
    return made.with_channels((*made.channels, Channel(Sensor.POSITION, 0, t, place, "", Stage.RAW, "GPS")))


def test_the_density_is_that_of_a_gas_ten_degrees_cooler_than_its_barometer() -> None:
    found = density_of(in_air(101325.0, 25.0), 0.0, 60.0)
    assert found is not None
    assert found.value == pytest.approx(1.225, rel=1e-3)
    assert found.sd == pytest.approx(0.021, abs=0.001)


def test_a_simulator_flies_in_the_standard_atmosphere_however_warm_its_board_is() -> None:
    found = density_of(in_air(94502.8, 29.7, SIM_OPOS_ALT=HOME_M), 0.0, 60.0)
    assert found is not None
    assert found.value == pytest.approx(standard(HOME_M), rel=1e-3)
    assert found.sd < 0.01


def test_the_altitude_alone_tells_less_and_nothing_tells_nothing() -> None:
    found = density_of(at_altitude(HIGH_M), 0.0, 60.0)
    assert found is not None
    assert found.value == pytest.approx(standard(HIGH_M), rel=1e-3)
    assert found.sd == pytest.approx(0.04)
    assert density_of(recording(), 0.0, 60.0) is None


@pytest.mark.parametrize("altitude", [0.0, HOME_M, HIGH_M])
def test_the_altitude_of_a_density(altitude: float) -> None:
    assert altitude_of(standard(altitude)) == pytest.approx(altitude, abs=0.1)


def test_densities_that_may_be_equal_expect_no_effect() -> None:
    sea, high = Density(1.22, 0.02), Density(1.0, 0.003)
    both = densities(sea, high, {})
    assert isinstance(both, Densities)
    assert both.excess == pytest.approx(0.22)
    assert both.alike is None
    for real, sim, said in (
        (sea, Density(1.2, 0.003), "agree to within 6 %"),
        (sea, Density(1.2, 0.06), "known to 6 % only"),
        (Density(1.203, 0.003), Density(1.2, 0.003), "agree to within 1 %"),
    ):
        near = densities(real, sim, {})
        assert isinstance(near, Densities)
        assert near.alike is not None
        assert said in near.alike.reason
        assert near.alike.need


def test_densities_that_are_not_known_say_why() -> None:
    sea = Density(1.22, 0.02)
    for real, sim, settings, said in (
        (None, sea, {}, "the real log has no pressure"),
        (sea, None, {}, "the simulated log has no pressure"),
        (sea, sea, {"SIH_MASS": 1.0}, "does not depend on the air"),
    ):
        lacks = densities(real, sim, settings)
        assert isinstance(lacks, Missing)
        assert said in lacks.reason
        assert lacks.need


def test_air_explains_a_thrust_of_its_own_size_only() -> None:
    both = Densities(Density(1.24, 0.02), Density(1.2, 0.003))
    assert both.explains(0.05, 0.004)
    assert both.explains(0.0, 0.004)
    assert not both.explains(-0.05, 0.004)
    assert not both.explains(0.08, 0.004)


def as_vehicle(found: Recording, warmer: float = 12.0) -> Recording:
    """Without the parameters that say that it is simulated: its air is measured like any other's."""
    own = {n: v for n, v in found.parameters.final().items() if not n.startswith("SIM_")}
    warm = tuple(
        replace(c, values=c.values + np.array([0.0, warmer])) if c.sensor == Sensor.AIR else c for c in found.dynamics
    )  # fmt: skip
    return replace(found, parameters=ParameterTimeline.constant(own), dynamics=warm)


def diagnosed(real: Recording, sim: Recording) -> tuple[AirframeAnswer, dict[str, FoundEffect]]:
    answer = airframe_gap(real, sim)
    assert isinstance(answer, AirframeAnswer), answer
    return answer, {f.id: f for f in answer.found if f.id != "wind"}


TRUE = standard(HIGH_M + 10.0) / standard(HOME_M + 10.0) - 1.0
CASES: Mapping[str, tuple[Mapping[str, Any], Mapping[str, float], Mapping[str, float]]] = {
    "air": ({}, {"SIM_OPOS_ALT": HIGH_M}, {"air_density": TRUE}),
    "thrust": ({"hoverThrOut": 0.39 / 0.93}, {}, {"thrust_scale": -0.07}),
    "both": ({"hoverThrOut": 0.39 / 0.9}, {"SIM_OPOS_ALT": HIGH_M}, {"air_density": TRUE, "thrust_scale": -0.1}),
}


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(CASES))
def test_thrust_of_thin_air_is_told_from_another_thrust(tmp_path: Path, simulated: Recording, name: str) -> None:
    frame, parameters, known = CASES[name]
    real = as_vehicle(flight(tmp_path / "x.bin", frame, other=True, **parameters))
    answer, found = diagnosed(real, simulated)
    assert set(found) == set(known)
    for id_, value in known.items():
        said = found[id_].values[0]
        assert abs(said.value - value) < 2.5 * max(said.sd, 0.003)
    assert ("air_density" in {m.id for m in answer.missing}) is ("air_density" not in known)
    if "air_density" in known:
        assert found["air_density"].domain is Domain.ENVIRONMENT
        altitude = next(v for v in found["air_density"].values if v.name == "altitude")
        assert abs(altitude.value - HIGH_M) < 3.0 * altitude.sd + 30.0


@pytest.mark.long
@pytest.mark.parametrize(("ratio", "rivals"), [(1.04, {"air_density"}), (0.96, set())])
def test_a_thrust_that_the_air_may_be_is_named_with_the_air_as_its_rival(
    tmp_path: Path, simulated: Recording, ratio: float, rivals: set[str]
) -> None:
    """A barometer that is 10 degrees too warm or right leaves 4 % of thrust open: nothing was named."""
    real = as_vehicle(flight(tmp_path / "x.bin", {"hoverThrOut": 0.39 / ratio}, other=True), warmer=0.0)
    _, found = diagnosed(real, simulated)
    assert set(found) == {"thrust_scale"}
    assert abs(found["thrust_scale"].values[0].value - (ratio - 1.0)) < 0.012
    assert {r.id for r in found["thrust_scale"].rivals} == rivals


@pytest.mark.long
def test_air_that_thrust_does_not_follow_is_not_named(tmp_path: Path, simulated: Recording) -> None:
    """A log whose barometer says 2000 m, of a vehicle that flew at home."""
    real = as_vehicle(flight(tmp_path / "x.bin", other=True))
    high = [79495.0, 12.0]
    wrong = tuple(
        replace(c, values=np.tile(high, (len(c), 1))) if c.sensor == Sensor.AIR else c for c in real.dynamics
    )  # fmt: skip
    _, found = diagnosed(replace(real, dynamics=wrong), simulated)
    assert found == {}
